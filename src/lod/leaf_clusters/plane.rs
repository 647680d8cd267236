//! A plane that stands for a group of leaves: its error, and how it is fitted.
//!
//! The best plane goes through the mean of the leaves' centres, and its normal is the eigenvector of
//! the smallest eigenvalue of the group's matrix `B` ([`Moments::cost_matrix`]).
//!
//! The paper looks for it by power iteration on the inverse of `A = B - alpha sum |n|^2 I`. That
//! finds the eigenvalue of smallest *magnitude*. All eigenvalues of `B` are at least 0, but those of
//! `A` are shifted down, and once some are negative, the smallest is not the one nearest to 0: the
//! iteration then gives another eigenvector, up to the worst of all. [`Eigen::Paper`] is kept to show
//! that.
//!
//! This work is based on:
//! Ismael Garcia, Mateu Sbert, László Szirmay-Kalos. Leaf Cluster Impostors for Tree Rendering with
//! Parallax. 2005

use glam::{DMat3, DVec3};

use crate::lod::eigen::smallest_eigenvector;
use crate::lod::leaf_clusters::moments::Moments;

/// How the normal of a group's plane is found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Eigen {
    /// By Jacobi's rotations: the best plane.
    #[default]
    Exact,
    /// By the paper's power iteration on `A^-1`, which misses the best plane where `alpha` matters.
    ///
    /// The paper states neither start nor end. Here: from (0.36, 0.48, 0.8), a unit vector that is
    /// across nothing likely, until a step turns the vector by less than 1e-12, at most 1000 steps.
    /// Where `A` has no inverse, 1e-12 of its largest element is added to its diagonal, so that the
    /// iteration finds what `A` maps to 0.
    Paper,
}

/// The paper's vector before the first step: of unit length, and along no axis or diagonal.
const PAPER_START: DVec3 = DVec3::new(0.36, 0.48, 0.8);

/// The paper's steps end when they move the unit vector by less.
const PAPER_STILL: f64 = 1e-12;

/// The paper's steps end here where two eigenvalues are equally far from 0, and nothing converges.
const PAPER_MAX_STEPS: usize = 1000;

/// Of the largest element: what makes a matrix without an inverse have one.
const PAPER_SHIFT: f64 = 1e-12;

/// The points `p` with `p.normal + d = 0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Of unit length.
    pub normal: DVec3,
    /// Distance of the plane from zero along `-normal`, in metres.
    pub d: f64,
}

impl Plane {
    /// The plane through a point, with the sign that makes `d` at least 0, or, if `d` is 0, the
    /// normal's first nonzero component positive.
    pub fn through(point: DVec3, normal: DVec3) -> Self {
        Self { normal, d: -point.dot(normal) }.with_sign()
    }

    /// The plane that fits a group best, or by the paper's iteration. That of no leaves is x = 0.
    pub fn fitted(moments: &Moments, alpha: f64, eigen: Eigen) -> Self {
        let normal = match eigen {
            Eigen::Exact => smallest_eigenvector(&moments.cost_matrix(alpha)).1,
            Eigen::Paper => paper_eigenvector(&moments.paper_matrix(alpha)),
        };
        Self::through(moments.mean, normal)
    }

    /// Signed distance of a point, above 0 on the side that the normal points to.
    #[inline]
    pub fn distance(&self, p: DVec3) -> f64 {
        p.dot(self.normal) + self.d
    }

    /// How badly it stands for a leaf with centre `p` and normal `n`, in square metres: its squared
    /// distance from `p`, and `alpha` times the squared sine of its angle to the leaf.
    #[inline]
    pub fn error(&self, p: DVec3, n: DVec3, alpha: f64) -> f64 {
        let distance = p.dot(self.normal) + self.d;
        // not 1 - (n.normal)^2, which can be below 0 when rounded
        distance * distance + alpha * n.cross(self.normal).length_squared()
    }

    /// The same plane for coordinates whose zero lies at `origin`.
    pub fn relative_to(&self, origin: DVec3) -> Self {
        Self { normal: self.normal, d: self.d + origin.dot(self.normal) }.with_sign()
    }

    /// The same plane with the sign of [`Self::through`].
    pub fn with_sign(self) -> Self {
        let [x, y, z] = self.normal.to_array();
        let first = [self.d, x, y, z].into_iter().find(|&value| value != 0.0);
        if first.is_some_and(|value| value < 0.0) {
            return Self { normal: -self.normal, d: -self.d };
        }
        // -0 is 0
        Self { normal: self.normal, d: self.d + 0.0 }
    }
}

/// Where the paper's power iteration on the inverse ends: a unit vector.
fn paper_eigenvector(matrix: &DMat3) -> DVec3 {
    let largest = matrix.to_cols_array().into_iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    if largest == 0.0 {
        return PAPER_START;
    }
    let scaled = *matrix * (1.0 / largest);
    let mut inverse = scaled.inverse();
    if scaled.determinant() == 0.0 || !inverse.is_finite() {
        inverse = (scaled + DMat3::from_diagonal(DVec3::splat(PAPER_SHIFT))).inverse();
    }
    let mut x = PAPER_START;
    for _ in 0..PAPER_MAX_STEPS {
        let Some(next) = (inverse * x).try_normalize() else { break };
        // an eigenvalue below 0 turns the vector round at each step
        let moved = (next - x).length().min((next + x).length());
        x = next;
        if moved < PAPER_STILL {
            break;
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn error_of_a_leaf_by_hand() {
        //   leaf at height 2, turned by 3-4-5    plane y = 0.5
        let plane = Plane { normal: DVec3::Y, d: -0.5 };
        let (p, n) = (DVec3::new(7.0, 2.0, -3.0), DVec3::new(0.6, 0.8, 0.0));
        let expected = 1.5 * 1.5 + 10.0 * (0.6 * 0.6);
        assert_eq!(plane.error(p, n, 10.0), expected, "distance, and sine of the angle");
        assert_eq!(plane.error(p, -n, 10.0), expected, "a leaf has two sides");
        let turned = Plane { normal: -plane.normal, d: -plane.d };
        assert_eq!(turned.error(p, n, 10.0), expected, "a plane has two sides");
        assert_eq!(plane.error(p, DVec3::ZERO, 10.0), 2.25, "no normal, no angle");
        assert_eq!(plane.error(p, n, 0.0), 2.25, "angles weigh nothing");
    }

    #[test]
    fn signs_are_fixed() {
        let above = Plane::through(DVec3::Y * 2.0, DVec3::Y);
        assert_eq!(above, Plane { normal: -DVec3::Y, d: 2.0 }, "d >= 0");
        let flat = Plane::through(DVec3::ZERO, DVec3::new(0.0, -0.6, 0.8));
        assert_eq!(flat.normal, DVec3::new(0.0, 0.6, -0.8), "d = 0: first nonzero is positive");
        assert!(flat.d == 0.0 && flat.d.is_sign_positive(), "no -0");
        let seen = above.relative_to(DVec3::Y * 5.0);
        assert_eq!(seen, Plane { normal: DVec3::Y, d: 3.0 }, "three below the new zero");
    }

    #[test]
    fn fits_of_leaves_by_hand() {
        // leaves in the plane x + z = 2, facing along x - z, which weighs nothing at alpha 0
        let centers = [[1.0, 0.0, 1.0], [0.0, 3.0, 2.0], [2.0, 1.0, 0.0]].map(DVec3::from);
        let half = 0.5_f64.sqrt();
        let moments = Moments::of(&centers, &[DVec3::new(half, 0.0, -half); 3]);
        let plane = Plane::fitted(&moments, 0.0, Eigen::Exact);
        let expected = DVec3::new(-half, 0.0, -half);
        assert!(plane.normal.abs_diff_eq(expected, 1e-15), "{plane:?}");
        assert!((plane.d - 2.0_f64.sqrt()).abs() < 1e-15, "{plane:?}");
        // facing wins where alpha is large
        let facing = Plane::fitted(&moments, 1e6, Eigen::Exact);
        assert!(facing.normal.dot(DVec3::new(half, 0.0, -half)).abs() > 1.0 - 1e-12, "{facing:?}");
        // one leaf is its own plane
        let one = Moments::of(&[DVec3::X * 3.0], &[DVec3::new(0.6, 0.8, 0.0)]);
        let plane = Plane::fitted(&one, 0.1, Eigen::Exact);
        assert!(plane.normal.abs_diff_eq(-DVec3::new(0.6, 0.8, 0.0), 1e-15), "{plane:?}");
        assert!((plane.d - 1.8).abs() < 1e-15, "{plane:?}");
    }

    #[test]
    fn the_papers_iteration_finds_the_best_plane_only_while_angles_weigh_little() {
        // spread 1, 4, 9 along x, y, z, and ten leaves facing x: A has 1 - 10 alpha, 4, 9
        let moments = Moments {
            count: 10,
            mean: DVec3::ZERO,
            spread: DMat3::from_diagonal(DVec3::new(1.0, 4.0, 9.0)),
            facing: DMat3::from_diagonal(DVec3::new(10.0, 0.0, 0.0)),
        };
        for (alpha, expected) in [
            (0.0, DVec3::X),
            // |1 - 10 alpha| < 4: still the nearest to 0
            (0.4, DVec3::X),
            // -4.5: the nearest to 0 is 4 by y
            (0.55, DVec3::Y),
            (10.0, DVec3::Y),
        ] {
            assert_eq!(Plane::fitted(&moments, alpha, Eigen::Exact).normal, DVec3::X, "{alpha}");
            let found = Plane::fitted(&moments, alpha, Eigen::Paper).normal;
            assert!(found.dot(expected).abs() > 1.0 - 1e-12, "{alpha}: {found}");
        }
        // A has no inverse: what it maps to 0 is still found
        let found = Plane::fitted(&moments, 0.1, Eigen::Paper).normal;
        assert!(found.dot(DVec3::X).abs() > 1.0 - 1e-12, "{found}");
        assert_eq!(Plane::fitted(&Moments::EMPTY, 1.0, Eigen::Paper).normal, PAPER_START, "none");
    }

    proptest! {
        #[test]
        fn a_plane_moved_to_another_zero_has_the_same_errors(
            values in prop::array::uniform12(-10.0..10.0_f64)
        ) {
            let [point, normal, n, origin] = [0, 3, 6, 9].map(|i| DVec3::from_slice(&values[i..]));
            let plane = Plane::through(point, normal.normalize_or(DVec3::X));
            let moved = plane.relative_to(origin);
            let (here, there) = (plane.error(point + n, n, 0.5), moved.error(point + n - origin, n, 0.5));
            prop_assert!((here - there).abs() < 1e-10 * (1.0 + here), "{here} {there}");
        }
    }
}
