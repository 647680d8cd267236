//! Exact sums over a group of leaves: the same in any order, and leaves can be taken out again.
//!
//! Coordinates are multiples of [`GRID`], so that they and their products are integers. Integers of
//! 128 bits hold the sums of 2^32 leaves without rounding. A clustering therefore adds and takes out
//! only the leaves that changed their cluster, on any number of threads, and still has the moments
//! that a fresh sum would give, to the bit.

use glam::{DMat3, DVec3};

use crate::lod::leaf_clusters::moments::Moments;

/// Coordinates in [-1, 1] are multiples of this: 2^-46, which keeps all digits of a 32-bit number of
/// at least 2^-22. Products are multiples of 2^-92, and 2^32 of them stay below 2^125.
pub(super) const GRID: f64 = 1.0 / (1_u64 << 46) as f64;

/// A number of [-2, 2] on the grid.
#[inline(always)]
pub(super) fn on_grid(value: f64) -> f64 {
    // adding 1.5 * 2^52 grid steps leaves no bits for less than one of them
    const ROUNDER: f64 = 1.5 * (1_u64 << 52) as f64 * GRID;
    (value + ROUNDER) - ROUNDER
}

/// Rows and columns of the elements of a symmetric matrix that are summed.
const ELEMENTS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

/// Count, sums and sums of products of a group of leaves, in grid steps.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Sums {
    pub(super) count: i64,
    centers: [i128; 3],
    spread: [i128; 6],
    facing: [i128; 6],
}

impl Sums {
    /// Adds a leaf (`SIGN` 1) or takes it out (-1): its centre and normal, on the grid.
    #[inline]
    pub(super) fn add<const SIGN: i64>(&mut self, leaf: [f64; 6]) {
        #[expect(clippy::cast_possible_truncation, reason = "whole numbers below 2^47")]
        let steps = leaf.map(|value| (value * (1.0 / GRID)) as i64);
        self.count = self.count.wrapping_add(SIGN);
        for (sum, step) in self.centers.iter_mut().zip(steps) {
            *sum = sum.wrapping_add(i128::from(SIGN.wrapping_mul(step)));
        }
        for (element, (i, j)) in ELEMENTS.into_iter().enumerate() {
            let p = i128::from(SIGN.wrapping_mul(steps[i])).wrapping_mul(i128::from(steps[j]));
            self.spread[element] = self.spread[element].wrapping_add(p);
            let n =
                i128::from(SIGN.wrapping_mul(steps[3 + i])).wrapping_mul(i128::from(steps[3 + j]));
            self.facing[element] = self.facing[element].wrapping_add(n);
        }
    }

    /// Adds all leaves of another group.
    pub(super) fn merge(&mut self, other: &Self) {
        self.count += other.count;
        let pairs: [(&mut [i128], &[i128]); 3] = [
            (&mut self.centers, &other.centers),
            (&mut self.spread, &other.spread),
            (&mut self.facing, &other.facing),
        ];
        for (sums, others) in pairs {
            for (sum, more) in sums.iter_mut().zip(others) {
                *sum = sum.wrapping_add(*more);
            }
        }
    }

    /// The moments, rounded once.
    pub(super) fn moments(&self) -> Moments {
        if self.count == 0 {
            return Moments::EMPTY;
        }
        let count = self.count as f64;
        // any whole number near the mean will do: what it is off by is taken out below
        #[expect(clippy::cast_possible_truncation, reason = "below 2^47 grid steps")]
        let near = self.centers.map(|sum| i128::from((sum as f64 / count).round() as i64));
        let wide = i128::from(self.count);
        let rest: [f64; 3] = std::array::from_fn(|axis: usize| {
            self.centers[axis].wrapping_sub(wide.wrapping_mul(near[axis])) as f64
        });
        let mut spread = [0.0; 6];
        let mut facing = [0.0; 6];
        for (element, (i, j)) in ELEMENTS.into_iter().enumerate() {
            // sum (p_i - c_i)(p_j - c_j): steps between may wrap, the result fits
            let about = self.spread[element]
                .wrapping_sub(near[i].wrapping_mul(self.centers[j]))
                .wrapping_sub(near[j].wrapping_mul(self.centers[i]))
                .wrapping_add(wide.wrapping_mul(near[i]).wrapping_mul(near[j]));
            spread[element] = (about as f64 - rest[i] * rest[j] / count) * (GRID * GRID);
            facing[element] = self.facing[element] as f64 * (GRID * GRID);
        }
        let mean =
            std::array::from_fn(|axis: usize| (near[axis] as f64 + rest[axis] / count) * GRID);
        Moments {
            count: self.count.unsigned_abs(),
            mean: DVec3::from_array(mean),
            spread: symmetric(spread),
            facing: symmetric(facing),
        }
    }
}

fn symmetric([xx, yy, zz, xy, xz, yz]: [f64; 6]) -> DMat3 {
    DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Rounding of up to 40 numbers of size 1 that are added in f64.
    const SUMMED: f64 = 1e-13;

    fn leaves() -> impl Strategy<Value = Vec<[f64; 6]>> {
        let leaf = prop::array::uniform6(-1.0..1.0_f64).prop_map(|values| values.map(on_grid));
        prop::collection::vec(leaf, 1..40)
    }

    fn sums_of(leaves: &[[f64; 6]]) -> Sums {
        let mut sums = Sums::default();
        leaves.iter().for_each(|&leaf| sums.add::<1>(leaf));
        sums
    }

    #[test]
    fn numbers_on_the_grid_stay_and_others_go_to_the_nearest() {
        for value in [0.0, 1.0, -1.0, GRID, f64::from(-0.123_f32), 1.0 - GRID] {
            assert_eq!(on_grid(value), value, "{value} is a multiple");
        }
        assert_eq!(on_grid(1.0 + 0.4 * GRID), 1.0, "down");
        assert_eq!(on_grid(-0.6 * GRID), -GRID, "away from 0");
    }

    #[test]
    fn a_tiny_group_far_from_zero_is_summed_without_loss() {
        let at = |steps: f64| [1.0 - steps * GRID, 0.5, -1.0, 0.0, 0.0, 1.0];
        // 0, 1 and 5 steps: mean 2, squares 4 + 1 + 9
        let moments = sums_of(&[at(0.0), at(1.0), at(5.0)]).moments();
        assert_eq!(moments.mean, DVec3::new(1.0 - 2.0 * GRID, 0.5, -1.0), "mean");
        let spread = DMat3::from_diagonal(DVec3::X * 14.0 * GRID * GRID);
        assert_eq!(moments.spread, spread, "14 squared steps");
        assert_eq!(moments.facing, DMat3::from_diagonal(DVec3::Z * 3.0), "three face z");
        // a mean between steps: 0 and 1 are each half a step off
        let spread = sums_of(&[at(0.0), at(1.0)]).moments().spread;
        assert_eq!(spread.x_axis.x, 0.5 * GRID * GRID, "half a squared step");
    }

    #[test]
    fn the_largest_sums_fit() {
        let mut sums = sums_of(&[[1.001, -1.001, 1.0, 1.0, 1.0, 0.0]].map(|row| row.map(on_grid)));
        for _ in 0..32 {
            let half = sums;
            sums.merge(&half);
        }
        let moments = sums.moments();
        assert_eq!(moments.count, 1 << 32, "as many leaves as ids");
        assert_eq!(moments.spread, DMat3::ZERO, "all at one place");
        assert_eq!(moments.facing.x_axis.y, (1_u64 << 32) as f64, "all with one normal");
    }

    proptest! {
        #[test]
        fn moments_are_those_of_the_leaves(leaves in leaves()) {
            let [centers, normals]: [Vec<DVec3>; 2] = [0, 3].map(|first| {
                leaves.iter().map(|leaf| DVec3::from_slice(&leaf[first..])).collect()
            });
            let (got, expected) = (sums_of(&leaves).moments(), Moments::of(&centers, &normals));
            prop_assert_eq!(got.count, expected.count);
            prop_assert!(got.mean.abs_diff_eq(expected.mean, SUMMED));
            prop_assert!(got.spread.abs_diff_eq(expected.spread, SUMMED));
            prop_assert!(got.facing.abs_diff_eq(expected.facing, SUMMED));
        }

        #[test]
        fn order_and_detours_do_not_show(leaves in leaves(), cut in 0..40_usize) {
            let expected = sums_of(&leaves);
            let turned: Vec<[f64; 6]> = leaves.iter().rev().copied().collect();
            prop_assert_eq!(sums_of(&turned), expected);
            let cut = cut.min(leaves.len());
            let mut sums = sums_of(&leaves[cut..]);
            sums.merge(&sums_of(&leaves[..cut]));
            prop_assert_eq!(sums, expected);
            for &leaf in &leaves[..cut] {
                sums.add::<-1>(leaf);
            }
            prop_assert_eq!(sums, sums_of(&leaves[cut..]));
        }
    }
}
