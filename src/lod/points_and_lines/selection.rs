//! How many triangles, points and lines of a group a view needs: the formulas alone.
//!
//! Lengths on the picture are measured at distance 1 from the eye. `sample` is the wanted distance
//! between two samples there (d' in the paper), `distance` the mean distance of the group (r).
//!
//! This work is based on:
//! Oliver Deussen, Carsten Colditz, Marc Stamminger, George Drettakis. Interactive Visualization of
//! Complex Plant Ecosystems. 2002

use std::ops::Range;

/// From this `t` on a group of lines is drawn as triangles.
const ALL_TRIANGLES_FROM: f64 = 1.5;

/// Points per triangle, on average.
pub const POINTS_PER_TRIANGLE: u32 = 2;

/// How a group's points were chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sampling {
    /// Two on each triangle, so that a triangle and its points can stand for one another.
    Stratified,
    /// In proportion to the triangles' areas; there is no blend between points and triangles.
    Area,
}

/// Which points belong to triangle `j` of `k`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PairOrder {
    /// `j` and `k + j`: short prefixes have at most one point of each triangle.
    Split,
    /// `2 j` and `2 j + 1`.
    Paired,
}

/// What is drawn of a group of points.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PointDraw {
    /// The first so many triangles, in permuted order.
    pub triangle_count: u32,
    /// Ranges of its points.
    pub points: [Range<u32>; 2],
}

impl PointDraw {
    /// Points drawn.
    pub fn point_count(&self) -> u32 {
        self.points.iter().map(|range| range.end - range.start).sum()
    }

    /// Vertices drawn: three a triangle, one a point.
    pub fn vertex_count(&self) -> u64 {
        3 * u64::from(self.triangle_count) + u64::from(self.point_count())
    }
}

/// What is drawn of a group of lines.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LineDraw {
    /// The first so many pieces are drawn as triangles.
    pub piece_count: u32,
    /// Pieces drawn as a line.
    pub lines: Range<u32>,
}

/// Samples that an area needs: `A' / d'^2` with `A' = area / distance^2`.
///
/// `area` is the mean projected area in square metres: half the area of leaves of one sheet at random
/// orientation, a quarter of that of closed or doubled ones. Infinite where the eye is at the group.
pub fn needed_points(area: f64, distance: f64, sample: f64) -> f64 {
    let spacing = distance * sample;
    if area > 0.0 { area / (spacing * spacing) } else { 0.0 }
}

/// Share of a group's lines whose area is that of its polygons: `q = A' / A'_L`.
///
/// Lines of total length `length` and width `sample` cover
/// `A'_L = sample * orientation_factor * length / distance`.
pub fn line_share(
    area: f64,
    length: f64,
    distance: f64,
    sample: f64,
    orientation_factor: f64,
) -> f64 {
    if area > 0.0 { area / (distance * sample * orientation_factor * length) } else { 0.0 }
}

/// Rounded down after adding an offset in [0, 1); one half rounds to the nearest.
///
/// Groups of a plant have offsets of their own, so that many small groups do not all vanish at once.
pub fn whole(needed: f64, offset: f64) -> u64 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
    let count = (needed + offset).floor() as u64;
    count
}

/// What to draw of a group of `triangle_count` triangles and twice as many points where `wanted`
/// vertices (`p`) are needed.
pub fn point_draw(
    wanted: u64,
    triangle_count: u32,
    sampling: Sampling,
    order: PairOrder,
) -> PointDraw {
    let all = u64::from(triangle_count);
    let only_triangles = || PointDraw { triangle_count, points: [0..0, 0..0] };
    let in_range = |count: u64| u32::try_from(count).expect("at most all points of a group");
    if wanted <= 2 * all {
        return PointDraw { triangle_count: 0, points: [0..in_range(wanted), 0..0] };
    }
    if wanted >= 3 * all || sampling == Sampling::Area {
        return only_triangles();
    }
    let t = in_range(wanted - 2 * all);
    let end = POINTS_PER_TRIANGLE * triangle_count;
    let points = match order {
        PairOrder::Split => [t..triangle_count, triangle_count + t..end],
        PairOrder::Paired => [2 * t..end, 0..0],
    };
    PointDraw { triangle_count: t, points }
}

/// What to draw of a group of `piece_count` pieces with a line each.
///
/// `share` is `q`; `deviation` is the largest distance of a vertex from its line over the distance
/// between samples there, `e / (r d')`. Offsets as for [`whole`].
pub fn line_draw(share: f64, deviation: f64, piece_count: u32, offset: f64) -> LineDraw {
    let t = share.max(deviation);
    if t >= ALL_TRIANGLES_FROM {
        return LineDraw { piece_count, lines: 0..0 };
    }
    let of = |share: f64, count: u32| {
        let wanted = whole(share * f64::from(count), offset);
        u32::try_from(wanted.min(u64::from(count))).expect("at most all")
    };
    let as_triangles = if t > 1.0 { of(2.0 * t - 2.0, piece_count) } else { 0 };
    let line_count = of(share.min(1.0), piece_count - as_triangles);
    LineDraw { piece_count: as_triangles, lines: as_triangles..as_triangles + line_count }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn drawn(p: u64, k: u32, order: PairOrder) -> (u32, Vec<Range<u32>>) {
        let draw = point_draw(p, k, Sampling::Stratified, order);
        let points = draw.points.into_iter().filter(|range| !range.is_empty()).collect();
        (draw.triangle_count, points)
    }

    #[test]
    fn the_paper_s_figure_6_by_hand() {
        // k = 10 triangles, 20 points; triangles and points drawn, by the vertices needed
        let split: [(u64, u32, &[Range<u32>]); 9] = [
            (0, 0, &[]),
            (7, 0, &[0..7; 1]),
            (19, 0, &[0..19; 1]),
            (20, 0, &[0..20; 1]),
            (21, 1, &[1..10, 11..20]),
            (25, 5, &[5..10, 15..20]),
            (29, 9, &[9..10, 19..20]),
            (30, 10, &[]),
            (u64::MAX, 10, &[]),
        ];
        for (p, triangles, points) in split {
            assert_eq!(drawn(p, 10, PairOrder::Split), (triangles, points.to_vec()), "p = {p}");
        }
        let paired: [(u64, u32, &[Range<u32>]); 5] = [
            (7, 0, &[0..7; 1]),
            (20, 0, &[0..20; 1]),
            (21, 1, &[2..20; 1]),
            (29, 9, &[18..20; 1]),
            (30, 10, &[]),
        ];
        for (p, triangles, points) in paired {
            assert_eq!(drawn(p, 10, PairOrder::Paired), (triangles, points.to_vec()), "p = {p}");
        }
        let area = |p| point_draw(p, 10, Sampling::Area, PairOrder::Split);
        assert_eq!((area(20).triangle_count, area(20).point_count()), (0, 20), "all points");
        assert_eq!((area(21).triangle_count, area(21).point_count()), (10, 0), "no blend");
        assert_eq!(drawn(5, 0, PairOrder::Split), (0, vec![]), "nothing of nothing");
    }

    #[test]
    fn as_many_vertices_are_drawn_as_are_needed() {
        for order in [PairOrder::Split, PairOrder::Paired] {
            for p in 0..=30 {
                let draw = point_draw(p, 10, Sampling::Stratified, order);
                assert_eq!(draw.vertex_count(), p, "{order:?}");
            }
            let most = point_draw(1000, 10, Sampling::Stratified, order);
            assert_eq!(most.vertex_count(), 30, "never more than 3k");
        }
    }

    #[test]
    fn lines_by_hand() {
        // eight leaves; (q, deviation), leaves as triangles, lines
        let cases: [(f64, f64, u32, Range<u32>); 11] = [
            (0.0, 0.0, 0, 0..0),
            (0.25, 0.0, 0, 0..2),
            // half a line more rounds up
            (0.3125, 0.0, 0, 0..3),
            (1.0, 0.0, 0, 0..8),
            (1.0, 1.0, 0, 0..8),
            (0.5, 1.0, 0, 0..4),
            // t = 1.25: half of the leaves, and q of the others
            (1.25, 0.0, 4, 4..8),
            (0.5, 1.25, 4, 4..6),
            (1.5, 0.0, 8, 0..0),
            (0.1, 1.5, 8, 0..0),
            (f64::INFINITY, f64::INFINITY, 8, 0..0),
        ];
        for (q, deviation, pieces, lines) in cases {
            let expected = LineDraw { piece_count: pieces, lines };
            assert_eq!(line_draw(q, deviation, 8, 0.5), expected, "q {q}, deviation {deviation}");
        }
    }

    #[test]
    fn counts_follow_from_areas_by_hand() {
        // 8 m^2 of leaves seen as 4 m^2; from 2 m, 1/10 a sample: 1 at distance 1, 100 samples of it
        assert!((needed_points(4.0, 2.0, 0.1) - 100.0).abs() < 1e-12, "(4 / 4) / 0.01");
        assert_eq!(needed_points(4.0, 0.0, 0.1), f64::INFINITY, "the eye is at the leaf");
        assert_eq!(needed_points(0.0, 0.0, 0.1), 0.0, "nothing needs nothing, wherever it is");
        // 10 m of lines, 1/10 wide, half as long from the side, from 2 m: 0.25 at distance 1
        assert!((line_share(0.8, 10.0, 2.0, 0.1, 0.5) - 0.8).abs() < 1e-12, "(0.8 / 4) / 0.25");
        assert_eq!(line_share(0.0, 0.0, 0.0, 0.1, 0.5), 0.0, "lines without area or length");
        assert_eq!([whole(0.49, 0.5), whole(0.5, 0.5), whole(7.0, 0.0)], [0, 1, 7], "rounded");
        assert_eq!(whole(f64::INFINITY, 0.5), u64::MAX, "as many as there are");
    }

    proptest! {
        #[test]
        fn a_nearer_eye_never_takes_anything_away(
            k in 1..200_u32, p in 0..700_u64, more in 0..50_u64, paired in any::<bool>()
        ) {
            let order = if paired { PairOrder::Paired } else { PairOrder::Split };
            let [far, near] = [p, p + more].map(|p| point_draw(p, k, Sampling::Stratified, order));
            prop_assert!(far.triangle_count <= near.triangle_count);
            // a point that is gone has its triangle in its place
            let has = |draw: &PointDraw, point: u32| draw.points.iter().any(|r| r.contains(&point));
            for point in 0..2 * k {
                let triangle = if paired { point / 2 } else { point % k };
                if has(&far, point) && !has(&near, point) {
                    prop_assert!(triangle < near.triangle_count, "point {point} is lost");
                }
            }
        }

        #[test]
        fn lines_and_triangles_never_stand_for_the_same_piece(
            share in 0.0..2.0_f64, deviation in 0.0..2.0_f64, count in 0..100_u32, offset in 0.0..1.0_f64
        ) {
            let draw = line_draw(share, deviation, count, offset);
            prop_assert!(draw.piece_count <= count && draw.lines.end <= count);
            prop_assert!(draw.lines.is_empty() || draw.lines.start == draw.piece_count);
        }
    }
}
