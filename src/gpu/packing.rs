//! From a draw list to what the shaders read of it, and to runs of items that are drawn in one go.

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

use crate::draw_list::{Blend, Buffers, DrawList, Geometry, Item, Primitive, Source, Surface};
use crate::error::{LodError, check_limit};
use crate::gpu::pipelines::{Key, Look, Mixing, Shapes, Targets};
use crate::texture::{Filter, Sampler};
use crate::view::View;

/// Quads that one draw call may have: the length of the pattern of their corners.
pub(crate) const PATTERN_QUADS: u32 = 1 << 18;

/// What rounding to a half leaves of a number at least, and some: alpha that equals a cutoff must pass.
const HALF_ROUNDING: f32 = 1.0 - 1.0 / 2048.0;

/// Primitives of an item that base vertices can count: corner numbers of quads are `i32`.
const MAX_QUAD: u64 = 1 << 29;

/// An instance as shaders read it.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct InstanceData {
    axes: [[f32; 4]; 3],
    offset: [f32; 4],
    tint: [f32; 4],
    params: [f32; 8],
    fade: f32,
    seed: u32,
    mirrored: u32,
    one: f32,
}

/// An item as shaders read it.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct ItemData {
    slab: [f32; 2],
    cutoff: f32,
    size: f32,
    has_ids: u32,
    step_count: u32,
    tolerance: f32,
    unused: u32,
}

/// What a surface reads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Reads {
    Nothing,
    Texture(u32, Sampler),
    Distribution(u32, u32, Sampler),
    Frames(u32, Sampler),
}

/// Consecutive items that are drawn with one state.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Run {
    /// With the targets of the picture.
    pub(crate) key: Key,
    pub(crate) vertices: Source,
    pub(crate) indices: Source,
    pub(crate) reads: Reads,
    /// Where in the arguments it begins, in words.
    pub(crate) first_word: usize,
    pub(crate) call_count: u32,
}

/// A list, packed.
#[derive(Debug, Default)]
pub(crate) struct Packed {
    pub(crate) instances: Vec<InstanceData>,
    pub(crate) items: Vec<ItemData>,
    /// One a copy of an item: item, instance, paint order of its primitive 0.
    pub(crate) draws: Vec<[u32; 4]>,
    /// Arguments of indirect draws.
    pub(crate) arguments: Vec<u32>,
    pub(crate) runs: Vec<Run>,
    /// Blended primitives, copies counted: their paint orders count from 1 to this.
    pub(crate) blended_count: u32,
    /// Corners that are submitted.
    pub(crate) corner_count: u64,
}

/// Words of the arguments of an indexed draw, and of one without indices.
const INDEXED_WORDS: usize = 5;
const PLAIN_WORDS: usize = 4;

impl Packed {
    /// Packs a list for pictures with such targets; `four` of 4 samples at once.
    ///
    /// # Errors
    /// A list of more primitives than numbers can count.
    pub(crate) fn new(
        list: &DrawList,
        view: &View,
        targets: Targets,
        four: bool,
    ) -> Result<Self, LodError> {
        let mut packed = Self::default();
        let scale = view.pixels_per_metre_at_one();
        let (right, down) = (view.right * (scale * view.pixel_aspect), -view.up * scale);
        packed.instances.extend(list.instances.iter().map(|instance| {
            let axis = |axis: Vec3, offset: f32| axis.extend(offset).to_array();
            let [x, y, z] =
                [instance.linear.x_axis, instance.linear.y_axis, instance.linear.z_axis];
            // far from the eye f32 sums would lose what tells a plant's vertices apart
            let far = instance.translation.as_dvec3();
            let offset = DVec3::new(right.dot(far), down.dot(far), -view.back.dot(far));
            InstanceData {
                offset: offset.as_vec3().extend(0.0).to_array(),
                axes: [
                    axis(x, instance.translation.x),
                    axis(y, instance.translation.y),
                    axis(z, instance.translation.z),
                ],
                tint: instance.tint.to_array(),
                params: instance.params,
                fade: instance.fade,
                seed: instance.seed,
                mirrored: u32::from(instance.linear.determinant() < 0.0),
                one: 1.0,
            }
        }));
        let mut order = 1_u64;
        for item in &list.items {
            packed.add(list, item, targets, four, &mut order)?;
        }
        check_limit("draw list", order, u64::from(u32::MAX), "blended primitives")?;
        packed.blended_count = u32::try_from(order - 1).expect("checked");
        Ok(packed)
    }

    fn add(
        &mut self,
        list: &DrawList,
        item: &Item,
        targets: Targets,
        four: bool,
        order: &mut u64,
    ) -> Result<(), LodError> {
        let primitive_count = item.primitives.len() as u64;
        if primitive_count == 0 || item.instances.is_empty() {
            return Ok(());
        }
        check_limit("draw list", u64::from(item.primitives.end), MAX_QUAD, "primitives")?;
        let number = u32::try_from(self.items.len()).expect("few items");
        let first_draw = u32::try_from(self.draws.len()).map_err(|_| too_many())?;
        let copies = &list.instances[item.instances.start as usize..item.instances.end as usize];
        let is_blended = item.blend == Blend::Over;
        for instance in item.instances.clone() {
            // wraps, and back when the primitive's number is added
            #[expect(clippy::cast_possible_truncation, reason = "checked by whoever packs")]
            let zero = (*order as u32).wrapping_sub(item.primitives.start);
            self.draws.push([number, instance, if is_blended { zero } else { 0 }, 0]);
            *order += if is_blended { primitive_count } else { 0 };
        }
        let (step_count, tolerance) = match item.surface {
            Surface::Parallax { step_count, tolerance, .. } => (step_count, tolerance),
            _ => (0, 0.0),
        };
        let [near, far] = item.slab.unwrap_or([0.0, f32::MAX]);
        self.items.push(ItemData {
            slab: [near, if far.is_finite() { far } else { f32::MAX }],
            cutoff: if let Blend::Test(cutoff) = item.blend { cutoff * HALF_ROUNDING } else { 0.0 },
            size: match item.primitive {
                Primitive::Lines { width_px: size } | Primitive::Points { size_px: size } => size,
                Primitive::Triangles | Primitive::Cards => 0.0,
            },
            has_ids: u32::from(!list.indices_of(item).source_ids.is_empty()),
            step_count,
            // none is the mark of what counts alike
            tolerance: if tolerance.is_finite() { tolerance } else { 0.0 },
            unused: 0,
        });
        let key = Key {
            shapes: shapes_of(item, targets),
            look: look_of(list, item.surface),
            mixing: match item.blend {
                Blend::Opaque => Mixing::Opaque,
                Blend::Test(_) => Mixing::Test,
                Blend::Coverage => Mixing::Coverage,
                Blend::Over => Mixing::Over,
            },
            writes_depth: item.depth_write,
            has_slab: item.slab.is_some(),
            is_dithered: copies.iter().any(|copy| copy.fade != 1.0),
            targets,
            four,
            search: None,
        };
        let reads = match item.surface {
            Surface::VertexColor => Reads::Nothing,
            Surface::Textured { texture, sampler } => Reads::Texture(texture, sampler),
            Surface::Indirect { distribution, leaves, sampler } => {
                Reads::Distribution(distribution, leaves, sampler)
            }
            Surface::Parallax { frames, sampler, .. } => Reads::Frames(frames, sampler),
        };
        let (vertices, indices) = (item.vertices, item.indices);
        let run = Run { key, vertices, indices, reads, first_word: 0, call_count: 0 };
        let copy_count = u32::try_from(copies.len()).expect("a range of u32");
        self.push_calls(item, run, copy_count, first_draw);
        self.corner_count += match item.primitive {
            Primitive::Triangles => 3,
            _ => 4,
        } * primitive_count
            * copies.len() as u64;
        Ok(())
    }

    /// Appends the calls that draw an item, to the last run if that has the same state.
    fn push_calls(&mut self, item: &Item, run: Run, copy_count: u32, first_draw: u32) {
        let goes_on = self.runs.last().is_some_and(|last| {
            *last == Run { first_word: last.first_word, call_count: last.call_count, ..run.clone() }
        });
        if !goes_on {
            self.runs.push(Run { first_word: self.arguments.len(), ..run.clone() });
        }
        let last = self.runs.last_mut().expect("one was pushed");
        let (start, end) = (item.primitives.start, item.primitives.end);
        match run.key.shapes {
            Shapes::Indexed => {
                last.call_count += 1;
                self.arguments.extend([3 * (end - start), copy_count, 3 * start, 0, first_draw]);
            }
            Shapes::Triangles => {
                last.call_count += 1;
                self.arguments.extend([3 * (end - start), copy_count, 3 * start, first_draw]);
            }
            Shapes::Cards | Shapes::Lines | Shapes::Points => {
                // copy after copy, or parts of a long item would be drawn before others of its copy
                let whole = end - start <= PATTERN_QUADS;
                let (copies, each) = if whole { (1, copy_count) } else { (copy_count, 1) };
                for copy in 0..copies {
                    for first in (start..end).step_by(PATTERN_QUADS as usize) {
                        let count = (end - first).min(PATTERN_QUADS);
                        last.call_count += 1;
                        self.arguments.extend([6 * count, each, 0, 4 * first, first_draw + copy]);
                    }
                }
            }
        }
    }
}

/// Copies of items beyond what a number counts.
fn too_many() -> LodError {
    let (asked, limit) = (u64::from(u32::MAX) + 1, u64::from(u32::MAX));
    LodError::Limit { name: "draw list", asked, limit, unit: "copies of items" }
}

impl Run {
    /// Whether its calls have indices.
    pub(crate) fn is_indexed(&self) -> bool {
        self.key.shapes != Shapes::Triangles
    }

    /// The arguments of its calls.
    pub(crate) fn arguments<'a>(&self, all: &'a [u32]) -> impl Iterator<Item = &'a [u32]> {
        let words = if self.is_indexed() { INDEXED_WORDS } else { PLAIN_WORDS };
        all[self.first_word..].chunks_exact(words).take(self.call_count as usize)
    }
}

/// Triangles need no numbers of their own, and so share corners, unless something asks for the numbers.
fn shapes_of(item: &Item, targets: Targets) -> Shapes {
    match item.primitive {
        Primitive::Triangles if targets.ids || item.blend == Blend::Coverage => Shapes::Triangles,
        Primitive::Triangles => Shapes::Indexed,
        Primitive::Cards => Shapes::Cards,
        Primitive::Lines { .. } => Shapes::Lines,
        Primitive::Points { .. } => Shapes::Points,
    }
}

fn look_of(list: &DrawList, surface: Surface) -> Look {
    let has_levels = |sampler: Sampler| sampler.filter == Filter::Trilinear;
    match surface {
        Surface::VertexColor => Look::Vertex,
        Surface::Textured { sampler, .. } => Look::Textured { trilinear: has_levels(sampler) },
        Surface::Indirect { sampler, .. } => Look::Indirect { trilinear: has_levels(sampler) },
        Surface::Parallax { frames, sampler, .. } => Look::Parallax {
            trilinear: has_levels(sampler),
            relit: list.frames[frames as usize].parts().relit.is_some(),
        },
    }
}

/// Least and greatest coordinates of vertices; the first above the second where there are none.
pub(crate) fn bounds_of(buffers: &Buffers) -> [Vec3; 2] {
    let start = [Vec3::INFINITY, Vec3::NEG_INFINITY];
    buffers.positions.iter().fold(start, |[low, high], &at| [low.min(at), high.max(at)])
}

/// A little more than the greatest depth that a list has in a parallel view, whose depths must lie
/// between two numbers. `bounds` gives those of shared vertices.
pub(crate) fn greatest_depth(
    list: &DrawList,
    view: &View,
    bounds: impl Fn(&Geometry) -> [Vec3; 2],
) -> f64 {
    let mut greatest = view.near * 2.0;
    let own = bounds_of(&list.own.buffers);
    for item in &list.items {
        let [mut low, mut high] = match item.vertices {
            Source::Shared(index) => bounds(&list.geometries[index as usize]),
            Source::Own => own,
        };
        if let Surface::Parallax { frames, .. } = item.surface {
            let [least, most] = list.frames[frames as usize].parts().bounds;
            (low, high) = (low.min(least), high.max(most));
        }
        if !low.is_finite() {
            continue;
        }
        let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
        let range = item.instances.start as usize..item.instances.end as usize;
        for instance in list.instances.get(range).unwrap_or_default() {
            let away = -view.back.as_vec3();
            let along = instance.linear.transpose() * away;
            let middle = f64::from(along.dot(center)) + f64::from(instance.translation.dot(away));
            greatest = greatest.max(middle + f64::from(along.abs().dot(half)));
        }
    }
    // rounding must not clip what lies furthest
    greatest * (1.0 + 1e-4)
}
