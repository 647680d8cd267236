//! How unlike two leaves are: what it costs to collapse them into one.
//!
//! `cost = (d / d_ref)^2 + weight |n_i x n_j|^2`: `d` the distance between the leaves, `d_ref` the side
//! of a square of the mean leaf's area, `n` their unit normals. The paper names the two terms, distance
//! and planarity; their form is ours, because the formula of 2002 is lost. All in f64, and the same
//! for both orders of a pair.

use glam::DVec3;

use crate::lod::foliage_hierarchy::quad::measure;

/// Between which points of two leaves the distance is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Distance {
    /// Their centres.
    Centre,
    /// The vertex that is farthest from the other leaf's quad, both ways.
    Hausdorff,
}

/// What the cost of a pair is computed from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CostRule {
    /// Kind of distance.
    pub distance: Distance,
    /// Of the planarity term.
    pub weight: f64,
    /// Metres.
    pub d_ref: f64,
}

/// A leaf or a collapsed one, as the cost sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CostLeaf {
    /// Centroid.
    pub center: DVec3,
    /// Unit, or zero.
    pub normal: DVec3,
    /// Largest distance of a corner from the centre.
    pub radius: f64,
}

impl CostLeaf {
    /// Measures a quad.
    pub fn new(quad: &[DVec3; 4]) -> Self {
        let measures = measure(quad);
        let center = measures.center;
        let radius = quad.iter().map(|corner| corner.distance(center)).fold(0.0, f64::max);
        Self { center, normal: measures.normal, radius }
    }
}

impl CostRule {
    /// Cost of a pair, at least 0. The quads are asked for only where the distance needs them.
    #[inline]
    pub fn cost(&self, a: &CostLeaf, b: &CostLeaf, quads: impl FnOnce() -> [[DVec3; 4]; 2]) -> f64 {
        let d_sq = match self.distance {
            Distance::Centre => a.center.distance_squared(b.center),
            Distance::Hausdorff => {
                let [a, b] = quads();
                hausdorff_sq(&a, &b)
            }
        };
        self.of_distance(d_sq) + self.weight * a.normal.cross(b.normal).length_squared()
    }

    /// The distance term; it never falls as the distance grows, in rounded arithmetic too.
    #[inline]
    pub fn of_distance(&self, d_sq: f64) -> f64 {
        d_sq / (self.d_ref * self.d_ref)
    }
}

/// Largest squared distance of a corner of either quad from the other.
fn hausdorff_sq(a: &[DVec3; 4], b: &[DVec3; 4]) -> f64 {
    let one_way = |from: &[DVec3; 4], to: &[DVec3; 4]| {
        from.iter().map(|&corner| quad_distance_sq(corner, to)).fold(0.0, f64::max)
    };
    one_way(a, b).max(one_way(b, a))
}

fn quad_distance_sq(point: DVec3, quad: &[DVec3; 4]) -> f64 {
    let [a, b, c, d] = *quad;
    triangle_distance_sq(point, a, b, c).min(triangle_distance_sq(point, a, c, d))
}

/// Squared distance of a point from a triangle, which may be a line or a point.
fn triangle_distance_sq(point: DVec3, a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let edges = segment_distance_sq(point, a, b)
        .min(segment_distance_sq(point, b, c))
        .min(segment_distance_sq(point, c, a));
    let across = (b - a).cross(c - a);
    let length_sq = across.length_squared();
    if length_sq == 0.0 {
        return edges;
    }
    // over the inside it is the distance from the plane
    let inside = |from: DVec3, to: DVec3| across.dot((to - from).cross(point - from)) >= 0.0;
    if inside(a, b) && inside(b, c) && inside(c, a) {
        let height = across.dot(point - a);
        return (height * height / length_sq).min(edges);
    }
    edges
}

fn segment_distance_sq(point: DVec3, a: DVec3, b: DVec3) -> f64 {
    let along = b - a;
    let length_sq = along.length_squared();
    let share = if length_sq > 0.0 { (point - a).dot(along) / length_sq } else { 0.0 };
    point.distance_squared(a + along * share.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of side 2 around a centre, in the plane of two axes.
    fn square(center: DVec3, x: DVec3, y: DVec3) -> [DVec3; 4] {
        [-x - y, x - y, x + y, y - x].map(|corner| center + corner)
    }

    fn cost(rule: CostRule, a: &[DVec3; 4], b: &[DVec3; 4]) -> f64 {
        rule.cost(&CostLeaf::new(a), &CostLeaf::new(b), || [*a, *b])
    }

    const RULE: CostRule = CostRule { distance: Distance::Centre, weight: 1.0, d_ref: 2.0 };

    #[test]
    fn distance_and_planarity_add_up() {
        let flat = square(DVec3::ZERO, DVec3::X, DVec3::Y);
        let beside = square(DVec3::new(0.0, 0.0, 4.0), DVec3::X, DVec3::Y);
        assert_eq!(cost(RULE, &flat, &beside), 4.0, "(4 / 2)^2, parallel");
        let across = square(DVec3::ZERO, DVec3::Y, DVec3::Z);
        assert_eq!(cost(RULE, &flat, &across), 1.0, "at right angles");
        assert_eq!(cost(CostRule { weight: 3.0, ..RULE }, &flat, &across), 3.0, "weighted");
        let turned = square(DVec3::new(0.0, 0.0, 4.0), DVec3::Y, DVec3::X);
        assert_eq!(cost(RULE, &flat, &turned), 4.0, "the sign of a normal does not matter");
        let line = [DVec3::ZERO, DVec3::X, DVec3::X * 2.0, DVec3::X * 3.0];
        let CostLeaf { center, normal, .. } = CostLeaf::new(&line);
        assert_eq!(normal, DVec3::ZERO, "no area");
        assert_eq!(cost(RULE, &line, &square(center, DVec3::X, DVec3::Z)), 0.0, "no planarity");
    }

    #[test]
    fn hausdorff_is_the_farthest_corner() {
        let rule = CostRule { distance: Distance::Hausdorff, weight: 0.0, d_ref: 1.0 };
        let flat = square(DVec3::ZERO, DVec3::X, DVec3::Y);
        let raised = square(DVec3::new(0.0, 0.0, 3.0), DVec3::X, DVec3::Y);
        assert_eq!(cost(rule, &flat, &raised), 9.0, "every corner lies 3 above");
        let small = square(DVec3::ZERO, DVec3::X * 0.5, DVec3::Y * 0.5);
        // from the corner (1, 1) to (0.5, 0.5); the small one lies inside
        assert_eq!(cost(rule, &flat, &small), 0.5, "the large one's corners");
        assert_eq!(cost(rule, &small, &flat), 0.5, "both ways");
        let aside = square(DVec3::new(5.0, 0.0, 0.0), DVec3::X, DVec3::Y);
        assert_eq!(cost(rule, &flat, &aside), 25.0, "from x = -1 to x = 4");
        assert_eq!(cost(rule, &flat, &flat), 0.0, "itself");
        let point = [DVec3::new(1.0, 1.0, 2.0); 4];
        assert_eq!(cost(rule, &point, &flat), 12.0, "from (-1, -1, 0): 4 + 4 + 4");
    }
}
