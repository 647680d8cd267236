//! A palm.

use crate::plant::grow::params::{
    Bark, Crown, Leaves, Level, Outline, Species, Trunk, Twigs, down_from, vary,
};
use crate::plant::grow::presets::LEVEL;
use crate::plant::grow::presets::blades::LEAFLET;

/// Share of the trunk below the fronds.
const BARE: f64 = 0.955;

/// A feather palm, 8 m: a bare, slightly bent trunk under a crown of arching fronds, young ones
/// upright in the middle, old ones hanging; each frond is a midrib with two rows of leaflets.
pub(in crate::plant::grow) const PALM: Species = Species {
    name: "palm",
    trunk: Trunk { height: vary(6.2, 0.3), radius: 0.021, flare: 0.5, lobes: (7.0, 0.03) },
    crown: Crown { outline: Outline::Free, radius: 0.5, widest: 0.5, ends: (1.0, 1.0) },
    levels: &[
        Level {
            segment_length: 0.2,
            max_segments: 26,
            sides: 12,
            taper: 0.3,
            curve_spread: 10.0,
            ..LEVEL
        },
        Level {
            length: vary(0.48, 0.04),
            radius_power: 2.6,
            taper: 0.9,
            segment_length: 0.2,
            max_segments: 10,
            sides: 4,
            spacing: 0.01,
            bare: BARE,
            down: down_from(BARE, 112.0, 12.0),
            down_spread: 6.0,
            around: vary(137.5, 8.0),
            curve: (0.0, 0.0),
            curve_spread: 8.0,
            upward: (-34.0, -58.0),
            ..LEVEL
        },
    ],
    stem_triangle_count: 3_012,
    twigs: Twigs::Wood,
    bark: Bark { old: [0.24, 0.2, 0.15], young: [0.2, 0.24, 0.07], spread: 0.16 },
    leaves: Leaves {
        count: 2_520,
        blade: LEAFLET,
        length: vary(0.62, 0.05),
        ends: (0.45, 0.35),
        bare: 0.14,
        end: 0.0,
        whorl: 2,
        down: (72.0, 32.0),
        down_spread: 4.0,
        first: Some(0.0),
        around: vary(0.0, 5.0),
        droop: vary(0.35, 0.15),
        facing: (1.0, 0.0, 0.08),
        curl: vary(0.22, 0.1),
        color: [0.12, 0.25, 0.05],
        other_color: [0.26, 0.33, 0.07],
        spread: 0.14,
        inner: 0.75,
    },
};
