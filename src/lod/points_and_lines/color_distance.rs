//! How much two colours differ to the eye, in CIELAB, and which importance follows from it.
//!
//! White is that of sRGB (D65), at linear (1, 1, 1).
//!
//! This work is based on:
//! CIE. Colorimetry, 3rd edition. CIE 15:2004 (L*a*b*, and the difference of 1976)
//! IEC 61966-2-1. sRGB. 1999 (the primaries)

use glam::DVec3;

/// Differences up to this one do not make a part important.
const UNIMPORTANT_UP_TO: f64 = 10.0;

/// Difference beyond that which adds 1 to an importance.
const DIFFERENCE_PER_UNIT: f64 = 20.0;

/// Largest importance that follows from a colour.
const MAX_AUTOMATIC: f64 = 4.0;

/// CIE L*, a*, b* of a linear sRGB colour; components below 0 count as 0.
pub fn lab(linear: DVec3) -> DVec3 {
    let DVec3 { x: r, y: g, z: b } = linear.max(DVec3::ZERO);
    // rows over the white point's X, Y, Z: the sums of the rows
    let x = (0.412_456_4 * r + 0.357_576_1 * g + 0.180_437_5 * b) / 0.950_470_0;
    let y = 0.212_672_9 * r + 0.715_152_2 * g + 0.072_175_0 * b;
    let z = (0.019_333_9 * r + 0.119_192_0 * g + 0.950_304_1 * b) / 1.088_830_0;
    let [x, y, z] = [x, y, z].map(|t| {
        if t > 216.0 / 24389.0 { libm::cbrt(t) } else { (24389.0 / 27.0 * t + 16.0) / 116.0 }
    });
    DVec3::new(116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z))
}

/// Importance of a part by its mean colour and the plant's: `min(4, 1 + max(0, dE - 10) / 20)`.
pub fn importance(part: DVec3, plant: DVec3) -> f64 {
    let difference = lab(part).distance(lab(plant));
    let beyond = (difference - UNIMPORTANT_UP_TO).max(0.0);
    (1.0 + beyond / DIFFERENCE_PER_UNIT).min(MAX_AUTOMATIC)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_colours_have_their_lab_values() {
        // skimage.color.xyz2lab of its own XYZ matrix times these, scikit-image 0.26.0
        let cases = [
            (DVec3::X, [53.240_6, 80.092_3, 67.202_8]),
            (DVec3::Y, [87.735_1, -86.183_0, 83.179_7]),
            (DVec3::Z, [32.295_7, 79.185_6, -107.857_3]),
            (DVec3::splat(0.18), [49.496_1, 0.0, 0.0]),
            (DVec3::ONE, [100.0, 0.0, 0.0]),
            (DVec3::ZERO, [0.0, 0.0, 0.0]),
        ];
        for (color, expected) in cases {
            let found = lab(color);
            // its matrix has fewer digits, and its white is not quite white
            assert!(found.abs_diff_eq(DVec3::from(expected), 0.01), "{color}: {found}");
        }
        assert_eq!(lab(-DVec3::ONE), lab(DVec3::ZERO), "below black is black");
    }

    #[test]
    fn importance_grows_with_the_difference() {
        let green = DVec3::new(0.05, 0.2, 0.03);
        assert_eq!(importance(green, green), 1.0, "the plant's own colour");
        assert_eq!(importance(green * 1.1, green), 1.0, "hardly another");
        let yellow = DVec3::new(0.8, 0.6, 0.02);
        let found = importance(yellow, green);
        let expected = 1.0 + (lab(yellow).distance(lab(green)) - 10.0) / 20.0;
        assert!(found == expected.min(4.0) && found > 2.0, "{found}");
        assert_eq!(importance(DVec3::new(1.0, 0.0, 1.0), green), 4.0, "at most 4");
    }
}
