//! A conifer.

use crate::plant::grow::params::{
    Bark, Crown, Leaves, Level, Outline, Species, Trunk, Twigs, vary,
};
use crate::plant::grow::presets::LEVEL;
use crate::plant::grow::presets::blades::NEEDLE;

/// A young pine, 7 m: a straight trunk, limbs in whorls, a cone of shoots full of needles.
///
/// A needle is longer and wider than a real one and stands for a bundle of them.
pub(in crate::plant::grow) const PINE: Species = Species {
    name: "pine",
    trunk: Trunk { height: vary(7.0, 0.3), radius: 0.016, flare: 0.3, lobes: (5.0, 0.04) },
    crown: Crown { outline: Outline::Cone, radius: 0.3, widest: 0.86, ends: (0.06, 0.7) },
    levels: &[
        Level {
            segment_length: 0.4,
            max_segments: 16,
            sides: 12,
            taper: 0.97,
            curve_spread: 4.0,
            upward: (10.0, 10.0),
            ..LEVEL
        },
        Level {
            length: vary(0.31, 0.03),
            radius_power: 1.35,
            segment_length: 0.3,
            max_segments: 7,
            sides: 5,
            spacing: 0.075,
            jitter: 0.03,
            whorl: 5,
            bare: 0.1,
            down: (92.0, 44.0),
            down_spread: 6.0,
            around: vary(36.0, 12.0),
            curve: (8.0, -20.0),
            curve_spread: 12.0,
            upward: (-6.0, 26.0),
            ..LEVEL
        },
        Level {
            length: vary(0.42, 0.06),
            radius_power: 1.2,
            taper: 0.7,
            segment_length: 0.16,
            max_segments: 3,
            sides: 3,
            spacing: 0.1,
            bare: 0.12,
            down: (58.0, 44.0),
            down_spread: 8.0,
            around: vary(180.0, 40.0),
            curve_spread: 16.0,
            upward: (4.0, 18.0),
            ..LEVEL
        },
        Level {
            length: vary(0.45, 0.1),
            radius_power: 1.0,
            taper: 0.5,
            segment_length: 0.12,
            max_segments: 2,
            sides: 3,
            spacing: 0.12,
            bare: 0.1,
            down: (50.0, 40.0),
            down_spread: 10.0,
            around: vary(180.0, 60.0),
            curve_spread: 16.0,
            upward: (10.0, 20.0),
            ..LEVEL
        },
    ],
    stem_triangle_count: 36_000,
    twigs: Twigs::Wood,
    bark: Bark { old: [0.2, 0.115, 0.065], young: [0.16, 0.1, 0.045], spread: 0.22 },
    leaves: Leaves {
        count: 80_000,
        blade: NEEDLE,
        length: vary(0.125, 0.02),
        ends: (1.0, 1.0),
        bare: 0.05,
        end: 0.3,
        whorl: 4,
        down: (62.0, 34.0),
        down_spread: 12.0,
        first: None,
        around: vary(50.0, 20.0),
        droop: vary(0.05, 0.1),
        facing: (0.3, 0.4, 0.9),
        curl: vary(0.05, 0.05),
        color: [0.06, 0.15, 0.055],
        other_color: [0.11, 0.21, 0.06],
        spread: 0.2,
        inner: 0.6,
    },
};
