//! The card that stands for a cluster of leaves: where it lies, how large it is, what it shows.
//!
//! The card lies in the cluster's plane and is the rectangle of least area around its leaves as seen
//! along the plane's normal, its up the side that leans most towards the world's. It may be cut to a
//! convex outline of few corners around the leaves, which draws fewer empty texels.

use std::borrow::Cow;

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use crate::bake::BakeRect;
use crate::lod::leaf_clusters::hierarchy::Level;
use crate::lod::leaf_clusters::plane::Plane;
use crate::lod::leaves::{FLAT, LEAST_SIZE, Leaves, Placed};
use crate::plant::rectangle::{Rectangle2, convex_hull, min_area_rectangle};

/// How leaves get into their cluster's plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flatten {
    /// Along the plane's normal: a leaf that leans shrinks.
    Project,
    /// Turned about its centre until it is parallel to the plane, which keeps its area.
    Rotate,
}

/// How much of its rectangle a card keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outline {
    /// All of it.
    Rectangle,
    /// A convex polygon around the leaves.
    Hull {
        /// Corners at most, where so few can enclose the leaves inside the rectangle.
        max_corner_count: usize,
    },
}

/// A cluster's card.
#[derive(Debug, Clone)]
pub(super) struct Impostor {
    /// The cluster's, with its normal upwards, or as it is where it is level.
    pub(super) plane: Plane,
    /// Mean of the cluster's leaf centres, relative to the plant's origin.
    pub(super) mean: DVec3,
    /// Seen from the side that the plane's normal points to.
    pub(super) rect: BakeRect,
    /// Corners, counter-clockwise as seen from there: shares of the rectangle's width and height,
    /// from its upper left.
    pub(super) outline: Vec<DVec2>,
    pub(super) leaves: Vec<Placed>,
    /// Sum over the leaves' vertices of the squared distance from the plane.
    pub(super) deviation_sq: f64,
    pub(super) vertex_count: usize,
}

impl Impostor {
    /// A point of the card, as shares of the rectangle from its upper left.
    pub(super) fn point(&self, at: DVec2) -> DVec3 {
        let BakeRect { center, right, up, width, height, .. } = self.rect;
        center + right * ((at.x - 0.5) * width) + up * ((0.5 - at.y) * height)
    }

    /// The rectangle as seen from behind.
    pub(super) fn back(&self) -> BakeRect {
        BakeRect { right: -self.rect.right, ..self.rect }
    }
}

/// The leaves as they are baked into a level's cards.
pub(super) fn flattened<'a, 'b>(
    leaves: &'b Leaves<'a>,
    level: &Level,
    flatten: Flatten,
) -> Cow<'b, Leaves<'a>> {
    if flatten == Flatten::Project {
        return Cow::Borrowed(leaves);
    }
    let normals = &leaves.plant.foliage.normals;
    Cow::Owned(leaves.turned(|leaf| {
        let plane = &level.planes[level.cluster_ids[leaf] as usize];
        turn_into(normals[leaf].as_dvec3(), plane.normal)
    }))
}

/// The least turn that makes a direction parallel to a unit vector; none for a direction of 0.
fn turn_into(from: DVec3, to: DVec3) -> DMat3 {
    let from = from.normalize_or_zero();
    let from = if from.dot(to) < 0.0 { -from } else { from };
    let cosine = from.dot(to);
    if from == DVec3::ZERO {
        return DMat3::IDENTITY;
    }
    // Rodrigues, with (1 - cos) / sin^2 = 1 / (1 + cos), and cos is not negative
    let axis = from.cross(to);
    let cross = DMat3::from_cols(
        DVec3::new(0.0, axis.z, -axis.y),
        DVec3::new(-axis.z, 0.0, axis.x),
        DVec3::new(axis.y, -axis.x, 0.0),
    );
    DMat3::IDENTITY + cross + cross * cross * (1.0 / (1.0 + cosine))
}

/// The cards of a level, from leaves as they grow and as they are baked.
pub(super) fn impostors(
    leaves: &Leaves<'_>,
    flat: &Leaves<'_>,
    level: &Level,
    outline: Outline,
) -> Vec<Impostor> {
    let mut members: Vec<Vec<Placed>> = vec![Vec::new(); level.planes.len()];
    for (leaf, &id) in level.cluster_ids.iter().enumerate() {
        members[id as usize].push(Placed { leaf, cut: false });
    }
    members
        .into_par_iter()
        .zip(&level.planes)
        .zip(&level.moments)
        .map(|((members, &plane), moments)| {
            let (deviation_sq, vertex_count) = deviation(leaves, &members, &plane);
            let card = impostor(flat, members, plane, moments.mean, outline);
            Impostor { deviation_sq, vertex_count, ..card }
        })
        .collect()
}

/// Sum of squared distances of leaves' vertices from a plane, and how many those are.
fn deviation(leaves: &Leaves<'_>, members: &[Placed], plane: &Plane) -> (f64, usize) {
    let vertices = members.iter().flat_map(|placed| leaves.vertices_of(placed.leaf));
    vertices.fold((0.0, 0), |(sum, count), vertex| {
        let distance = plane.distance(vertex + leaves.center);
        (sum + distance * distance, count + 1)
    })
}

fn impostor(
    leaves: &Leaves<'_>,
    members: Vec<Placed>,
    plane: Plane,
    mean: DVec3,
    outline: Outline,
) -> Impostor {
    // leaves are mostly seen from where light comes from, which matters where that side alone is baked
    let plane =
        if plane.normal.y < 0.0 { Plane { normal: -plane.normal, d: -plane.d } } else { plane };
    let normal = plane.normal;
    // the card's coordinates count from a point of the plane near its leaves
    let start = mean - normal * plane.distance(mean);
    let across = normal.any_orthonormal_vector();
    let along = normal.cross(across);
    let mut points = Vec::new();
    let mut reach = 0.0_f64;
    for placed in &members {
        for vertex in leaves.vertices_of(placed.leaf) {
            let from = vertex + leaves.center - start;
            points.push(DVec2::new(from.dot(across), from.dot(along)));
            reach = reach.max(from.dot(normal).abs());
        }
    }
    let found = min_area_rectangle(&points).expect("a cluster has a leaf, and a leaf has vertices");
    // leaves in a line or in a point still need a card
    let least = (leaves.radius * FLAT).max(LEAST_SIZE * FLAT);
    let in_space = |v: DVec2| across * v.x + along * v.y;
    let (right, up, half) = upright(&found, normal, in_space);
    let half = half.max(DVec2::splat(least));
    let rect = BakeRect {
        center: start + in_space(found.center),
        right,
        up,
        width: 2.0 * half.x,
        height: 2.0 * half.y,
        reach: reach.max(least),
    };
    let corners = match outline {
        Outline::Rectangle => RECTANGLE.to_vec(),
        Outline::Hull { max_corner_count } => {
            let [x, y] = [right, up].map(|axis| DVec2::new(axis.dot(across), axis.dot(along)));
            let share = |p: &DVec2| {
                let from = *p - found.center;
                DVec2::new(0.5 + from.dot(x) / rect.width, 0.5 - from.dot(y) / rect.height)
            };
            let shares: Vec<DVec2> = points.iter().map(share).collect();
            convex_outline(&shares, max_corner_count)
        }
    };
    let outline = corners;
    let (deviation_sq, vertex_count) = (0.0, 0);
    Impostor { plane, mean, rect, outline, leaves: members, deviation_sq, vertex_count }
}

/// Corners of a whole card: counter-clockwise as seen, from the lower left; y points down.
const RECTANGLE: [DVec2; 4] =
    [DVec2::new(0.0, 1.0), DVec2::new(1.0, 1.0), DVec2::new(1.0, 0.0), DVec2::new(0.0, 0.0)];

/// Right, up and half the sides of a rectangle, turned by quarters until up leans most towards the
/// world's up; of equals, and in level planes, towards -z.
fn upright(
    found: &Rectangle2,
    normal: DVec3,
    in_space: impl Fn(DVec2) -> DVec3,
) -> (DVec3, DVec3, DVec2) {
    let (axis, across) = (in_space(found.axis), in_space(found.across()));
    let half = found.half;
    let turned = [
        (axis, half.y, half.x),
        (across, half.x, half.y),
        (-axis, half.y, half.x),
        (-across, half.x, half.y),
    ];
    let lean = |up: DVec3| up.y - up.z * 1e-6;
    let mut best = turned[0];
    for candidate in turned {
        if lean(candidate.0) > lean(best.0) + 1e-9 {
            best = candidate;
        }
    }
    let (up, half_width, half_height) = best;
    (up.cross(normal), up, DVec2::new(half_width, half_height))
}

/// A convex polygon of few corners inside the unit square around points of it, running as
/// [`RECTANGLE`] does.
///
/// The square is cut along edges of the points' hull, each time along the one that leaves least area
/// with no more corners than there may be, until no cut gains. Of equals the earliest edge.
fn convex_outline(points: &[DVec2], max_corner_count: usize) -> Vec<DVec2> {
    // with y up the hull runs counter-clockwise
    let flipped: Vec<DVec2> = points.iter().map(|p| DVec2::new(p.x, -p.y)).collect();
    let hull: Vec<DVec2> = convex_hull(&flipped).iter().map(|&i| points[i as usize]).collect();
    let mut outline = RECTANGLE.to_vec();
    if hull.len() < 3 {
        return outline;
    }
    loop {
        let area = doubled_area(&outline);
        let cuts = (0..hull.len()).filter_map(|i| {
            let cut = cut_along(&outline, hull[i], hull[(i + 1) % hull.len()]);
            let left = doubled_area(&cut);
            let gains = left < area * (1.0 - LEAST_GAIN);
            (gains && cut.len() <= max_corner_count).then_some((left, cut))
        });
        match cuts.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((_, cut)) => outline = cut,
            None => return outline,
        }
    }
}

/// A cut that gains less than this share of an outline's area is not worth a corner.
const LEAST_GAIN: f64 = 1e-3;

/// Twice the area, above 0 if the corners run as [`RECTANGLE`]'s do.
fn doubled_area(corners: &[DVec2]) -> f64 {
    let next = corners.iter().cycle().skip(1);
    -corners.iter().zip(next).map(|(a, b)| a.perp_dot(*b)).sum::<f64>()
}

/// What of a polygon lies on the inner side of a line that runs along a hull's edge.
fn cut_along(corners: &[DVec2], from: DVec2, to: DVec2) -> Vec<DVec2> {
    // y points down, so what is inside gives negative products
    let inside = |p: DVec2| -(to - from).perp_dot(p - from);
    let mut kept = Vec::with_capacity(corners.len() + 1);
    for (i, &a) in corners.iter().enumerate() {
        let b = corners[(i + 1) % corners.len()];
        let (at_a, at_b) = (inside(a), inside(b));
        if at_a >= 0.0 {
            kept.push(a);
        }
        if (at_a > 0.0 && at_b < 0.0) || (at_a < 0.0 && at_b > 0.0) {
            kept.push(a + (b - a) * (at_a / (at_a - at_b)));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outlines_enclose_and_shrink() {
        // a cut-off corner:  +--+
        //                    |   \
        //                    +----+
        let v = DVec2::new;
        let points = [v(0.0, 1.0), v(1.0, 1.0), v(1.0, 0.5), v(0.5, 0.0), v(0.0, 0.0), v(0.3, 0.4)];
        let five = convex_outline(&points, 8);
        assert_eq!(five.len(), 5, "all corners of the hull");
        assert!((doubled_area(&five) - 2.0 * (1.0 - 0.125)).abs() < 1e-12, "an eighth is cut off");
        assert_eq!(convex_outline(&points, 5), five, "the square and a cut");
        let four = convex_outline(&points, 4);
        assert!((doubled_area(&four) - 2.0).abs() < 1e-12, "the square again: {four:?}");
        assert_eq!(convex_outline(&points[..2], 8), RECTANGLE, "a line has no outline");
        assert!((doubled_area(&RECTANGLE) - 2.0).abs() < 1e-12, "the whole");
    }

    #[test]
    fn outlines_of_a_circle_hold_it() {
        let points: Vec<DVec2> = (0..100)
            .map(|i| {
                let angle = f64::from(i) * std::f64::consts::TAU / 100.0;
                DVec2::new(0.5 + 0.5 * libm::cos(angle), 0.5 + 0.5 * libm::sin(angle))
            })
            .collect();
        let mut last = f64::INFINITY;
        for count in [4, 6, 8, 12, 100] {
            let outline = convex_outline(&points, count);
            assert!(outline.len() <= count, "{count}: {}", outline.len());
            let area = doubled_area(&outline);
            assert!(area < last + 1e-12, "{count}: more corners, less area");
            last = area;
            for (i, a) in outline.iter().enumerate() {
                let b = outline[(i + 1) % outline.len()];
                // rounding of a meeting point
                let inside = points.iter().all(|p| -(b - *a).perp_dot(*p - *a) > -1e-12);
                assert!(inside, "{count}: edge {i} cuts the circle");
                assert!(a.min_element() >= 0.0 && a.max_element() <= 1.0, "inside the square");
            }
        }
    }

    #[test]
    fn leaves_turn_the_short_way() {
        for from in [DVec3::Y, DVec3::NEG_Y, DVec3::new(0.6, 0.0, 0.8), DVec3::Z] {
            let turn = turn_into(from, DVec3::Z);
            let turned = turn * from;
            assert!(turned.cross(DVec3::Z).length() < 1e-15, "{from} becomes {turned}");
            assert!((turn.determinant() - 1.0).abs() < 1e-15, "a turn");
            assert!(
                (turn * turn.transpose() - DMat3::IDENTITY)
                    .to_cols_array()
                    .iter()
                    .all(|x| x.abs() < 1e-15),
                "rigid"
            );
        }
        assert_eq!(turn_into(DVec3::ZERO, DVec3::Z), DMat3::IDENTITY, "no normal, no turn");
    }
}
