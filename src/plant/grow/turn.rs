//! Turning vectors, with the same result on every machine.
//!
//! The sines and cosines of the standard library differ between platforms, so these are `libm`'s.

use glam::DVec3;

/// `vector` turned about a unit `axis` by an angle in radians, counter-clockwise seen from its tip.
pub(super) fn turn(vector: DVec3, axis: DVec3, angle: f64) -> DVec3 {
    let (sin, cos) = (libm::sin(angle), libm::cos(angle));
    vector * cos + axis.cross(vector) * sin + axis * (axis.dot(vector) * (1.0 - cos))
}

/// A unit vector across `direction`: the horizontal one on its right, +x if it is vertical.
pub(super) fn level_side(direction: DVec3) -> DVec3 {
    direction.cross(DVec3::Y).try_normalize().unwrap_or(DVec3::X)
}

/// The unit vector that leaves `direction` by `down` and stands at azimuth `around` from `side`.
///
/// Angles in radians; `direction` and `side` are perpendicular unit vectors.
pub(super) fn side_direction(direction: DVec3, side: DVec3, around: f64, down: f64) -> DVec3 {
    let outward = around_axis(direction, side, around);
    (direction * libm::cos(down) + outward * libm::sin(down)).normalize()
}

/// The unit vector across `direction` at azimuth `around` (radians) from `side`.
pub(super) fn around_axis(direction: DVec3, side: DVec3, around: f64) -> DVec3 {
    (side * libm::cos(around) + direction.cross(side) * libm::sin(around)).normalize()
}

/// The part of `vector` across the unit vector `direction`, at unit length.
pub(super) fn across(vector: DVec3, direction: DVec3) -> DVec3 {
    let across = vector - direction * vector.dot(direction);
    // a vector along the direction has no such part; any perpendicular one will do
    across.try_normalize().unwrap_or_else(|| level_side(direction))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_counter_clockwise() {
        let right = std::f64::consts::FRAC_PI_2;
        let near = |a: DVec3, b: DVec3| a.distance(b) < 1e-15;
        assert!(near(turn(DVec3::X, DVec3::Y, right), -DVec3::Z), "x about y");
        assert!(near(turn(DVec3::Y, DVec3::X, right), DVec3::Z), "y about x");
        assert!(near(side_direction(DVec3::Y, DVec3::X, 0.0, right), DVec3::X), "towards side");
        assert!(near(side_direction(DVec3::Y, DVec3::X, right, right), -DVec3::Z), "a quarter on");
        assert_eq!(level_side(DVec3::Y), DVec3::X, "vertical");
        assert_eq!(across(DVec3::Y * 3.0, DVec3::Y), DVec3::X, "no part across");
    }
}
