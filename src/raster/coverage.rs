//! Which samples of which pixels a shape covers: exact fixed-point edges, the top-left rule.
//!
//! A sample on an edge belongs to the shape whose left or upper edge it is, so triangles that share
//! an edge cover every sample on it exactly once. Eight samples are tested at once: those of one
//! pixel or of a few neighbours in a row, as they lie in a tile's memory.
//!
//! This work is based on:
//! Juan Pineda. A parallel algorithm for polygon rasterization. 1988
//! Fabian Giesen. Optimizing Software Occlusion Culling. 2013

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8, mask32x8};

use crate::raster::grid::PixelBox;
use crate::raster::samples::{SUBPIXEL_COUNT, SamplePosition};
use crate::raster::setup::{Shape, flags};
use crate::simd::LANE_COUNT;

/// Vectors that hold the samples of a pixel, at 16 samples.
const MAX_BLOCK_COUNT: usize = 2;

/// Edge functions that change by less than this over a box of pixels stay within i32 wherever they
/// cross it.
const MAX_CHANGE: i64 = 1 << 29;

/// Where the samples of a vector lie, relative to the pixel of its first one.
///
/// With `n` samples a pixel, a vector holds `8 / n` pixels of a row; above 8 samples a pixel has
/// several vectors, its blocks.
pub(crate) struct Lanes {
    /// Samples a pixel.
    pub(crate) sample_count: usize,
    /// Pixels a vector holds.
    pub(crate) column_count: i32,
    /// Vectors a pixel takes.
    pub(crate) block_count: usize,
    /// Sub-pixel steps in x and y, one pair of vectors a block.
    steps: [[[i32; LANE_COUNT]; 2]; MAX_BLOCK_COUNT],
    /// The same in pixels.
    pixels: [[[f32; LANE_COUNT]; 2]; MAX_BLOCK_COUNT],
    /// Which pixel after the first.
    columns: [i32; LANE_COUNT],
    /// Smallest and largest position of a sample in its pixel, in sub-pixel steps.
    reach: [SamplePosition; 2],
}

impl Lanes {
    /// For 1, 4, 8 or 16 samples.
    pub(crate) fn new(samples: &[SamplePosition]) -> Self {
        let sample_count = samples.len();
        let bounds = |pick: fn(i32, i32) -> i32| {
            [0, 1].map(|axis| samples.iter().map(|at| at[axis]).reduce(pick).unwrap_or(0))
        };
        assert!([1, 4, 8, 16].contains(&sample_count), "a pass has so many samples");
        let mut lanes = Self {
            sample_count,
            column_count: 1,
            block_count: sample_count.div_ceil(LANE_COUNT),
            steps: Default::default(),
            pixels: Default::default(),
            columns: Default::default(),
            reach: [bounds(i32::min), bounds(i32::max)],
        };
        for block in 0..MAX_BLOCK_COUNT {
            let mut sample = block * LANE_COUNT % sample_count;
            let mut column = 0;
            for lane in 0..LANE_COUNT {
                let [x, y] = samples[sample];
                for (axis, at) in [x + column * SUBPIXEL_COUNT, y].into_iter().enumerate() {
                    lanes.steps[block][axis][lane] = at;
                    lanes.pixels[block][axis][lane] = at as f32 * (1.0 / SUBPIXEL_COUNT as f32);
                }
                lanes.columns[lane] = column;
                lanes.column_count = column + 1;
                sample = (sample + 1) % sample_count;
                column += i32::from(sample == 0);
            }
        }
        lanes
    }

    /// Pixel after a vector's first, and sample of that pixel, of a lane.
    #[inline(always)]
    pub(crate) fn place(&self, lane: usize, block: usize) -> (i32, usize) {
        // counts of samples are powers of two
        let sample = (block * LANE_COUNT + lane) & (self.sample_count - 1);
        (self.columns[lane], sample)
    }

    /// A block's x or y in pixels.
    #[inline(always)]
    pub(crate) fn pixels<S: Simd>(&self, simd: S, block: usize, axis: usize) -> f32x8<S> {
        f32x8::simd_from(simd, self.pixels[block][axis])
    }

    /// Which pixel after a vector's first each lane is in.
    #[inline(always)]
    pub(crate) fn columns<S: Simd>(&self, simd: S) -> f32x8<S> {
        i32x8::simd_from(simd, self.columns).to_float()
    }

    #[inline(always)]
    pub(crate) fn column_vector<S: Simd>(&self, simd: S) -> i32x8<S> {
        i32x8::simd_from(simd, self.columns)
    }

    /// Smallest and largest position of a sample in its pixel, in sub-pixel steps.
    #[inline(always)]
    pub(crate) fn reach(&self) -> [SamplePosition; 2] {
        self.reach
    }

    #[inline(always)]
    pub(crate) fn steps<S: Simd>(&self, simd: S, block: usize, axis: usize) -> i32x8<S> {
        i32x8::simd_from(simd, self.steps[block][axis])
    }

    /// A bit for each lane of a block in which a shape covers the sample, tested one by one.
    #[inline(never)]
    fn covered_singly(
        &self,
        shape: &Shape,
        [_, _, x1, _]: PixelBox,
        x: i32,
        y: i32,
        block: usize,
    ) -> u64 {
        let edges = [0, 1, 2].map(|from| Edge::new(shape, from, x, y));
        let mut bits = 0;
        for lane in 0..LANE_COUNT {
            let at_x = x * SUBPIXEL_COUNT + self.steps[block][0][lane];
            let at_y = y * SUBPIXEL_COUNT + self.steps[block][1][lane];
            let mut edges = edges.iter().enumerate();
            let inside = edges.all(|(from, edge)| edge.exact(shape, from, at_x, at_y) >= 0);
            bits |= u64::from(inside && x + self.columns[lane] <= x1) << lane;
        }
        bits
    }

    /// How many pixels have a bit set that had none in the blocks before.
    #[inline(always)]
    pub(crate) fn pixel_count<S: Simd>(&self, hit: &Covered<S>, before: &mut Before) -> u64 {
        let bits = hit.bits;
        if self.sample_count <= 4 {
            // the lowest bit of each pixel
            let (pixels, joined) = match self.sample_count {
                1 => (0xFF, bits),
                _ => (0x11, bits | bits >> 1 | bits >> 2 | bits >> 3),
            };
            return u64::from((joined & pixels).count_ones());
        }
        let pixel = hit.at.wrapping_sub(hit.block.wrapping_mul(LANE_COUNT));
        let counted = before.pixel == pixel && before.is_counted;
        *before = Before { pixel, is_counted: counted | (bits != 0) };
        u64::from(!counted & (bits != 0))
    }
}

/// The pixel that [`Lanes::pixel_count`] was asked about last.
pub(crate) struct Before {
    pixel: usize,
    is_counted: bool,
}

impl Default for Before {
    fn default() -> Self {
        Self { pixel: usize::MAX, is_counted: false }
    }
}

/// Eight samples of which a shape covers some.
#[derive(Clone, Copy)]
pub(crate) struct Covered<S: Simd> {
    /// Pixel of the first.
    pub(crate) x: i32,
    pub(crate) y: i32,
    pub(crate) block: usize,
    /// Index of the first after that of the box's first.
    pub(crate) at: usize,
    pub(crate) inside: mask32x8<S>,
    /// The same, a bit each.
    pub(crate) bits: u64,
}

/// Calls `visit` for every vector of the box (ends inclusive) of which the shape covers a sample,
/// or, if `ALL`, for every vector: whoever can do without a branch is spared wrong guesses.
///
/// `BLOCKS` is the lanes' `block_count`; a row of the tile's arrays holds `side` pixels.
#[inline(always)]
pub(crate) fn covered<S: Simd, const BLOCKS: usize, const ALL: bool>(
    simd: S,
    lanes: &Lanes,
    shape: &Shape,
    pixels: PixelBox,
    side: usize,
    mut visit: impl FnMut(Covered<S>),
) {
    let [x0, y0, x1, y1] = pixels;
    let mut edges =
        [Edge::new(shape, 0, x0, y0), Edge::new(shape, 1, x0, y0), Edge::new(shape, 2, x0, y0)];
    let row_length = side.wrapping_mul(lanes.sample_count);
    let vector_length = BLOCKS.wrapping_mul(LANE_COUNT);
    if shape.tag.has(flags::RECT) {
        covered_rect::<S, BLOCKS, ALL>(simd, lanes, shape, pixels, side, visit);
        return;
    }
    if shape.tag.has(flags::WIDE) {
        let tested = Edge::leave_out_uncrossed(&mut edges, shape, pixels);
        if tested == Tested::Nothing {
            return;
        }
        if tested != Tested::Vectors {
            let (mut y, mut row_at) = (y0, 0_usize);
            while y <= y1 {
                let (mut x, mut at) = (x0, row_at);
                while x <= x1 {
                    for block in 0..BLOCKS {
                        let bits = lanes.covered_singly(shape, pixels, x, y, block);
                        if bits != 0 {
                            let inside = mask32x8::from_bitmask(simd, bits);
                            let at = at.wrapping_add(block.wrapping_mul(LANE_COUNT));
                            visit(Covered { x, y, block, at, inside, bits });
                        }
                    }
                    x = x.wrapping_add(lanes.column_count);
                    at = at.wrapping_add(vector_length);
                }
                y = y.wrapping_add(1);
                row_at = row_at.wrapping_add(row_length);
            }
            return;
        }
    }
    let [e0, e1, e2] = &edges;
    let mut row = [[i32x8::splat(simd, 0); 3]; BLOCKS];
    for (block, row) in row.iter_mut().enumerate() {
        let [x, y] = [lanes.steps(simd, block, 0), lanes.steps(simd, block, 1)];
        *row = [e0.lanes(x, y), e1.lanes(x, y), e2.lanes(x, y)];
    }
    let right = SUBPIXEL_COUNT.wrapping_mul(lanes.column_count);
    let right = [
        i32x8::splat(simd, e0.a.wrapping_mul(right)),
        i32x8::splat(simd, e1.a.wrapping_mul(right)),
        i32x8::splat(simd, e2.a.wrapping_mul(right)),
    ];
    let down = [
        i32x8::splat(simd, e0.b.wrapping_mul(SUBPIXEL_COUNT)),
        i32x8::splat(simd, e1.b.wrapping_mul(SUBPIXEL_COUNT)),
        i32x8::splat(simd, e2.b.wrapping_mul(SUBPIXEL_COUNT)),
    ];
    let zero = i32x8::splat(simd, 0);
    let columns = i32x8::simd_from(simd, lanes.columns);
    let (mut y, mut row_at) = (y0, 0_usize);
    if BLOCKS == 1 && x1.wrapping_sub(x0) < lanes.column_count {
        // most triangles are no wider than a vector
        let beyond = i32x8::splat(simd, x1.wrapping_sub(x0)) - columns;
        let [mut a, mut b, mut c] = row[0];
        while y <= y1 {
            let inside = (a | b | c | beyond).simd_ge(zero);
            let bits = inside.to_bitmask();
            if ALL || bits != 0 {
                visit(Covered { x: x0, y, block: 0, at: row_at, inside, bits });
            }
            (a, b, c) = (a + down[0], b + down[1], c + down[2]);
            y = y.wrapping_add(1);
            row_at = row_at.wrapping_add(row_length);
        }
        return;
    }
    while y <= y1 {
        let mut here = row;
        let (mut x, mut at) = (x0, row_at);
        loop {
            // a vector may reach beyond the box: there the difference is negative
            let beyond = i32x8::splat(simd, x1.wrapping_sub(x)) - columns;
            for (block, here) in here.iter_mut().enumerate() {
                let [a, b, c] = *here;
                let inside = (a | b | c | beyond).simd_ge(zero);
                let bits = inside.to_bitmask();
                if ALL || bits != 0 {
                    let at = at.wrapping_add(block.wrapping_mul(LANE_COUNT));
                    visit(Covered { x, y, block, at, inside, bits });
                }
                *here = [a + right[0], b + right[1], c + right[2]];
            }
            x = x.wrapping_add(lanes.column_count);
            at = at.wrapping_add(vector_length);
            if x > x1 {
                break;
            }
        }
        for row in &mut row {
            let [a, b, c] = *row;
            *row = [a + down[0], b + down[1], c + down[2]];
        }
        y = y.wrapping_add(1);
        row_at = row_at.wrapping_add(row_length);
    }
}

/// [`covered`] for an axis-aligned rectangle, which needs no edges.
#[inline(always)]
fn covered_rect<S: Simd, const BLOCKS: usize, const ALL: bool>(
    simd: S,
    lanes: &Lanes,
    shape: &Shape,
    [x0, y0, x1, y1]: PixelBox,
    side: usize,
    mut visit: impl FnMut(Covered<S>),
) {
    let columns = i32x8::simd_from(simd, lanes.columns);
    let steps = |block: usize, axis: usize| lanes.steps(simd, block, axis);
    let row_length = side.wrapping_mul(lanes.sample_count);
    let vector_length = BLOCKS.wrapping_mul(LANE_COUNT);
    // a mask for each block of the columns' vector at x; vectors may reach beyond the box
    let within_columns = |block: usize, x: i32| {
        let first = x.wrapping_mul(SUBPIXEL_COUNT);
        let at = steps(block, 0);
        at.simd_ge(shape.x[0].wrapping_sub(first))
            & at.simd_le(shape.x[1].wrapping_sub(first))
            & columns.simd_le(x1.wrapping_sub(x))
    };
    let mut first_columns = [mask32x8::splat(simd, false); BLOCKS];
    for (block, mask) in first_columns.iter_mut().enumerate() {
        *mask = within_columns(block, x0);
    }
    let is_narrow = x1.wrapping_sub(x0) < lanes.column_count;
    let (mut y, mut row_at) = (y0, 0_usize);
    while y <= y1 {
        let first = y.wrapping_mul(SUBPIXEL_COUNT);
        let (low, high) = (shape.y[0].wrapping_sub(first), shape.y[1].wrapping_sub(first));
        let mut in_rows = [mask32x8::splat(simd, false); BLOCKS];
        for (block, mask) in in_rows.iter_mut().enumerate() {
            let at = steps(block, 1);
            *mask = at.simd_ge(low) & at.simd_le(high);
        }
        let mut in_columns = first_columns;
        let (mut x, mut at) = (x0, row_at);
        loop {
            for block in 0..BLOCKS {
                let inside = in_rows[block] & in_columns[block];
                let bits = inside.to_bitmask();
                if ALL || bits != 0 {
                    let at = at.wrapping_add(block.wrapping_mul(LANE_COUNT));
                    visit(Covered { x, y, block, at, inside, bits });
                }
            }
            x = x.wrapping_add(lanes.column_count);
            if is_narrow || x > x1 {
                break;
            }
            at = at.wrapping_add(vector_length);
            for (block, mask) in in_columns.iter_mut().enumerate() {
                *mask = within_columns(block, x);
            }
        }
        y = y.wrapping_add(1);
        row_at = row_at.wrapping_add(row_length);
    }
}

/// How a shape's samples are found.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Tested {
    /// There are none.
    Nothing,
    /// Eight at a time, in i32.
    Vectors,
    /// One by one, in i64.
    Singly,
}

/// An edge's function, which is negative outside: its value at a box's first pixel modulo 2^32 and
/// its change a sub-pixel step.
#[derive(Clone, Copy)]
struct Edge {
    at: i32,
    a: i32,
    b: i32,
}

impl Edge {
    #[inline(always)]
    fn new(shape: &Shape, from: usize, x: i32, y: i32) -> Self {
        let to = if from == 2 { 0 } else { from.wrapping_add(1) };
        let dx = shape.x[to].wrapping_sub(shape.x[from]);
        let dy = shape.y[to].wrapping_sub(shape.y[from]);
        // corners run clockwise with y down: inside is right of an edge that goes up, below one
        // that goes right
        let owns = (dy < 0) | ((dy == 0) & (dx > 0));
        let from_x = x.wrapping_mul(SUBPIXEL_COUNT).wrapping_sub(shape.x[from]);
        let from_y = y.wrapping_mul(SUBPIXEL_COUNT).wrapping_sub(shape.y[from]);
        let (a, b) = (dy.wrapping_neg(), dx);
        let at = a.wrapping_mul(from_x).wrapping_add(b.wrapping_mul(from_y));
        // not negative is inside, also for edges that do not own their samples
        Self { at: at.wrapping_add(i32::from(owns)).wrapping_sub(1), a, b }
    }

    /// Its values at some steps from the first pixel, modulo 2^32: exact for triangles under 64
    /// pixels and for edges of [`Tested::Vectors`].
    #[inline(always)]
    fn lanes<S: Simd>(&self, x: i32x8<S>, y: i32x8<S>) -> i32x8<S> {
        x * self.a + y * self.b + self.at
    }

    /// The whole value at a point in steps. Corners lie within 2^29 steps of the picture, so
    /// products fit in i64 with room to spare.
    fn exact(&self, shape: &Shape, from: usize, x: i32, y: i32) -> i64 {
        let dx = i64::from(self.b);
        let dy = -i64::from(self.a);
        let owns = dy < 0 || (dy == 0 && dx > 0);
        let from_x = i64::from(x) - i64::from(shape.x[from]);
        let from_y = i64::from(y) - i64::from(shape.y[from]);
        dx * from_y - dy * from_x + i64::from(owns) - 1
    }

    /// Puts edges that always hold in the place of those that do not cross the box, and says how
    /// the others can be tested.
    #[cold]
    #[inline(never)]
    fn leave_out_uncrossed(
        edges: &mut [Self; 3],
        shape: &Shape,
        [x0, y0, x1, y1]: PixelBox,
    ) -> Tested {
        // a vector may reach seven pixels beyond the box
        let width = i64::from(x1 - x0 + 8) * i64::from(SUBPIXEL_COUNT);
        let height = i64::from(y1 - y0 + 1) * i64::from(SUBPIXEL_COUNT);
        let mut tested = Tested::Vectors;
        for (from, edge) in edges.iter_mut().enumerate() {
            let at = edge.exact(shape, from, x0 * SUBPIXEL_COUNT, y0 * SUBPIXEL_COUNT);
            let change = i64::from(edge.a).abs() * width + i64::from(edge.b).abs() * height;
            if at + change < 0 {
                return Tested::Nothing;
            }
            if at - change >= 0 {
                *edge = Self { at: 0, a: 0, b: 0 };
            } else if change >= MAX_CHANGE {
                tested = Tested::Singly;
            }
        }
        tested
    }
}
