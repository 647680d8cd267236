//! Which vectors of samples a small triangle may cover, row by row: edges of eight triangles set up at
//! once, and of a triangle wider than a vector only the span of each row that its edges leave.
//!
//! Triangles are long and thin more often than not: most of a wide one's box lies outside it. Where
//! a row's span begins and ends is found for eight rows at once, in f32 and a little too wide;
//! whether a sample is inside is decided exactly, by the same edge functions as everywhere.
//!
//! This work is based on:
//! Juan Pineda. A parallel algorithm for polygon rasterization. 1988

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8};

use crate::raster::coverage::{Covered, Lanes};
use crate::raster::grid::PixelBox;
use crate::raster::samples::SUBPIXEL_COUNT;
use crate::raster::setup::Shape;
use crate::raster::visible::index;
use crate::simd::LANE_COUNT;

/// Pixels that a span is too wide on either side: far more than f32 errs over 64 pixels.
const SLACK: f32 = 1.0 / 64.0;

/// Eight numbers, one a triangle, for each of three edges.
type Numbers<T> = [[T; LANE_COUNT]; 3];

/// Corners and pixels of eight triangles.
#[derive(Default)]
pub(crate) struct Corners {
    x: Numbers<i32>,
    y: Numbers<i32>,
    /// x0, y0, x1, y1, ends inclusive.
    pixels: [[i32; LANE_COUNT]; 4],
}

impl Corners {
    /// Takes a triangle in.
    #[inline(always)]
    pub(crate) fn put(&mut self, lane: usize, shape: &Shape) {
        for corner in 0..3 {
            self.x[corner][lane] = shape.x[corner];
            self.y[corner][lane] = shape.y[corner];
        }
        for (pixels, pixel) in self.pixels.iter_mut().zip(shape.pixels) {
            pixels[lane] = i32::from(pixel);
        }
    }
}

/// Edge functions of eight triangles, which are negative outside: modulo 2^32, exact for triangles
/// under 64 pixels.
#[derive(Default)]
pub(crate) struct Edges {
    /// At the upper left corner of the first pixel.
    at: Numbers<i32>,
    /// Changes a sub-pixel step to the right, and down.
    a: Numbers<i32>,
    b: Numbers<i32>,
    /// What a sample of a pixel has more than its upper left corner, at most.
    most: Numbers<i32>,
    /// Pixels to the right over which the function falls by one.
    falls: Numbers<f32>,
    /// Pixels in the tile: x0, y0, x1, y1, ends inclusive.
    pixels: [[i32; LANE_COUNT]; 4],
}

impl Edges {
    /// Those of triangles in a tile (x0, y0, x1, y1, ends exclusive), set up by lanes.
    #[inline(always)]
    pub(crate) fn new<S: Simd>(
        simd: S,
        lanes: &Lanes,
        corners: &Corners,
        tile_box: [i32; 4],
    ) -> Self {
        let mut edges = Self::default();
        let vector = |numbers: [i32; LANE_COUNT]| i32x8::simd_from(simd, numbers);
        let zero = i32x8::splat(simd, 0);
        let x0 = vector(corners.pixels[0]).max(i32x8::splat(simd, tile_box[0]));
        let y0 = vector(corners.pixels[1]).max(i32x8::splat(simd, tile_box[1]));
        let last = [tile_box[2].wrapping_sub(1), tile_box[3].wrapping_sub(1)];
        let x1 = vector(corners.pixels[2]).min(i32x8::splat(simd, last[0]));
        let y1 = vector(corners.pixels[3]).min(i32x8::splat(simd, last[1]));
        let [low, high] = lanes.reach();
        let (left, top) = (x0 * SUBPIXEL_COUNT, y0 * SUBPIXEL_COUNT);
        for (from, to) in [(0, 1), (1, 2), (2, 0)] {
            let (x, y) = (vector(corners.x[from]), vector(corners.y[from]));
            let (b, dy) = (vector(corners.x[to]) - x, vector(corners.y[to]) - y);
            let a = zero - dy;
            // corners run clockwise with y down: inside is right of an edge that goes up, below one
            // that goes right
            let owns = dy.simd_lt(zero) | (dy.simd_eq(zero) & b.simd_gt(zero));
            // a mask is -1 where it holds; not negative is inside, also for edges that do not own
            let at = a * (left - x) + b * (top - y) - owns.to_vector() - 1;
            let most = (a * low[0]).max(a * high[0]) + (b * low[1]).max(b * high[1]);
            let falls = -1.0 / (a * SUBPIXEL_COUNT).to_float::<f32x8<S>>();
            let none = f32x8::splat(simd, 0.0);
            edges.at[from] = at.into();
            edges.a[from] = a.into();
            edges.b[from] = b.into();
            edges.most[from] = most.into();
            edges.falls[from] = a.simd_eq(zero).select(none, falls).into();
        }
        edges.pixels = [x0.into(), y0.into(), x1.into(), y1.into()];
        edges
    }

    /// A triangle's pixels in the tile, ends inclusive.
    #[inline(always)]
    pub(crate) fn pixels(&self, lane: usize) -> PixelBox {
        let lane = lane % LANE_COUNT;
        let [x0, y0, x1, y1] = &self.pixels;
        [x0[lane], y0[lane], x1[lane], y1[lane]]
    }

    /// Calls `visit` for vectors that hold all samples which a triangle covers, with the samples'
    /// places in pixels. Some hold none.
    #[inline(always)]
    pub(crate) fn each<S: Simd, const BLOCKS: usize>(
        &self,
        simd: S,
        lanes: &Lanes,
        lane: usize,
        side: usize,
        mut visit: impl FnMut(Covered<S>, [f32x8<S>; 2]),
    ) {
        let lane = lane % LANE_COUNT;
        let [x0, y0, x1, y1] = self.pixels(lane);
        let splat = |numbers: &Numbers<i32>, edge: usize| i32x8::splat(simd, numbers[edge][lane]);
        let zero = i32x8::splat(simd, 0);
        let a = [splat(&self.a, 0), splat(&self.a, 1), splat(&self.a, 2)];
        let b = [splat(&self.b, 0), splat(&self.b, 1), splat(&self.b, 2)];
        let at = [splat(&self.at, 0), splat(&self.at, 1), splat(&self.at, 2)];
        let down = [b[0] * SUBPIXEL_COUNT, b[1] * SUBPIXEL_COUNT, b[2] * SUBPIXEL_COUNT];
        let mut inner = [[zero; 3]; BLOCKS];
        let mut places = [[f32x8::splat(simd, 0.0); 2]; BLOCKS];
        for (block, (inner, place)) in inner.iter_mut().zip(&mut places).enumerate() {
            let [x, y] = [lanes.steps(simd, block, 0), lanes.steps(simd, block, 1)];
            *inner = [a[0] * x + b[0] * y, a[1] * x + b[1] * y, a[2] * x + b[2] * y];
            *place = [lanes.pixels(simd, block, 0), lanes.pixels(simd, block, 1)];
        }
        let columns = lanes.column_vector(simd);
        let width = x1.wrapping_sub(x0);
        let row_length = side.wrapping_mul(lanes.sample_count);
        let (mut y, mut row_at) = (y0, 0_usize);
        let mut place_y = f32x8::splat(simd, y0 as f32);
        if BLOCKS == 1 && width < lanes.column_count {
            // most triangles are no wider than a vector at one sample
            let beyond = i32x8::splat(simd, width) - columns;
            let [inner_a, inner_b, inner_c] = inner[0];
            let mut here = [inner_a + at[0], inner_b + at[1], inner_c + at[2]];
            let place_x = places[0][0] + x0 as f32;
            while y <= y1 {
                let [a, b, c] = here;
                let inside = (a | b | c | beyond).simd_ge(zero);
                let bits = inside.to_bitmask();
                let hit = Covered { x: x0, y, block: 0, at: row_at, inside, bits };
                visit(hit, [place_x, places[0][1] + place_y]);
                here = [a + down[0], b + down[1], c + down[2]];
                y = y.wrapping_add(1);
                place_y += 1.0;
                row_at = row_at.wrapping_add(row_length);
            }
            return;
        }
        let vector_length = BLOCKS.wrapping_mul(LANE_COUNT);
        let right = [a[0] * SUBPIXEL_COUNT, a[1] * SUBPIXEL_COUNT, a[2] * SUBPIXEL_COUNT];
        let rows = i32x8::simd_from(simd, [0, 1, 2, 3, 4, 5, 6, 7]);
        let endless = f32x8::splat(simd, f32::INFINITY);
        let none = f32x8::splat(simd, 0.0);
        let rightmost = i32x8::splat(simd, width);
        let mut at = at;
        while y <= y1 {
            let mut starts = [zero; 3];
            let mut first = none;
            let mut last = rightmost.to_float::<f32x8<S>>();
            for edge in 0..3 {
                let start = at[edge] + rows * down[edge];
                starts[edge] = start;
                let most: f32x8<S> = (start + splat(&self.most, edge)).to_float();
                let falls = f32x8::splat(simd, self.falls[edge][lane]);
                let ends = most * falls;
                let rises = falls.simd_lt(none);
                let drops = falls.simd_gt(none);
                first = first.max(rises.select(ends - SLACK, none));
                last = last.min(drops.select(ends + SLACK, endless));
            }
            let first = first.ceil().to_int::<i32x8<S>>().min(rightmost);
            let last: [i32; LANE_COUNT] = last.floor().to_int::<i32x8<S>>().into();
            let start_a: [i32; LANE_COUNT] = (starts[0] + first * right[0]).into();
            let start_b: [i32; LANE_COUNT] = (starts[1] + first * right[1]).into();
            let start_c: [i32; LANE_COUNT] = (starts[2] + first * right[2]).into();
            let place_x: [f32; LANE_COUNT] = (first + x0).to_float::<f32x8<S>>().into();
            let first: [i32; LANE_COUNT] = first.into();
            for row in 0..LANE_COUNT {
                let mut column = first[row];
                let skipped = index(column, 0, 0).wrapping_mul(lanes.sample_count);
                let mut at = row_at.wrapping_add(skipped);
                let mut here = [start_a[row], start_b[row], start_c[row]];
                let mut place_x = place_x[row];
                loop {
                    let beyond = i32x8::splat(simd, width.wrapping_sub(column)) - columns;
                    let x = x0.wrapping_add(column);
                    for block in 0..BLOCKS {
                        let [a, b, c] = inner[block];
                        let (a, b, c) = (a + here[0], b + here[1], c + here[2]);
                        let inside = (a | b | c | beyond).simd_ge(zero);
                        let bits = inside.to_bitmask();
                        let at = at.wrapping_add(block.wrapping_mul(LANE_COUNT));
                        let hit = Covered { x, y, block, at, inside, bits };
                        visit(hit, [places[block][0] + place_x, places[block][1] + place_y]);
                    }
                    column = column.wrapping_add(lanes.column_count);
                    if column > last[row] {
                        break;
                    }
                    at = at.wrapping_add(vector_length);
                    place_x += lanes.column_count as f32;
                    let step = SUBPIXEL_COUNT.wrapping_mul(lanes.column_count);
                    for (here, a) in here.iter_mut().zip(&self.a) {
                        *here = here.wrapping_add(a[lane].wrapping_mul(step));
                    }
                }
                y = y.wrapping_add(1);
                place_y += 1.0;
                row_at = row_at.wrapping_add(row_length);
                if y > y1 {
                    return;
                }
            }
            at = [at[0] + down[0] * 8, at[1] + down[1] * 8, at[2] + down[2] * 8];
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;
    use crate::raster::coverage::covered;
    use crate::raster::grid::Grid;
    use crate::raster::samples;
    use crate::simd::{Kernel, Level};
    use crate::view::{Projection, View};

    const SIDE: i32 = 128;

    /// Samples inside, as indices from the box's first one on, and how many vectors were looked at.
    type Found = (BTreeSet<usize>, usize);

    struct Look<'a> {
        lanes: &'a Lanes,
        shape: &'a Shape,
        tile_box: [i32; 4],
        by_spans: bool,
    }

    impl Look<'_> {
        #[inline(always)]
        fn look<S: Simd, const BLOCKS: usize>(self, simd: S) -> Found {
            let Self { lanes, shape, tile_box, by_spans } = self;
            let mut corners = Corners::default();
            // any lane must do
            corners.put(5, shape);
            let edges = Edges::new(simd, lanes, &corners, tile_box);
            let mut found = Found::default();
            let mut note = |hit: Covered<S>| {
                found.1 += 1;
                for lane in 0..LANE_COUNT {
                    if hit.bits >> lane & 1 == 1 {
                        assert!(found.0.insert(hit.at + lane), "a sample is met once");
                    }
                }
            };
            let side = SIDE.unsigned_abs() as usize;
            if by_spans {
                edges.each::<S, BLOCKS>(simd, lanes, 5, side, |hit, [x, y]| {
                    let at = lanes.pixels(simd, hit.block, 0) + hit.x as f32;
                    assert_eq!(<[f32; 8]>::from(x), <[f32; 8]>::from(at), "where samples lie");
                    let at = lanes.pixels(simd, hit.block, 1) + hit.y as f32;
                    assert_eq!(<[f32; 8]>::from(y), <[f32; 8]>::from(at), "where samples lie");
                    note(hit);
                });
            } else {
                let pixels = edges.pixels(5);
                covered::<S, BLOCKS, true>(simd, lanes, shape, pixels, side, note);
            }
            found
        }
    }

    impl Kernel for Look<'_> {
        type Output = Found;
        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> Found {
            if self.lanes.block_count == 1 {
                self.look::<S, 1>(simd)
            } else {
                self.look::<S, 2>(simd)
            }
        }
    }

    /// A triangle from corners in sub-pixel steps, if it may cover a sample of the tile.
    fn shape(mut corners: [[i32; 2]; 3], samples: u32, tile_box: [i32; 4]) -> Option<Shape> {
        let [a, b, c] = corners;
        let doubled_area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if doubled_area < 0 {
            corners.swap(1, 2);
        }
        let (x, y) = (corners.map(|at| at[0]), corners.map(|at| at[1]));
        let size = (SIDE.unsigned_abs(), SIDE.unsigned_abs());
        let projection = Projection::Orthographic { height: 1.0 };
        let view = View::new(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y, projection, size, 0.1);
        let positions = samples::positions(samples).expect("allowed");
        let grid = Grid::new(&view.expect("valid"), SIDE, 0..1, &positions);
        let [low, high] =
            [i32::min, i32::max].map(|pick| [x, y].map(|v| pick(pick(v[0], v[1]), v[2])));
        let pixels = grid.pixel_box(low, high)?;
        let [x0, y0, x1, y1] = pixels.map(i32::from);
        let meets = x0 < tile_box[2] && y0 < tile_box[3] && x1 >= tile_box[0] && y1 >= tile_box[1];
        (doubled_area != 0 && meets).then(|| Shape { x, y, pixels, ..Shape::default() })
    }

    fn found(corners: [[i32; 2]; 3], samples: u32, tile_box: [i32; 4]) -> Option<[Found; 2]> {
        let shape = shape(corners, samples, tile_box)?;
        let lanes = Lanes::new(&samples::positions(samples).expect("allowed"));
        let mut levels = Level::all().into_iter().map(|level| {
            [true, false].map(|by_spans| {
                level.run(Look { lanes: &lanes, shape: &shape, tile_box, by_spans })
            })
        });
        let first = levels.next().expect("scalar code works everywhere");
        for other in levels {
            assert_eq!(other, first, "every level finds the same");
        }
        Some(first)
    }

    #[test]
    fn a_long_thin_triangle_is_one_vector_a_row() {
        // from the upper left to the lower right, a pixel and a half high: 40 x 20 pixels
        let corners = [[0, 0], [40 * 256, 20 * 256], [0, 384]];
        let whole = [0, 0, SIDE, SIDE];
        let [spans, boxes] = found(corners, 1, whole).expect("covers samples");
        assert_eq!(spans.0, boxes.0, "the same samples");
        // a row of the box has five vectors
        assert_eq!((spans.1, boxes.1), (20, 100), "vectors looked at");
        assert!(spans.0.contains(&0), "the first pixel's centre lies inside");
        let moved = corners.map(|[x, y]| [x, y + 128]);
        let [other, _] = found(moved, 1, whole).expect("covers samples");
        assert_ne!(other.0, spans.0, "half a pixel lower, other samples are inside");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn spans_hold_all_samples(
            first in [-3000..30_000, -3000..30_000],
            second in [-16_383..16_384, -16_383..16_384],
            share in [0..1000_i64, 0..1000_i64],
            thin in any::<bool>(),
            samples in prop::sample::select(vec![1_u32, 4, 8, 16]),
            tile in prop::sample::select(vec![[0, 0, 128, 128], [32, 64, 64, 96], [64, 0, 96, 32]]),
        ) {
            let [x, y] = first;
            let reach = |along: i32, share: i64| {
                i32::try_from(i64::from(along) * share / 1000).expect("shorter than before")
            };
            // beside the first edge or anywhere in its box
            let shares = if thin { [share[0]; 2] } else { share };
            let aside = if thin { 40 } else { 0 };
            let third = [x + reach(second[0], shares[0]), y + reach(second[1], shares[1]) + aside];
            let corners = [first, [x + second[0], y + second[1]], third];
            let high = corners.map(|at| at[1]);
            let height = high.iter().max().zip(high.iter().min()).map_or(0, |(a, b)| a - b);
            prop_assume!(height < 1 << 14);
            if let Some([spans, boxes]) = found(corners, samples, tile) {
                prop_assert_eq!(&spans.0, &boxes.0);
                prop_assert!(spans.1 <= boxes.1, "{} vectors instead of {}", spans.1, boxes.1);
            }
        }
    }
}
