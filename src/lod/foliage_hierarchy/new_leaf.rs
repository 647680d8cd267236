//! Which quad two leaves collapse into: two corners of each, in some order.
//!
//! There are 36 choices of corners and 3 orders around each. Orders that cross themselves, seen along
//! the parents' mean normal, are out. Of the rest the one is taken whose area is nearest to that of
//! the plant's leaves that it stands for, and which is flattest.

use std::cmp::Ordering;

use glam::DVec3;

/// What makes a candidate the better one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Choice {
    /// Least `|S - T| / T + (1 - V / S)`: area and flatness weigh against each other.
    Balanced,
    /// Least `|S - T|`, of equals the largest `V / S`: the paper's, which folds quads.
    Paper,
}

/// Pairs of corners of a quad, in order.
const PAIRS: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Orders around two corners of the first parent (0, 1) and two of the second (2, 3).
const ORDERS: [[usize; 4]; 3] = [[0, 1, 2, 3], [0, 1, 3, 2], [0, 2, 1, 3]];

/// A corner of one of two parents: 0 to 3 are the first one's, 4 to 7 the second one's.
pub type ParentCorner = usize;

/// How much two leaves differ from what they would become.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    index: usize,
    /// |S - T|.
    area_error: f64,
    /// What is least for the best.
    key: [f64; 2],
    crosses: bool,
    /// Twice the area vector, by which it is turned to face as its parents do.
    across: DVec3,
}

/// The corners of the quad that two parents collapse into, in order around it.
///
/// `mean_normal` need not be of unit length; where it is zero, no order counts as crossing itself.
/// `target_area` is T, the area of the plant's leaves below, in square metres.
pub fn new_leaf(
    first: &[DVec3; 4],
    second: &[DVec3; 4],
    mean_normal: DVec3,
    target_area: f64,
    choice: Choice,
) -> [ParentCorner; 4] {
    let mut best: Option<Candidate> = None;
    let mut nearest: Option<Candidate> = None;
    for (number, pairs) in PAIRS.iter().flat_map(|a| PAIRS.map(|b| (*a, b))).enumerate() {
        let ([a, b], [c, d]) = pairs;
        let corners = [first[a], first[b], second[c], second[d]];
        for candidate in candidates(corners, number * 3, mean_normal, target_area, choice) {
            if nearest.is_none_or(|known| candidate.area_error < known.area_error) {
                nearest = Some(candidate);
            }
            let is_better = |known: Candidate| less(candidate.key, known.key);
            if !candidate.crosses && best.is_none_or(is_better) {
                best = Some(candidate);
            }
        }
    }
    let chosen = best.or(nearest).expect("there are 108");
    let (pair, order) = (chosen.index / 3, ORDERS[chosen.index % 3]);
    let ([a, b], [c, d]) = (PAIRS[pair / 6], PAIRS[pair % 6]);
    let [w, x, y, z] = order.map(|corner| [a, b, 4 + c, 4 + d][corner]);
    // seen from where the parents face, corners run counter-clockwise; the cut stays where it was
    if chosen.across.dot(mean_normal) < 0.0 { [w, z, y, x] } else { [w, x, y, z] }
}

fn less(a: [f64; 2], b: [f64; 2]) -> bool {
    a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])) == Ordering::Less
}

/// The three orders around corners a, b of the first parent and c, d of the second.
///
/// Cut along their first and third corner, they are made of the triangles abc, abd and acd alone.
#[inline]
fn candidates(
    [a, b, c, d]: [DVec3; 4],
    first_index: usize,
    normal: DVec3,
    target_area: f64,
    choice: Choice,
) -> [Candidate; 3] {
    let (ab, ac, ad) = (b - a, c - a, d - a);
    let [abc, abd, acd] = [ab.cross(ac), ab.cross(ad), ac.cross(ad)];
    let [abc_2, abd_2, acd_2] = [abc, abd, acd].map(DVec3::length);
    // which way triangles run around, seen along the normal
    let [in_abc, in_abd, in_acd] = [abc, abd, acd].map(|across| across.dot(normal));
    let in_bcd = (c - b).cross(d - b).dot(normal);
    // whether the segments cross inside
    let ab_cd = in_abc * in_abd < 0.0 && in_acd * in_bcd < 0.0;
    let ac_bd = in_abc * in_acd > 0.0 && in_abd * in_bcd > 0.0;
    let ad_bc = in_abd * in_acd < 0.0 && in_abc * in_bcd < 0.0;
    let candidate = |order: usize, twice_area: f64, across: DVec3, crosses: bool| {
        let area = twice_area * 0.5;
        let area_error = (area - target_area).abs();
        let flatness = if twice_area > 0.0 { across.length() / twice_area } else { 0.0 };
        let key = match choice {
            _ if target_area == 0.0 => [area, 0.0],
            Choice::Balanced => [area_error / target_area + (1.0 - flatness), 0.0],
            Choice::Paper => [area_error, -flatness],
        };
        Candidate { index: first_index + order, area_error, key, crosses, across }
    };
    [
        // sides ab, bc, cd, da; cut along ac
        candidate(0, abc_2 + acd_2, abc + acd, ab_cd || ad_bc),
        // sides ab, bd, dc, ca; cut along ad
        candidate(1, abd_2 + acd_2, abd - acd, ab_cd || ac_bd),
        // sides ac, cb, bd, da; cut along ab
        candidate(2, abc_2 + abd_2, abd - abc, ac_bd || ad_bc),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corners_of(first: &[DVec3; 4], second: &[DVec3; 4], chosen: [usize; 4]) -> [DVec3; 4] {
        chosen.map(|corner| if corner < 4 { first[corner] } else { second[corner - 4] })
    }

    fn square(x: f64, y: f64, side: f64) -> [DVec3; 4] {
        [[x, y], [x + side, y], [x + side, y + side], [x, y + side]]
            .map(|[x, y]| DVec3::new(x, y, 0.0))
    }

    #[test]
    fn two_squares_side_by_side_become_the_rectangle_around_them() {
        //  3---2 7---6
        //  |   | |   |     T = 2: the rectangle of 2 by 1 has exactly that
        //  0---1 4---5
        let (left, right) = (square(0.0, 0.0, 1.0), square(1.0, 0.0, 1.0));
        let chosen = new_leaf(&left, &right, DVec3::Z, 2.0, Choice::Balanced);
        assert_eq!(chosen, [0, 5, 6, 3], "outer corners, counter-clockwise");
        let mirrored = new_leaf(&left, &right, -DVec3::Z, 2.0, Choice::Balanced);
        assert_eq!(mirrored, [0, 3, 6, 5], "facing as the parents do");
        assert_eq!(new_leaf(&left, &right, DVec3::Z, 2.0, Choice::Paper), chosen, "S = T, flat");
    }

    #[test]
    fn the_area_of_the_leaves_below_is_what_counts() {
        //  apart by 2: rectangles of 1 by 1 to 4 by 1 can be had
        let (left, right) = (square(0.0, 0.0, 1.0), square(3.0, 0.0, 1.0));
        for (target, area) in [(2.0, 2.0), (3.0, 3.0), (4.0, 4.0), (9.0, 4.0)] {
            let chosen = new_leaf(&left, &right, DVec3::Z, target, Choice::Balanced);
            let [a, b, c, d] = corners_of(&left, &right, chosen);
            let found = (c - a).cross(d - b).z * 0.5;
            assert_eq!(found, area, "{chosen:?} for {target}");
        }
        let none = new_leaf(&left, &right, DVec3::Z, 0.0, Choice::Balanced);
        let [a, b, c, d] = corners_of(&left, &right, none);
        assert_eq!((b - a).cross(c - a).length() + (c - a).cross(d - a).length(), 0.0, "T = 0");
    }

    #[test]
    fn balance_prefers_flat_quads_where_the_paper_folds_them() {
        // a cross of two upright squares: the paper's rule finds T = 2 folded
        let first = square(0.0, 0.0, 1.0);
        let second = first.map(|p| DVec3::new(0.5, p.y, p.x - 0.5));
        let flatness = |chosen: [usize; 4]| {
            let [a, b, c, d] = corners_of(&first, &second, chosen);
            let area = (b - a).cross(c - a).length() + (c - a).cross(d - a).length();
            ((c - a).cross(d - b).length() / area, area * 0.5)
        };
        let mean = DVec3::new(1.0, 0.0, 1.0);
        let (flat, _) = flatness(new_leaf(&first, &second, mean, 2.0, Choice::Balanced));
        let (folded, area) = flatness(new_leaf(&first, &second, mean, 2.0, Choice::Paper));
        assert!(flat > folded, "{flat} {folded}");
        assert!((area - 2.0).abs() < 1.0, "{area}");
    }

    #[test]
    fn no_chosen_quad_crosses_itself_where_any_does_not() {
        // on random squares in one plane the chosen quad is simple: its signed area is its area
        for seed in 0..200_u32 {
            let at = |k: u32| f64::from((seed * 7919 + k * 104_729) % 997) / 997.0;
            let first = square(at(0), at(1), 0.1 + at(2));
            let second = square(at(3), at(4), 0.1 + at(5));
            let target = 0.5 + at(6);
            let crosses = |p: DVec3, q: DVec3, r: DVec3, s: DVec3| {
                let side = |u: DVec3, v: DVec3, w: DVec3| (v - u).cross(w - u).z;
                side(p, q, r) * side(p, q, s) < 0.0 && side(r, s, p) * side(r, s, q) < 0.0
            };
            for choice in [Choice::Balanced, Choice::Paper] {
                let chosen = new_leaf(&first, &second, DVec3::Z, target, choice);
                let [a, b, c, d] = corners_of(&first, &second, chosen);
                assert!(!crosses(a, b, c, d) && !crosses(b, c, d, a), "{seed}: {chosen:?}");
            }
        }
    }
}
