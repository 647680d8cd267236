//! The species that can be grown, as data.
//!
//! Sizes are those of the plants measured by Garcia, Sbert and Szirmay-Kalos (2005; a chestnut) and
//! by Remolar et al. (2003; a tree of quad leaves), so that results can be set beside theirs.

use crate::plant::grow::params::{Bark, Blade, Crown, Leaves, Level, Species, Trunk, vary};

/// Every species, in the order in which messages list them.
pub(super) const PRESETS: &[&Species] = &[&CHESTNUT, &BROADLEAF];

/// Five leaflets around the leaf's stalk, joined at their bases: 12 vertices, 10 triangles.
const PALMATE: Blade = Blade { vertices: &PALMATE_VERTICES, triangles: &PALMATE_TRIANGLES };

/// The hub, the five tips, and the six hollows beside and between the leaflets.
const PALMATE_VERTICES: [[f64; 3]; 12] = [
    [0.0, 0.0, 0.0],
    [-0.634, -0.182, 0.0],
    [-0.719, 0.542, 0.0],
    [0.000, 1.000, 0.0],
    [0.719, 0.542, 0.0],
    [0.634, -0.182, 0.0],
    [-0.222, -0.186, 0.07],
    [-0.374, 0.066, 0.07],
    [-0.201, 0.403, 0.07],
    [0.201, 0.403, 0.07],
    [0.374, 0.066, 0.07],
    [0.222, -0.186, 0.07],
];

const PALMATE_TRIANGLES: [[u8; 3]; 10] = [
    [0, 1, 6],
    [0, 7, 1],
    [0, 2, 7],
    [0, 8, 2],
    [0, 3, 8],
    [0, 9, 3],
    [0, 4, 9],
    [0, 10, 4],
    [0, 5, 10],
    [0, 11, 5],
];

/// A quad folded along its midrib: 4 vertices, 2 triangles.
const FOLDED: Blade = Blade {
    vertices: &[[0.0, 0.0, 0.0], [0.3, 0.42, 0.07], [0.0, 1.0, 0.0], [-0.3, 0.42, 0.07]],
    triangles: &[[0, 1, 2], [0, 2, 3]],
};

/// What a level has unless its species says otherwise.
const LEVEL: Level = Level {
    length: vary(1.0, 0.0),
    radius_power: 1.3,
    taper: 0.95,
    segment_length: 0.5,
    max_segments: 8,
    sides: 6,
    spacing: 0.3,
    bare: 0.1,
    down: (60.0, 40.0),
    down_spread: 8.0,
    around: vary(137.5, 20.0),
    curve: (0.0, 0.0),
    curve_spread: 10.0,
    upward: (0.0, 0.0),
    forks: 0.0,
    forks_from: 0.3,
    fork_angle: vary(45.0, 10.0),
};

/// A horse chestnut, 16 m: a short bole, arching limbs whose ends turn up, a high dome.
const CHESTNUT: Species = Species {
    name: "chestnut",
    trunk: Trunk { height: vary(15.8, 0.5), radius: 0.024, flare: 0.5, lobes: (6.0, 0.1) },
    crown: Crown { radius: 0.39, widest: 0.62, ends: (0.3, 0.72) },
    levels: &[
        Level {
            segment_length: 0.7,
            max_segments: 22,
            sides: 18,
            taper: 0.97,
            curve_spread: 16.0,
            upward: (4.0, 12.0),
            forks: 2.6,
            forks_from: 0.24,
            fork_angle: vary(44.0, 8.0),
            ..LEVEL
        },
        Level {
            length: vary(0.54, 0.06),
            radius_power: 1.25,
            segment_length: 0.55,
            max_segments: 11,
            sides: 8,
            spacing: 0.27,
            bare: 0.18,
            down: (80.0, 34.0),
            around: vary(137.5, 20.0),
            curve: (12.0, -26.0),
            curve_spread: 26.0,
            upward: (-8.0, 24.0),
            forks: 0.5,
            forks_from: 0.3,
            fork_angle: vary(48.0, 10.0),
            ..LEVEL
        },
        Level {
            length: vary(0.4, 0.1),
            radius_power: 1.2,
            segment_length: 0.45,
            max_segments: 4,
            sides: 4,
            spacing: 0.36,
            bare: 0.16,
            down: (62.0, 42.0),
            down_spread: 12.0,
            around: vary(180.0, 55.0),
            curve: (8.0, -20.0),
            curve_spread: 30.0,
            upward: (-10.0, 22.0),
            ..LEVEL
        },
        Level {
            length: vary(0.42, 0.1),
            radius_power: 1.0,
            taper: 0.6,
            segment_length: 0.3,
            max_segments: 2,
            sides: 3,
            spacing: 0.3,
            bare: 0.2,
            down: (58.0, 40.0),
            down_spread: 14.0,
            around: vary(180.0, 60.0),
            curve_spread: 24.0,
            upward: (0.0, 20.0),
            ..LEVEL
        },
    ],
    wood_triangle_count: 46_174,
    bark: Bark { old: [0.16, 0.125, 0.093], young: [0.13, 0.11, 0.055], spread: 0.2 },
    leaves: Leaves {
        count: 11_291,
        blade: PALMATE,
        length: vary(0.26, 0.05),
        bare: 0.3,
        end: 0.35,
        whorl: 2,
        down: (75.0, 50.0),
        down_spread: 18.0,
        around: vary(90.0, 25.0),
        droop: vary(0.5, 0.35),
        facing: (0.8, 0.55, 0.45),
        curl: vary(0.22, 0.1),
        color: [0.105, 0.245, 0.038],
        other_color: [0.2, 0.3, 0.05],
        spread: 0.18,
        inner: 0.5,
    },
};

/// A lime-like tree, 12 m: many fine limbs that rise steeply, an egg-shaped crown.
const BROADLEAF: Species = Species {
    name: "broadleaf",
    trunk: Trunk { height: vary(12.2, 0.4), radius: 0.02, flare: 0.45, lobes: (5.0, 0.08) },
    crown: Crown { radius: 0.335, widest: 0.66, ends: (0.25, 0.6) },
    levels: &[
        Level {
            segment_length: 0.6,
            max_segments: 20,
            sides: 16,
            taper: 0.98,
            curve_spread: 14.0,
            upward: (6.0, 12.0),
            forks: 1.6,
            forks_from: 0.25,
            fork_angle: vary(34.0, 8.0),
            ..LEVEL
        },
        Level {
            length: vary(0.5, 0.06),
            radius_power: 1.3,
            segment_length: 0.5,
            max_segments: 9,
            sides: 7,
            spacing: 0.19,
            bare: 0.17,
            down: (70.0, 32.0),
            around: vary(137.5, 20.0),
            curve: (0.0, -18.0),
            curve_spread: 28.0,
            upward: (4.0, 14.0),
            forks: 0.35,
            forks_from: 0.35,
            fork_angle: vary(42.0, 10.0),
            ..LEVEL
        },
        Level {
            length: vary(0.38, 0.1),
            radius_power: 1.2,
            segment_length: 0.4,
            max_segments: 4,
            sides: 4,
            spacing: 0.26,
            bare: 0.14,
            down: (58.0, 38.0),
            down_spread: 12.0,
            around: vary(180.0, 50.0),
            curve_spread: 30.0,
            upward: (-4.0, 10.0),
            ..LEVEL
        },
        Level {
            length: vary(0.42, 0.1),
            radius_power: 1.0,
            taper: 0.6,
            segment_length: 0.3,
            max_segments: 2,
            sides: 3,
            spacing: 0.17,
            bare: 0.15,
            down: (55.0, 38.0),
            down_spread: 14.0,
            around: vary(180.0, 60.0),
            curve_spread: 26.0,
            upward: (-10.0, -10.0),
            ..LEVEL
        },
    ],
    wood_triangle_count: 47_691,
    bark: Bark { old: [0.145, 0.125, 0.105], young: [0.11, 0.085, 0.05], spread: 0.18 },
    leaves: Leaves {
        count: 20_376,
        blade: FOLDED,
        length: vary(0.19, 0.04),
        bare: 0.15,
        end: 0.4,
        whorl: 1,
        down: (68.0, 30.0),
        down_spread: 18.0,
        around: vary(180.0, 40.0),
        droop: vary(0.35, 0.35),
        facing: (0.8, 0.45, 0.6),
        curl: vary(0.12, 0.12),
        color: [0.125, 0.275, 0.042],
        other_color: [0.23, 0.34, 0.06],
        spread: 0.2,
        inner: 0.5,
    },
};
