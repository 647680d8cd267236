//! The smallest rectangle around points of a plane, and their convex hull.
//!
//! One side of the smallest rectangle lies along an edge of the hull. The hull is a monotone chain;
//! rotating calipers then try its edges in order, so all takes O(n log n) time and the order of the
//! points only matters among coincident ones. Nothing is rounded but the arithmetic: what is left
//! out of a hull or a rectangle lies within some 1e-15 of its size.
//!
//! Points must be finite, and their distances 0 or in 1e-150..1e150, so that products of two exist.
//!
//! This work is based on:
//! A. M. Andrew. Another efficient algorithm for convex hulls in two dimensions. 1979
//! H. Freeman, R. Shapira. Determining the minimum-area encasing rectangle for an arbitrary closed
//! curve. 1975
//! G. T. Toussaint. Solving geometric problems with the rotating calipers. 1983

use glam::DVec2;

/// Areas, and sides, that differ by less than this share count as equal: rounding makes the four
/// rectangles along the sides of a square differ by some 1e-16.
pub const TIE_REL: f64 = 1e-12;

/// A rectangle in a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle2 {
    /// Where its diagonals meet.
    pub center: DVec2,
    /// Unit vector along the longer side, with its first component that is not zero above zero.
    pub axis: DVec2,
    /// Half the longer side and half the shorter one.
    pub half: DVec2,
}

impl Rectangle2 {
    /// Unit vector along the shorter side: the axis turned by a quarter, counter-clockwise.
    pub fn across(&self) -> DVec2 {
        self.axis.perp()
    }

    /// Area.
    pub fn area(&self) -> f64 {
        4.0 * self.half.x * self.half.y
    }

    /// The corners, counter-clockwise from the one at the lower ends of axis and [`Self::across`].
    pub fn corners(&self) -> [DVec2; 4] {
        let (along, across) = (self.axis * self.half.x, self.across() * self.half.y);
        [-along - across, along - across, along + across, across - along].map(|o| self.center + o)
    }
}

/// Indices of the convex hull's corners, counter-clockwise from the lowest point, of several the
/// leftmost.
///
/// Points along its edges are left out; of coincident points the first counts. Coincident points
/// alone give one corner, collinear ones two, none none.
pub fn convex_hull(points: &[DVec2]) -> Vec<u32> {
    let count = u32::try_from(points.len()).expect("indices are u32");
    let at = |index: u32| points[index as usize];
    let mut order: Vec<u32> = (0..count).collect();
    order.sort_unstable_by(|&a, &b| {
        let (p, q) = (at(a), at(b));
        // + 0.0 makes -0 the same as 0
        (p.y + 0.0)
            .total_cmp(&(q.y + 0.0))
            .then((p.x + 0.0).total_cmp(&(q.x + 0.0)))
            .then(a.cmp(&b))
    });
    order.dedup_by(|next, kept| at(*next) == at(*kept));
    if order.len() < 3 {
        return order;
    }
    let mut hull: Vec<u32> = Vec::new();
    let mut grow = |next: u32, least: usize| {
        // what does not turn left lies inside, or on an edge
        while let [.., a, b] = hull[..]
            && hull.len() > least
            && (at(b) - at(a)).perp_dot(at(next) - at(a)) <= 0.0
        {
            hull.pop();
        }
        hull.push(next);
        hull.len()
    };
    // up the right side, then down the left one
    let top = order.iter().fold(0, |_, &next| grow(next, 1));
    for &next in order.iter().rev().skip(1) {
        grow(next, top);
    }
    // the way down ends where the way up began
    hull.pop();
    hull
}

/// The rectangle of least area that holds all points; `None` without any.
///
/// Of rectangles of equal area it is the one along the first edge of [`convex_hull`], of equal
/// sides the longer is the one along that edge. Collinear points give a rectangle without height,
/// a single place one without size whose axis is x.
pub fn min_area_rectangle(points: &[DVec2]) -> Option<Rectangle2> {
    let hull: Vec<DVec2> = convex_hull(points).iter().map(|&i| points[i as usize]).collect();
    match hull[..] {
        [] => None,
        [center] => Some(Rectangle2 { center, axis: DVec2::X, half: DVec2::ZERO }),
        [a, b] => {
            let axis = canonical(unit(b - a));
            let half = DVec2::new(0.5 * a.distance(b), 0.0);
            Some(Rectangle2 { center: a.midpoint(b), axis, half })
        }
        _ => Some(around_hull(&hull)),
    }
}

/// What is tight along one edge of a hull.
struct Fit {
    start: DVec2,
    direction: DVec2,
    /// Lowest and highest coordinate along the direction, from the start.
    along: (f64, f64),
    height: f64,
}

impl Fit {
    fn area(&self) -> f64 {
        (self.along.1 - self.along.0) * self.height
    }
}

/// Of at least three corners that turn left everywhere.
fn around_hull(hull: &[DVec2]) -> Rectangle2 {
    let count = hull.len();
    let corner = |index: usize| hull[index % count];
    let side = |index: usize| corner(index + 1) - corner(index);
    // the farthest corner to the right, from the edge, and to the left; as the edge turns, they only
    // go on. A side tells better than two corners' coordinates whether its end is farther: it is
    // exact to rounding of itself.
    let (mut right, mut top, mut left) = (1, 1, 1);
    let mut best: Option<Fit> = None;
    for edge in 0..count {
        let (start, direction) = (corner(edge), unit(side(edge)));
        let up = direction.perp();
        let end = edge + count;
        right = right.max(edge + 1);
        while right < end && side(right).dot(direction) > 0.0 {
            right += 1;
        }
        top = top.max(right);
        while top < end && side(top).dot(up) > 0.0 {
            top += 1;
        }
        left = left.max(top);
        while left < end && side(left).dot(direction) < 0.0 {
            left += 1;
        }
        let along = |index: usize| (corner(index) - start).dot(direction);
        let fit = Fit {
            start,
            direction,
            along: (along(left), along(right)),
            height: (corner(top) - start).dot(up),
        };
        if best.as_ref().is_none_or(|best| fit.area() < best.area() * (1.0 - TIE_REL)) {
            best = Some(fit);
        }
    }
    let Fit { start, direction, along, height } = best.expect("a hull has edges");
    let width = along.1 - along.0;
    let middle = DVec2::new(0.5 * (along.0 + along.1), 0.5 * height);
    let center = start + direction * middle.x + direction.perp() * middle.y;
    if height > width * (1.0 + TIE_REL) {
        let half = DVec2::new(height, width) * 0.5;
        return Rectangle2 { center, axis: canonical(direction.perp()), half };
    }
    // of sides equal but for rounding the longer comes first too
    let half = DVec2::new(width.max(height), width.min(height)) * 0.5;
    Rectangle2 { center, axis: canonical(direction), half }
}

/// Divided by its length, so that a vector along an axis becomes exactly that axis; a product with
/// the length's inverse would not.
fn unit(vector: DVec2) -> DVec2 {
    vector / vector.length()
}

/// The axis or its opposite. Adding 0 turns -0 into 0.
fn canonical(axis: DVec2) -> DVec2 {
    let first = if axis.x == 0.0 { axis.y } else { axis.x };
    if first < 0.0 { DVec2::ZERO - axis } else { axis + DVec2::ZERO }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use proptest::test_runner::{RngSeed, TestRunner};

    use super::*;

    /// Of a rectangle's size: what rounding in f64 may add, with room.
    const ROUNDING: f64 = 1e-14;

    fn points(rows: &[[f64; 2]]) -> Vec<DVec2> {
        rows.iter().map(|&row| row.into()).collect()
    }

    /// Area of the rectangle along a direction.
    fn area_along(points: &[DVec2], direction: DVec2) -> f64 {
        let extent = |axis: DVec2| {
            let of = |p: &DVec2| (*p - points[0]).dot(axis);
            let low = points.iter().map(of).fold(f64::INFINITY, f64::min);
            points.iter().map(of).fold(f64::NEG_INFINITY, f64::max) - low
        };
        extent(direction) * extent(direction.perp())
    }

    /// Smallest area along the line through any two points: the hull's edges are among those.
    fn area_naive(points: &[DVec2]) -> f64 {
        let mut least = f64::INFINITY;
        for (index, &a) in points.iter().enumerate() {
            for &b in &points[index + 1..] {
                if a != b {
                    least = least.min(area_along(points, (b - a).normalize()));
                }
            }
        }
        if least.is_finite() { least } else { 0.0 }
    }

    /// What must hold for any points.
    fn check(points: &[DVec2]) {
        let rectangle = min_area_rectangle(points).expect("there are points");
        let Rectangle2 { center, axis, half } = rectangle;
        assert!(half.x >= half.y && half.y >= 0.0, "the longer side first: {rectangle:?}");
        assert!((axis.length() - 1.0).abs() < ROUNDING, "unit length: {axis}");
        assert!(axis.x > 0.0 || (axis.x == 0.0 && axis.y == 1.0), "one of two signs: {axis}");
        // far from the origin a centre is as coarse as any coordinate
        let reach = points.iter().map(|p| p.abs().max_element()).fold(half.x, f64::max);
        let slack = ROUNDING * reach;
        let mut touched = [f64::INFINITY; 4];
        for &point in points {
            let place =
                DVec2::new(axis.dot(point - center), rectangle.across().dot(point - center));
            let gaps = [half.x - place.x, half.x + place.x, half.y - place.y, half.y + place.y];
            assert!(gaps.iter().all(|&gap| gap >= -slack), "{point} outside {rectangle:?}");
            touched = std::array::from_fn(|side| f64::min(touched[side], gaps[side]));
        }
        assert!(touched.iter().all(|&gap| gap <= slack), "a side touches no point: {rectangle:?}");
        let (least, tolerance) = (area_naive(points), 4.0 * slack * half.x);
        assert!((rectangle.area() - least).abs() <= tolerance, "{} of {least}", rectangle.area());
    }

    #[test]
    fn the_hull_runs_counter_clockwise_from_the_lowest_corner() {
        //  2 . . 3 . 4      y = 2
        //  .   8     .
        //  1 . 7 . . 5      7 and 8 are inside; 1, 3 and 6 lie along edges
        //  . 0 . 6 . 9      y = 0; 10 is 0 again
        let rows = [
            [1.0, 0.0],
            [0.0, 1.0],
            [0.0, 2.0],
            [3.0, 2.0],
            [5.0, 2.0],
            [5.0, 1.0],
            [3.0, 0.0],
            [2.0, 1.0],
            [2.0, 1.5],
            [5.0, 0.0],
            [1.0, 0.0],
        ];
        assert_eq!(convex_hull(&points(&rows)), [0, 9, 4, 2, 1], "corners only");
    }

    #[test]
    fn hulls_of_few_places() {
        assert_eq!(convex_hull(&[]), [0_u32; 0], "nothing");
        let twice = points(&[[1.0, 0.0], [1.0, -0.0], [1.0, 0.0]]);
        assert_eq!(convex_hull(&twice), [0], "one place: the first of the points");
        let line = points(&[[1.0, 1.0], [3.0, 3.0], [0.0, 0.0], [2.0, 2.0], [3.0, 3.0]]);
        assert_eq!(convex_hull(&line), [2, 1], "the ends of a line");
        let level = points(&[[2.0, 5.0], [-1.0, 5.0], [0.0, 5.0]]);
        assert_eq!(convex_hull(&level), [1, 0], "left end first");
    }

    #[test]
    fn a_slanted_rectangle_is_its_own() {
        //      2          half sides 2 sqrt 2 and sqrt 2
        //    3   .
        //      .   1      rises to the left, so the axis points right and down
        //        0
        let rows = [[3.0, 0.0], [5.0, 2.0], [1.0, 6.0], [-1.0, 4.0]];
        let rectangle = min_area_rectangle(&points(&rows)).expect("points");
        let root = std::f64::consts::FRAC_1_SQRT_2;
        assert!(rectangle.center.abs_diff_eq(DVec2::new(2.0, 3.0), ROUNDING), "{rectangle:?}");
        assert!(rectangle.axis.abs_diff_eq(DVec2::new(root, -root), ROUNDING), "{rectangle:?}");
        let half = DVec2::new(4.0 * root, 2.0 * root);
        assert!(rectangle.half.abs_diff_eq(half, ROUNDING), "{rectangle:?}");
        let corners = rectangle.corners();
        for (corner, row) in corners.into_iter().zip([3, 0, 1, 2]) {
            assert!(corner.abs_diff_eq(rows[row].into(), 4.0 * ROUNDING), "{corner} is {row}");
        }
    }

    #[test]
    fn of_equal_rectangles_the_first_edge_has_it() {
        // a square that stands on a corner: all four edges tie, the first rises to the right
        let square = points(&[[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]);
        let root = std::f64::consts::FRAC_1_SQRT_2;
        let axis = min_area_rectangle(&square).expect("points").axis;
        assert!(axis.abs_diff_eq(DVec2::splat(root), ROUNDING), "{axis}");
        // a right triangle: along its legs 3 x 4, along the hypotenuse 5 x 2.4; the leg at the
        // bottom comes first, and the longer side is the other one
        let triangle = points(&[[0.0, 4.0], [0.0, 0.0], [3.0, 0.0]]);
        let rectangle = min_area_rectangle(&triangle).expect("points");
        assert_eq!(rectangle.axis, DVec2::Y, "along the longer leg");
        assert_eq!(rectangle.half, DVec2::new(2.0, 1.5), "exact");
        assert_eq!(rectangle.center, DVec2::new(1.5, 2.0), "exact");
    }

    #[test]
    fn rounding_breaks_no_tie() {
        // a square turned any way: its four edges tie, and each rectangle's sides do; off the
        // middle, where its corners round each in its own way
        for step in 0..100 {
            let turn = DVec2::from_angle(f64::from(step) * 0.1);
            let square: Vec<DVec2> = [[3.0, 3.0], [-3.0, 3.0], [-3.0, -3.0], [3.0, -3.0]]
                .map(|row| turn.rotate(row.into()) + DVec2::new(0.1, 0.7))
                .to_vec();
            let hull = convex_hull(&square);
            let edge = square[hull[1] as usize] - square[hull[0] as usize];
            let axis = min_area_rectangle(&square).expect("points").axis;
            assert_eq!(axis, canonical(unit(edge)), "along the first edge at step {step}");
        }
    }

    #[test]
    fn a_large_hull_takes_all_its_edges_in_turn() {
        // a lens of many edges, wider than high, turned: only the calipers' order finds it
        let turn = DVec2::from_angle(0.7);
        let lens: Vec<DVec2> = (0..200)
            .map(|step| DVec2::from_angle(f64::from(step) * std::f64::consts::TAU / 200.0))
            .map(|p| turn.rotate(p * DVec2::new(3.0, 1.0)))
            .collect();
        assert_eq!(convex_hull(&lens).len(), 200, "every point is a corner");
        check(&lens);
    }

    #[test]
    fn degenerate_points_have_a_defined_rectangle() {
        assert_eq!(min_area_rectangle(&[]), None, "nothing");
        let place = DVec2::new(-3.0, 2.0);
        let point = Rectangle2 { center: place, axis: DVec2::X, half: DVec2::ZERO };
        assert_eq!(min_area_rectangle(&[place; 1]), Some(point), "one point");
        assert_eq!(min_area_rectangle(&[place; 5]), Some(point), "coincident");
        let line = points(&[[0.0, 0.0], [-3.0, 4.0], [-1.5, 2.0]]);
        let rectangle = min_area_rectangle(&line).expect("points");
        assert_eq!(rectangle.center, DVec2::new(-1.5, 2.0), "in the middle");
        assert_eq!(rectangle.half, DVec2::new(2.5, 0.0), "no height");
        assert!(rectangle.axis.abs_diff_eq(DVec2::new(0.6, -0.8), ROUNDING), "{rectangle:?}");
        let upright = min_area_rectangle(&points(&[[1.0, 7.0], [1.0, 3.0]])).expect("points");
        assert_eq!((upright.axis, upright.half.x), (DVec2::Y, 2.0), "two points");
        assert!(upright.axis.x.is_sign_positive(), "no minus zero");
    }

    #[test]
    fn random_points_have_the_rectangle_of_the_naive_twin() {
        // a grid of few places, where most points coincide, are collinear or tie; and places of no
        // grid. Both tiny, large and far away.
        let place = prop_oneof![
            (-3..=3_i8, -3..=3_i8).prop_map(|(x, y)| DVec2::new(f64::from(x), f64::from(y))),
            (-1.0..1.0_f64, -1.0..1.0_f64).prop_map(|(x, y)| DVec2::new(x, y)),
            (-1.0..1.0_f64).prop_map(|t| DVec2::new(t, 0.25 - 1.5 * t)),
        ];
        let grid = (-3..=3_i8, -3..=3_i8).prop_map(|(x, y)| DVec2::new(x.into(), y.into()));
        let any =
            prop_oneof![prop::collection::vec(grid, 1..12), prop::collection::vec(place, 1..30),];
        let scale = prop::sample::select(vec![1e-4, 1.0, 1e4]);
        let away = prop::sample::select(vec![0.0, 1e6]);
        let flat = prop::sample::select(vec![1.0, 1e-6]);
        let mut config = ProptestConfig::with_cases(3000);
        config.rng_seed = RngSeed::Fixed(1);
        config.failure_persistence = None;
        let strategy = (any, scale, away, flat, 0.0..6.3_f64);
        let found = TestRunner::new(config).run(&strategy, |(places, scale, away, flat, angle)| {
            // half of them unturned, so that the grid stays one
            let turn = DVec2::from_angle(if angle < 3.0 { 0.0 } else { angle });
            let offset = DVec2::new(away, -away);
            let moved: Vec<DVec2> = places
                .iter()
                .map(|&p| turn.rotate(p * DVec2::new(scale, scale * flat)) + offset)
                .collect();
            check(&moved);
            Ok(())
        });
        found.expect("no counter-example");
    }

    #[test]
    fn the_hull_of_a_grid_is_exact() {
        // sums and products of small integers round nowhere, so each statement is one of signs
        let grid = (-4..=4_i8, -4..=4_i8).prop_map(|(x, y)| DVec2::new(x.into(), y.into()));
        let mut config = ProptestConfig::with_cases(2000);
        config.rng_seed = RngSeed::Fixed(2);
        config.failure_persistence = None;
        let strategy = prop::collection::vec(grid, 1..20);
        let found = TestRunner::new(config).run(&strategy, |points| {
            let hull = convex_hull(&points);
            let lowest =
                points.iter().copied().min_by(|p, q| p.y.total_cmp(&q.y).then(p.x.total_cmp(&q.x)));
            assert_eq!(Some(points[hull[0] as usize]), lowest, "where it begins");
            let corner = |index: usize| points[hull[index % hull.len()] as usize];
            for edge in 0..hull.len() {
                let (a, b) = (corner(edge), corner(edge + 1));
                let first = points.iter().position(|&p| p == a);
                assert_eq!(first, Some(hull[edge] as usize), "the first of coincident points");
                for &p in &points {
                    let height = (b - a).perp_dot(p - a);
                    assert!(hull.len() < 2 || height >= 0.0, "{p} lies right of {a} to {b}");
                    let along = (p - a).dot(b - a) / (b - a).length_squared();
                    let corner_or_off = height != 0.0 || p == a || p == b;
                    assert!(
                        corner_or_off || (along > 0.0 && along < 1.0),
                        "{p} is on the line of {a} to {b} and beyond"
                    );
                }
                if hull.len() > 2 {
                    let turn = (b - a).perp_dot(corner(edge + 2) - b);
                    assert!(turn > 0.0, "{b} is no corner");
                }
            }
            Ok(())
        });
        found.expect("no counter-example");
    }
}
