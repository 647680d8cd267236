//! Shapes of single leaves, as data.

use crate::plant::grow::params::Blade;

/// Five leaflets around the leaf's stalk, joined at their bases: 12 vertices, 10 triangles.
pub(super) const PALMATE: Blade =
    Blade { vertices: &PALMATE_VERTICES, triangles: &PALMATE_TRIANGLES };

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
pub(super) const FOLDED: Blade = Blade {
    vertices: &[[0.0, 0.0, 0.0], [0.3, 0.42, 0.07], [0.0, 1.0, 0.0], [-0.3, 0.42, 0.07]],
    triangles: &[[0, 1, 2], [0, 2, 3]],
};

/// A thin triangle, wider on one side: 3 vertices.
pub(super) const NEEDLE: Blade = Blade {
    vertices: &[[0.0, 0.0, 0.0], [0.07, 0.3, 0.0], [0.0, 1.0, 0.0]],
    triangles: &[[0, 1, 2]],
};

/// A long narrow leaflet, folded along its midrib: 8 vertices, 8 triangles.
pub(super) const LEAFLET: Blade = long_blade(&LEAFLET_VERTICES);
const LEAFLET_VERTICES: [[f64; 3]; 8] = long_vertices(0.03, 0.036, 0.3, 0.7, 0.4);

/// A petal: 8 vertices, 8 triangles.
pub(super) const PETAL: Blade = long_blade(&PETAL_VERTICES);
const PETAL_VERTICES: [[f64; 3]; 8] = long_vertices(0.12, 0.13, 0.3, 0.7, 0.25);

/// A petal with a blunt end.
pub(super) const BLUNT_PETAL: Blade = long_blade(&BLUNT_PETAL_VERTICES);
const BLUNT_PETAL_VERTICES: [[f64; 3]; 8] = long_vertices(0.1, 0.15, 0.4, 0.86, 0.2);

/// A heart.
pub(super) const HEART: Blade = long_blade(&HEART_VERTICES);
const HEART_VERTICES: [[f64; 3]; 8] = long_vertices(0.42, 0.3, 0.12, 0.55, 0.18);

/// A spoon: a narrow stalk that widens towards a round end.
pub(super) const SPOON: Blade = long_blade(&SPOON_VERTICES);
const SPOON_VERTICES: [[f64; 3]; 8] = long_vertices(0.05, 0.22, 0.4, 0.75, 0.25);

const fn long_blade(vertices: &'static [[f64; 3]; 8]) -> Blade {
    Blade { vertices, triangles: &LONG_TRIANGLES }
}

/// Foot, left, middle and right at two places along the midrib, tip. Half widths, then the places,
/// then the slope of the two halves against the midrib.
const fn long_vertices(lower: f64, upper: f64, from: f64, to: f64, fold: f64) -> [[f64; 3]; 8] {
    [
        [0.0, 0.0, 0.0],
        [-lower, from, lower * fold],
        [0.0, from, 0.0],
        [lower, from, lower * fold],
        [-upper, to, upper * fold],
        [0.0, to, 0.0],
        [upper, to, upper * fold],
        [0.0, 1.0, 0.0],
    ]
}

const LONG_TRIANGLES: [[u8; 3]; 8] =
    [[0, 3, 2], [0, 2, 1], [2, 3, 6], [2, 6, 5], [1, 2, 5], [1, 5, 4], [5, 6, 7], [4, 5, 7]];
