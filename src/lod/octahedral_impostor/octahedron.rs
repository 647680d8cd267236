//! Directions on a square: the octahedral map, the grid of frames on it, and which frames a view mixes.
//!
//! A direction is divided by the sum of its coordinates' magnitudes, which puts it on an octahedron, and
//! the octahedron is unfolded. The upper half alone is a square that stands on a corner; turned by 45
//! degrees it fills [-1, 1] x [-1, 1], with the zenith in the middle and the horizon around the edge. The
//! whole has the upper half inside the standing square and the lower half folded out into the corners.
//! No trigonometry, and neighbours stay neighbours.
//!
//! This work is based on:
//! Quirin Meyer et al. On Floating-Point Normal Vectors. 2010 (the map)
//! Ryan Brucks. Octahedral Impostors. 2018 (its upper half, the grid, the three frames)

use glam::{DVec2, DVec3};

use crate::error::{LodError, check_in};

/// Frames a side, at least: the corners. One more for the whole.
pub const MIN_FRAME_COUNT: usize = 2;

/// Frames a side, at most: more are taken for a mistake.
pub const MAX_FRAME_COUNT: usize = 64;

/// Weights below this are none.
const LEAST_WEIGHT: f64 = 1e-9;

/// Frames on a square of directions, as many on each side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// Frames a side.
    pub side: usize,
    /// Whether only directions from the horizon up have frames.
    pub hemisphere: bool,
}

/// 1 or -1, and 1 for 0.
fn sign(value: f64) -> f64 {
    if value < 0.0 { -1.0 } else { 1.0 }
}

/// Where a direction of any length lies on the square; directions below the horizon lie on its edge if
/// it has the upper half alone.
pub fn square_from_direction(direction: DVec3, hemisphere: bool) -> DVec2 {
    let above = if hemisphere { direction.with_y(direction.y.max(0.0)) } else { direction };
    let sum = above.abs().element_sum();
    if sum == 0.0 {
        return DVec2::ZERO;
    }
    let (x, z) = (above.x / sum, above.z / sum);
    if hemisphere {
        return DVec2::new(x + z, x - z);
    }
    if above.y >= 0.0 {
        return DVec2::new(x, z);
    }
    DVec2::new((1.0 - z.abs()) * sign(x), (1.0 - x.abs()) * sign(z))
}

/// The unit direction of a point of the square.
pub fn direction_from_square(at: DVec2, hemisphere: bool) -> DVec3 {
    let flat = if hemisphere {
        DVec2::new(at.x + at.y, at.x - at.y) * 0.5
    } else {
        DVec2::new(at.x, at.y)
    };
    let height = 1.0 - flat.x.abs() - flat.y.abs();
    let point = if height >= 0.0 {
        DVec3::new(flat.x, height, flat.y)
    } else {
        let (x, z) = ((1.0 - flat.y.abs()) * sign(flat.x), (1.0 - flat.x.abs()) * sign(flat.y));
        DVec3::new(x, height, z)
    };
    // sums of an edge's coordinates miss 0 by a rounding, and the horizon is level
    let point = if hemisphere && height < 1e-12 { point.with_y(0.0) } else { point };
    point.normalize()
}

impl Grid {
    /// A grid of frames.
    ///
    /// # Errors
    /// `frame_count` out of range.
    pub fn new(side: usize, hemisphere: bool) -> Result<Self, LodError> {
        // the corners of the whole are all the nadir
        let least = if hemisphere { MIN_FRAME_COUNT } else { MIN_FRAME_COUNT + 1 };
        check_in("frame_count", side, least..=MAX_FRAME_COUNT)?;
        Ok(Self { side, hemisphere })
    }

    /// Frames of the square, some of which may show the same direction.
    pub fn frame_count(&self) -> usize {
        self.side * self.side
    }

    /// Unit vector from the plant to the viewer of a frame; frames are counted along u first.
    pub fn direction(&self, frame: usize) -> DVec3 {
        let last = (self.side - 1) as f64;
        // opposite points are exactly opposite, so that those of one direction are equal
        let at = |index: usize| (2.0 * index as f64 - last) / last;
        let square = DVec2::new(at(frame % self.side), at(frame / self.side));
        direction_from_square(square, self.hemisphere)
    }

    /// For each frame, the first that shows the same direction: where the whole octahedron is unfolded,
    /// its lower edges lie twice on the rim of the square.
    pub fn stand_ins(&self) -> Vec<usize> {
        let directions: Vec<DVec3> = (0..self.frame_count()).map(|f| self.direction(f)).collect();
        let rim = |frame: usize| {
            let (u, v) = (frame % self.side, frame / self.side);
            [u, v].iter().any(|&at| at == 0 || at == self.side - 1)
        };
        (0..self.frame_count())
            .map(|frame| {
                if self.hemisphere || !rim(frame) {
                    return frame;
                }
                let same = |&other: &usize| rim(other) && directions[other] == directions[frame];
                (0..frame).find(same).unwrap_or(frame)
            })
            .collect()
    }

    /// The corners of the triangle of the grid that holds a direction, with its barycentric weights
    /// there, which sum to 1. The cells of the grid are cut along their diagonals from the least to the
    /// greatest u and v.
    pub fn triangle(&self, direction: DVec3) -> [(usize, f64); 3] {
        let last = (self.side - 1) as f64;
        let at = (square_from_direction(direction, self.hemisphere) + 1.0) * (0.5 * last);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let cell = |at: f64| at.floor().clamp(0.0, last - 1.0) as usize;
        let (u, v) = (cell(at.x), cell(at.y));
        let inside = |at: f64, cell: usize| (at - cell as f64).clamp(0.0, 1.0);
        let (x, y) = (inside(at.x, u), inside(at.y, v));
        let frame = |u: usize, v: usize| v * self.side + u;
        let beside = if x >= y { frame(u + 1, v) } else { frame(u, v + 1) };
        [(frame(u, v), 1.0 - x.max(y)), (beside, (x - y).abs()), (frame(u + 1, v + 1), x.min(y))]
    }

    /// The frames of [`Grid::triangle`] that have weight, or the heaviest of them alone, which of equals
    /// is the one of lowest number. Weights sum to 1.
    pub fn frames(&self, direction: DVec3, nearest: bool) -> Vec<(usize, f64)> {
        let corners = self.triangle(direction);
        if nearest {
            let heavier =
                |a: &(usize, f64), b: &(usize, f64)| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0));
            let best = corners.into_iter().max_by(heavier).expect("three corners");
            return vec![(best.0, 1.0)];
        }
        let kept: Vec<_> =
            corners.into_iter().filter(|(_, weight)| *weight >= LEAST_WEIGHT).collect();
        let sum: f64 = kept.iter().map(|(_, weight)| weight).sum();
        kept.into_iter().map(|(frame, weight)| (frame, weight / sum)).collect()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn grid(side: usize, hemisphere: bool) -> Grid {
        Grid::new(side, hemisphere).expect("in range")
    }

    #[test]
    fn axes_and_corners_lie_where_they_should() {
        //  upper half:  -Z ---- +X      whole:  -Y  -- +Z --  -Y      u to the right, v up
        //                |  +Y  |                |   -X +Y +X  |
        //               -X ---- +Z              -Y  -- -Z --  -Y
        for (direction, half, whole) in [
            (DVec3::Y, [0.0, 0.0], [0.0, 0.0]),
            (DVec3::X, [1.0, 1.0], [1.0, 0.0]),
            (DVec3::NEG_X, [-1.0, -1.0], [-1.0, 0.0]),
            (DVec3::Z, [1.0, -1.0], [0.0, 1.0]),
            (DVec3::NEG_Z, [-1.0, 1.0], [0.0, -1.0]),
            // a face's middle: a third of each coordinate
            (DVec3::ONE, [2.0 / 3.0, 0.0], [1.0 / 3.0, 1.0 / 3.0]),
            // below +x +z: (1 - 1/3, 1 - 1/3)
            (DVec3::new(1.0, -1.0, 1.0), [1.0, 0.0], [2.0 / 3.0, 2.0 / 3.0]),
        ] {
            let found = [true, false].map(|half| square_from_direction(direction * 3.0, half));
            let error =
                (found[0] - DVec2::from(half)).length() + (found[1] - DVec2::from(whole)).length();
            assert!(error < 1e-15, "{direction}: {found:?}");
        }
        assert_eq!(square_from_direction(DVec3::NEG_Y, false), DVec2::ONE, "one of four corners");
        for corner in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]] {
            let down = direction_from_square(DVec2::from(corner), false);
            assert_eq!(down, DVec3::NEG_Y, "{corner:?}");
        }
    }

    #[test]
    fn a_grid_of_three_has_the_axes() {
        //  6 7 8      upper half: zenith in the middle, axes in the corners
        //  3 4 5      whole: axes in the middles of the rim, nadir in the corners
        //  0 1 2
        let half = grid(3, true);
        let axes =
            [(4, DVec3::Y), (8, DVec3::X), (2, DVec3::Z), (0, DVec3::NEG_X), (6, DVec3::NEG_Z)];
        for (frame, axis) in axes {
            assert!((half.direction(frame) - axis).length() < 1e-15, "{frame} of the upper half");
        }
        let between = DVec3::new(1.0, 0.0, 1.0).normalize();
        assert!((half.direction(5) - between).length() < 1e-15, "between +x and +z");
        assert_eq!(half.stand_ins(), (0..9).collect::<Vec<_>>(), "nothing twice");
        let whole = grid(3, false);
        let axes =
            [(4, DVec3::Y), (5, DVec3::X), (7, DVec3::Z), (3, DVec3::NEG_X), (1, DVec3::NEG_Z)];
        for (frame, axis) in axes {
            assert!((whole.direction(frame) - axis).length() < 1e-15, "{frame} of the whole");
        }
        assert_eq!(
            whole.stand_ins(),
            [0, 1, 0, 3, 4, 5, 0, 7, 0],
            "the nadir once: six directions"
        );
        // a rim of 12, of which the corners are one and the others are pairs
        let four = grid(4, false).stand_ins();
        let own = (0..16).filter(|&frame| four[frame] == frame).count();
        assert_eq!(own, 4 + 1 + 4, "inside, nadir, pairs");
    }

    #[test]
    fn weights_are_those_of_the_triangle() {
        // u = 1.25 and v = 1.75 on a grid of 3: the cell from (1, 1) to (2, 2), above its diagonal
        let at = |u: f64, v: f64| direction_from_square(DVec2::new(u - 1.0, v - 1.0), true);
        let found = grid(3, true).frames(at(1.25, 1.75), false);
        for (&(frame, weight), wanted) in found.iter().zip([(4, 0.25), (7, 0.5), (8, 0.25)]) {
            assert_eq!(frame, wanted.0, "{found:?}");
            assert!((weight - wanted.1).abs() < 1e-12, "{found:?}");
        }
        let nearest = grid(3, true).frames(at(1.25, 1.75), true);
        assert_eq!(nearest, [(7, 1.0)], "the heaviest alone");
        // half way between two frames the lower number wins; this is exact
        let tie = grid(2, true).frames(DVec3::new(1.0, 0.0, 1.0), true);
        assert_eq!(tie, [(1, 1.0)], "+z before +x");
        for frame in 0..9 {
            let alone = grid(3, true).frames(grid(3, true).direction(frame), false);
            assert_eq!(alone.len(), 1, "{alone:?}");
            assert_eq!(alone[0].0, frame, "a frame's own direction");
            assert!((alone[0].1 - 1.0).abs() < 1e-12, "whole");
        }
        let below = grid(3, true).frames(DVec3::new(3.0, -5.0, 0.0), false);
        assert_eq!(below, [(8, 1.0)], "below +x as at it");
    }

    #[test]
    fn counts_out_of_range_are_refused() {
        for (side, hemisphere) in [(0, true), (1, true), (65, true), (2, false)] {
            let text = Grid::new(side, hemisphere).expect_err("refused").to_string();
            assert!(text.starts_with("frame_count"), "{text}");
        }
    }

    fn direction() -> impl Strategy<Value = DVec3> {
        let part = || prop_oneof![-1.0..1.0_f64, Just(0.0), Just(1.0), Just(-1.0)];
        (part(), part(), part())
            .prop_map(|(x, y, z)| DVec3::new(x, y, z))
            .prop_filter("a direction", |v| v.length() > 1e-3)
            .prop_map(DVec3::normalize)
    }

    /// Weights of a direction, by the frames that stand for others.
    fn weights(grid: Grid, stand_ins: &[usize], direction: DVec3) -> Vec<f64> {
        let mut weights = vec![0.0; grid.frame_count()];
        for (frame, weight) in grid.triangle(direction) {
            weights[stand_ins[frame]] += weight;
        }
        weights
    }

    /// Largest change of a weight from a direction to one that is 1e-7 beside it.
    fn jump(grid: Grid, stand_ins: &[usize], direction: DVec3, aside: DVec3) -> f64 {
        let near = (direction + aside * 1e-7).normalize();
        let [a, b] = [direction, near].map(|at| weights(grid, stand_ins, at));
        a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn weights_do_not_jump_where_the_whole_is_folded() {
        // below +x, where the rim of the square has the same direction twice
        let direction = DVec3::new(0.936_822_136_401_652_2, -0.349_806_067_339_953_45, 0.0);
        let grid = grid(6, false);
        let alone: Vec<usize> = (0..grid.frame_count()).collect();
        let jumps = |stand_ins: &[usize]| {
            let sides = [DVec3::Z, DVec3::NEG_Z];
            sides
                .map(|aside| jump(grid, stand_ins, direction, aside))
                .into_iter()
                .fold(0.0, f64::max)
        };
        let most = jumps(&grid.stand_ins());
        assert!(most < 1e-5, "a jump of {most}");
        // the control: it is the frames that stand for others that close the fold
        let torn = jumps(&alone);
        assert!(torn > 0.1, "would be seen: {torn}");
    }

    proptest! {
        #[test]
        fn directions_survive_the_round_trip(direction in direction(), hemisphere: bool) {
            let square = square_from_direction(direction, hemisphere);
            prop_assert!(square.abs().max_element() <= 1.0 + 1e-15, "{}", square);
            let back = direction_from_square(square, hemisphere);
            let level = direction.with_y(0.0);
            if hemisphere && direction.y < 0.0 {
                // straight down has no horizon of its own
                prop_assume!(level.length() > 1e-6);
                prop_assert!((back - level.normalize()).length() < 1e-9, "{} for {}", back, direction);
            } else {
                prop_assert!((back - direction).length() < 1e-12, "{} for {}", back, direction);
            }
        }

        #[test]
        fn points_survive_the_round_trip(u in -1.0..=1.0_f64, v in -1.0..=1.0_f64, hemisphere: bool) {
            let at = DVec2::new(u, v);
            let direction = direction_from_square(at, hemisphere);
            prop_assert!((direction.length() - 1.0).abs() < 1e-12, "unit length");
            prop_assert!(!hemisphere || direction.y >= 0.0, "never below the horizon: {}", direction);
            let back = square_from_direction(direction, hemisphere);
            prop_assert!((back - at).length() < 1e-11, "{} for {}", back, at);
        }

        #[test]
        fn weights_sum_to_one_and_give_the_point_back(
            direction in direction(), side in 3..20_usize, hemisphere: bool,
        ) {
            let grid = grid(side, hemisphere);
            let triangle = grid.triangle(direction);
            let sum: f64 = triangle.iter().map(|(_, weight)| weight).sum();
            prop_assert!((sum - 1.0).abs() < 1e-12, "{}", sum);
            prop_assert!(triangle.iter().all(|(_, weight)| (0.0..=1.0).contains(weight)));
            let mean = triangle.iter().fold(DVec2::ZERO, |mean, &(frame, weight)| {
                let at = DVec2::new((frame % side) as f64, (frame / side) as f64);
                mean + at * weight
            });
            let at = (square_from_direction(direction, hemisphere) + 1.0) * (0.5 * (side - 1) as f64);
            prop_assert!((mean - at).length() < 1e-9, "{} for {}", mean, at);
        }

        #[test]
        fn weights_change_without_a_jump(
            direction in direction(), aside in direction(), side in 3..20_usize, hemisphere: bool,
        ) {
            let grid = grid(side, hemisphere);
            // who looks from straight below the upper half sees any horizon
            let level = direction.x.hypot(direction.z);
            prop_assume!(!hemisphere || direction.y >= 0.0 || level > 1e-2);
            // at most 1e-7 times the grid's steps a radian, and those near the horizon seen from below
            let most = jump(grid, &grid.stand_ins(), direction, aside);
            prop_assert!(most < 1e-7 * 400.0 * side as f64, "a jump of {}", most);
        }
    }
}
