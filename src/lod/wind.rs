//! Wind: how far a placed plant leans at a moment, and the shear that leans it.
//!
//! A plant in the wind is sheared: its foot stays, and what stands higher moves further sideways, level
//! with the ground. A shear is affine, so it joins a copy's transform and any technique has it for
//! nothing. A technique that moves in a way of its own says so ([`Representation::sways`]) and reads
//! the [`Gust`] of each copy instead.
//!
//! Every copy swings at its own phase, drawn from the wind's seed and the copy's place in its scene.
//!
//! This work is based on:
//! Daniel Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming. 2003 (chapter 20)
//!
//! [`Representation::sways`]: crate::lod::Representation::sways

use std::f64::consts::TAU;

use glam::{DAffine3, DMat3, DVec3};

use crate::error::{LodError, check_in};
use crate::lod::view_blend::level_direction;
use crate::random::{Purpose, Stream};
use crate::view::View;
use crate::view_state::Key;

const PHASE: Purpose = Purpose::named("wind.phase");

/// A steady lean and a swing about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wind {
    /// Metres that the top is moved at all times, a metre of height: in [-1, 1].
    pub lean: f64,
    /// Largest distance from there, a metre of height: in [0, 1].
    pub sway: f64,
    /// Seconds from one swing to the next, in [1e-3, 1e6].
    pub period_secs: f64,
    /// Where it blows to: a horizontal direction, or to the right of the picture.
    pub toward: Option<DVec3>,
    /// Of the phases.
    pub seed: u64,
}

impl Wind {
    /// A wind that blows to an azimuth in degrees: 0 is +z, 90 is +x.
    pub fn direction_of(azimuth_deg: f64) -> DVec3 {
        let angle = azimuth_deg.to_radians();
        DVec3::new(libm::sin(angle), 0.0, libm::cos(angle))
    }

    /// Metres that anything moves at most, a metre above the foot.
    pub fn reach(&self) -> f64 {
        self.lean.abs() + self.sway
    }

    /// Whether every number is in its range.
    ///
    /// # Errors
    /// [`LodError::OutOfRange`] with the first number that is out of its range.
    pub fn check(&self) -> Result<(), LodError> {
        check_in("lean", self.lean, -1.0..=1.0)?;
        check_in("sway", self.sway, 0.0..=1.0)?;
        check_in("period_secs", self.period_secs, 1e-3..=1e6)
    }
}

/// The wind at a placed copy, at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gust {
    /// What blows.
    pub wind: Wind,
    /// When, in seconds.
    pub time_secs: f64,
    /// Which copy.
    pub key: Key,
}

impl Gust {
    /// Where in its swing the copy starts, in [0, 1).
    pub fn phase(&self) -> f64 {
        let (group, copy) = self.key;
        let index = u64::from(group) << 32 | u64::from(copy);
        Stream::new(self.wind.seed, PHASE, index).unit()
    }

    /// Metres that a point moves a metre above the foot.
    pub fn slope(&self) -> f64 {
        self.slope_at(self.phase())
    }

    /// As [`Gust::slope`], for a part of a plant that swings at a phase of its own.
    pub fn slope_at(&self, phase: f64) -> f64 {
        let Wind { lean, sway, period_secs, .. } = self.wind;
        // whole swings first: they would cost digits
        let swings = (self.time_secs / period_secs).fract() + phase;
        lean + sway * libm::sin(TAU * swings)
    }

    /// Unit vector in the world to which a positive slope leans a plant: level, unless it was given.
    pub fn toward(&self, view: &View) -> DVec3 {
        // the picture's right, which is vertical only where its up is level
        self.wind.toward.unwrap_or_else(|| level_direction(view.right, view.up).normalize())
    }

    /// The shear of a placed copy, in its own coordinates: what is at the height of `foot` stays.
    pub fn shear(&self, view: &View, world_from_local: &DAffine3, foot: DVec3) -> DAffine3 {
        self.shear_by(view, world_from_local, foot, self.slope())
    }

    /// As [`Gust::shear`], with another slope: for a part of a plant that moves by itself.
    pub fn shear_by(
        &self,
        view: &View,
        world_from_local: &DAffine3,
        foot: DVec3,
        slope: f64,
    ) -> DAffine3 {
        let across = world_from_local.inverse().transform_vector3(self.toward(view));
        // in the plant's own level, at the length that the world's direction has along it
        let across = DVec3::new(across.x, 0.0, across.z).normalize_or_zero() * slope;
        DAffine3 {
            matrix3: DMat3::from_cols(DVec3::X, DVec3::Y + across, DVec3::Z),
            translation: across * -foot.y,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::Projection;

    fn gust(lean: f64, sway: f64, toward: Option<DVec3>) -> Gust {
        let wind = Wind { lean, sway, period_secs: 4.0, toward, seed: 1 };
        Gust { wind, time_secs: 0.0, key: (0, 0) }
    }

    fn view(eye: DVec3, up: DVec3) -> View {
        let projection = Projection::Perspective { fov_y: 1.0 };
        View::new(eye, DVec3::ZERO, up, projection, (8, 8), 0.1).expect("valid")
    }

    #[test]
    fn the_foot_stays_and_the_top_moves_level() {
        let from_z = view(DVec3::Z * 9.0, DVec3::Y);
        let shear = gust(0.25, 0.0, None).shear(&from_z, &DAffine3::IDENTITY, DVec3::Y * 2.0);
        let moved = |p: DVec3| shear.transform_point3(p);
        assert_eq!(moved(DVec3::new(3.0, 2.0, 5.0)), DVec3::new(3.0, 2.0, 5.0), "at the foot");
        assert_eq!(moved(DVec3::new(3.0, 6.0, 5.0)), DVec3::new(4.0, 6.0, 5.0), "4 m above it");
        let shear = gust(0.25, 0.0, Some(DVec3::Z)).shear(&from_z, &DAffine3::IDENTITY, DVec3::Y);
        assert_eq!(shear.transform_point3(DVec3::Y * 5.0), DVec3::new(0.0, 5.0, 1.0), "away");
    }

    #[test]
    fn turned_and_mirrored_copies_lean_the_same_way() {
        let from_z = view(DVec3::Z * 9.0, DVec3::Y);
        let turns = [
            DAffine3::from_rotation_y(1.0),
            DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)),
            DAffine3::from_scale(DVec3::splat(3.0)) * DAffine3::from_rotation_y(-2.0),
        ];
        for placed in turns {
            let shear = gust(0.5, 0.0, None).shear(&from_z, &placed, DVec3::ZERO);
            let (still, top) = (placed, placed * shear);
            let height = still.transform_point3(DVec3::Y).y;
            let moved = top.transform_point3(DVec3::Y) - still.transform_point3(DVec3::Y);
            assert!(moved.abs_diff_eq(DVec3::X * (0.5 * height), 1e-12), "{placed:?}: {moved}");
        }
    }

    #[test]
    fn a_swing_takes_its_period() {
        let still = gust(0.1, 0.0, None);
        assert_eq!((still.slope(), still.slope_at(0.7)), (0.1, 0.1), "a steady wind");
        let swinging = gust(0.1, 0.2, None);
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
        assert!(near(swinging.slope_at(0.0), 0.1), "in the middle");
        assert!(near(swinging.slope_at(0.25), 0.1 + 0.2), "a quarter on");
        assert!(near(swinging.slope_at(0.75), 0.1 - 0.2), "at the other end");
        let later = Gust { time_secs: 1.0, ..swinging };
        assert!(near(later.slope_at(0.0), 0.3), "a quarter of 4 seconds");
        let much_later = Gust { time_secs: 4e8 + 1.0, ..swinging };
        assert_eq!(much_later.slope_at(0.0), later.slope_at(0.0), "1e8 swings later");
        let before = Gust { time_secs: -1.0, ..swinging };
        assert!(near(before.slope_at(0.0), -0.1), "before the start");
    }

    #[test]
    fn copies_swing_at_phases_of_their_own() {
        let phases: Vec<f64> =
            (0..1000).map(|copy| Gust { key: (0, copy), ..gust(0.0, 1.0, None) }.phase()).collect();
        let mean = phases.iter().sum::<f64>() / 1000.0;
        // a uniform mean of 1000 lies within 5 standard deviations: 5 * sqrt(1 / 12000)
        assert!((mean - 0.5).abs() < 0.046, "{mean}");
        let of = |key: Key, seed: u64| {
            let still = gust(0.0, 1.0, None);
            Gust { key, wind: Wind { seed, ..still.wind }, ..still }.phase()
        };
        assert_eq!(of((0, 3), 1), phases[3], "the same key");
        assert_ne!(of((1, 3), 1), phases[3], "another plant");
        assert_ne!(of((0, 3), 2), phases[3], "another seed");
    }

    #[test]
    fn rolled_and_steep_cameras_have_a_level_right() {
        let lean = gust(1.0, 0.0, None);
        let upright = lean.toward(&view(DVec3::Z * 9.0, DVec3::Y));
        assert_eq!(upright, DVec3::X, "the picture's right");
        let rolled = lean.toward(&view(DVec3::Z * 9.0, DVec3::new(1.0, 1.0, 0.0)));
        assert!(rolled.abs_diff_eq(DVec3::X, 1e-12), "half way round, level still: {rolled}");
        for up in [DVec3::X, DVec3::NEG_X] {
            let on_its_side = lean.toward(&view(DVec3::Z * 9.0, up));
            assert!(on_its_side.y == 0.0 && on_its_side.is_normalized(), "{up}: {on_its_side}");
        }
        let down = lean.toward(&view(DVec3::Y * 9.0, DVec3::NEG_Z));
        assert!(down.abs_diff_eq(DVec3::X, 1e-12), "straight down: {down}");
    }

    #[test]
    fn storms_are_refused() {
        let still = Wind { lean: 0.0, sway: 0.0, period_secs: 1.0, toward: None, seed: 0 };
        still.check().expect("a calm");
        let bad = [
            (Wind { lean: 1.5, ..still }, "lean"),
            (Wind { sway: -0.1, ..still }, "sway"),
            (Wind { sway: f64::NAN, ..still }, "sway"),
            (Wind { period_secs: 0.0, ..still }, "period_secs"),
        ];
        for (wind, name) in bad {
            let message = wind.check().expect_err(name).to_string();
            assert!(message.starts_with(name), "{message}");
        }
    }
}
