//! The smallest eigenvalue of a symmetric matrix, by Jacobi's rotations.
//!
//! This work is based on:
//! C. G. J. Jacobi. Über ein leichtes Verfahren, die in der Theorie der Säcularstörungen vorkommenden
//! Gleichungen numerisch aufzulösen. 1846

use glam::{DMat3, DVec3};

/// Rounds of Jacobi's rotations. They converge quadratically: five or six are enough.
const MAX_SWEEPS: usize = 32;

/// The smallest eigenvalue of a symmetric matrix and a unit eigenvector of it.
///
/// Of equal eigenvalues the one found first counts: the vector is then one of many, but always the
/// same for the same matrix.
pub fn smallest_eigenvector(matrix: &DMat3) -> (f64, DVec3) {
    let mut a = matrix.to_cols_array_2d();
    let mut vectors = [DVec3::X, DVec3::Y, DVec3::Z];
    for _ in 0..MAX_SWEEPS {
        let mut still = true;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            still &= !rotate(&mut a, &mut vectors, p, q);
        }
        if still {
            break;
        }
    }
    let mut least = 0;
    for axis in 1..3 {
        if a[axis][axis] < a[least][least] {
            least = axis;
        }
    }
    (a[least][least], vectors[least].normalize())
}

/// Turns in the plane of two axes until element (p, q) is 0; false if it is as good as that already.
fn rotate(a: &mut [[f64; 3]; 3], vectors: &mut [DVec3; 3], p: usize, q: usize) -> bool {
    let off = a[p][q];
    if a[p][p] + off == a[p][p] && a[q][q] + off == a[q][q] {
        a[p][q] = 0.0;
        a[q][p] = 0.0;
        return false;
    }
    // tan of the turn: the root of t^2 + 2 theta t - 1 that is nearer to 0
    let theta = (a[q][q] - a[p][p]) / (2.0 * off);
    let t = 1.0_f64.copysign(theta) / (theta.abs() + (theta * theta + 1.0).sqrt());
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    a[p][p] -= t * off;
    a[q][q] += t * off;
    a[p][q] = 0.0;
    a[q][p] = 0.0;
    let r = 3 - p - q;
    let [to_p, to_q] = [a[r][p], a[r][q]];
    a[r][p] = c * to_p - s * to_q;
    a[r][q] = s * to_p + c * to_q;
    a[p][r] = a[r][p];
    a[q][r] = a[r][q];
    let [v_p, v_q] = [vectors[p], vectors[q]];
    vectors[p] = v_p * c - v_q * s;
    vectors[q] = v_p * s + v_q * c;
    true
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Of the matrix' size: rounding of a few dozen operations in f64.
    const ROUNDED: f64 = 1e-14;

    fn size(matrix: &DMat3) -> f64 {
        DVec3::from(matrix.to_cols_array_2d().map(|column| DVec3::from(column).length())).length()
    }

    fn symmetric([xx, yy, zz, xy, xz, yz]: [f64; 6]) -> DMat3 {
        DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
    }

    #[test]
    fn equal_eigenvalues_give_the_first_axis() {
        assert_eq!(smallest_eigenvector(&DMat3::ZERO), (0.0, DVec3::X), "zero");
        assert_eq!(smallest_eigenvector(&(DMat3::IDENTITY * 5.0)), (5.0, DVec3::X), "isotropic");
        let two = DMat3::from_diagonal(DVec3::new(3.0, 2.0, 2.0));
        assert_eq!(smallest_eigenvector(&two), (2.0, DVec3::Y), "two of three");
    }

    proptest! {
        #[test]
        fn eigenvectors_have_no_residual_and_nothing_is_smaller(
            elements in prop::array::uniform6(-1.0..1.0_f64), scale in -12..12_i32,
            other in prop::array::uniform3(-1.0..1.0_f64)
        ) {
            let matrix = symmetric(elements) * 10.0_f64.powi(scale);
            let (value, vector) = smallest_eigenvector(&matrix);
            let residual = (matrix * vector - vector * value).length();
            prop_assert!(residual <= ROUNDED * size(&matrix), "{residual} of {}", size(&matrix));
            prop_assert!((vector.length() - 1.0).abs() < ROUNDED);
            let other = DVec3::from(other).normalize_or(DVec3::X);
            prop_assert!(other.dot(matrix * other) >= value - ROUNDED * size(&matrix));
        }
    }
}
