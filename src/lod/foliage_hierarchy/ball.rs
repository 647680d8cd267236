//! The ball around a node and all below it, as drawn.
//!
//! It holds its children's balls and its own corners, with f32 rounding on the outside. It need not
//! be the smallest.

use glam::DVec3;

use crate::lod::foliage_hierarchy::forest::{Forest, Sphere};

/// By how much a radius grows so that rounding to f32 leaves nothing outside.
const ROUNDING: f64 = 1.0 + 1e-6;

/// A ball around a node whose children have theirs.
pub fn node_ball(forest: &Forest, node: u32) -> Sphere {
    let corners = forest.drawn_quad(node);
    let record = &forest.nodes[node as usize];
    let (center, radius) = if record.is_leaf() {
        let center = corners.iter().sum::<DVec3>() / 4.0;
        (center, 0.0)
    } else {
        let [a, b] = record.children.map(|child| forest.spheres[child as usize]);
        union([a, b].map(|ball| (ball.center.as_dvec3(), f64::from(ball.radius))))
    };
    let (center, _) = corners.iter().fold((center, radius), |ball, &p| with_point(ball, p));
    // from the rounded centre, so that everything is inside
    let rounded = center.as_vec3();
    let center = rounded.as_dvec3();
    let mut radius = corners.iter().map(|corner| corner.distance(center)).fold(0.0, f64::max);
    if !record.is_leaf() {
        for child in record.children {
            let ball = forest.spheres[child as usize];
            let reach = ball.center.as_dvec3().distance(center) + f64::from(ball.radius);
            radius = radius.max(reach);
        }
    }
    #[expect(clippy::cast_possible_truncation, reason = "rounded outwards")]
    Sphere { center: rounded, radius: (radius * ROUNDING) as f32 }
}

/// The smallest ball around two.
fn union([a, b]: [(DVec3, f64); 2]) -> (DVec3, f64) {
    let distance = a.0.distance(b.0);
    if distance + b.1 <= a.1 {
        return a;
    }
    if distance + a.1 <= b.1 {
        return b;
    }
    let radius = (distance + a.1 + b.1) * 0.5;
    (a.0 + (b.0 - a.0) * ((radius - a.1) / distance), radius)
}

/// The smallest ball around one and a point.
fn with_point(ball: (DVec3, f64), point: DVec3) -> (DVec3, f64) {
    union([ball, (point, 0.0)])
}
