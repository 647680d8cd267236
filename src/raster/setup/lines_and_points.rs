//! Set-up of lines, which are rectangles with butt ends, and of points, which are squares along the
//! picture's axes, eight at once. A line of which something takes a part (a plane, a slab, a fade, what it
//! lets through) or which is long is two triangles.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8};
use glam::Vec3;

use super::{Batch, Context, Origin, Shape, Unit, WIDE, flags};
use crate::raster::grid::PixelBoxes;
use crate::raster::placing::{GUARD_PX, ScreenVertex, snap, snap_lanes};
use crate::simd::{Kernel, LANE_COUNT};

impl Unit {
    /// Lines as parallelograms where they are plain, and as two triangles elsewhere.
    pub(super) fn lines(&mut self, context: &Context<'_>, width_px: f32) {
        let Context { level, list, item, primitives, plain_keys, .. } = context;
        self.vertex_count += 2 * u64::from(primitives.end - primitives.start);
        let mut batch = Batch { sides: Some([0; LANE_COUNT]), ..Batch::default() };
        let half = width_px * 0.5;
        if plain_keys.0 < plain_keys.1 {
            level.run(SetUpLines { unit: self, context, half, batch: &mut batch });
        } else {
            for primitive in primitives.clone() {
                self.line_in_two(context, half, &mut batch, primitive);
            }
        }
        self.flush(context, &list.vertices_of(item).positions, &mut batch);
    }

    /// Appends a line as two triangles.
    #[inline(never)]
    fn line_in_two(&mut self, context: &Context<'_>, half: f32, batch: &mut Batch, primitive: u32) {
        let Context { list, item, placing, .. } = context;
        let buffers = list.vertices_of(item);
        let indices = &list.indices_of(item).indices;
        let at = primitive as usize * 2;
        let ends = [indices[at], indices[at + 1]];
        let local = ends.map(|v| buffers.positions[v as usize]);
        let cut = placing.exact.line(local.map(|p| p.as_dvec3()), f64::from(GUARD_PX));
        let Some([a, b]) = cut else { return };
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = libm::hypotf(along[0], along[1]);
        if length == 0.0 {
            return;
        }
        let half = half / length;
        let across = [-along[1] * half, along[0] * half];
        let corner = |end: [f32; 3], sign: f32, source: u32| {
            let (x, y) = (end[0] + sign * across[0], end[1] + sign * across[1]);
            ScreenVertex { x, y, key: end[2], source, snapped: [snap(x), snap(y)] }
        };
        let quad = [
            corner(a, -1.0, ends[0]),
            corner(b, -1.0, ends[1]),
            corner(b, 1.0, ends[1]),
            corner(a, 1.0, ends[0]),
        ];
        if quad.iter().any(|c| !(c.x.abs() <= GUARD_PX && c.y.abs() <= GUARD_PX)) {
            return;
        }
        let side = placing.side_seen(local[0], buffers.normals[ends[0] as usize]);
        let base = super::u32_from(self.vertices.len());
        self.vertices.extend(quad);
        for corners in [[0, 1, 2], [0, 2, 3]] {
            if let Some(sides) = &mut batch.sides {
                sides[batch.length % LANE_COUNT] = side;
            }
            let vertices = corners.map(|c| base + c);
            self.push(context, &buffers.positions, batch, vertices, primitive);
        }
    }

    /// Points as rectangles.
    pub(super) fn points(&mut self, context: &Context<'_>, size_px: f32) {
        let Context { level, primitives, .. } = context;
        self.vertex_count += u64::from(primitives.end - primitives.start);
        level.run(SetUpPoints { unit: self, context, half: size_px * 0.5 });
    }
}

/// Sets up lines, eight at a time, and appends those that may be seen.
struct SetUpLines<'a> {
    unit: &'a mut Unit,
    context: &'a Context<'a>,
    half: f32,
    /// Triangles of lines that are no parallelograms.
    batch: &'a mut Batch,
}

impl Kernel for SetUpLines<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { unit, context, half, batch } = self;
        let Context { list, item, placing, primitives, grid, .. } = context;
        let buffers = list.vertices_of(item);
        let range = primitives.start as usize * 2..primitives.end as usize * 2;
        let indices = list.indices_of(item).indices[range].as_chunks::<2>().0;
        unit.shapes.reserve(indices.len());
        unit.origins.reserve(indices.len());
        let (lowest, highest) = context.plain_keys;
        let none = f32x8::splat(simd, 0.0);
        let limit = i32x8::splat(simd, WIDE);
        let mut first_primitive = primitives.start;
        for chosen in indices.chunks(LANE_COUNT) {
            let mut ends = [[0_u32; LANE_COUNT]; 2];
            for (lane, &[near, far]) in chosen.iter().enumerate() {
                ends[0][lane % LANE_COUNT] = near;
                ends[1][lane % LANE_COUNT] = far;
            }
            let [near, far] = [&ends[0][..chosen.len()], &ends[1][..chosen.len()]];
            let position = gathered(simd, &buffers.positions, near);
            let normal = gathered(simd, &buffers.normals, near);
            let ([x, y, key], inside) = placing.lanes(simd, position);
            let other = gathered(simd, &buffers.positions, far);
            let ([other_x, other_y, other_key], other_inside) = placing.lanes(simd, other);
            let backs = placing.backs_seen(simd, position, normal).to_bitmask();
            let (along_x, along_y) = (other_x - x, other_y - y);
            let squared = along_x * along_x + along_y * along_y;
            let scale = half / squared.sqrt();
            let (across_x, across_y) = (none - along_y * scale, along_x * scale);
            // the near end's two corners, and a far one; the other is opposite
            let corner_x = [x - across_x, other_x - across_x, x + across_x];
            let corner_y = [y - across_y, other_y - across_y, y + across_y];
            let [sx0, sx1, sx2] =
                [snap_lanes(corner_x[0]), snap_lanes(corner_x[1]), snap_lanes(corner_x[2])];
            let [sy0, sy1, sy2] =
                [snap_lanes(corner_y[0]), snap_lanes(corner_y[1]), snap_lanes(corner_y[2])];
            let (ux, uy, vx, vy) = (sx1 - sx0, sy1 - sy0, sx2 - sx0, sy2 - sy0);
            let (sx3, sy3) = (sx1 + vx, sy1 + vy);
            let [low, high] = [
                [sx0.min(sx1).min(sx2.min(sx3)), sy0.min(sy1).min(sy2.min(sy3))],
                [sx0.max(sx1).max(sx2.max(sx3)), sy0.max(sy1).max(sy2.max(sy3))],
            ];
            let wide = (high[0] - low[0]).simd_ge(limit) | (high[1] - low[1]).simd_ge(limit);
            let (farthest, nearest) = (key.min(other_key), key.max(other_key));
            let plain = farthest.simd_gt(f32x8::splat(simd, lowest))
                & nearest.simd_le(f32x8::splat(simd, highest));
            // a line without length is nowhere, in two triangles as in one shape
            let whole = inside & other_inside & squared.simd_gt(none) & plain & !wide;
            let pixels = PixelBoxes::new(simd, grid, low, high);
            let area = ux * vy - uy * vx;
            let drawn = whole & area.simd_gt(i32x8::splat(simd, 0));
            let slope = (other_key - key) / squared;
            let slopes = super::finite_or_none(simd, [slope * along_x, slope * along_y]);
            let steps: [[i32; LANE_COUNT]; 6] =
                [sx0.into(), sx1.into(), sx2.into(), sy0.into(), sy1.into(), sy2.into()];
            let place: [[f32; LANE_COUNT]; 2] = [x.into(), y.into()];
            let keys: [[f32; LANE_COUNT]; 3] = [key.into(), slopes[0].into(), slopes[1].into()];
            let key_ranges: [[f32; LANE_COUNT]; 2] = [farthest.into(), nearest.into()];
            let (drawn, whole) = (drawn.to_bitmask() & pixels.held, whole.to_bitmask());
            let mut left_over = (drawn | !whole) & ((1_u64 << chosen.len()) - 1);
            while left_over != 0 {
                let lane = left_over.trailing_zeros() as usize % LANE_COUNT;
                left_over &= left_over.wrapping_sub(1);
                let primitive = first_primitive.wrapping_add(super::u32_from(lane));
                if drawn >> lane & 1 == 0 {
                    unit.line_in_two(context, half, batch, primitive);
                    continue;
                }
                if batch.length != 0 {
                    unit.flush(context, &buffers.positions, batch);
                }
                let side = if backs >> lane & 1 == 1 { 0 } else { flags::FRONT };
                let tag = context.tag.with(flags::LINE | side);
                unit.shapes.push(Shape {
                    x: [steps[0][lane], steps[1][lane], steps[2][lane]],
                    y: [steps[3][lane], steps[4][lane], steps[5][lane]],
                    key: [keys[0][lane], keys[1][lane], keys[2][lane]],
                    key_range: [key_ranges[0][lane], key_ranges[1][lane]],
                    origin: [place[0][lane], place[1][lane]],
                    pixels: pixels.get(lane),
                    tag,
                });
                let vertices = [ends[0][lane], ends[1][lane], ends[1][lane]];
                unit.origins.push(Origin { vertices, primitive, tag });
            }
            first_primitive = first_primitive.wrapping_add(super::u32_from(LANE_COUNT));
        }
    }
}

/// Sets up points, eight at a time, and appends those that may be seen.
struct SetUpPoints<'a> {
    unit: &'a mut Unit,
    context: &'a Context<'a>,
    half: f32,
}

impl Kernel for SetUpPoints<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { unit, context, half } = self;
        let Context { list, item, placing, primitives, grid, .. } = context;
        let buffers = list.vertices_of(item);
        let range = primitives.start as usize..primitives.end as usize;
        let indices = &list.indices_of(item).indices[range];
        unit.shapes.reserve(indices.len());
        unit.origins.reserve(indices.len());
        let (lowest, highest) = context.plain_keys;
        let mut first_primitive = primitives.start;
        for chosen in indices.chunks(LANE_COUNT) {
            let position = gathered(simd, &buffers.positions, chosen);
            let normal = gathered(simd, &buffers.normals, chosen);
            let ([x, y, key], inside) = placing.lanes(simd, position);
            let backs = placing.backs_seen(simd, position, normal).to_bitmask();
            // a sample on the right or lower edge belongs to the next square
            let [rect_x0, rect_y0] = [snap_lanes(x - half), snap_lanes(y - half)];
            let [rect_x1, rect_y1] = [snap_lanes(x + half) - 1, snap_lanes(y + half) - 1];
            let pixels = PixelBoxes::new(simd, grid, [rect_x0, rect_y0], [rect_x1, rect_y1]);
            let drawn = inside & rect_x0.simd_le(rect_x1) & rect_y0.simd_le(rect_y1);
            let plain = (key.simd_gt(f32x8::splat(simd, lowest))
                & key.simd_le(f32x8::splat(simd, highest)))
            .to_bitmask();
            let rect: [[i32; LANE_COUNT]; 4] =
                [rect_x0.into(), rect_y0.into(), rect_x1.into(), rect_y1.into()];
            let place: [[f32; LANE_COUNT]; 3] = [x.into(), y.into(), key.into()];
            let mut left_over = drawn.to_bitmask() & pixels.held & ((1_u64 << chosen.len()) - 1);
            while left_over != 0 {
                let lane = left_over.trailing_zeros() as usize % LANE_COUNT;
                left_over &= left_over.wrapping_sub(1);
                let side = if backs >> lane & 1 == 1 { 0 } else { flags::FRONT };
                let plain = if plain >> lane & 1 == 1 { flags::PLAIN } else { 0 };
                let tag = context.tag.with(flags::RECT | side | plain);
                let key = place[2][lane];
                unit.shapes.push(Shape {
                    x: [rect[0][lane], rect[2][lane], 0],
                    y: [rect[1][lane], rect[3][lane], 0],
                    key: [key, 0.0, 0.0],
                    key_range: [key; 2],
                    origin: [place[0][lane], place[1][lane]],
                    pixels: pixels.get(lane),
                    tag,
                });
                let primitive = first_primitive.wrapping_add(super::u32_from(lane));
                unit.origins.push(Origin { vertices: [chosen[lane]; 3], primitive, tag });
            }
            first_primitive = first_primitive.wrapping_add(super::u32_from(LANE_COUNT));
        }
    }
}

/// Components of up to eight vectors; the lanes after them are 0.
#[inline(always)]
fn gathered<S: Simd>(simd: S, vectors: &[Vec3], chosen: &[u32]) -> [f32x8<S>; 3] {
    let [mut x, mut y, mut z] = [[0.0; LANE_COUNT]; 3];
    for (lane, &index) in chosen.iter().take(LANE_COUNT).enumerate() {
        let vector = vectors[index as usize];
        (x[lane], y[lane], z[lane]) = (vector.x, vector.y, vector.z);
    }
    [f32x8::simd_from(simd, x), f32x8::simd_from(simd, y), f32x8::simd_from(simd, z)]
}

#[cfg(test)]
mod tests;
