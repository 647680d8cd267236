//! Drawing what most shapes are, opaque and there as a whole, many in one go.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, u32x8};

use crate::raster::coverage::{Before, Lanes, covered};
use crate::raster::setup::{Shape, flags};
use crate::raster::visible::{Depth, index, pixels_in};
use crate::simd::{Kernel, LANE_COUNT};

/// Shapes that are fetched before any of them is drawn: each lies by itself in memory.
const FETCHED_COUNT: usize = 16;

/// Shapes to draw into a tile: those before the first that is not plain. Running it gives how many
/// those are, and the pixels they cover, if wanted.
pub(crate) struct Plain<'a> {
    pub(crate) lanes: &'a Lanes,
    /// The unit's.
    pub(crate) shapes: &'a [Shape],
    /// Indices of those to draw.
    pub(crate) chosen: &'a [u32],
    /// Reference to the unit's first shape.
    pub(crate) first_reference: u32,
    /// Pixels of the tile: x0, y0, x1, y1, ends exclusive.
    pub(crate) tile_box: [i32; 4],
    /// Pixels a row of the tile's arrays.
    pub(crate) side: i32,
    /// Depth keys of the tile's samples.
    pub(crate) keys: &'a mut [f32],
    /// References of what shows in them.
    pub(crate) waiting: &'a mut [u32],
    pub(crate) counts_fragments: bool,
}

impl Kernel for Plain<'_> {
    type Output = (usize, u64);

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> (usize, u64) {
        if self.lanes.block_count == 1 { self.draw::<S, 1>(simd) } else { self.draw::<S, 2>(simd) }
    }
}

impl Plain<'_> {
    #[inline(always)]
    fn draw<S: Simd, const BLOCKS: usize>(self, simd: S) -> (usize, u64) {
        let Self { lanes, shapes, chosen, first_reference, tile_box, side, keys, waiting, .. } =
            self;
        let row = index(0, 1, side);
        let nothing = f32x8::splat(simd, f32::NEG_INFINITY);
        let mut fragment_count = 0_u64;
        let mut done = 0_usize;
        let mut fetched = [Shape::default(); FETCHED_COUNT];
        while done < chosen.len() {
            let next = &chosen[done..chosen.len().min(done.wrapping_add(FETCHED_COUNT))];
            for (shape, &index) in fetched.iter_mut().zip(next) {
                *shape = shapes[index as usize];
            }
            for (shape, &number) in fetched.iter().zip(next) {
                if !shape.tag.has(flags::PLAIN) {
                    return (done, fragment_count);
                }
                done = done.wrapping_add(1);
                let pixels = pixels_in(shape, tile_box);
                let left = pixels[0].wrapping_sub(tile_box[0]);
                let top = pixels[1].wrapping_sub(tile_box[1]);
                let first = index(left, top, side).wrapping_mul(lanes.sample_count);
                let depth = Depth::new(simd, lanes, shape);
                let reference = u32x8::splat(simd, first_reference | number);
                let mut before = Before::default();
                covered::<S, BLOCKS, true>(
                    simd,
                    lanes,
                    shape,
                    pixels,
                    row,
                    #[inline(always)]
                    |hit| {
                        if self.counts_fragments {
                            let more = lanes.pixel_count(&hit, &mut before);
                            fragment_count = fragment_count.wrapping_add(more);
                        }
                        let at = first.wrapping_add(hit.at);
                        let keys = &mut keys[at..at.wrapping_add(LANE_COUNT)];
                        let waiting = &mut waiting[at..at.wrapping_add(LANE_COUNT)];
                        let key = hit.inside.select(depth.keys(simd, &hit), nothing);
                        let old_key = f32x8::from_slice(simd, keys);
                        let front = key.simd_gt(old_key);
                        // not `front.select(key, old_key)`: that becomes a masked store, which is
                        // slow on some processors
                        key.max(old_key).store_slice(keys);
                        let old = u32x8::from_slice(simd, waiting);
                        front.select(reference, old).store_slice(waiting);
                    },
                );
            }
        }
        (done, fragment_count)
    }
}
