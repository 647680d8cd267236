//! From a draw list to shapes in pixels: transform, clip, snap, cull, and sort into tiles.
//!
//! The list is cut into units of consecutive primitives; units are independent, so they are built in
//! parallel and drawn in order. Corners are snapped to 1/256 pixel for coverage; depth and attributes
//! come from the corners as they were. Eight triangles are set up at once; those that reach behind
//! the near plane or far outside the picture are clipped in f64, one by one, at their place in the
//! order.

mod lines_and_points;

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8};
use glam::Vec3;

use crate::draw_list::{Blend, DrawList, Item, Primitive, Surface};
use crate::raster::clip::clip_polygon;
use crate::raster::grid::{Grid, PixelBoxes};
use crate::raster::placing::{Chosen, GUARD_PX, Placing, ScreenVertex, snap};
use crate::raster::tile::slab_keys;
use crate::simd::{Kernel, LANE_COUNT, Level};
use crate::view::View;

/// Primitives a unit holds: enough to pay for its tile table, few enough to share among threads.
pub(crate) const UNIT_PRIMITIVE_COUNT: u32 = 4096;

/// Triangles under this many sub-pixel steps a side, 64 pixels, have edge functions that fit in i32.
const WIDE: i32 = 1 << 14;

/// What a shape is, beside its corners.
pub(crate) mod flags {
    /// The counter-clockwise side is seen.
    pub(crate) const FRONT: u32 = 1;
    /// `vertices` index the item's arrays; attributes come from f64 clip space.
    pub(crate) const CLIPPED: u32 = 2;
    /// An axis-aligned rectangle: `x[0]..=x[1]` by `y[0]..=y[1]`.
    pub(crate) const RECT: u32 = 4;
    /// Edge functions may need i64.
    pub(crate) const WIDE: u32 = 8;
    /// Opaque, writes its depth, and is there as a whole: no slab or fade takes a part of it.
    pub(crate) const PLAIN: u32 = 16;
    /// A parallelogram: its corners are the first and that one's neighbours along and across the line.
    /// As plain as shapes with that flag, and never wide.
    pub(crate) const LINE: u32 = 32;
}

/// A shape's segment, as an index into its unit's `segments`, and `flags`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tag(u32);

impl Tag {
    /// Bits that hold flags; the segment is in the others.
    const FLAG_BITS: u32 = 8;

    fn of_segment(number: u32) -> Self {
        Self(number << Self::FLAG_BITS)
    }

    pub(crate) fn with(self, flags: u32) -> Self {
        Self(self.0 | flags)
    }

    pub(crate) fn has(self, flag: u32) -> bool {
        self.0 & flag != 0
    }

    pub(crate) fn flags(self) -> u32 {
        self.0 & ((1 << Self::FLAG_BITS) - 1)
    }

    pub(crate) fn segment(self) -> u32 {
        self.0 >> Self::FLAG_BITS
    }
}

/// What a triangle, rectangle or line needs to be drawn: one cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
pub(crate) struct Shape {
    /// Snapped corners, clockwise as seen on the picture (y down), in sub-pixel steps.
    pub(crate) x: [i32; 3],
    pub(crate) y: [i32; 3],
    /// Depth key at `origin`, and its change a pixel.
    pub(crate) key: [f32; 3],
    pub(crate) key_range: [f32; 2],
    pub(crate) origin: [f32; 2],
    /// Pixels of the picture that it can touch: x0, y0, x1, y1, ends inclusive.
    pub(crate) pixels: [u16; 4],
    pub(crate) tag: Tag,
}

/// Where a shape comes from: what only its colour needs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Origin {
    /// Indices into the unit's `vertices`, in the item's order of corners; into the item's arrays
    /// for [`flags::CLIPPED`], [`flags::RECT`] and [`flags::LINE`], whose far end stands twice.
    pub(crate) vertices: [u32; 3],
    /// Index of the primitive in the item's index buffer.
    pub(crate) primitive: u32,
    /// The shape's tag again: whoever colours it can do without the shape.
    pub(crate) tag: Tag,
}

/// Consecutive primitives of one item, for one instance.
#[derive(Clone, Debug)]
pub(crate) struct Segment {
    pub(crate) item: u32,
    pub(crate) instance: u32,
    pub(crate) primitives: Range<u32>,
}

/// What one job sets up.
#[derive(Debug, Default)]
pub(crate) struct Unit {
    pub(crate) segments: Vec<Segment>,
    pub(crate) vertices: Vec<ScreenVertex>,
    pub(crate) shapes: Vec<Shape>,
    /// One a shape.
    pub(crate) origins: Vec<Origin>,
    /// Shapes of tile `t`: `tile_shapes[tile_offsets[t]..tile_offsets[t + 1]]`, in order.
    tile_offsets: Vec<u32>,
    tile_shapes: Vec<u32>,
    /// Vertices transformed.
    pub(crate) vertex_count: u64,
}

/// What the primitives of one segment have in common while they are set up.
struct Context<'a> {
    level: Level,
    list: &'a DrawList,
    item: &'a Item,
    grid: &'a Grid,
    placing: Placing,
    /// The segment's, without flags.
    tag: Tag,
    /// Depth keys above the first and up to the second make a shape plain, if anything does.
    plain_keys: (f32, f32),
    primitives: Range<u32>,
}

impl Context<'_> {
    /// [`flags::PLAIN`] for a shape of these keys, or nothing.
    fn plain(&self, [farthest, nearest]: [f32; 2]) -> u32 {
        let (lowest, highest) = self.plain_keys;
        if farthest > lowest && nearest <= highest { flags::PLAIN } else { 0 }
    }
}

/// Triangles that wait to be set up together.
#[derive(Default)]
struct Batch {
    corners: [[u32; 3]; LANE_COUNT],
    primitives: [u32; LANE_COUNT],
    /// The side that is seen of each, where winding does not tell.
    sides: Option<[u32; LANE_COUNT]>,
    length: usize,
}

impl Unit {
    /// Sets up the segments; `self` may hold an earlier unit, whose memory is used again.
    pub(crate) fn build(
        &mut self,
        level: Level,
        list: &DrawList,
        view: &View,
        grid: &Grid,
        segments: &[Segment],
    ) {
        self.segments.clear();
        self.segments.extend_from_slice(segments);
        self.vertices.clear();
        self.shapes.clear();
        self.origins.clear();
        self.vertex_count = 0;
        for (number, segment) in (0_u32..).zip(segments) {
            let item = &list.items[segment.item as usize];
            let instance = &list.instances[segment.instance as usize];
            // where frames are looked through, depth is not that of the shape
            let own_depth = !matches!(item.surface, Surface::Parallax { .. });
            let whole = item.depth_write && instance.fade == 1.0;
            let plain = item.blend == Blend::Opaque && own_depth && whole;
            let nowhere = (f32::INFINITY, f32::NEG_INFINITY);
            let context = Context {
                level,
                list,
                item,
                grid,
                placing: Placing::new(view, instance.linear, instance.translation),
                tag: Tag::of_segment(number),
                plain_keys: if plain { slab_keys(view, item.slab) } else { nowhere },
                primitives: segment.primitives.clone(),
            };
            match item.primitive {
                Primitive::Triangles => self.triangles::<3>(&context),
                Primitive::Cards => self.triangles::<4>(&context),
                Primitive::Lines { width_px } => self.lines(&context, width_px),
                Primitive::Points { size_px } => self.points(&context, size_px),
            }
        }
        self.sort_into_tiles(grid);
    }

    /// Triangles, or cards of `CORNERS` = 4.
    fn triangles<const CORNERS: usize>(&mut self, context: &Context<'_>) {
        let Context { level, list, item, placing, primitives, .. } = context;
        let positions = &list.vertices_of(item).positions;
        let range = primitives.start as usize * CORNERS..primitives.end as usize * CORNERS;
        let indices = &list.indices_of(item).indices[range];
        if indices.is_empty() {
            return;
        }
        // Neighbouring primitives share vertices: where the range they span is no longer than the
        // index list, each vertex of it is transformed once.
        let (low, high) =
            indices.iter().fold((u32::MAX, 0), |(low, high), &v| (low.min(v), high.max(v)));
        let span = (high - low) as usize + 1;
        let shared = span <= indices.len();
        let base = u32_from(self.vertices.len());
        let chosen = if shared {
            Chosen::Range(&positions[low as usize..low as usize + span], low)
        } else {
            Chosen::Indexed(positions, indices)
        };
        placing.vertices(*level, chosen, &mut self.vertices);
        self.vertex_count += self.vertices.len() as u64 - u64::from(base);
        let mut batch = Batch::default();
        let mut next = base;
        let shift = base.wrapping_sub(low);
        for (primitive, corners) in primitives.clone().zip(indices.as_chunks::<CORNERS>().0) {
            let at = |corner: usize| {
                let alone = next.wrapping_add(u32_from(corner));
                if shared { corners[corner].wrapping_add(shift) } else { alone }
            };
            self.push(context, positions, &mut batch, [at(0), at(1), at(2)], primitive);
            if CORNERS == 4 {
                self.push(context, positions, &mut batch, [at(0), at(2), at(3)], primitive);
            }
            next = next.wrapping_add(u32_from(CORNERS));
        }
        self.flush(context, positions, &mut batch);
    }

    #[inline]
    fn push(
        &mut self,
        context: &Context<'_>,
        positions: &[Vec3],
        batch: &mut Batch,
        corners: [u32; 3],
        primitive: u32,
    ) {
        let lane = batch.length % LANE_COUNT;
        batch.corners[lane] = corners;
        batch.primitives[lane] = primitive;
        batch.length = lane.wrapping_add(1);
        if batch.length == LANE_COUNT {
            self.flush(context, positions, batch);
        }
    }

    /// Sets up the waiting triangles.
    #[inline(never)]
    fn flush(&mut self, context: &Context<'_>, positions: &[Vec3], batch: &mut Batch) {
        context.level.run(SetUp { unit: self, context, positions, batch });
        batch.length = 0;
    }

    /// A triangle that is large or reaches out of what can be drawn.
    #[cold]
    fn triangle_alone(
        &mut self,
        context: &Context<'_>,
        positions: &[Vec3],
        vertices: [u32; 3],
        primitive: u32,
    ) {
        let corners = vertices.map(|v| self.vertices[v as usize]);
        let winding = context.placing.stored_winding();
        if !corners.iter().any(|c| c.key.is_nan()) {
            let points = corners.map(|c| [c.x, c.y, c.key]);
            self.extend(context, points, vertices, primitive, winding);
            return;
        }
        let sources = corners.map(|c| c.source);
        let local = sources.map(|v| positions[v as usize].as_dvec3());
        let polygon = clip_polygon(&context.placing.exact, local, f64::from(GUARD_PX));
        for pair in polygon.windows(2).skip(1) {
            let points = [polygon[0], pair[0], pair[1]];
            self.extend(context, points, sources, primitive, winding | flags::CLIPPED);
        }
    }

    /// Appends a triangle of corners (x, y, key) if a sample may be covered.
    ///
    /// `winding` has [`flags::FRONT`] if corners that run counter-clockwise on the picture show the
    /// front.
    fn extend(
        &mut self,
        context: &Context<'_>,
        points: [[f32; 3]; 3],
        vertices: [u32; 3],
        primitive: u32,
        winding: u32,
    ) {
        if let Some(mut shape) = triangle(points, context.tag.with(winding), context.grid) {
            shape.tag = shape.tag.with(context.plain(shape.key_range));
            self.origins.push(Origin { vertices, primitive, tag: shape.tag });
            self.shapes.push(shape);
        }
    }

    /// Makes the last shapes, from `first` on, show a side.
    fn show_side(&mut self, first: usize, side: u32) {
        let made = self.shapes[first..].iter_mut().zip(&mut self.origins[first..]);
        for (shape, origin) in made {
            shape.tag = Tag(shape.tag.0 & !flags::FRONT | side);
            origin.tag = shape.tag;
        }
    }

    /// Counting sort of the shapes by tile; within a tile they keep their order.
    fn sort_into_tiles(&mut self, grid: &Grid) {
        let Self { shapes, tile_offsets, tile_shapes, .. } = self;
        let (tile_count, columns) = (grid.tile_count(), grid.column_count());
        let each_tile = |shape: &Shape, visit: &mut dyn FnMut(usize)| {
            let [column0, row0, column1, row1] = grid.tiles(shape.pixels);
            for row in row0..=row1 {
                for column in column0..=column1 {
                    visit(row.wrapping_mul(columns).wrapping_add(column));
                }
            }
        };
        // most shapes lie in one tile
        let only_tile = |shape: &Shape| {
            let [column0, row0, column1, row1] = grid.tiles(shape.pixels);
            let tile = row0.wrapping_mul(columns).wrapping_add(column0);
            (column0 == column1 && row0 == row1).then_some(tile)
        };
        tile_offsets.clear();
        tile_offsets.resize(tile_count + 1, 0);
        for shape in shapes.iter() {
            match only_tile(shape) {
                Some(tile) => tile_offsets[tile + 1] = tile_offsets[tile + 1].wrapping_add(1),
                None => each_tile(shape, &mut |tile| tile_offsets[tile + 1] += 1),
            }
        }
        let mut sum = 0_u32;
        for offset in tile_offsets.iter_mut() {
            sum = sum.wrapping_add(*offset);
            *offset = sum;
        }
        tile_shapes.clear();
        tile_shapes.resize(sum as usize, 0);
        for (index, shape) in (0_u32..).zip(shapes.iter()) {
            // offsets run ahead while filling and are set back below
            let mut put = |tile: usize| {
                let next = &mut tile_offsets[tile];
                tile_shapes[*next as usize] = index;
                *next = next.wrapping_add(1);
            };
            match only_tile(shape) {
                Some(tile) => put(tile),
                None => each_tile(shape, &mut put),
            }
        }
        tile_offsets.copy_within(0..tile_count, 1);
        tile_offsets[0] = 0;
    }

    /// Shapes that touch a tile, in paint order.
    #[inline(always)]
    pub(crate) fn shapes_in(&self, tile: usize) -> &[u32] {
        let range = self.tile_offsets[tile] as usize..self.tile_offsets[tile + 1] as usize;
        &self.tile_shapes[range]
    }
}

/// Three corners' numbers as vectors. (What is not inlined cannot use the level's instructions, and
/// nothing promises that `map` is.)
#[inline(always)]
fn floats_of<S: Simd>(simd: S, [a, b, c]: [[f32; LANE_COUNT]; 3]) -> [f32x8<S>; 3] {
    [f32x8::simd_from(simd, a), f32x8::simd_from(simd, b), f32x8::simd_from(simd, c)]
}

#[inline(always)]
fn steps_of<S: Simd>(simd: S, [a, b, c]: [[i32; LANE_COUNT]; 3]) -> [i32x8<S>; 3] {
    [i32x8::simd_from(simd, a), i32x8::simd_from(simd, b), i32x8::simd_from(simd, c)]
}

/// Sets up the triangles of a batch, a lane each, and appends those that may be seen.
struct SetUp<'a> {
    unit: &'a mut Unit,
    context: &'a Context<'a>,
    positions: &'a [Vec3],
    batch: &'a Batch,
}

impl Kernel for SetUp<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { unit, context, positions, batch } = self;
        let mut floats = [[[0.0_f32; LANE_COUNT]; 3]; 3];
        let mut steps = [[[0_i32; LANE_COUNT]; 3]; 2];
        for lane in 0..batch.length.min(LANE_COUNT) {
            for corner in 0..3 {
                let vertex = &unit.vertices[batch.corners[lane][corner] as usize];
                floats[0][corner][lane] = vertex.x;
                floats[1][corner][lane] = vertex.y;
                floats[2][corner][lane] = vertex.key;
                steps[0][corner][lane] = vertex.snapped[0];
                steps[1][corner][lane] = vertex.snapped[1];
            }
        }
        let [x, y] = [floats_of(simd, floats[0]), floats_of(simd, floats[1])];
        let key = floats_of(simd, floats[2]);
        let [sx, sy] = [steps_of(simd, steps[0]), steps_of(simd, steps[1])];
        // one NaN corner makes the sum NaN; nothing else can, since keys are finite
        let sum = key[0] + key[1] + key[2];
        let clipped = sum.simd_ne(sum).to_bitmask();
        let low = [sx[0].min(sx[1]).min(sx[2]), sy[0].min(sy[1]).min(sy[2])];
        let high = [sx[0].max(sx[1]).max(sx[2]), sy[0].max(sy[1]).max(sy[2])];
        let limit = i32x8::splat(simd, WIDE);
        let wide = (high[0] - low[0]).simd_ge(limit) | (high[1] - low[1]).simd_ge(limit);
        let alone = clipped | wide.to_bitmask();
        let (ux, vx, uy, vy) = (sx[1] - sx[0], sx[2] - sx[0], sy[1] - sy[0], sy[2] - sy[0]);
        let doubled_area = ux * vy - uy * vx;
        let pixels = PixelBoxes::new(simd, context.grid, low, high);
        let zero = i32x8::splat(simd, 0);
        let drawn = pixels.held & (!doubled_area.simd_eq(zero)).to_bitmask();
        let mut left = (drawn | alone) & ((1_u64 << batch.length) - 1);
        if left == 0 {
            return;
        }
        let [slope_x, slope_y] = slopes(simd, x, y, key);
        let keys: [[f32; LANE_COUNT]; 3] = [key[0].into(), slope_x.into(), slope_y.into()];
        let nearest: [f32; LANE_COUNT] = key[0].max(key[1]).max(key[2]).into();
        let farthest: [f32; LANE_COUNT] = key[0].min(key[1]).min(key[2]).into();
        let turned = doubled_area.simd_lt(zero).to_bitmask();
        while left != 0 {
            let lane = left.trailing_zeros() as usize % LANE_COUNT;
            left &= left.wrapping_sub(1);
            let (vertices, primitive) = (batch.corners[lane], batch.primitives[lane]);
            if alone >> lane & 1 == 1 {
                let first = unit.shapes.len();
                unit.triangle_alone(context, positions, vertices, primitive);
                if let Some(sides) = batch.sides {
                    unit.show_side(first, sides[lane]);
                }
                continue;
            }
            let is_turned = turned >> lane & 1 == 1;
            // counter-clockwise as seen, since y points down
            let [b, c] = if is_turned { [2, 1] } else { [1, 2] };
            let winding = match batch.sides {
                Some(sides) => sides[lane],
                None => context.placing.stored_winding() ^ (u32::from(!is_turned) * flags::FRONT),
            };
            let key_range = [farthest[lane], nearest[lane]];
            let tag = context.tag.with(winding | context.plain(key_range));
            unit.shapes.push(Shape {
                x: [steps[0][0][lane], steps[0][b][lane], steps[0][c][lane]],
                y: [steps[1][0][lane], steps[1][b][lane], steps[1][c][lane]],
                key: [keys[0][lane], keys[1][lane], keys[2][lane]],
                key_range,
                origin: [floats[0][0][lane], floats[1][0][lane]],
                pixels: pixels.get(lane),
                tag,
            });
            unit.origins.push(Origin { vertices, primitive, tag });
        }
    }
}

/// An index of a unit, which is small.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "a unit has few vertices")]
fn u32_from(index: usize) -> u32 {
    index as u32
}

/// How the depth key changes a pixel to the right and down; not at all where that is not finite.
#[inline(always)]
fn slopes<S: Simd>(
    simd: S,
    x: [f32x8<S>; 3],
    y: [f32x8<S>; 3],
    key: [f32x8<S>; 3],
) -> [f32x8<S>; 2] {
    let [ux, vx, uy, vy] = [x[1] - x[0], x[2] - x[0], y[1] - y[0], y[2] - y[0]];
    let (uk, vk) = (key[1] - key[0], key[2] - key[0]);
    let area = ux * vy - vx * uy;
    finite_or_none(simd, [(uk * vy - vk * uy) / area, (vk * ux - uk * vx) / area])
}

/// Slopes, or 0 where either is not finite.
#[inline(always)]
fn finite_or_none<S: Simd>(simd: S, [slope_x, slope_y]: [f32x8<S>; 2]) -> [f32x8<S>; 2] {
    // infinity times 0 is NaN, which is not 0
    let none = f32x8::splat(simd, 0.0);
    let finite = (slope_x * 0.0 + slope_y * 0.0).simd_eq(none);
    [finite.select(slope_x, none), finite.select(slope_y, none)]
}

/// A triangle from corners (x, y, key), or nothing where no sample can be covered. `tag` as in
/// [`Unit::extend`].
fn triangle(points: [[f32; 3]; 3], tag: Tag, grid: &Grid) -> Option<Shape> {
    let mut x = points.map(|p| snap(p[0]));
    let mut y = points.map(|p| snap(p[1]));
    let edge = |to: usize| (i64::from(x[to] - x[0]), i64::from(y[to] - y[0]));
    let ((ux, uy), (vx, vy)) = (edge(1), edge(2));
    let doubled_area = ux * vy - uy * vx;
    if doubled_area == 0 {
        return None;
    }
    let mut tag = tag;
    if doubled_area < 0 {
        // counter-clockwise as seen, since y points down
        x.swap(1, 2);
        y.swap(1, 2);
    } else {
        tag.0 ^= flags::FRONT;
    }
    let low = [x[0].min(x[1]).min(x[2]), y[0].min(y[1]).min(y[2])];
    let high = [x[0].max(x[1]).max(x[2]), y[0].max(y[1]).max(y[2])];
    let pixels = grid.pixel_box(low, high)?;
    if high[0] - low[0] >= WIDE || high[1] - low[1] >= WIDE {
        tag = tag.with(flags::WIDE);
    }
    let [[x0, y0, k0], [x1, y1, k1], [x2, y2, k2]] = points;
    let area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
    let slope_x = ((k1 - k0) * (y2 - y0) - (k2 - k0) * (y1 - y0)) / area;
    let slope_y = ((k2 - k0) * (x1 - x0) - (k1 - k0) * (x2 - x0)) / area;
    let sloped = slope_x.is_finite() && slope_y.is_finite();
    Some(Shape {
        x,
        y,
        key: if sloped { [k0, slope_x, slope_y] } else { [k0, 0.0, 0.0] },
        key_range: [k0.min(k1).min(k2), k0.max(k1).max(k2)],
        origin: [x0, y0],
        pixels,
        tag,
    })
}

/// Units' segments: the list's primitives in order, cut into pieces of a unit's size.
pub(crate) fn cut(list: &DrawList) -> Vec<Vec<Segment>> {
    let mut units = Vec::new();
    let mut current: Vec<Segment> = Vec::new();
    let mut room = UNIT_PRIMITIVE_COUNT;
    for (number, item) in (0_u32..).zip(&list.items) {
        for instance in item.instances.clone() {
            let mut next = item.primitives.start;
            while next < item.primitives.end {
                let end = item.primitives.end.min(next + room);
                current.push(Segment { item: number, instance, primitives: next..end });
                room -= end - next;
                next = end;
                if room == 0 {
                    units.push(std::mem::take(&mut current));
                    room = UNIT_PRIMITIVE_COUNT;
                }
            }
        }
    }
    if !current.is_empty() {
        units.push(current);
    }
    units
}
