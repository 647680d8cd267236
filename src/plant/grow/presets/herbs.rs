//! Flowers and grass.

use crate::plant::grow::grass::Tuft;
use crate::plant::grow::herb::{Head, Herb, Leaves, Stems};
use crate::plant::grow::params::vary;
use crate::plant::grow::presets::blades::{BLUNT_PETAL, FOLDED, HEART, PETAL, SPOON};

/// A sunflower, 1.7 m, whose head looks aside.
pub(in crate::plant::grow) const SUNFLOWER: Herb = Herb {
    name: "sunflower",
    stems: Stems {
        count: 1,
        height: vary(1.75, 0.12),
        radius: 0.017,
        lean: vary(2.0, 2.0),
        nod: vary(64.0, 10.0),
        nod_from: 0.87,
        segments: 18,
        sides: 8,
    },
    leaves: Leaves {
        count: 17,
        blade: HEART,
        length: (0.34, 0.17),
        stalk: 0.5,
        along: (0.2, 0.86),
        lift: (-26.0, 14.0),
        curl: vary(0.12, 0.1),
        color: [0.1, 0.23, 0.04],
    },
    head: Head {
        radius: 0.1,
        dome: 0.22,
        depth: 0.4,
        floret_count: 500,
        floret: FOLDED,
        disc: ([0.09, 0.055, 0.02], [0.17, 0.075, 0.018]),
        ray_count: 38,
        ray: PETAL,
        ray_length: vary(0.12, 0.014),
        ray_lift: vary(12.0, 9.0),
        ray_curl: vary(0.08, 0.15),
        ray_color: [0.83, 0.5, 0.02],
        bract_count: 26,
        bract: FOLDED,
    },
    green: [0.12, 0.22, 0.05],
};

/// A daisy, 30 cm: white flowers with yellow discs above a rosette of spoon-shaped leaves.
pub(in crate::plant::grow) const DAISY: Herb = Herb {
    name: "daisy",
    stems: Stems {
        count: 11,
        height: vary(0.25, 0.05),
        radius: 0.0016,
        lean: vary(30.0, 8.0),
        nod: vary(26.0, 16.0),
        nod_from: 0.5,
        segments: 8,
        sides: 5,
    },
    leaves: Leaves {
        count: 30,
        blade: SPOON,
        length: (0.07, 0.05),
        stalk: 0.0,
        along: (0.0, 0.0),
        lift: (16.0, 58.0),
        curl: vary(0.12, 0.1),
        color: [0.09, 0.2, 0.04],
    },
    head: Head {
        radius: 0.0085,
        dome: 0.45,
        depth: 0.5,
        floret_count: 90,
        floret: FOLDED,
        disc: ([0.75, 0.47, 0.02], [0.83, 0.55, 0.03]),
        ray_count: 26,
        ray: BLUNT_PETAL,
        ray_length: vary(0.0175, 0.0018),
        ray_lift: vary(6.0, 7.0),
        ray_curl: vary(0.1, 0.12),
        ray_color: [0.9, 0.9, 0.87],
        bract_count: 12,
        bract: FOLDED,
    },
    green: [0.12, 0.23, 0.06],
};

/// A tuft of grass, 40 cm.
pub(in crate::plant::grow) const GRASS: Tuft = Tuft {
    name: "grass",
    blade_count: 450,
    radius: 0.06,
    length: vary(0.42, 0.14),
    width: 0.0055,
    lean: 26.0,
    bend: vary(105.0, 60.0),
    color: [0.1, 0.24, 0.035],
    other_color: [0.2, 0.34, 0.06],
    dry: ([0.42, 0.36, 0.14], 0.07),
};
