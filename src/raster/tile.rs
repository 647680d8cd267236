//! One tile of the picture: visibility first, colour once it is known what is seen.
//!
//! Opaque and alpha-tested shapes leave only a depth key and a reference to themselves in each sample.
//! Colours are computed when a blended shape needs them, or at the end: once a pixel and shape where
//! the shape has no texture, at the centroid of the samples it shows in; once a sample otherwise.

use glam::{Vec2, Vec3, Vec4};

use crate::draw_list::{Blend, DrawList, Item, Primitive, Surface};
use crate::raster::colors::{Colors, Known};
use crate::raster::coverage::Lanes;
use crate::raster::frame::{EMPTY_ID, Outputs};
use crate::raster::grid::Grid;
use crate::raster::over::{HALF_OPACITY, HalfOpacity};
use crate::raster::parallax::Covers;
use crate::raster::plain::Plain;
use crate::raster::samples::{SUBPIXEL_COUNT, SamplePosition, alpha_threshold};
use crate::raster::setup::{Shape, Unit, flags};
use crate::raster::shade::{Material, Weigher};
use crate::raster::spans::{LINE, TRIANGLE};
use crate::raster::visible::{Sample, Sink, Visible, bits, index};
use crate::simd::{LANE_COUNT, Level};
use crate::view::View;

/// No shape waits to be coloured in this sample.
pub(crate) const NONE: u32 = u32::MAX;

/// Bits of a reference that count shapes inside a unit: a clipped card gives at most 12.
const SHAPE_BITS: u32 = 16;

/// What all tiles of a picture share.
pub(crate) struct Scene<'a, const S: usize> {
    pub(crate) level: Level,
    pub(crate) list: &'a DrawList,
    pub(crate) view: &'a View,
    pub(crate) units: &'a [Unit],
    pub(crate) grid: Grid,
    pub(crate) lanes: Lanes,
    /// Where in a pixel the samples lie.
    offsets: [Vec2; S],
    /// Which of colour, albedo and normal are wanted.
    pub(crate) layers: [bool; 3],
    /// Whether to count the pixels that shapes cover.
    pub(crate) counts_fragments: bool,
    /// One a unit, where all its shapes are points in flat colours; empty where more than colour is
    /// wanted.
    flats: Vec<Option<Flat<'a>>>,
}

/// Points of one item and instance, in colours that change nowhere on a point.
#[derive(Clone, Copy)]
struct Flat<'a> {
    front: &'a [Vec3],
    back: &'a [Vec3],
    tint: Vec4,
    source_ids: &'a [u32],
}

impl<'a> Flat<'a> {
    fn new(list: &'a DrawList, unit: &Unit) -> Option<Self> {
        let [segment] = &unit.segments[..] else { return None };
        let item = &list.items[segment.item as usize];
        let is_flat = matches!(item.primitive, Primitive::Points { .. })
            && item.blend != Blend::Over
            && item.surface == Surface::VertexColor;
        let buffers = list.vertices_of(item);
        is_flat.then(|| Self {
            front: &buffers.front,
            back: &buffers.back,
            tint: list.instances[segment.instance as usize].tint.with_w(1.0),
            source_ids: &list.indices_of(item).source_ids,
        })
    }
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
    known_colors: Known,
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

impl<'a, const S: usize> Scene<'a, S> {
    pub(crate) fn new(
        level: Level,
        list: &'a DrawList,
        view: &'a View,
        units: &'a [Unit],
        grid: Grid,
        samples: &[SamplePosition; S],
        outputs: Outputs,
    ) -> Self {
        let step = 1.0 / SUBPIXEL_COUNT as f32;
        let offsets = samples.map(|[x, y]| Vec2::new(x as f32, y as f32) * step);
        let layers = [outputs.color, outputs.albedo, outputs.normal];
        let lanes = Lanes::new(samples);
        let counts_fragments = false;
        let color_alone = layers == [true, false, false];
        let flats = if color_alone {
            units.iter().map(|unit| Flat::new(list, unit)).collect()
        } else {
            Vec::new()
        };
        Self { level, list, view, units, grid, lanes, offsets, layers, counts_fragments, flats }
    }

    /// Colour and id of a point in a flat colour.
    #[inline(always)]
    pub(crate) fn flat(&self, reference: u32) -> Option<(Vec4, u32)> {
        let flat = self.flats.get((reference >> SHAPE_BITS) as usize)?.as_ref()?;
        let (unit, index) = self.referred(reference);
        let origin = &unit.origins[index];
        let side = if origin.tag.has(flags::FRONT) { flat.front } else { flat.back };
        let color = side[origin.vertices[0] as usize].extend(1.0) * flat.tint;
        let primitive = origin.primitive;
        Some((color, flat.source_ids.get(primitive as usize).copied().unwrap_or(primitive)))
    }

    /// Whether no shape of the batch touches a tile.
    pub(crate) fn is_empty(&self, tile: usize) -> bool {
        self.units.iter().all(|unit| unit.shapes_in(tile).is_empty())
    }

    /// Where a sample of a pixel lies on the picture.
    #[inline(always)]
    pub(crate) fn point(&self, x: i32, y: i32, sample: usize) -> Vec2 {
        Vec2::new(x as f32, y as f32) + self.offsets[sample]
    }

    #[inline]
    fn point_of(&self, sample: &Sample) -> Vec2 {
        self.point(sample.pixel[0], sample.pixel[1], sample.number)
    }

    /// The middle of some samples of a pixel.
    #[inline(always)]
    pub(crate) fn centroid(&self, x: i32, y: i32, mask: u32) -> Vec2 {
        if S == 1 {
            return self.point(x, y, 0);
        }
        let sum: Vec2 = bits(mask.into()).map(|s| self.point(x, y, s)).sum();
        sum * (1.0 / mask.count_ones() as f32)
    }

    /// Unit and index of the shape that a reference stands for.
    #[inline(always)]
    pub(crate) fn referred(&self, reference: u32) -> (&'a Unit, usize) {
        let unit = &self.units[(reference >> SHAPE_BITS) as usize];
        (unit, (reference & ((1 << SHAPE_BITS) - 1)) as usize)
    }
}

/// What the shapes of one segment share, looked up once.
struct Style<'a> {
    unit: u32,
    segment: u32,
    material: Material<'a>,
    slab_keys: (f32, f32),
    /// Seed and fade of an instance that is not fully there.
    dither: Option<(u32, f32)>,
}

impl<'a> Style<'a> {
    #[inline(never)]
    fn new<const S: usize>(scene: &Scene<'a, S>, unit: u32, shape: &Shape) -> Self {
        let material = Material::new(scene.list, scene.view, &scene.units[unit as usize], shape);
        let instance = material.instance;
        Self {
            unit,
            segment: shape.tag.segment(),
            slab_keys: slab_keys(scene.view, material.item.slab),
            dither: (instance.fade != 1.0).then_some((instance.seed, instance.fade)),
            material,
        }
    }

    /// Whether it is the style of a shape.
    #[inline(always)]
    fn fits(&self, unit: u32, shape: &Shape) -> bool {
        self.unit == unit && self.segment == shape.tag.segment()
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
        // the last row's vectors may reach beyond it
        let length = side * side * sample_count + LANE_COUNT;
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
        // references mean other shapes in another batch
        self.known_colors.forget();
        let tile_box = scene.grid.tile_box(tile);
        let mut at_hand: Option<Style<'_>> = None;
        for (unit_index, unit) in (0_u32..).zip(scene.units) {
            let mut left = unit.shapes_in(tile);
            while let [index, rest @ ..] = left {
                let index = *index;
                let shape = &unit.shapes[index as usize];
                if shape.tag.has(flags::PLAIN) || shape.tag.has(flags::LINE) {
                    let done = if shape.tag.has(flags::LINE) {
                        self.draw_plain::<S, LINE>(scene, tile_box, unit_index, left)
                    } else {
                        self.draw_plain::<S, TRIANGLE>(scene, tile_box, unit_index, left)
                    };
                    left = &left[done..];
                    continue;
                }
                left = rest;
                if !at_hand.as_ref().is_some_and(|style| style.fits(unit_index, shape)) {
                    at_hand = Some(Style::new(scene, unit_index, shape));
                }
                let Some(style) = &at_hand else { continue };
                let target = Target { tile_box, style, shape, unit: unit_index, index };
                if style.material.parallax().is_some() {
                    if style.material.item.blend == Blend::Over {
                        self.color_waiting(scene, tile);
                    }
                    self.draw_parallax(scene, &target);
                    continue;
                }
                match style.material.item.blend {
                    Blend::Opaque => self.draw_opaque(scene, &target),
                    Blend::Test(cutoff) => self.draw_tested(scene, &target, |_| cutoff),
                    Blend::Coverage => {
                        let seed = style.material.instance.seed;
                        let id = style.material.source_id(unit.origins[index as usize].primitive);
                        let threshold = |sample| alpha_threshold(sample, S, seed, id);
                        self.draw_tested(scene, &target, threshold);
                    }
                    Blend::Over => {
                        self.color_waiting(scene, tile);
                        self.draw_over(scene, &target);
                    }
                }
            }
        }
    }

    /// Draws chosen shapes of a unit up to the first of another kind; how many.
    fn draw_plain<const S: usize, const EDGES: usize>(
        &mut self,
        scene: &Scene<'_, S>,
        tile_box: [i32; 4],
        unit: u32,
        chosen: &[u32],
    ) -> usize {
        self.any_waiting = true;
        let Self { keys, waiting, .. } = self;
        let (done, fragment_count) = scene.level.run(Plain::<EDGES> {
            lanes: &scene.lanes,
            shapes: &scene.units[unit as usize].shapes,
            chosen,
            first_reference: unit << SHAPE_BITS,
            tile_box,
            side: scene.grid.tile,
            keys,
            waiting,
            counts_fragments: scene.counts_fragments,
        });
        self.fragment_count += fragment_count;
        done
    }

    fn draw_opaque<const S: usize>(&mut self, scene: &Scene<'_, S>, target: &Target<'_>) {
        self.any_waiting = true;
        let Self { keys, waiting, fragment_count, .. } = self;
        let write = target.style.material.item.depth_write;
        let sink = Sink::Store { waiting, reference: target.reference(), write };
        *fragment_count += target.draw(scene, keys, sink);
    }

    fn draw_tested<const S: usize>(
        &mut self,
        scene: &Scene<'_, S>,
        target: &Target<'_>,
        cutoff: impl Fn(usize) -> f32,
    ) {
        self.any_waiting = true;
        let Self { keys, waiting, fragment_count, .. } = self;
        let material = &target.style.material;
        let (weigher, reference) = (target.weigher(scene), target.reference());
        let write = material.item.depth_write;
        if let Some(cut_out) = material.cut_out(&weigher, &cutoff, S) {
            let sink = Sink::Test { cut_out: &cut_out, waiting, reference, write };
            *fragment_count += target.draw(scene, keys, sink);
            return;
        }
        let mut lod = Lod::default();
        let mut visit = |sample: &Sample, keys: &mut [f32]| {
            let lod = lod.at(material, &weigher, sample);
            if material.alpha(&weigher, scene.point_of(sample), lod) >= cutoff(sample.number) {
                if write {
                    keys[sample.at] = sample.key;
                }
                waiting[sample.at] = reference;
            }
        };
        *fragment_count += target.draw(scene, keys, Sink::Visit(&mut visit));
    }

    fn draw_over<const S: usize>(&mut self, scene: &Scene<'_, S>, target: &Target<'_>) {
        let Self { keys, layers, fragment_count, .. } = self;
        let material = &target.style.material;
        let weigher = target.weigher(scene);
        let write = material.item.depth_write;
        if scene.layers == [true, false, false]
            && let Some(over) = material.over(target.shape, &weigher)
        {
            let sink = Sink::Over { over: &over, colors: &mut layers[0], write };
            *fragment_count += target.draw(scene, keys, sink);
            return;
        }
        let mut lod = Lod::default();
        let mut visit = |sample: &Sample, keys: &mut [f32]| {
            let lod = lod.at(material, &weigher, sample);
            let point = scene.point_of(sample);
            let shaded = material.shade(target.shape, &weigher, point, lod, scene.layers);
            if shaded[0].w == 0.0 {
                return;
            }
            for ((layer, source), wanted) in layers.iter_mut().zip(shaded).zip(scene.layers) {
                if wanted {
                    layer[sample.at] = source + layer[sample.at] * (1.0 - source.w);
                }
            }
            if write {
                keys[sample.at] = sample.key;
            }
        };
        *fragment_count += target.draw(scene, keys, Sink::Visit(&mut visit));
    }

    /// Draws a shape through which frames are looked at: whether and how near there is anything is known
    /// only once a sample's ray has been followed.
    #[inline(never)]
    fn draw_parallax<const S: usize>(&mut self, scene: &Scene<'_, S>, target: &Target<'_>) {
        let Self { keys, waiting, any_waiting, layers, fragment_count, .. } = self;
        let (material, reference) = (&target.style.material, target.reference());
        let Some(parallax) = material.parallax() else { return };
        let positions = &material.buffers.positions;
        let weigher = target.weigher(scene);
        let Item { blend, depth_write, .. } = *material.item;
        let (lowest, highest) = target.style.slab_keys;
        let seed = material.instance.seed;
        let unit = &scene.units[target.unit as usize];
        let id = material.source_id(unit.origins[target.index as usize].primitive);
        let mut lod = Lod::default();
        let visit = |sample: &Sample| {
            let lod = lod.at(material, &weigher, sample);
            let point = scene.point_of(sample);
            let Some(seen) = parallax.seen(&weigher, positions, point, lod) else { return };
            let in_front = seen.key > keys[sample.at];
            if !in_front || seen.key <= lowest || seen.key > highest {
                return;
            }
            let alpha = seen.alpha * material.instance.tint.w;
            let hides = match blend {
                Blend::Opaque => true,
                Blend::Test(cutoff) => alpha >= cutoff,
                Blend::Coverage => alpha >= alpha_threshold(sample.number, S, seed, id),
                Blend::Over => {
                    let shaded = material.shade(target.shape, &weigher, point, lod, scene.layers);
                    for ((layer, source), wanted) in layers.iter_mut().zip(shaded).zip(scene.layers)
                    {
                        if wanted {
                            layer[sample.at] = source + layer[sample.at] * (1.0 - source.w);
                        }
                    }
                    if depth_write {
                        keys[sample.at] = seen.key;
                    }
                    return;
                }
            };
            if hides {
                *any_waiting = true;
                waiting[sample.at] = reference;
                if depth_write {
                    keys[sample.at] = seen.key;
                }
            }
        };
        *fragment_count += target.cover(scene, visit);
    }

    /// Gives every waiting sample its colour and id.
    pub(crate) fn color_waiting<const S: usize>(&mut self, scene: &Scene<'_, S>, tile: usize) {
        if !std::mem::take(&mut self.any_waiting) {
            return;
        }
        let [x0, y0, x1, y1] = scene.grid.tile_box(tile);
        let Self { waiting, layers, ids, known_colors, .. } = self;
        let mut colors = Colors::new(known_colors);
        for y in y0..y1 {
            for x in x0..x1 {
                let first = index(x - x0, y - y0, scene.grid.tile) * S;
                let waiting = &mut waiting[first..first + S];
                let references: [u32; S] = (&*waiting).try_into().expect("S samples");
                colors.each(scene, x, y, &references, |mask, shaded, id| {
                    for s in bits(mask.into()) {
                        for (layer, source) in layers.iter_mut().zip(shaded) {
                            if let Some(stored) = layer.get_mut(first + s) {
                                *stored = source;
                            }
                        }
                        if let Some(stored) = ids.get_mut(first + s) {
                            *stored = id;
                        }
                    }
                });
                waiting.fill(NONE);
            }
        }
    }

    /// Walks the batch's blended shapes nearest first and moves the depth of samples whose opacity
    /// reaches a half to the shape that did it. Batches are given last to first.
    pub(crate) fn find_half_opacity<const S: usize>(&mut self, scene: &Scene<'_, S>, tile: usize) {
        self.opacity.resize(self.keys.len(), 0.0);
        let Self { keys, ids, opacity, .. } = self;
        let tile_box = scene.grid.tile_box(tile);
        let mut at_hand: Option<Style<'_>> = None;
        let unit_count = u32::try_from(scene.units.len()).expect("few units");
        for unit_index in (0..unit_count).rev() {
            let unit = &scene.units[unit_index as usize];
            for &index in unit.shapes_in(tile).iter().rev() {
                let shape = &unit.shapes[index as usize];
                if !at_hand.as_ref().is_some_and(|style| style.fits(unit_index, shape)) {
                    at_hand = Some(Style::new(scene, unit_index, shape));
                }
                let Some(style) = &at_hand else { continue };
                let material = &style.material;
                if material.item.blend != Blend::Over {
                    continue;
                }
                let target = Target { tile_box, style, shape, unit: unit_index, index };
                let weigher = target.weigher(scene);
                let id = material.source_id(unit.origins[index as usize].primitive);
                if let Some(lookup) = material.lookup(&weigher) {
                    let half = HalfOpacity { lookup };
                    target.draw(
                        scene,
                        keys,
                        Sink::HalfOpacity { half: &half, opacities: opacity, ids, id },
                    );
                    continue;
                }
                let mut lod = Lod::default();
                let mut gather = |at: usize, alpha: f32, key: f32, keys: &mut [f32]| {
                    let before = opacity[at];
                    opacity[at] = before + (1.0 - before) * alpha.clamp(0.0, 1.0);
                    if before < HALF_OPACITY && opacity[at] >= HALF_OPACITY {
                        // what lies behind cannot be nearer, so the key doubles as the answer
                        keys[at] = key;
                        if let Some(stored) = ids.get_mut(at) {
                            *stored = id;
                        }
                    }
                };
                if let Some(parallax) = material.parallax() {
                    let (lowest, highest) = style.slab_keys;
                    let positions = &material.buffers.positions;
                    target.cover(scene, |sample| {
                        let lod = lod.at(material, &weigher, sample);
                        let point = scene.point_of(sample);
                        let seen = parallax.seen(&weigher, positions, point, lod);
                        let shown = |key: f32| key > lowest && key <= highest;
                        if let Some(seen) = seen
                            && seen.key > keys[sample.at]
                            && shown(seen.key)
                        {
                            let alpha = seen.alpha * material.instance.tint.w;
                            gather(sample.at, alpha, seen.key, keys);
                        }
                    });
                    continue;
                }
                let mut visit = |sample: &Sample, keys: &mut [f32]| {
                    let lod = lod.at(material, &weigher, sample);
                    let alpha = material.alpha(&weigher, scene.point_of(sample), lod);
                    gather(sample.at, alpha, sample.key, keys);
                };
                target.draw(scene, keys, Sink::Visit(&mut visit));
            }
        }
    }

    /// [`TileBuffer::resolve`] for the colour of what is not blended, which most pictures are.
    fn resolve_color<const S: usize>(
        &mut self,
        scene: &Scene<'_, S>,
        tile: usize,
        weight: f32,
        first: bool,
        target: &mut TileTarget<'_>,
    ) {
        let [x0, y0, ..] = scene.grid.tile_box(tile);
        let Self { waiting, known_colors, .. } = self;
        let mut colors = Colors::new(known_colors);
        let side = scene.grid.tile.unsigned_abs() as usize;
        for ((y, row), waiting) in (y0..).zip(&mut target.color).zip(waiting.chunks_exact(side * S))
        {
            let samples = waiting.as_chunks::<S>().0;
            for ((x, pixel), references) in (x0..).zip(row.iter_mut()).zip(samples) {
                let mut sum = Vec4::ZERO;
                if references.iter().any(|&reference| reference != NONE) {
                    colors.each(scene, x, y, references, |mask, shaded, _| {
                        sum += shaded[0] * mask.count_ones() as f32;
                    });
                }
                let before = if first { Vec4::ZERO } else { *pixel };
                *pixel = before + sum * weight;
            }
        }
    }

    /// Adds the tile's samples, each with weight `weight`, to the picture; if `first`, to nothing.
    pub(crate) fn resolve<const S: usize>(
        &mut self,
        scene: &Scene<'_, S>,
        tile: usize,
        weight: f32,
        first: bool,
        target: &mut TileTarget<'_>,
    ) {
        let layered = self.layers.iter().any(|layer| !layer.is_empty()) || !self.ids.is_empty();
        if !layered && scene.layers == [true, false, false] && target.depth.is_empty() {
            self.resolve_color(scene, tile, weight, first, target);
            return;
        }
        let [x0, y0, x1, y1] = scene.grid.tile_box(tile);
        let Self { keys, waiting, layers, ids, known_colors, .. } = self;
        let mut colors = Colors::new(known_colors);
        for y in y0..y1 {
            let row = usize::try_from(y - y0).expect("inside the tile");
            for x in x0..x1 {
                let column = usize::try_from(x - x0).expect("inside the tile");
                let at = index(x - x0, y - y0, scene.grid.tile) * S;
                let keys: &[f32; S] = keys[at..at + S].try_into().expect("S samples");
                let nearest = (1..S).fold(0, |best, s| if keys[s] > keys[best] { s } else { best });
                let mut sums = [Vec4::ZERO; 3];
                let mut id = EMPTY_ID;
                if layered {
                    for (sum, layer) in sums.iter_mut().zip(&*layers) {
                        if !layer.is_empty() {
                            *sum = layer[at..at + S].iter().sum();
                        }
                    }
                    id = ids.get(at + nearest).copied().unwrap_or(EMPTY_ID);
                } else {
                    let references: &[u32; S] = waiting[at..at + S].try_into().expect("S samples");
                    colors.each(scene, x, y, references, |mask, shaded, shape_id| {
                        let count = mask.count_ones() as f32;
                        for (sum, source) in sums.iter_mut().zip(shaded) {
                            *sum += source * count;
                        }
                        if mask >> nearest & 1 == 1 {
                            id = shape_id;
                        }
                    });
                }
                let wanted = [&mut target.color, &mut target.albedo, &mut target.normal];
                for (rows, sum) in wanted.into_iter().zip(sums) {
                    if let Some(row) = rows.get_mut(row) {
                        let before = if first { Vec4::ZERO } else { row[column] };
                        row[column] = before + sum * weight;
                    }
                }
                let key = keys[nearest];
                let depth = if key == f32::NEG_INFINITY {
                    f32::INFINITY
                } else if scene.view.is_orthographic() {
                    -key
                } else {
                    1.0 / key
                };
                let mut is_nearest = depth < f32::INFINITY;
                if let Some(row) = target.depth.get_mut(row) {
                    let before = if first { f32::INFINITY } else { row[column] };
                    is_nearest = depth < before;
                    row[column] = before.min(depth);
                }
                if let Some(row) = target.ids.get_mut(row)
                    && (first || is_nearest)
                {
                    row[column] = if is_nearest { id } else { EMPTY_ID };
                }
            }
        }
    }
}

/// Writes to a picture what a tile without shapes shows: nothing.
pub(crate) fn leave_blank(target: &mut TileTarget<'_>) {
    for rows in [&mut target.color, &mut target.albedo, &mut target.normal] {
        rows.iter_mut().for_each(|row| row.fill(Vec4::ZERO));
    }
    target.depth.iter_mut().for_each(|row| row.fill(f32::INFINITY));
    target.ids.iter_mut().for_each(|row| row.fill(EMPTY_ID));
}

/// A shape and the tile it is drawn into.
struct Target<'a> {
    tile_box: [i32; 4],
    style: &'a Style<'a>,
    shape: &'a Shape,
    unit: u32,
    index: u32,
}

impl Target<'_> {
    /// What stands for the shape in a sample.
    #[inline(always)]
    fn reference(&self) -> u32 {
        self.unit << SHAPE_BITS | self.index
    }

    fn weigher<const S: usize>(&self, scene: &Scene<'_, S>) -> Weigher {
        let unit = &scene.units[self.unit as usize];
        Weigher::new(scene.view, &self.style.material, unit, self.index as usize)
    }

    /// Visits every sample that it covers, whatever is in front, and counts its pixels.
    fn cover<const S: usize>(&self, scene: &Scene<'_, S>, mut visit: impl FnMut(&Sample)) -> u64 {
        scene.level.run(Covers {
            lanes: &scene.lanes,
            shape: self.shape,
            tile_box: self.tile_box,
            side: scene.grid.tile,
            dither: self.style.dither,
            visit: &mut visit,
        })
    }

    /// Draws it and counts the pixels that it covers.
    #[inline]
    fn draw<const S: usize>(
        &self,
        scene: &Scene<'_, S>,
        keys: &mut [f32],
        sink: Sink<'_, '_>,
    ) -> u64 {
        scene.level.run(Visible {
            lanes: &scene.lanes,
            shape: self.shape,
            tile_box: self.tile_box,
            side: scene.grid.tile,
            slab_keys: self.style.slab_keys,
            dither: self.style.dither,
            keys,
            sink,
        })
    }
}

/// A texture's level of detail, which is the same for all samples of a pixel.
#[derive(Default)]
struct Lod(Option<([i32; 2], f32)>);

impl Lod {
    #[inline]
    fn at(&mut self, material: &Material<'_>, weigher: &Weigher, sample: &Sample) -> f32 {
        match self.0 {
            Some((pixel, lod)) if pixel == sample.pixel => lod,
            _ => {
                let lod = material.lod(weigher, sample.pixel_center());
                self.0 = Some((sample.pixel, lod));
                lod
            }
        }
    }
}
