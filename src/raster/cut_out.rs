//! Alpha tests of textured shapes, eight samples at a time.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use crate::raster::coverage::{Covered, Lanes};
use crate::raster::lookup::Lookup;
use crate::simd::LANE_COUNT;

/// A bound is compared with this share of a cutoff: what filters compute may be above it by rounding.
const NEARLY: f32 = 0.999;

/// What the alpha test of a shape needs.
pub(crate) struct CutOut<'a> {
    pub(crate) lookup: Lookup<'a>,
    /// Alpha from which a sample of a pixel is there.
    pub(crate) cutoffs: [f32; 16],
}

impl CutOut<'_> {
    /// Which of some lanes pass the test.
    ///
    /// One function a level: inlined where shapes are walked it would stand there many times.
    #[inline(never)]
    pub(crate) fn passing<S: Simd>(
        &self,
        simd: S,
        lanes: &Lanes,
        hit: &Covered<S>,
        lanes_in_front: u64,
    ) -> u64 {
        simd.vectorize(
            #[inline(always)]
            || self.passing_inlined(simd, lanes, hit, lanes_in_front),
        )
    }

    #[inline(always)]
    fn passing_inlined<S: Simd>(
        &self,
        simd: S,
        lanes: &Lanes,
        hit: &Covered<S>,
        lanes_in_front: u64,
    ) -> u64 {
        let Self { lookup, cutoffs } = self;
        let points = lookup.points(simd, lanes, hit);
        let mut wanted = [0.0; LANE_COUNT];
        for (lane, cutoff) in wanted.iter_mut().enumerate() {
            let (_, sample) = lanes.place(lane, hit.block);
            *cutoff = cutoffs[sample % 16];
        }
        let wanted = f32x8::simd_from(simd, wanted);
        let most = points.opacity * lookup.most_alpha(simd, &points, lanes_in_front) * lookup.tint;
        let asked = most.simd_ge(wanted * NEARLY).to_bitmask() & lanes_in_front;
        if asked == 0 {
            return 0;
        }
        let alpha = points.opacity * lookup.texel_alpha(simd, &points, asked) * lookup.tint;
        // lanes that were not asked have an alpha of 0, which a cutoff of 0 lets pass: all are asked then
        alpha.simd_ge(wanted).to_bitmask() & lanes_in_front
    }
}
