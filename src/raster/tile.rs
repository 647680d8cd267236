//! One tile of the picture: visibility first, colour once it is known what is seen.
//!
//! Opaque and alpha-tested shapes leave only a depth key and a reference to themselves in each sample.
//! Colours are computed when a blended shape needs them, or at the end: once a pixel and shape where
//! the shape has no texture, at the centroid of the samples it shows in; once a sample otherwise.

use glam::{Vec2, Vec4};

use crate::draw_list::{Blend, DrawList};
use crate::raster::coverage::covered;
use crate::raster::frame::{EMPTY_ID, Outputs};
use crate::raster::samples::{SUBPIXEL_COUNT, SamplePosition};
use crate::raster::setup::{Grid, Shape, Unit};
use crate::raster::shade::{Material, Weigher};
use crate::view::View;

/// No shape waits to be coloured in this sample.
const NONE: u32 = u32::MAX;

/// Bits of a reference that count shapes inside a unit: a clipped card gives at most 12.
const SHAPE_BITS: u32 = 15;

/// Opacity, gathered front to back, at which a blended pixel's depth is taken.
const HALF_OPACITY: f32 = 0.5;

/// What all tiles of a picture share.
pub(crate) struct Scene<'a, const S: usize> {
    pub(crate) list: &'a DrawList,
    pub(crate) view: &'a View,
    pub(crate) units: &'a [Unit],
    pub(crate) grid: Grid,
    pub(crate) samples: [SamplePosition; S],
    /// The same in pixels.
    pub(crate) offsets: [Vec2; S],
    /// Which of colour, albedo and normal are wanted.
    pub(crate) layers: [bool; 3],
}

/// Samples of one tile; index = pixel in the tile * S + sample.
#[derive(Debug, Default)]
pub(crate) struct TileBuffer {
    /// Depth key of the nearest opaque sample; negative infinity where there is none.
    keys: Vec<f32>,
    /// What is to be coloured: unit and shape; [`NONE`] where nothing waits.
    waiting: Vec<u32>,
    /// Whether any sample of `waiting` is in use.
    any_waiting: bool,
    /// Colour, albedo, normal: only where blending or several batches need them.
    layers: [Vec<Vec4>; 3],
    /// Source ids, if asked for.
    ids: Vec<u32>,
    /// Opacity of blended shapes, gathered front to back.
    opacity: Vec<f32>,
    /// (shape, pixel) pairs covered.
    pub(crate) fragment_count: u64,
}

/// Rows of each output that a tile writes; empty where an output is not asked for.
#[derive(Default)]
pub(crate) struct TileTarget<'a> {
    pub(crate) color: Vec<&'a mut [Vec4]>,
    pub(crate) depth: Vec<&'a mut [f32]>,
    pub(crate) ids: Vec<&'a mut [u32]>,
    pub(crate) normal: Vec<&'a mut [Vec4]>,
    pub(crate) albedo: Vec<&'a mut [Vec4]>,
}

/// A pixel of a tile while a shape is drawn into it.
struct Pixel<'a, const S: usize> {
    x: i32,
    y: i32,
    /// Index of its first sample.
    first: usize,
    /// Samples where the shape is in front.
    mask: u32,
    /// Depth keys of the shape, one a sample.
    keys: &'a [f32; S],
}

impl<const S: usize> Pixel<'_, S> {
    fn samples(&self) -> impl Iterator<Item = usize> + use<S> {
        bits(self.mask)
    }

    fn center(&self) -> Vec2 {
        Vec2::new(self.x as f32 + 0.5, self.y as f32 + 0.5)
    }
}

/// Indices of the bits that are set, lowest first.
fn bits(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lowest = mask.trailing_zeros();
        mask &= mask.wrapping_sub(1);
        (lowest < 32).then_some(lowest as usize)
    })
}

impl<'a, const S: usize> Scene<'a, S> {
    pub(crate) fn new(
        list: &'a DrawList,
        view: &'a View,
        units: &'a [Unit],
        grid: Grid,
        samples: [SamplePosition; S],
        outputs: Outputs,
    ) -> Self {
        let step = 1.0 / SUBPIXEL_COUNT as f32;
        let offsets = samples.map(|[x, y]| Vec2::new(x as f32, y as f32) * step);
        let layers = [outputs.color, outputs.albedo, outputs.normal];
        Self { list, view, units, grid, samples, offsets, layers }
    }

    /// Where a sample of a pixel lies on the picture.
    #[inline]
    fn point(&self, x: i32, y: i32, sample: usize) -> Vec2 {
        Vec2::new(x as f32, y as f32) + self.offsets[sample]
    }

    /// Calls `visit` for each pixel of the tile in which the shape is nearest at some sample.
    #[inline]
    fn visible(
        &self,
        style: &Style<'_>,
        shape: &Shape,
        tile_box: [i32; 4],
        keys: &mut [f32],
        fragment_count: &mut u64,
        mut visit: impl FnMut(&Pixel<'_, S>, &mut [f32]),
    ) {
        let [x0, y0, x1, y1] = shape.pixels.map(i32::from);
        let pixels = [
            x0.max(tile_box[0]),
            y0.max(tile_box[1]),
            x1.min(tile_box[2] - 1),
            y1.min(tile_box[3] - 1),
        ];
        let (lowest, highest) = style.slab_keys;
        let [at_origin, slope_x, slope_y] = shape.key;
        let [farthest, nearest] = shape.key_range;
        let mut count = 0;
        covered(shape, pixels, &self.samples, |x, y, mask| {
            count += 1;
            let first = pixel_index(x - tile_box[0], y - tile_box[1], self.grid.tile) * S;
            let stored: &[f32; S] = keys[first..first + S].try_into().expect("S samples");
            let corner = Vec2::new(x as f32, y as f32) - Vec2::from(shape.origin);
            let mut shape_keys = [0.0_f32; S];
            let mut front = 0;
            for s in 0..S {
                let from = corner + self.offsets[s];
                let key = at_origin + (slope_x * from.x + slope_y * from.y);
                let key = key.max(farthest).min(nearest);
                shape_keys[s] = key;
                let seen = (key > stored[s]) & (key > lowest) & (key <= highest);
                front |= u32::from(seen) << s;
            }
            let mut mask = mask & front;
            if style.dithered {
                let instance = style.material.instance;
                mask &= dither_mask(x, y, S, instance.seed, instance.fade);
            }
            if mask != 0 {
                visit(&Pixel { x, y, first, mask, keys: &shape_keys }, keys);
            }
        });
        *fragment_count += count;
    }
}

/// What the shapes of one segment share, looked up once.
struct Style<'a> {
    unit: u32,
    segment: u32,
    material: Material<'a>,
    slab_keys: (f32, f32),
    dithered: bool,
}

impl<'a> Style<'a> {
    /// The style of a shape: the one at hand if the shape is of the same segment.
    #[inline]
    fn of<const S: usize>(
        scene: &Scene<'a, S>,
        unit: u32,
        shape: &Shape,
        at_hand: Option<Self>,
    ) -> Self {
        match at_hand {
            Some(style) if style.unit == unit && style.segment == shape.segment => style,
            _ => {
                let material = Material::new(scene.list, &scene.units[unit as usize], shape);
                Self {
                    unit,
                    segment: shape.segment,
                    slab_keys: slab_keys(scene.view, material.item.slab),
                    dithered: material.instance.fade != 1.0,
                    material,
                }
            }
        }
    }
}

/// Depth keys above the first and up to the second lie in the slab and not nearer than the view allows.
pub(crate) fn slab_keys(view: &View, slab: Option<[f32; 2]>) -> (f32, f32) {
    #[expect(clippy::cast_possible_truncation, reason = "keys are f32")]
    let view_near = view.near as f32;
    let [near, far] = slab.unwrap_or([view_near, f32::INFINITY]);
    if view.is_orthographic() {
        (-far, -near.max(view_near))
    } else {
        // the near plane itself was clipped exactly
        (1.0 / far, if slab.is_some() { 1.0 / near } else { f32::INFINITY })
    }
}

fn pixel_index(x: i32, y: i32, tile: i32) -> usize {
    usize::try_from(y * tile + x).expect("inside the tile")
}

/// Samples that a fade keeps: those whose fixed random number is below it; for a negative fade the
/// others, so that `fade` and `fade - 1` complete one another.
fn dither_mask(x: i32, y: i32, sample_count: usize, seed: u32, fade: f32) -> u32 {
    let mut mask = 0;
    for s in 0..sample_count {
        let mut hash = seed.wrapping_mul(0x9E37_79B9);
        for part in [x.unsigned_abs(), y.unsigned_abs(), u32::try_from(s).expect("under 32")] {
            hash = (hash ^ part).wrapping_mul(0x85EB_CA6B);
            hash ^= hash >> 15;
        }
        hash = hash.wrapping_mul(0xC2B2_AE35);
        let number = ((hash ^ hash >> 16) >> 8) as f32 * (1.0 / 16_777_216.0);
        let kept = if fade >= 0.0 { number < fade } else { number >= 1.0 + fade };
        mask |= u32::from(kept) << s;
    }
    mask
}

fn refill<T: Clone>(vec: &mut Vec<T>, wanted: bool, length: usize, value: T) {
    vec.clear();
    if wanted {
        vec.resize(length, value);
    }
}

impl TileBuffer {
    /// Bytes a sample takes when colours are kept between batches.
    pub(crate) const LAYERED_SAMPLE_BYTES: u64 = 4 + 4 + 3 * 16 + 4 + 4;

    /// Empties the tile; `layered` keeps a colour for every sample.
    pub(crate) fn clear(
        &mut self,
        grid: &Grid,
        sample_count: usize,
        outputs: Outputs,
        layered: bool,
    ) {
        let side = usize::try_from(grid.tile).expect("positive");
        let length = side * side * sample_count;
        refill(&mut self.keys, true, length, f32::NEG_INFINITY);
        refill(&mut self.waiting, true, length, NONE);
        self.any_waiting = false;
        let wanted = [outputs.color, outputs.albedo, outputs.normal];
        for (layer, wanted) in self.layers.iter_mut().zip(wanted) {
            refill(layer, layered && wanted, length, Vec4::ZERO);
        }
        refill(&mut self.ids, layered && outputs.ids, length, EMPTY_ID);
        self.opacity.clear();
    }

    /// Draws the batch's shapes of a tile in order.
    pub(crate) fn draw<const S: usize>(&mut self, scene: &Scene<'_, S>, tile: usize) {
        let tile_box = scene.grid.tile_box(tile);
        let mut at_hand = None;
        for (unit_index, unit) in (0_u32..).zip(scene.units) {
            for &index in unit.shapes_in(tile) {
                let shape = &unit.shapes[index as usize];
                let style = Style::of(scene, unit_index, shape, at_hand.take());
                let reference = unit_index << SHAPE_BITS | index;
                match style.material.item.blend {
                    Blend::Opaque => {
                        self.any_waiting = true;
                        self.draw_opaque(scene, tile_box, &style, shape, reference);
                    }
                    Blend::Test(cutoff) => {
                        self.any_waiting = true;
                        let weigher = Weigher::new(scene.view, &style.material, unit, shape);
                        let test = (&weigher, cutoff);
                        self.draw_tested(scene, tile_box, &style, test, shape, reference);
                    }
                    Blend::Over => {
                        self.color_waiting(scene, tile);
                        let weigher = Weigher::new(scene.view, &style.material, unit, shape);
                        self.draw_over(scene, tile_box, &style, &weigher, shape);
                    }
                }
                at_hand = Some(style);
            }
        }
    }

    fn draw_opaque<const S: usize>(
        &mut self,
        scene: &Scene<'_, S>,
        tile_box: [i32; 4],
        style: &Style<'_>,
        shape: &Shape,
        reference: u32,
    ) {
        let Self { keys, waiting, fragment_count, .. } = self;
        let write = style.material.item.depth_write;
        scene.visible(style, shape, tile_box, keys, fragment_count, |pixel, keys| {
            for s in 0..S {
                if pixel.mask >> s & 1 == 1 {
                    if write {
                        keys[pixel.first + s] = pixel.keys[s];
                    }
                    waiting[pixel.first + s] = reference;
                }
            }
        });
    }

    fn draw_tested<const S: usize>(
        &mut self,
        scene: &Scene<'_, S>,
        tile_box: [i32; 4],
        style: &Style<'_>,
        (weigher, cutoff): (&Weigher, f32),
        shape: &Shape,
        reference: u32,
    ) {
        let Self { keys, waiting, fragment_count, .. } = self;
        let material = &style.material;
        let write = material.item.depth_write;
        scene.visible(style, shape, tile_box, keys, fragment_count, |pixel, keys| {
            let lod = material.lod(weigher, pixel.center());
            for s in pixel.samples() {
                let point = scene.point(pixel.x, pixel.y, s);
                if material.alpha(weigher, point, lod) >= cutoff {
                    if write {
                        keys[pixel.first + s] = pixel.keys[s];
                    }
                    waiting[pixel.first + s] = reference;
                }
            }
        });
    }

    fn draw_over<const S: usize>(
        &mut self,
        scene: &Scene<'_, S>,
        tile_box: [i32; 4],
        style: &Style<'_>,
        weigher: &Weigher,
        shape: &Shape,
    ) {
        let Self { keys, layers, fragment_count, .. } = self;
        let material = &style.material;
        let write = material.item.depth_write;
        scene.visible(style, shape, tile_box, keys, fragment_count, |pixel, keys| {
            let lod = material.lod(weigher, pixel.center());
            for s in pixel.samples() {
                let at = pixel.first + s;
                let point = scene.point(pixel.x, pixel.y, s);
                let shaded = material.shade(shape, weigher, point, lod, scene.layers);
                if shaded[0].w == 0.0 {
                    continue;
                }
                for ((layer, source), wanted) in layers.iter_mut().zip(shaded).zip(scene.layers) {
                    if wanted {
                        layer[at] = source + layer[at] * (1.0 - source.w);
                    }
                }
                if write {
                    keys[at] = pixel.keys[s];
                }
            }
        });
    }

    /// Gives every waiting sample its colour and id.
    pub(crate) fn color_waiting<const S: usize>(&mut self, scene: &Scene<'_, S>, tile: usize) {
        if !std::mem::take(&mut self.any_waiting) {
            return;
        }
        let [x0, y0, x1, y1] = scene.grid.tile_box(tile);
        let mut last = None;
        for y in y0..y1 {
            for x in x0..x1 {
                let first = pixel_index(x - x0, y - y0, scene.grid.tile) * S;
                let references: [u32; S] =
                    self.waiting[first..first + S].try_into().expect("S samples");
                for_each_shaded(scene, x, y, &references, &mut last, |mask, shaded, id| {
                    for s in bits(mask) {
                        for (layer, source) in self.layers.iter_mut().zip(shaded) {
                            if let Some(stored) = layer.get_mut(first + s) {
                                *stored = source;
                            }
                        }
                        if let Some(stored) = self.ids.get_mut(first + s) {
                            *stored = id;
                        }
                    }
                });
                self.waiting[first..first + S].fill(NONE);
            }
        }
    }

    /// Walks the batch's blended shapes nearest first and moves the depth of samples whose opacity
    /// reaches a half to the shape that did it. Batches are given last to first.
    pub(crate) fn find_half_opacity<const S: usize>(&mut self, scene: &Scene<'_, S>, tile: usize) {
        self.opacity.resize(self.keys.len(), 0.0);
        let Self { keys, ids, opacity, .. } = self;
        let tile_box = scene.grid.tile_box(tile);
        let mut uncounted = 0;
        let mut at_hand = None;
        let unit_count = u32::try_from(scene.units.len()).expect("few units");
        for unit_index in (0..unit_count).rev() {
            let unit = &scene.units[unit_index as usize];
            for &index in unit.shapes_in(tile).iter().rev() {
                let shape = &unit.shapes[index as usize];
                let style = Style::of(scene, unit_index, shape, at_hand.take());
                let style = at_hand.insert(style);
                let material = &style.material;
                if material.item.blend != Blend::Over {
                    continue;
                }
                let weigher = Weigher::new(scene.view, material, unit, shape);
                let id = material.source_id(shape);
                scene.visible(style, shape, tile_box, keys, &mut uncounted, |pixel, keys| {
                    let lod = material.lod(&weigher, pixel.center());
                    for s in pixel.samples() {
                        let at = pixel.first + s;
                        let point = scene.point(pixel.x, pixel.y, s);
                        let alpha = material.alpha(&weigher, point, lod).clamp(0.0, 1.0);
                        let before = opacity[at];
                        opacity[at] = before + (1.0 - before) * alpha;
                        if before < HALF_OPACITY && opacity[at] >= HALF_OPACITY {
                            // what lies behind cannot be nearer, so the key doubles as the answer
                            keys[at] = pixel.keys[s];
                            if let Some(stored) = ids.get_mut(at) {
                                *stored = id;
                            }
                        }
                    }
                });
            }
        }
    }

    /// Adds the tile's samples, each with weight `weight`, to the picture.
    pub(crate) fn resolve<const S: usize>(
        &mut self,
        scene: &Scene<'_, S>,
        tile: usize,
        weight: f32,
        target: &mut TileTarget<'_>,
    ) {
        let [x0, y0, x1, y1] = scene.grid.tile_box(tile);
        let layered = self.layers.iter().any(|layer| !layer.is_empty()) || !self.ids.is_empty();
        let mut last = None;
        for y in y0..y1 {
            let row = usize::try_from(y - y0).expect("inside the tile");
            for x in x0..x1 {
                let column = usize::try_from(x - x0).expect("inside the tile");
                let first = pixel_index(x - x0, y - y0, scene.grid.tile) * S;
                let keys = &self.keys[first..first + S];
                let nearest = (1..S).fold(0, |best, s| if keys[s] > keys[best] { s } else { best });
                let mut sums = [Vec4::ZERO; 3];
                let mut id = EMPTY_ID;
                if layered {
                    for (sum, layer) in sums.iter_mut().zip(&self.layers) {
                        if !layer.is_empty() {
                            *sum = layer[first..first + S].iter().sum();
                        }
                    }
                    id = self.ids.get(first + nearest).copied().unwrap_or(EMPTY_ID);
                } else {
                    let references: [u32; S] =
                        self.waiting[first..first + S].try_into().expect("S samples");
                    for_each_shaded(
                        scene,
                        x,
                        y,
                        &references,
                        &mut last,
                        |mask, shaded, shape_id| {
                            let count = mask.count_ones() as f32;
                            for (sum, source) in sums.iter_mut().zip(shaded) {
                                *sum += source * count;
                            }
                            if mask >> nearest & 1 == 1 {
                                id = shape_id;
                            }
                        },
                    );
                }
                let wanted = [&mut target.color, &mut target.albedo, &mut target.normal];
                for (rows, sum) in wanted.into_iter().zip(sums) {
                    if let Some(row) = rows.get_mut(row) {
                        row[column] += sum * weight;
                    }
                }
                let key = keys[nearest];
                if key == f32::NEG_INFINITY {
                    continue;
                }
                let depth = if scene.view.is_orthographic() { -key } else { 1.0 / key };
                let mut is_nearest = true;
                if let Some(row) = target.depth.get_mut(row) {
                    is_nearest = depth < row[column];
                    row[column] = row[column].min(depth);
                }
                if is_nearest && let Some(row) = target.ids.get_mut(row) {
                    row[column] = id;
                }
            }
        }
    }
}

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
        let unit = &scene.units[(reference >> SHAPE_BITS) as usize];
        let shape = &unit.shapes[(reference & ((1 << SHAPE_BITS) - 1)) as usize];
        let material = Material::new(scene.list, unit, shape);
        let weigher = Weigher::new(scene.view, &material, unit, shape);
        let id = material.source_id(shape);
        Self { reference, shape, material, weigher, id }
    }
}

/// Colours a pixel's waiting samples: `visit(mask, colours, id)` once for each shape, or once a
/// sample where a texture may change between samples.
#[inline]
fn for_each_shaded<'a, const S: usize>(
    scene: &Scene<'a, S>,
    x: i32,
    y: i32,
    references: &[u32; S],
    last: &mut Option<LastShaded<'a>>,
    mut visit: impl FnMut(u32, [Vec4; 3], u32),
) {
    let mut left = 0_u32;
    for (s, &reference) in references.iter().enumerate() {
        left |= u32::from(reference != NONE) << s;
    }
    while left != 0 {
        let reference = references[left.trailing_zeros() as usize];
        let mut mask = 0_u32;
        for (s, &other) in references.iter().enumerate() {
            mask |= u32::from(other == reference) << s;
        }
        left &= !mask;
        let known = last.take().filter(|last| last.reference == reference);
        let shaded = last.insert(known.unwrap_or_else(|| LastShaded::new(scene, reference)));
        let LastShaded { shape, material, weigher, id, .. } = shaded;
        if material.is_smooth() {
            let sum: Vec2 = bits(mask).map(|s| scene.point(x, y, s)).sum();
            let centroid = sum * (1.0 / mask.count_ones() as f32);
            visit(mask, material.shade(shape, weigher, centroid, 0.0, scene.layers), *id);
        } else {
            let lod = material.lod(weigher, Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
            for s in bits(mask) {
                let point = scene.point(x, y, s);
                visit(1 << s, material.shade(shape, weigher, point, lod, scene.layers), *id);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fade_and_its_complement_share_the_samples() {
        for fade in [0.0, 0.25, 0.7] {
            let mut kept = 0;
            for (x, y) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
                let here = dither_mask(x, y, 4, 7, fade);
                let there = if fade == 0.0 { 0b1111 } else { dither_mask(x, y, 4, 7, fade - 1.0) };
                assert_eq!(here ^ there, 0b1111, "each sample once at ({x}, {y})");
                kept += here.count_ones();
            }
            let share = f64::from(kept) / f64::from(64 * 64 * 4);
            // four standard deviations of 16384 draws
            assert!((share - f64::from(fade)).abs() < 0.016, "{share} for {fade}");
        }
    }
}
