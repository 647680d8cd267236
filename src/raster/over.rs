//! Blended textured shapes, eight samples at a time: what they paint, and where they hide half of what
//! is behind.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;
use glam::{Vec2, Vec3, Vec4, Vec4Swizzles};

use crate::raster::coverage::{Covered, Lanes};
use crate::raster::lookup::Lookup;
use crate::raster::shade::mix;
use crate::raster::visible::bits;
use crate::simd::LANE_COUNT;

/// Opacity, gathered front to back, at which a blended pixel's depth is taken.
pub(crate) const HALF_OPACITY: f32 = 0.5;

/// What painting the colour of a shape needs.
pub(crate) struct Over<'a> {
    pub(crate) lookup: Lookup<'a>,
    /// Lit colours of the corners.
    pub(crate) lit: [Vec3; 3],
    pub(crate) tint: Vec4,
}

impl Over<'_> {
    /// Paints over the colours of some lanes; which of them it changes.
    #[inline(never)]
    pub(crate) fn paint<S: Simd>(
        &self,
        simd: S,
        lanes: &Lanes,
        hit: &Covered<S>,
        lanes_in_front: u64,
        colors: &mut [Vec4],
    ) -> u64 {
        simd.vectorize(
            #[inline(always)]
            || self.paint_inlined(simd, lanes, hit, lanes_in_front, colors),
        )
    }

    #[inline(always)]
    fn paint_inlined<S: Simd>(
        &self,
        simd: S,
        lanes: &Lanes,
        hit: &Covered<S>,
        lanes_in_front: u64,
        colors: &mut [Vec4],
    ) -> u64 {
        let Self { lookup, lit, tint } = self;
        let points = lookup.points(simd, lanes, hit);
        // a texel that reads nothing but empty ones is empty itself
        let most = lookup.most_alpha(simd, &points, lanes_in_front);
        let asked = most.simd_gt(0.0).to_bitmask() & lanes_in_front;
        if asked == 0 {
            return 0;
        }
        let read = |lanes: f32x8<S>| -> [f32; LANE_COUNT] { lanes.into() };
        let (u, v, opacities) = (read(points.u), read(points.v), read(points.opacity));
        let weights = points.weights.map(read);
        let mut painted = 0;
        for lane in bits(asked) {
            let texel = lookup.look.sample(Vec2::new(u[lane], v[lane]), points.lods[lane]);
            let alpha = (texel.w * opacities[lane] * tint.w).clamp(0.0, 1.0);
            if texel.w == 0.0 || alpha == 0.0 {
                continue;
            }
            let lit = mix(*lit, [0.0, weights[0][lane], weights[1][lane]]);
            let color = lit * (texel.xyz() * (1.0 / texel.w)) * tint.xyz();
            colors[lane] = (color * alpha).extend(alpha) + colors[lane] * (1.0 - alpha);
            painted |= 1 << lane;
        }
        painted
    }
}

/// The search for the depth at which opacity, gathered front to back, reaches a half.
pub(crate) struct HalfOpacity<'a> {
    pub(crate) lookup: Lookup<'a>,
}

impl HalfOpacity<'_> {
    /// Adds to the opacities of some lanes; which of them reach a half by it.
    #[inline(never)]
    pub(crate) fn reached<S: Simd>(
        &self,
        simd: S,
        lanes: &Lanes,
        hit: &Covered<S>,
        lanes_in_front: u64,
        opacities: &mut [f32],
    ) -> u64 {
        simd.vectorize(
            #[inline(always)]
            || self.reached_inlined(simd, lanes, hit, lanes_in_front, opacities),
        )
    }

    #[inline(always)]
    fn reached_inlined<S: Simd>(
        &self,
        simd: S,
        lanes: &Lanes,
        hit: &Covered<S>,
        lanes_in_front: u64,
        opacities: &mut [f32],
    ) -> u64 {
        let lookup = &self.lookup;
        let before = f32x8::from_slice(simd, opacities);
        // what is half hidden already is known
        let open = before.simd_lt(HALF_OPACITY).to_bitmask() & lanes_in_front;
        if open == 0 {
            return 0;
        }
        let points = lookup.points(simd, lanes, hit);
        let most = lookup.most_alpha(simd, &points, open);
        let asked = most.simd_gt(0.0).to_bitmask() & open;
        if asked == 0 {
            return 0;
        }
        let texel = lookup.texel_alpha(simd, &points, asked);
        let alpha = points.opacity * texel * lookup.tint;
        let (zero, one) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 1.0));
        // lanes that were not asked have an alpha of 0
        let after = before + (1.0 - before) * alpha.max(zero).min(one);
        after.store_slice(opacities);
        after.simd_ge(HALF_OPACITY).to_bitmask() & asked
    }
}
