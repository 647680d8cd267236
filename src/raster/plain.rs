//! Drawing what most shapes are, opaque and there as a whole, many in one go.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, u32x8};

use crate::raster::coverage::{Before, Covered, Lanes, covered};
use crate::raster::setup::{Shape, flags};
use crate::raster::spans::{Corners, Edges, LINE, TRIANGLE};
use crate::raster::visible::{Depth, index};
use crate::simd::{Kernel, LANE_COUNT};

/// Shapes to draw into a tile: those before the first of another kind, which is [`LINE`] or [`TRIANGLE`],
/// rectangles among the latter. Running it gives how many those are, and the pixels they cover, if wanted.
pub(crate) struct Plain<'a, const EDGES: usize> {
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

impl<const EDGES: usize> Kernel for Plain<'_, EDGES> {
    type Output = (usize, u64);

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> (usize, u64) {
        match (self.lanes.block_count, self.counts_fragments) {
            (1, false) => self.draw::<S, 1, false>(simd),
            (1, true) => self.draw::<S, 1, true>(simd),
            (_, false) => self.draw::<S, 2, false>(simd),
            (_, true) => self.draw::<S, 2, true>(simd),
        }
    }
}

impl<const EDGES: usize> Plain<'_, EDGES> {
    /// What tells its shapes.
    const KIND: u32 = if EDGES == LINE { flags::LINE } else { flags::PLAIN };

    #[inline(always)]
    fn draw<S: Simd, const BLOCKS: usize, const COUNTS: bool>(self, simd: S) -> (usize, u64) {
        let Self { lanes, shapes, chosen, first_reference, tile_box, side, keys, waiting, .. } =
            self;
        let row = index(0, 1, side);
        let mut fragment_count = 0_u64;
        let mut done = 0_usize;
        let mut corners = Corners::default();
        let tags = |shapes: &[Shape], numbers: &[u32]| {
            numbers
                .iter()
                .fold(Self::KIND, |all, &number| all & shapes[number as usize].tag.flags())
        };
        let mut are_plain = 0;
        while done < chosen.len() {
            let (next, later) =
                chosen[done..].split_at(LANE_COUNT.min(chosen.len().wrapping_sub(done)));
            let all_plain = are_plain;
            // asked for now, so that they are here when it is their turn
            are_plain = tags(shapes, &later[..LANE_COUNT.min(later.len())]);
            for (lane, &number) in next.iter().enumerate() {
                corners.put(lane % LANE_COUNT, &shapes[number as usize]);
            }
            let edges = Edges::<EDGES>::new(simd, lanes, &corners, tile_box);
            for (lane, &number) in next.iter().enumerate() {
                let shape = &shapes[number as usize];
                if all_plain == 0 && !shape.tag.has(Self::KIND) {
                    return (done, fragment_count);
                }
                done = done.wrapping_add(1);
                let pixels = edges.pixels(lane);
                let left = pixels[0].wrapping_sub(tile_box[0]);
                let top = pixels[1].wrapping_sub(tile_box[1]);
                let first = index(left, top, side).wrapping_mul(lanes.sample_count);
                let mut store = Store::<S, COUNTS> {
                    lanes,
                    depth: Depth::new(simd, lanes, shape),
                    reference: u32x8::splat(simd, first_reference | number),
                    first,
                    keys: &mut *keys,
                    waiting: &mut *waiting,
                    before: Before::default(),
                    fragment_count: 0,
                };
                let is_general = shape.tag.has(flags::RECT) || shape.tag.has(flags::WIDE);
                if EDGES == TRIANGLE && is_general {
                    covered::<S, BLOCKS, true>(
                        simd,
                        lanes,
                        shape,
                        pixels,
                        row,
                        #[inline(always)]
                        |hit| {
                            let x = lanes.pixels(simd, hit.block, 0) + hit.x as f32;
                            let y = lanes.pixels(simd, hit.block, 1) + hit.y as f32;
                            store.hit(simd, &hit, [x, y]);
                        },
                    );
                } else {
                    edges.each::<S, BLOCKS>(
                        simd,
                        lanes,
                        lane,
                        row,
                        #[inline(always)]
                        |hit, place| store.hit(simd, &hit, place),
                    );
                }
                fragment_count = fragment_count.wrapping_add(store.fragment_count);
            }
        }
        (done, fragment_count)
    }
}

/// Where the samples of one shape go.
struct Store<'a, S: Simd, const COUNTS: bool> {
    lanes: &'a Lanes,
    depth: Depth<'a, S>,
    reference: u32x8<S>,
    /// Index of the box's first sample.
    first: usize,
    keys: &'a mut [f32],
    waiting: &'a mut [u32],
    before: Before,
    /// Pixels covered, if `COUNTS`.
    fragment_count: u64,
}

impl<S: Simd, const COUNTS: bool> Store<'_, S, COUNTS> {
    /// Stores the shape where it covers samples and is in front.
    #[inline(always)]
    fn hit(&mut self, simd: S, hit: &Covered<S>, place: [f32x8<S>; 2]) {
        if COUNTS {
            let more = self.lanes.pixel_count(hit, &mut self.before);
            self.fragment_count = self.fragment_count.wrapping_add(more);
        }
        let at = self.first.wrapping_add(hit.at);
        let keys = &mut self.keys[at..at.wrapping_add(LANE_COUNT)];
        let waiting = &mut self.waiting[at..at.wrapping_add(LANE_COUNT)];
        let nothing = f32x8::splat(simd, f32::NEG_INFINITY);
        let key = hit.inside.select(self.depth.keys_at(place), nothing);
        let old_key = f32x8::from_slice(simd, keys);
        let front = key.simd_gt(old_key);
        // not `front.select(key, old_key)`: that becomes a masked store, which is slow on some
        // processors
        key.max(old_key).store_slice(keys);
        let old = u32x8::from_slice(simd, waiting);
        front.select(self.reference, old).store_slice(waiting);
    }
}
