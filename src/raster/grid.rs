//! The picture's tiles, and which pixels and tiles a box of sub-pixel steps touches.

use std::ops::Range;

use fearless_simd::i32x8;
use fearless_simd::prelude::*;

use crate::raster::samples::{SUBPIXEL_BITS, SUBPIXEL_COUNT, SamplePosition};
use crate::simd::LANE_COUNT;
use crate::view::View;

/// The picture's grid of tiles and the rows that are drawn now.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grid {
    pub(crate) width: i32,
    pub(crate) height: i32,
    /// Pixels a tile's side, a power of two.
    pub(crate) tile: i32,
    tile_bits: u32,
    pub(crate) columns: i32,
    /// Tile rows drawn, end exclusive.
    pub(crate) first_row: i32,
    pub(crate) last_row: i32,
    /// Smallest and largest sample position inside a pixel, in sub-pixel steps, x then y.
    pub(crate) sample_low: [i32; 2],
    pub(crate) sample_high: [i32; 2],
}

/// Pixels x0, y0, x1, y1, ends inclusive.
pub(crate) type PixelBox = [i32; 4];

impl Grid {
    pub(crate) fn new(
        view: &View,
        tile: i32,
        rows: Range<i32>,
        samples: &[SamplePosition],
    ) -> Self {
        let width = i32::try_from(view.width).expect("at most 16384");
        let height = i32::try_from(view.height).expect("at most 16384");
        let bound = |axis: usize| {
            let positions = samples.iter().map(|p| p[axis]);
            (positions.clone().min().unwrap_or(0), positions.max().unwrap_or(SUBPIXEL_COUNT - 1))
        };
        let ((low_x, high_x), (low_y, high_y)) = (bound(0), bound(1));
        Self {
            width,
            height,
            tile,
            tile_bits: tile.trailing_zeros(),
            columns: (width + tile - 1) / tile,
            first_row: rows.start,
            last_row: rows.end,
            sample_low: [low_x, low_y],
            sample_high: [high_x, high_y],
        }
    }

    pub(crate) fn tile_count(&self) -> usize {
        usize::try_from(self.columns * (self.last_row - self.first_row)).expect("not negative")
    }

    pub(crate) fn column_count(&self) -> usize {
        usize::try_from(self.columns).expect("not negative")
    }

    /// Pixels that are drawn: those of the grid's rows.
    pub(crate) fn drawn(&self) -> PixelBox {
        let last = self.height.min(self.last_row * self.tile) - 1;
        [0, self.first_row * self.tile, self.width - 1, last]
    }

    /// Columns and rows of tiles (first column, first row, last column, last row) that a box of
    /// drawn pixels touches, rows counted from the first that is drawn.
    #[inline(always)]
    pub(crate) fn tiles(&self, pixels: [u16; 4]) -> [usize; 4] {
        let first = usize::try_from(self.first_row).unwrap_or(0);
        let [x0, y0, x1, y1] = pixels.map(|p| usize::from(p) >> self.tile_bits);
        [x0, y0.wrapping_sub(first), x1, y1.wrapping_sub(first)]
    }

    /// Pixel box (x0, y0, x1, y1; ends exclusive) of a tile.
    pub(crate) fn tile_box(&self, tile: usize) -> [i32; 4] {
        let tile = i32::try_from(tile).expect("inside the grid");
        let x0 = tile % self.columns * self.tile;
        let y0 = (tile / self.columns + self.first_row) * self.tile;
        [x0, y0, (x0 + self.tile).min(self.width), (y0 + self.tile).min(self.height)]
    }

    /// Drawn pixels with samples in a box of sub-pixel steps (ends inclusive).
    #[inline]
    pub(crate) fn pixel_box(&self, low: [i32; 2], high: [i32; 2]) -> Option<[u16; 4]> {
        let [left, top, right, bottom] = self.drawn();
        let first = |axis: usize| {
            (low[axis] - self.sample_high[axis] + SUBPIXEL_COUNT - 1) >> SUBPIXEL_BITS
        };
        let last = |axis: usize| (high[axis] - self.sample_low[axis]) >> SUBPIXEL_BITS;
        let (x0, x1) = (first(0).max(left), last(0).min(right));
        let (y0, y1) = (first(1).max(top), last(1).min(bottom));
        (x0 <= x1 && y0 <= y1).then(|| [x0, y0, x1, y1].map(pixel_u16))
    }
}

/// Drawn pixels of eight boxes, ends inclusive.
pub(crate) struct PixelBoxes {
    /// x0, y0, x1, y1 of each.
    pixels: [[i32; LANE_COUNT]; 4],
    /// A bit for each that holds any.
    pub(crate) held: u64,
}

impl PixelBoxes {
    /// As [`Grid::pixel_box`], of eight boxes at once.
    #[inline(always)]
    pub(crate) fn new<S: Simd>(
        simd: S,
        grid: &Grid,
        low: [i32x8<S>; 2],
        high: [i32x8<S>; 2],
    ) -> Self {
        let [left, top, right, bottom] = grid.drawn();
        let up = SUBPIXEL_COUNT - 1;
        let [low_x, low_y] = grid.sample_low;
        let [high_x, high_y] = grid.sample_high;
        let x0 = ((low[0] + (up - high_x)) >> SUBPIXEL_BITS).max(i32x8::splat(simd, left));
        let y0 = ((low[1] + (up - high_y)) >> SUBPIXEL_BITS).max(i32x8::splat(simd, top));
        let x1 = ((high[0] - low_x) >> SUBPIXEL_BITS).min(i32x8::splat(simd, right));
        let y1 = ((high[1] - low_y) >> SUBPIXEL_BITS).min(i32x8::splat(simd, bottom));
        let held = (x0.simd_le(x1) & y0.simd_le(y1)).to_bitmask();
        Self { pixels: [x0.into(), y0.into(), x1.into(), y1.into()], held }
    }

    /// One that holds pixels, as a shape stores it.
    #[inline(always)]
    pub(crate) fn get(&self, lane: usize) -> [u16; 4] {
        let lane = lane % LANE_COUNT;
        let [x0, y0, x1, y1] = &self.pixels;
        [pixel_u16(x0[lane]), pixel_u16(y0[lane]), pixel_u16(x1[lane]), pixel_u16(y1[lane])]
    }
}

/// A pixel of a picture as it is stored.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below 16384")]
fn pixel_u16(pixel: i32) -> u16 {
    pixel as u16
}
