//! What a group of leaves needs to be known by, to fit a plane to it and to know the fit's error.
//!
//! With centres `p` of mean `c` and normals `n`, the error of the plane through `c` with the unit
//! normal `x` is `x.B x`, where
//!
//! ```text
//! B = sum (p - c)(p - c)^T + alpha sum (|n|^2 I - n n^T)
//! ```
//!
//! so that count, mean and two symmetric matrices are enough, whatever `alpha` is. Those of two
//! groups give those of both together.
//!
//! This work is based on:
//! Ismael Garcia, Mateu Sbert, László Szirmay-Kalos. Leaf Cluster Impostors for Tree Rendering with
//! Parallax. 2005
//! Philippe Pébay. Formulas for Robust, One-Pass Parallel Computation of Covariances and
//! Arbitrary-Order Statistical Moments. 2008

use glam::{DMat3, DVec3};

/// Count, mean and second moments of a group of leaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments {
    /// How many leaves.
    pub count: u64,
    /// Mean of their centres, in metres; 0 for no leaves.
    pub mean: DVec3,
    /// Sum of `(p - mean)(p - mean)^T`, in square metres.
    pub spread: DMat3,
    /// Sum of `n n^T`.
    pub facing: DMat3,
}

impl Moments {
    /// Those of no leaves.
    pub const EMPTY: Self =
        Self { count: 0, mean: DVec3::ZERO, spread: DMat3::ZERO, facing: DMat3::ZERO };

    /// Those of leaves with the given centres and normals: the mean first, then what differs from it,
    /// so that a small group far from zero keeps its digits.
    ///
    /// # Panics
    /// If there are not as many normals as centres.
    pub fn of(centers: &[DVec3], normals: &[DVec3]) -> Self {
        assert_eq!(centers.len(), normals.len(), "a normal for each centre");
        if centers.is_empty() {
            return Self::EMPTY;
        }
        let count = centers.len() as f64;
        // twice: the second time it is the rounding of the first that is averaged away
        let rough = centers.iter().copied().sum::<DVec3>() / count;
        let mean = rough + centers.iter().map(|&p| p - rough).sum::<DVec3>() / count;
        Self {
            count: centers.len() as u64,
            mean,
            spread: centers.iter().fold(DMat3::ZERO, |sum, &p| sum + outer(p - mean, p - mean)),
            facing: normals.iter().fold(DMat3::ZERO, |sum, &n| sum + outer(n, n)),
        }
    }

    /// Those of two groups together.
    pub fn merge(&self, other: &Self) -> Self {
        let count = self.count + other.count;
        if count == 0 {
            return Self::EMPTY;
        }
        let share = other.count as f64 / count as f64;
        let apart = other.mean - self.mean;
        Self {
            count,
            mean: self.mean + apart * share,
            spread: self.spread + other.spread + outer(apart, apart) * (self.count as f64 * share),
            facing: self.facing + other.facing,
        }
    }

    /// `B`: positive semidefinite, and `x.B x` is the error of the plane through the mean with the
    /// unit normal `x`. `alpha` is in square metres.
    pub fn cost_matrix(&self, alpha: f64) -> DMat3 {
        let [xx, yy, zz] = [0, 1, 2].map(|axis| self.facing.col(axis)[axis]);
        // |n|^2 - n_x^2 summed as n_y^2 + n_z^2: nothing cancels
        let rest = DMat3::from_diagonal(DVec3::new(yy + zz, xx + zz, xx + yy));
        let diagonal = DMat3::from_diagonal(DVec3::new(xx, yy, zz));
        self.spread + (rest - (self.facing - diagonal)) * alpha
    }

    /// The paper's `A = sum (p - c)(p - c)^T - alpha sum n n^T`, which has the eigenvectors of `B`,
    /// and negative eigenvalues as soon as `alpha` matters.
    pub fn paper_matrix(&self, alpha: f64) -> DMat3 {
        self.spread - self.facing * alpha
    }

    /// Error of the plane through the mean with the unit normal `normal`; never below 0.
    pub fn cost(&self, normal: DVec3, alpha: f64) -> f64 {
        normal.dot(self.cost_matrix(alpha) * normal).max(0.0)
    }
}

/// `a b^T`.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Two ways to sum up to 40 numbers of size 1e3, with products of size 1e6, in f64.
    const SUMMED: f64 = 1e-8;

    fn vectors(count: usize) -> impl Strategy<Value = Vec<DVec3>> {
        let vector = (-1e3..1e3, -1e3..1e3, -1e3..1e3).prop_map(|(x, y, z)| DVec3::new(x, y, z));
        prop::collection::vec(vector, count..=count)
    }

    #[test]
    fn three_leaves_by_hand() {
        //  y
        //  2  c            centres a (0,0,0), b (3,0,0), c (0,3,0); mean (1,1,0)
        //  1    +          a, b face z, c faces x
        //  0  a    b
        let centers = [DVec3::ZERO, DVec3::X * 3.0, DVec3::Y * 3.0];
        let moments = Moments::of(&centers, &[DVec3::Z, DVec3::Z, DVec3::X]);
        assert_eq!((moments.count, moments.mean), (3, DVec3::new(1.0, 1.0, 0.0)), "mean");
        // x: 1 + 4 + 1, y: 1 + 1 + 4, xy: 1 - 2 - 2
        let spread = DMat3::from_cols_array(&[6.0, -3.0, 0.0, -3.0, 6.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(moments.spread, spread, "about the mean");
        assert_eq!(moments.facing, DMat3::from_diagonal(DVec3::new(1.0, 0.0, 2.0)), "normals");
        let cost = spread + DMat3::from_diagonal(DVec3::new(2.0, 3.0, 1.0)) * 0.5;
        assert_eq!(moments.cost_matrix(0.5), cost, "3 I - facing");
        let paper = spread - DMat3::from_diagonal(DVec3::new(1.0, 0.0, 2.0)) * 0.5;
        assert_eq!(moments.paper_matrix(0.5), paper, "facing subtracted");
        assert_eq!(moments.cost(DVec3::Z, 0.5), 0.5, "only the leaf that faces x is off");
    }

    #[test]
    fn no_leaves_add_nothing() {
        let one = Moments::of(&[DVec3::X], &[DVec3::Y]);
        assert_eq!(Moments::of(&[], &[]), Moments::EMPTY, "none");
        assert_eq!(Moments::EMPTY.merge(&Moments::EMPTY), Moments::EMPTY, "none and none");
        assert_eq!(one.merge(&Moments::EMPTY), one, "none after");
        assert_eq!(Moments::EMPTY.merge(&one), one, "none before");
    }

    #[test]
    fn a_small_group_far_away_keeps_its_digits() {
        let away = DVec3::splat(1e6);
        let moments = Moments::of(&[away, away + DVec3::X * 0.25], &[DVec3::Z; 2]);
        assert_eq!(moments.spread.x_axis.x, 2.0 * 0.125 * 0.125, "exact: powers of two");
    }

    proptest! {
        #[test]
        fn two_groups_together_are_all_their_leaves(
            centers in vectors(40), normals in vectors(40), cut in 0..=40_usize
        ) {
            let all = Moments::of(&centers, &normals);
            let merged = Moments::of(&centers[..cut], &normals[..cut])
                .merge(&Moments::of(&centers[cut..], &normals[cut..]));
            prop_assert_eq!(merged.count, all.count);
            prop_assert!(merged.mean.abs_diff_eq(all.mean, SUMMED), "mean");
            prop_assert!(merged.spread.abs_diff_eq(all.spread, 40.0 * SUMMED), "spread");
            prop_assert!(merged.facing.abs_diff_eq(all.facing, 40.0 * SUMMED), "facing");
        }

        #[test]
        fn the_cost_is_the_sum_of_the_leaves_errors(
            centers in vectors(9), normals in vectors(9), normal in vectors(1)
        ) {
            prop_assume!(normal[0].length() > 1.0);
            let unit = normal[0].normalize();
            let moments = Moments::of(&centers, &normals);
            let sum: f64 = centers.iter().zip(&normals).map(|(p, n)| {
                (p - moments.mean).dot(unit).powi(2) + 0.3 * n.cross(unit).length_squared()
            }).sum();
            prop_assert!((moments.cost(unit, 0.3) - sum).abs() < 40.0 * SUMMED);
        }
    }
}
