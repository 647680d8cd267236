//! How a billboard stands: which way it faces, and which way is up in it.
//!
//! A frame has no roll: its right is level, so a camera that is tilted sideways sees an upright plant.
//! All directions are the plant's own.
//!
//! This work is based on:
//! Daniel Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming. 2003 (chapter 20)

use glam::DVec3;

use crate::lod::Crown;
use crate::lod::view_blend::level_direction;
use crate::view::View;

/// An eye nearer to the centre than this share of the radius sees along its own direction.
const INSIDE: f64 = 1e-3;

/// Which way a billboard faces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Align {
    /// The eye.
    Camera,
    /// Back along the viewing direction: it is parallel to the picture.
    ViewPlane,
    /// The eye, but turned from there by this many radians at most.
    Limited(f64),
}

/// About what a billboard turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// The vertical through its centre.
    Vertical,
    /// Its centre.
    Free,
}

/// A camera as a plant sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Unit vector from the centre to the eye; in a parallel view, or with the eye at the centre, `back`.
    pub eye: DVec3,
    /// Unit vector against the viewing direction.
    pub back: DVec3,
    /// Unit vector to the picture's top.
    pub up: DVec3,
}

impl Seen {
    /// What a copy sees whose own ball has a centre and a radius.
    pub fn new(view: &View, crown: &Crown, center: DVec3, radius: f64) -> Self {
        let back = crown.local_direction(view.back);
        let from_center = crown.local_eye(view) - center;
        let is_outside = !view.is_orthographic() && from_center.length() > INSIDE * radius;
        let eye = if is_outside { from_center.normalize() } else { back };
        Self { eye, back, up: crown.local_direction(view.up) }
    }
}

/// Unit vectors along a billboard's rows, to its top, and to its viewer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Level.
    pub right: DVec3,
    /// Vertical if `toward` is level.
    pub up: DVec3,
    /// The billboard's normal.
    pub toward: DVec3,
}

impl Frame {
    /// The upright frame that faces a direction; straight above or below, the picture's up decides.
    pub fn facing(toward: DVec3, up: DVec3) -> Self {
        let right = DVec3::Y.cross(level_direction(toward, up).normalize());
        Self { right, up: toward.cross(right), toward }
    }

    /// The frame of a billboard that is seen.
    pub fn new(align: Align, axis: Axis, seen: &Seen) -> Self {
        let Seen { eye, back, up } = *seen;
        let (eye, back, pole) = match axis {
            Axis::Free => (eye, back, up),
            Axis::Vertical => {
                let level = |toward| level_direction(toward, up).normalize();
                (level(eye), level(back), DVec3::Y)
            }
        };
        let toward = match align {
            Align::Camera => eye,
            Align::ViewPlane => back,
            Align::Limited(most) => turned(back, eye, most, pole),
        };
        Self::facing(toward, up)
    }
}

/// One unit vector turned towards another by at most `most` radians; about the pole if they are
/// opposite.
fn turned(from: DVec3, to: DVec3, most: f64, pole: DVec3) -> DVec3 {
    let across = from.cross(to);
    if libm::atan2(across.length(), from.dot(to)) <= most {
        return to;
    }
    let about = across.try_normalize().unwrap_or(pole);
    from * libm::cos(most) + about.cross(from) * libm::sin(most)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

    use glam::DAffine3;

    use super::*;
    use crate::lod::made::{parallel, perspective};

    fn near(a: DVec3, b: DVec3) -> bool {
        a.abs_diff_eq(b, 1e-12)
    }

    fn seen(eye: DVec3, target: DVec3, up: DVec3) -> Seen {
        Seen::new(
            &perspective(eye, target, up),
            &Crown::alone(DAffine3::IDENTITY),
            DVec3::ZERO,
            1.0,
        )
    }

    /// From (3, 4, 3) straight ahead along -z: the plant stands to the left and below.
    fn off_axis(up: DVec3) -> Seen {
        let eye = DVec3::new(3.0, 4.0, 3.0);
        seen(eye, eye - DVec3::Z, up)
    }

    #[test]
    fn a_billboard_faces_the_eye_or_the_picture() {
        let half = 0.5_f64.sqrt();
        for up in [DVec3::Y, DVec3::new(1.0, 2.0, 0.0), DVec3::NEG_X] {
            let seen = off_axis(up);
            let frame = |align, axis| Frame::new(align, axis, &seen);
            let flat = frame(Align::ViewPlane, Axis::Free);
            let ahead = Frame { right: DVec3::X, up: DVec3::Y, toward: DVec3::Z };
            assert_eq!(flat, ahead, "parallel to the picture, upright at any roll");
            assert_eq!(frame(Align::ViewPlane, Axis::Vertical), ahead, "and vertical anyway");
            let upright = frame(Align::Camera, Axis::Vertical);
            assert!(near(upright.toward, DVec3::new(half, 0.0, half)), "45 degrees aside");
            assert!(near(upright.right, DVec3::new(half, 0.0, -half)), "level");
            assert!(near(upright.up, DVec3::Y), "vertical");
            let free = frame(Align::Camera, Axis::Free);
            let toward = DVec3::new(3.0, 4.0, 3.0) / 34.0_f64.sqrt();
            assert!(near(free.toward, toward), "to the eye");
            assert!(near(free.right, DVec3::new(half, 0.0, -half)), "level all the same");
            let top = DVec3::new(-4.0 * half, 18.0_f64.sqrt(), -4.0 * half) / 34.0_f64.sqrt();
            assert!(near(free.up, top), "tipped back: {}", free.up);
        }
    }

    #[test]
    fn a_limited_turn_stops() {
        let seen = off_axis(DVec3::Y);
        let of = |most: f64, axis| Frame::new(Align::Limited(most), axis, &seen);
        for axis in [Axis::Vertical, Axis::Free] {
            assert_eq!(of(0.0, axis), Frame::new(Align::ViewPlane, axis, &seen), "no turn at all");
            assert_eq!(of(PI, axis), Frame::new(Align::Camera, axis, &seen), "any turn");
        }
        // 45 degrees are asked for
        let (sin, cos) = (0.5, 0.75_f64.sqrt());
        let third = of(PI / 6.0, Axis::Vertical);
        assert!(near(third.toward, DVec3::new(sin, 0.0, cos)), "30 of them: {}", third.toward);
        let all = of(FRAC_PI_4 + 1e-9, Axis::Vertical);
        assert_eq!(all, Frame::new(Align::Camera, Axis::Vertical, &seen), "a little more than 45");
        // along the arc to (3, 4, 3), whose level part leans 3 to 4
        let free = of(PI / 6.0, Axis::Free);
        assert!(near(free.toward, DVec3::new(0.6 * sin, 0.8 * sin, cos)), "{}", free.toward);
    }

    #[test]
    fn behind_the_eye_the_turn_is_about_the_pole() {
        let opposite = Seen { eye: DVec3::NEG_Z, back: DVec3::Z, up: DVec3::Y };
        let turned = Frame::new(Align::Limited(FRAC_PI_2), Axis::Vertical, &opposite);
        assert!(near(turned.toward, DVec3::X), "a quarter about +y: {}", turned.toward);
        let whole = Frame::new(Align::Limited(PI), Axis::Free, &opposite);
        assert_eq!(whole.toward, DVec3::NEG_Z, "half a turn reaches it");
    }

    #[test]
    fn straight_above_and_below_the_pictures_up_decides() {
        let down = seen(DVec3::Y * 5.0, DVec3::ZERO, DVec3::NEG_Z);
        let free = Frame::new(Align::Camera, Axis::Free, &down);
        assert_eq!(
            free,
            Frame { right: DVec3::X, up: DVec3::NEG_Z, toward: DVec3::Y },
            "lies flat"
        );
        let upright = Frame::new(Align::Camera, Axis::Vertical, &down);
        assert_eq!(upright, Frame { right: DVec3::X, up: DVec3::Y, toward: DVec3::Z }, "on edge");
        let from_below = seen(DVec3::Y * -5.0, DVec3::ZERO, DVec3::NEG_Z);
        let below = Frame::new(Align::Camera, Axis::Free, &from_below);
        assert_eq!(below.toward, DVec3::NEG_Y, "seen from below");
        assert!(near(below.up, DVec3::NEG_Z) && near(below.right, DVec3::NEG_X), "{below:?}");
    }

    #[test]
    fn an_eye_at_the_centre_and_a_parallel_view_see_along_the_view() {
        let (center, crown) = (DVec3::new(0.0, 2.0, 0.0), Crown::alone(DAffine3::IDENTITY));
        for eye in [center, center + DVec3::X * 0.9e-3] {
            let view = perspective(eye, eye + DVec3::new(1.0, 0.0, 0.0), DVec3::Y);
            let seen = Seen::new(&view, &crown, center, 1.0);
            assert!(near(seen.eye, DVec3::NEG_X), "at the centre: {}", seen.eye);
        }
        let view = perspective(center - DVec3::X * 0.5, center + DVec3::Z, DVec3::Y);
        let inside = Seen::new(&view, &crown, center, 1.0);
        assert!(near(inside.eye, DVec3::NEG_X), "in the crown, left of the middle");
        let parallel = Seen::new(&parallel(DVec3::Z, DVec3::Y, 2.0, 8), &crown, center, 1.0);
        assert_eq!((parallel.eye, parallel.back), (DVec3::Z, DVec3::Z), "one direction for all");
    }

    #[test]
    fn frames_are_right_handed_and_unit() {
        for degrees in [-180.0_f64, -91.0, -30.0, 0.0, 12.0, 90.0, 179.0] {
            for height in [-0.99, -0.2, 0.0, 0.7] {
                let across = (1.0 - f64::powi(height, 2)).sqrt();
                let angle = degrees.to_radians();
                let toward = DVec3::new(across * angle.sin(), height, across * angle.cos());
                let frame = Frame::facing(toward, DVec3::Y);
                assert!(near(frame.right.cross(frame.up), toward), "{toward}");
                assert!(frame.right.y == 0.0 && frame.up.y >= 0.0, "upright: {toward}");
                assert!(frame.right.is_normalized() && frame.up.is_normalized(), "{toward}");
            }
        }
    }
}
