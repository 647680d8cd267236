//! Which vectors of samples a small triangle or line may cover, row by row: edges of eight shapes set up
//! at once, and of a shape wider than a vector only the span of each row that its edges leave.
//!
//! Shapes are long and thin more often than not: most of a wide one's box lies outside it. Where
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

/// Corners and pixels of eight triangles, or of lines, whose fourth corner follows.
#[derive(Default)]
pub(crate) struct Corners {
    x: [[i32; LANE_COUNT]; 3],
    y: [[i32; LANE_COUNT]; 3],
    /// x0, y0, x1, y1, ends inclusive.
    pixels: [[i32; LANE_COUNT]; 4],
}

impl Corners {
    /// Takes a shape in.
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

    /// Functions of the edges between two corners: at a place in steps, and their changes a step to the
    /// right and down.
    #[inline(always)]
    fn edge<S: Simd>(
        &self,
        simd: S,
        [from, to]: [usize; 2],
        [left, top]: [i32x8<S>; 2],
    ) -> [i32x8<S>; 3] {
        let vector = |numbers: [i32; LANE_COUNT]| i32x8::simd_from(simd, numbers);
        let zero = i32x8::splat(simd, 0);
        let (x, y) = (vector(self.x[from]), vector(self.y[from]));
        let (b, dy) = (vector(self.x[to]) - x, vector(self.y[to]) - y);
        let a = zero - dy;
        // corners run clockwise with y down: inside is right of an edge that goes up, below one
        // that goes right
        let owns = dy.simd_lt(zero) | (dy.simd_eq(zero) & b.simd_gt(zero));
        // a mask is -1 where it holds; not negative is inside, also for edges that do not own
        [a * (left - x) + b * (top - y) - owns.to_vector() - 1, a, b]
    }
}

/// Edges of a triangle.
pub(crate) const TRIANGLE: usize = 3;

/// Edges of a line, which is a parallelogram.
pub(crate) const LINE: usize = 4;

/// Functions of the `EDGES` edges of eight shapes, which are negative outside: modulo 2^32, exact for
/// shapes under 64 pixels.
pub(crate) struct Edges<const EDGES: usize> {
    /// At the upper left corner of the first pixel.
    at: [[i32; LANE_COUNT]; EDGES],
    /// Changes a sub-pixel step to the right, and down.
    a: [[i32; LANE_COUNT]; EDGES],
    b: [[i32; LANE_COUNT]; EDGES],
    /// What a sample of a pixel has more than its upper left corner, at most.
    most: [[i32; LANE_COUNT]; EDGES],
    /// Pixels to the right over which the function falls by one.
    falls: [[f32; LANE_COUNT]; EDGES],
    /// Pixels in the tile: x0, y0, x1, y1, ends inclusive.
    pixels: [[i32; LANE_COUNT]; 4],
}

impl<const EDGES: usize> Edges<EDGES> {
    /// Those of shapes in a tile (x0, y0, x1, y1, ends exclusive), set up by lanes.
    #[inline(always)]
    pub(crate) fn new<S: Simd>(
        simd: S,
        lanes: &Lanes,
        corners: &Corners,
        tile_box: [i32; 4],
    ) -> Self {
        let mut edges = Self {
            at: [[0; LANE_COUNT]; EDGES],
            a: [[0; LANE_COUNT]; EDGES],
            b: [[0; LANE_COUNT]; EDGES],
            most: [[0; LANE_COUNT]; EDGES],
            falls: [[0.0; LANE_COUNT]; EDGES],
            pixels: [[0; LANE_COUNT]; 4],
        };
        let vector = |numbers: [i32; LANE_COUNT]| i32x8::simd_from(simd, numbers);
        let zero = i32x8::splat(simd, 0);
        let x0 = vector(corners.pixels[0]).max(i32x8::splat(simd, tile_box[0]));
        let y0 = vector(corners.pixels[1]).max(i32x8::splat(simd, tile_box[1]));
        let last = [tile_box[2].wrapping_sub(1), tile_box[3].wrapping_sub(1)];
        let x1 = vector(corners.pixels[2]).min(i32x8::splat(simd, last[0]));
        let y1 = vector(corners.pixels[3]).min(i32x8::splat(simd, last[1]));
        edges.pixels = [x0.into(), y0.into(), x1.into(), y1.into()];
        let (left, top) = (x0 * SUBPIXEL_COUNT, y0 * SUBPIXEL_COUNT);
        let first = corners.edge(simd, [0, 1], [left, top]);
        let last = corners.edge(simd, [2, 0], [left, top]);
        edges.put(simd, lanes, 0, first);
        if EDGES == LINE {
            edges.put(simd, lanes, 1, last);
            // of opposite sides one owns its samples, and what lies before both adds up to the area
            let most = first[2] * last[1] - first[1] * last[2] - 1;
            edges.put(simd, lanes, 2, [most - first[0], zero - first[1], zero - first[2]]);
            edges.put(simd, lanes, 3, [most - last[0], zero - last[1], zero - last[2]]);
        } else {
            edges.put(simd, lanes, 1, corners.edge(simd, [1, 2], [left, top]));
            edges.put(simd, lanes, 2, last);
        }
        edges
    }

    /// Takes eight shapes' edge of a number in.
    #[inline(always)]
    fn put<S: Simd>(&mut self, simd: S, lanes: &Lanes, edge: usize, [at, a, b]: [i32x8<S>; 3]) {
        let [low, high] = lanes.reach();
        let most = (a * low[0]).max(a * high[0]) + (b * low[1]).max(b * high[1]);
        let falls = -1.0 / (a * SUBPIXEL_COUNT).to_float::<f32x8<S>>();
        let level = a.simd_eq(i32x8::splat(simd, 0));
        self.at[edge] = at.into();
        self.a[edge] = a.into();
        self.b[edge] = b.into();
        self.most[edge] = most.into();
        self.falls[edge] = level.select(f32x8::splat(simd, 0.0), falls).into();
    }

    /// A shape's pixels in the tile, ends inclusive.
    #[inline(always)]
    pub(crate) fn pixels(&self, lane: usize) -> PixelBox {
        let lane = lane % LANE_COUNT;
        let [x0, y0, x1, y1] = &self.pixels;
        [x0[lane], y0[lane], x1[lane], y1[lane]]
    }

    /// Calls `visit` for vectors that hold all samples which a shape covers, with the samples'
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
        let zero = i32x8::splat(simd, 0);
        // (what is not inlined cannot use the level's instructions, and nothing promises that `map` is)
        let (mut a, mut b) = ([zero; EDGES], [zero; EDGES]);
        let (mut at, mut down) = ([zero; EDGES], [zero; EDGES]);
        for edge in 0..EDGES {
            a[edge] = i32x8::splat(simd, self.a[edge][lane]);
            b[edge] = i32x8::splat(simd, self.b[edge][lane]);
            at[edge] = i32x8::splat(simd, self.at[edge][lane]);
            down[edge] = b[edge] * SUBPIXEL_COUNT;
        }
        let mut inner = [[zero; EDGES]; BLOCKS];
        let mut places = [[f32x8::splat(simd, 0.0); 2]; BLOCKS];
        for (block, (inner, place)) in inner.iter_mut().zip(&mut places).enumerate() {
            let [x, y] = [lanes.steps(simd, block, 0), lanes.steps(simd, block, 1)];
            for edge in 0..EDGES {
                inner[edge] = a[edge] * x + b[edge] * y;
            }
            *place = [lanes.pixels(simd, block, 0), lanes.pixels(simd, block, 1)];
        }
        let columns = lanes.column_vector(simd);
        let width = x1.wrapping_sub(x0);
        let row_length = side.wrapping_mul(lanes.sample_count);
        let (mut y, mut row_at) = (y0, 0_usize);
        let mut place_y = f32x8::splat(simd, y0 as f32);
        if BLOCKS == 1 && width < lanes.column_count {
            // most shapes are no wider than a vector at one sample
            let beyond = i32x8::splat(simd, width) - columns;
            let mut here = inner[0];
            for edge in 0..EDGES {
                here[edge] += at[edge];
            }
            let place_x = places[0][0] + x0 as f32;
            while y <= y1 {
                let mut all = here[0];
                for here in &here[1..] {
                    all |= *here;
                }
                let inside = (all | beyond).simd_ge(zero);
                let bits = inside.to_bitmask();
                let hit = Covered { x: x0, y, block: 0, at: row_at, inside, bits };
                visit(hit, [place_x, places[0][1] + place_y]);
                for edge in 0..EDGES {
                    here[edge] += down[edge];
                }
                y = y.wrapping_add(1);
                place_y += 1.0;
                row_at = row_at.wrapping_add(row_length);
            }
            return;
        }
        let vector_length = BLOCKS.wrapping_mul(LANE_COUNT);
        let rows = i32x8::simd_from(simd, [0, 1, 2, 3, 4, 5, 6, 7]);
        let endless = f32x8::splat(simd, f32::INFINITY);
        let none = f32x8::splat(simd, 0.0);
        let rightmost = i32x8::splat(simd, width);
        let mut right = [zero; EDGES];
        for edge in 0..EDGES {
            right[edge] = a[edge] * SUBPIXEL_COUNT;
        }
        while y <= y1 {
            let mut starts = [zero; EDGES];
            let mut first = none;
            let mut last = rightmost.to_float::<f32x8<S>>();
            for edge in 0..EDGES {
                let start = at[edge] + rows * down[edge];
                starts[edge] = start;
                let most = start + i32x8::splat(simd, self.most[edge][lane]);
                let falls = f32x8::splat(simd, self.falls[edge][lane]);
                let ends = most.to_float::<f32x8<S>>() * falls;
                let rises = falls.simd_lt(none);
                let drops = falls.simd_gt(none);
                first = first.max(rises.select(ends - SLACK, none));
                last = last.min(drops.select(ends + SLACK, endless));
            }
            let first = first.ceil().to_int::<i32x8<S>>().min(rightmost);
            let last: [i32; LANE_COUNT] = last.floor().to_int::<i32x8<S>>().into();
            let mut begins = [[0_i32; LANE_COUNT]; EDGES];
            for edge in 0..EDGES {
                begins[edge] = (starts[edge] + first * right[edge]).into();
            }
            let place_x: [f32; LANE_COUNT] = (first + x0).to_float::<f32x8<S>>().into();
            let first: [i32; LANE_COUNT] = first.into();
            for row in 0..LANE_COUNT {
                let mut column = first[row];
                let skipped = index(column, 0, 0).wrapping_mul(lanes.sample_count);
                let mut at = row_at.wrapping_add(skipped);
                let mut here = [0; EDGES];
                for edge in 0..EDGES {
                    here[edge] = begins[edge][row];
                }
                let mut place_x = place_x[row];
                loop {
                    let beyond = i32x8::splat(simd, width.wrapping_sub(column)) - columns;
                    let x = x0.wrapping_add(column);
                    for block in 0..BLOCKS {
                        let mut all = inner[block][0] + here[0];
                        for edge in 1..EDGES {
                            all |= inner[block][edge] + here[edge];
                        }
                        let inside = (all | beyond).simd_ge(zero);
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
            for edge in 0..EDGES {
                at[edge] += down[edge] * 8;
            }
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
    use crate::raster::naive::contains;
    use crate::raster::samples;
    use crate::raster::setup::{Tag, flags};
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
            let edges = Edges::<TRIANGLE>::new(simd, lanes, &corners, tile_box);
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

    struct LookAtLine<'a> {
        lanes: &'a Lanes,
        shape: &'a Shape,
        tile_box: [i32; 4],
    }

    impl Kernel for LookAtLine<'_> {
        type Output = BTreeSet<[i32; 3]>;
        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> BTreeSet<[i32; 3]> {
            let Self { lanes, shape, tile_box } = self;
            let mut corners = Corners::default();
            corners.put(2, shape);
            let edges = Edges::<LINE>::new(simd, lanes, &corners, tile_box);
            let mut found = BTreeSet::new();
            let sample_count = i32::try_from(lanes.sample_count).expect("few");
            let mut note = |hit: Covered<S>| {
                for lane in (0..8).filter(|lane| hit.bits >> lane & 1 == 1) {
                    let column = lane * lanes.column_count / 8;
                    let sample = (i32::try_from(hit.block).expect("two") * 8 + lane) % sample_count;
                    assert!(found.insert([hit.x + column, hit.y, sample]), "a sample is met once");
                }
            };
            let side = SIDE.unsigned_abs() as usize;
            if lanes.block_count == 1 {
                edges.each::<S, 1>(simd, lanes, 2, side, |hit, _| note(hit));
            } else {
                edges.each::<S, 2>(simd, lanes, 2, side, |hit, _| note(hit));
            }
            found
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]
        #[test]
        fn lines_cover_what_their_four_edges_hold(
            first in [-3000..30_000, -3000..30_000],
            along in [-8000..8000, -8000..8000],
            // of 1/256 pixel, or on the samples of one a pixel, where edges meet them
            grid in prop::sample::select(vec![1, 128]),
            width in 1..1500_i32,
            samples in prop::sample::select(vec![1_u32, 4, 8, 16]),
            tile in prop::sample::select(vec![[0, 0, 128, 128], [32, 64, 64, 96], [64, 0, 96, 32]]),
        ) {
            let [first, along]: [[i32; 2]; 2] = [first, along].map(|at| at.map(|v| v / grid * grid));
            let length = f64::from(along[0]).hypot(f64::from(along[1]));
            prop_assume!(length > 0.0);
            #[expect(clippy::cast_possible_truncation, reason = "as long as the width")]
            let across = [-along[1], along[0]].map(|v| (f64::from(v * width) / length) as i32 / grid * grid);
            prop_assume!(along[0] * across[1] - along[1] * across[0] > 0);
            let corners = [first, [0, 1].map(|i| first[i] + along[i]), [0, 1].map(|i| first[i] + across[i])];
            let (x, y) = (corners.map(|at| at[0]), corners.map(|at| at[1]));
            // its pixels are those of both triangles
            let opposite = [x[1] + x[2] - x[0], y[1] + y[2] - y[0]];
            let boxes = [corners, [corners[1], opposite, corners[2]]]
                .map(|half| shape(half, samples, [0, 0, SIDE, SIDE]));
            let Some(pixels) = boxes.iter().flatten().map(|half| half.pixels).reduce(|a, b| {
                [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]
            }) else { return Ok(()) };
            let [x0, y0, x1, y1] = pixels.map(i32::from);
            let is_there = x0 < tile[2] && y0 < tile[3] && x1 >= tile[0] && y1 >= tile[1];
            if !is_there {
                return Ok(());
            }
            let tag = Tag::default().with(flags::LINE);
            let line = Shape { x, y, pixels, tag, ..Shape::default() };
            let places = samples::positions(samples).expect("allowed");
            let lanes = Lanes::new(&places);
            let mut expected = BTreeSet::new();
            for (y, x) in (tile[1]..tile[3]).flat_map(|y| (tile[0]..tile[2]).map(move |x| (y, x))) {
                for (sample, place) in (0..).zip(&places) {
                    let at = [x * SUBPIXEL_COUNT + place[0], y * SUBPIXEL_COUNT + place[1]];
                    if contains(&line, at) {
                        expected.insert([x, y, sample]);
                    }
                }
            }
            for level in Level::all() {
                let found = level.run(LookAtLine { lanes: &lanes, shape: &line, tile_box: tile });
                prop_assert_eq!(&found, &expected, "{:?}", level);
            }
        }
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
