//! What colour is seen in a sample, once it is known which shape is.

use glam::{Vec2, Vec4};

use crate::raster::setup::Shape;
use crate::raster::shade::{Material, Smooth, Weigher};
use crate::raster::tile::{NONE, Scene};
use crate::raster::visible::bits;

/// Shapes whose colours a tile remembers, a power of two: a leaf's triangles are seen row after row.
const KNOWN_COUNT: usize = 128;

/// The shape that was shaded last: its neighbours in the picture are often of the same one.
struct LastShaded<'a> {
    reference: u32,
    shape: &'a Shape,
    material: Material<'a>,
    weigher: Weigher,
    id: u32,
}

impl<'a> LastShaded<'a> {
    fn new<const S: usize>(scene: &Scene<'a, S>, reference: u32) -> Self {
        let (unit, index) = scene.referred(reference);
        let shape = &unit.shapes[index];
        let material = Material::new(scene.list, scene.view, unit, shape);
        let weigher = Weigher::new(scene.view, &material, unit, index);
        let id = material.source_id(unit.origins[index].primitive);
        Self { reference, shape, material, weigher, id }
    }
}

/// Untextured shapes of a batch whose colours a tile knows.
#[derive(Debug)]
pub(crate) struct Known {
    /// At the place of a reference's low bits: the shape that is there.
    references: [u32; KNOWN_COUNT],
    /// `None` where the shape has a texture.
    shapes: [Option<Smooth>; KNOWN_COUNT],
}

impl Default for Known {
    fn default() -> Self {
        Self { references: [NONE; KNOWN_COUNT], shapes: [None; KNOWN_COUNT] }
    }
}

impl Known {
    pub(crate) fn forget(&mut self) {
        self.references.fill(NONE);
    }
}

/// Finds the colours of shapes, and remembers those it has found.
pub(crate) struct Colors<'a, 'b> {
    known: &'b mut Known,
    last: Option<LastShaded<'a>>,
}

impl<'a, 'b> Colors<'a, 'b> {
    pub(crate) fn new(known: &'b mut Known) -> Self {
        Self { known, last: None }
    }

    /// Colours a pixel's waiting samples: `visit(mask, colours, id)` once for each shape, or once a
    /// sample where a texture may change between samples.
    #[inline(always)]
    pub(crate) fn each<const S: usize>(
        &mut self,
        scene: &Scene<'a, S>,
        x: i32,
        y: i32,
        references: &[u32; S],
        mut visit: impl FnMut(u32, [Vec4; 3], u32),
    ) {
        let mut left = 0_u32;
        for (s, &reference) in references.iter().enumerate() {
            left |= u32::from(reference != NONE) << s;
        }
        while left != 0 {
            let reference = references[left.trailing_zeros() as usize % S];
            let mut mask = 0_u32;
            for (s, &other) in references.iter().enumerate() {
                mask |= u32::from(other == reference) << s;
            }
            left &= !mask;
            if let Some((color, id)) = scene.flat(reference) {
                visit(mask, [color, Vec4::ZERO, Vec4::ZERO], id);
                continue;
            }
            if let Some(smooth) = self.smooth(scene, reference) {
                let color = smooth.color(scene.centroid(x, y, mask));
                visit(mask, [color, Vec4::ZERO, Vec4::ZERO], smooth.id);
                continue;
            }
            let known = self.last.take().filter(|last| last.reference == reference);
            let shaded =
                self.last.insert(known.unwrap_or_else(|| LastShaded::new(scene, reference)));
            let LastShaded { shape, material, weigher, id, .. } = shaded;
            if material.is_smooth() {
                let at = scene.centroid(x, y, mask);
                visit(mask, material.shade(shape, weigher, at, 0.0, scene.layers), *id);
            } else {
                let lod = material.lod(weigher, Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
                for s in bits(mask.into()) {
                    let point = scene.point(x, y, s);
                    let color = material.shade(shape, weigher, point, lod, scene.layers);
                    visit(1 << s, color, *id);
                }
            }
        }
    }

    #[inline(always)]
    fn smooth<const S: usize>(&mut self, scene: &Scene<'a, S>, reference: u32) -> Option<&Smooth> {
        let Known { references, shapes } = &mut *self.known;
        let place = reference as usize % KNOWN_COUNT;
        if references[place] != reference {
            references[place] = reference;
            let (unit, index) = scene.referred(reference);
            let color_alone = scene.layers == [true, false, false];
            let smooth = || Smooth::new(scene.view, scene.list, unit, index);
            shapes[place] = if color_alone { smooth() } else { None };
        }
        shapes[place].as_ref()
    }
}
