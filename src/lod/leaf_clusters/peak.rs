//! How many operations on vectors a core does a second: what bounds a pass over all leaves and planes.

use std::time::Instant;

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use crate::simd::{Kernel, LANE_COUNT, Level};

/// Operations that a pair of leaf and plane takes: seven products and six sums for the errors, two to
/// number them, three to keep the best two.
pub const OPS_PER_PAIR: u32 = 18;

/// Chains that run side by side, enough to hide what one operation waits for another.
const CHAIN_COUNT: usize = 12;

/// Rounds of a product, a sum and a minimum for each chain: about a millisecond.
const ROUND_COUNT: u32 = 1 << 16;

/// Operations on single numbers that vectors of a level do a second, on one thread: the best of
/// `repeats`.
pub fn ops_per_sec(level: Level, repeats: usize) -> f64 {
    let ops = f64::from(ROUND_COUNT) * (3 * CHAIN_COUNT * LANE_COUNT) as f64;
    let mut least = f64::INFINITY;
    for _ in 0..repeats {
        let start = Instant::now();
        let sum = level.run(Chains);
        let secs = start.elapsed().as_secs_f64();
        assert!(sum.is_finite(), "the chains end at a number");
        least = least.min(secs);
    }
    ops / least
}

struct Chains;

impl Kernel for Chains {
    type Output = f32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f32 {
        let [factor, more, most] =
            std::hint::black_box([0.5_f32, 1.0, 1e3]).map(|value| f32x8::splat(simd, value));
        let mut chains: [f32x8<S>; CHAIN_COUNT] =
            std::array::from_fn(|chain| f32x8::splat(simd, chain as f32));
        for _ in 0..ROUND_COUNT {
            for chain in &mut chains {
                *chain = (*chain * factor + more).min(most);
            }
        }
        let lanes = chains.map(|chain| -> [f32; LANE_COUNT] { chain.into() });
        lanes.iter().flatten().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_core_does_some_operations() {
        for level in Level::all() {
            // one in ten cycles of the slowest processor, and a hundred a cycle of the fastest
            let rate = ops_per_sec(level, 3);
            assert!((1e7..1e12).contains(&rate), "{level:?}: {rate}");
        }
    }
}
