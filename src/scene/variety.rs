//! Variety: how copies of one plant differ in size, side and colour.
//!
//! Sizes and mirrored sides are affine and join a copy's transform; colours are multiplied by a tint. A
//! tint cannot turn every hue: it is the one that turns the hue of one stated colour, as HSV counts hues
//! of encoded colours, and pulls all others the same way. Techniques of the same plant get the same
//! tint, since it does not depend on what they have baked.
//!
//! Every copy draws from a stream of its own, keyed by the seed and its place in the scene.
//!
//! This work is based on:
//! Daniel Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming. 2003 (chapter 20)
//! Alvy Ray Smith. Color Gamut Transform Pairs. 1978 (HSV)

use glam::{DAffine3, DVec3, Vec3};

use crate::error::{LodError, check_in};
use crate::random::{Purpose, Stream};
use crate::texture::srgb::{linear_from_srgb, srgb_from_linear};
use crate::view_state::Key;

const COPY: Purpose = Purpose::named("scene.variety");

/// How far copies may differ from their plant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Variety {
    /// Largest change of size, as a share, in [0, 0.9].
    pub size: f64,
    /// Largest turn of the hue in degrees, in [0, 180].
    pub hue_deg: f64,
    /// Largest change of brightness, as a share, in [0, 0.9].
    pub value: f64,
    /// Whether about half of the copies are mirrored, left and right exchanged.
    pub mirror: bool,
    /// The linear colour whose hue is turned; each channel in [0.001, 1].
    pub color: DVec3,
    /// Of all choices.
    pub seed: u64,
}

/// What one copy is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Variant {
    /// Times as large.
    pub scale: f64,
    /// Whether left and right are exchanged.
    pub is_mirrored: bool,
    /// Degrees by which the hue is turned: from red over green to blue.
    pub hue_deg: f64,
    /// Times as bright.
    pub value: f64,
}

impl Variety {
    /// Whether every number is in its range.
    ///
    /// # Errors
    /// [`LodError::OutOfRange`] with the first number that is out of its range.
    pub fn check(&self) -> Result<(), LodError> {
        check_in("size", self.size, 0.0..=0.9)?;
        check_in("hue_deg", self.hue_deg, 0.0..=180.0)?;
        check_in("value", self.value, 0.0..=0.9)?;
        self.color.to_array().into_iter().try_for_each(|c| check_in("color", c, 1e-3..=1.0))
    }

    /// What a copy is like.
    pub fn of(&self, (group, copy): Key) -> Variant {
        let mut stream = Stream::new(self.seed, COPY, u64::from(group) << 32 | u64::from(copy));
        // all four are drawn always, so that one choice does not change another
        let [size, hue, value] = [(); 3].map(|()| stream.signed());
        Variant {
            scale: 1.0 + self.size * size,
            is_mirrored: self.mirror & (stream.unit() < 0.5),
            hue_deg: self.hue_deg * hue,
            value: 1.0 + self.value * value,
        }
    }

    /// What a copy's colours are multiplied by.
    pub fn tint(&self, variant: &Variant) -> Vec3 {
        let turned = if variant.hue_deg == 0.0 {
            DVec3::ONE
        } else {
            let encoded = self.color.to_array().map(srgb_from_linear);
            DVec3::from(turned(encoded, variant.hue_deg).map(linear_from_srgb)) / self.color
        };
        (turned * variant.value).as_vec3()
    }
}

impl Variant {
    /// Its size and side, in the plant's own coordinates; the foot stays.
    pub fn placed(&self, foot: DVec3) -> DAffine3 {
        let across = if self.is_mirrored { -self.scale } else { self.scale };
        let about_zero = DAffine3::from_scale(DVec3::new(across, self.scale, self.scale));
        DAffine3::from_translation(foot) * about_zero * DAffine3::from_translation(-foot)
    }
}

/// A colour with its hue turned by some degrees; value and saturation of HSV stay.
fn turned(color: [f64; 3], degrees: f64) -> [f64; 3] {
    let [r, g, b] = color;
    let (most, least) = (r.max(g).max(b), r.min(g).min(b));
    let chroma = most - least;
    if chroma == 0.0 {
        return color;
    }
    // in sixths of a circle from red
    let hue = if most == r {
        (g - b) / chroma
    } else if most == g {
        2.0 + (b - r) / chroma
    } else {
        4.0 + (r - g) / chroma
    };
    let hue = hue + degrees / 60.0;
    [5.0, 3.0, 1.0].map(|channel| {
        let at = (channel + hue).rem_euclid(6.0);
        most - chroma * at.min(4.0 - at).clamp(0.0, 1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some() -> Variety {
        Variety {
            size: 0.15,
            hue_deg: 20.0,
            value: 0.1,
            mirror: true,
            color: DVec3::new(0.1, 0.2, 0.05),
            seed: 0,
        }
    }

    fn near(a: [f64; 3], b: [f64; 3]) -> bool {
        DVec3::from(a).abs_diff_eq(DVec3::from(b), 1e-12)
    }

    #[test]
    fn hues_are_turned_as_hsv_counts_them() {
        assert!(near(turned([1.0, 0.0, 0.0], 120.0), [0.0, 1.0, 0.0]), "red to green");
        assert!(near(turned([1.0, 0.0, 0.0], -120.0), [0.0, 0.0, 1.0]), "red to blue");
        assert!(near(turned([0.0, 0.5, 0.0], -60.0), [0.5, 0.5, 0.0]), "green to yellow");
        // hue 90 degrees, value 0.8, chroma 0.6: 15 degrees are a quarter of a sixth, 0.15
        assert!(near(turned([0.5, 0.8, 0.2], 15.0), [0.35, 0.8, 0.2]), "towards green");
        assert!(near(turned([0.5, 0.8, 0.2], -15.0), [0.65, 0.8, 0.2]), "towards yellow");
        assert!(near(turned([0.2, 0.5, 0.8], 360.0), [0.2, 0.5, 0.8]), "all the way round");
        assert_eq!(turned([0.3; 3], 77.0), [0.3; 3], "grey has no hue");
    }

    #[test]
    fn the_tint_turns_the_stated_colour() {
        let variety = Variety { color: DVec3::new(0.25, 0.25, 0.125), ..some() };
        let variant = Variant { scale: 1.0, is_mirrored: false, hue_deg: 60.0, value: 1.0 };
        // yellow turned by a sixth is green: red falls to what blue is
        let tint = variety.tint(&variant);
        assert!(tint.abs_diff_eq(Vec3::new(0.5, 1.0, 1.0), 1e-6), "{tint}");
        let bright = variety.tint(&Variant { hue_deg: 0.0, value: 1.25, ..variant });
        assert_eq!(bright, Vec3::splat(1.25), "brightness alone keeps every ratio");
    }

    #[test]
    fn size_and_side_change_about_the_foot() {
        let foot = DVec3::new(2.0, 1.0, 0.0);
        let variant = Variant { scale: 1.5, is_mirrored: true, hue_deg: 0.0, value: 1.0 };
        let placed = variant.placed(foot);
        assert_eq!(placed.transform_point3(foot), foot, "stays");
        let branch = placed.transform_point3(DVec3::new(4.0, 3.0, 2.0));
        assert_eq!(branch, DVec3::new(-1.0, 4.0, 3.0), "2 to the right, 2 up, 2 ahead, times 1.5");
        let plain = Variant { scale: 1.0, is_mirrored: false, ..variant };
        assert_eq!(plain.placed(foot), DAffine3::IDENTITY, "the plant itself");
    }

    #[test]
    fn copies_fill_their_ranges_and_keep_their_choices() {
        let variants: Vec<Variant> = (0..2000).map(|copy| some().of((0, copy))).collect();
        let range = |of: fn(&Variant) -> f64| {
            let values = variants.iter().map(of);
            values.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)))
        };
        let within = |(low, high): (f64, f64), least: f64, most: f64| {
            let width = most - least;
            low >= least && high <= most && low < least + 0.01 * width && high > most - 0.01 * width
        };
        assert!(within(range(|v| v.scale), 0.85, 1.15), "{:?}", range(|v| v.scale));
        assert!(within(range(|v| v.hue_deg), -20.0, 20.0), "{:?}", range(|v| v.hue_deg));
        assert!(within(range(|v| v.value), 0.9, 1.1), "{:?}", range(|v| v.value));
        let mirrored = variants.iter().filter(|v| v.is_mirrored).count();
        // 5 standard deviations of 2000 fair coins are 112
        assert!(mirrored.abs_diff(1000) < 112, "{mirrored}");
        assert_ne!(some().of((1, 0)), variants[0], "another plant");
        assert_ne!(Variety { seed: 1, ..some() }.of((0, 0)), variants[0], "another seed");
        for (copy, variant) in (0..).zip(&variants) {
            let still = Variety { mirror: false, size: 0.0, ..some() }.of((0, copy));
            let expected = Variant { scale: 1.0, is_mirrored: false, ..*variant };
            assert_eq!(still, expected, "without size and side all else is as before");
        }
    }

    #[test]
    fn wild_varieties_are_refused() {
        some().check().expect("mild");
        let bad = [
            (Variety { size: 1.0, ..some() }, "size"),
            (Variety { hue_deg: -1.0, ..some() }, "hue_deg"),
            (Variety { value: f64::NAN, ..some() }, "value"),
            (Variety { color: DVec3::new(0.1, 0.0, 0.1), ..some() }, "color"),
        ];
        for (variety, name) in bad {
            let message = variety.check().expect_err(name).to_string();
            assert!(message.starts_with(name), "{message}");
        }
    }
}
