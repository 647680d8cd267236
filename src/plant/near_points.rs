//! Which of many labelled points is nearest to a place: a tree of halved boxes.
//!
//! Of points equally far, the lower label counts, so the answer does not depend on how the tree was
//! built. O(n log n) to build; a look visits about log n boxes.
//!
//! This work is based on:
//! Jon Louis Bentley. Multidimensional binary search trees used for associative searching. 1975

use glam::{DVec3, Vec3};

use crate::error::LodError;
use crate::job::Job;

/// Points that are looked at one by one.
const BUCKET: usize = 8;

/// The job is looked at before so many points are parted.
const POINTS_PER_CHECK: usize = 1 << 14;

/// A point and what it belongs to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Labelled {
    pub(crate) position: Vec3,
    pub(crate) label: u32,
}

/// A box of points.
#[derive(Debug, Clone)]
struct Node {
    low: Vec3,
    high: Vec3,
    /// Lowest label inside.
    least_label: u32,
    /// Its two halves; `None` for a bucket.
    halves: Option<[usize; 2]>,
    start: usize,
    end: usize,
}

/// Labelled points, ready to be looked through.
#[derive(Debug, Clone)]
pub(crate) struct NearPoints {
    points: Vec<Labelled>,
    nodes: Vec<Node>,
}

impl NearPoints {
    /// Sorts points, at least one.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub(crate) fn new(mut points: Vec<Labelled>, job: &Job) -> Result<Self, LodError> {
        assert!(!points.is_empty(), "nothing is nearest to nowhere");
        let mut nodes = Vec::new();
        let count = points.len();
        halve(&mut points, 0, count, &mut nodes, job)?;
        Ok(Self { points, nodes })
    }

    /// Distance and label of the nearest point whose label is below `end`.
    pub(crate) fn nearest(&self, place: DVec3, end: u32) -> Option<(f64, u32)> {
        let mut best: Option<(f64, u32)> = None;
        let mut open = vec![(0, self.nodes[0].distance_sq(place))];
        while let Some((number, distance_sq)) = open.pop() {
            let node = &self.nodes[number];
            if node.least_label >= end || best.is_some_and(|best| distance_sq > best.0) {
                continue;
            }
            let Some(halves) = node.halves else {
                for point in &self.points[node.start..node.end] {
                    let found = (point.position.as_dvec3().distance_squared(place), point.label);
                    if point.label < end && best.is_none_or(|best| found < best) {
                        best = Some(found);
                    }
                }
                continue;
            };
            let mut both = halves.map(|half| (half, self.nodes[half].distance_sq(place)));
            // the nearer one on top
            if both[0].1 < both[1].1 {
                both.swap(0, 1);
            }
            open.extend(both);
        }
        best.map(|(distance_sq, label)| (distance_sq.sqrt(), label))
    }
}

impl Node {
    /// From the nearest place in its box.
    fn distance_sq(&self, place: DVec3) -> f64 {
        place.clamp(self.low.as_dvec3(), self.high.as_dvec3()).distance_squared(place)
    }
}

/// Adds the node of a range of points and those below it; gives its number.
fn halve(
    points: &mut [Labelled],
    start: usize,
    end: usize,
    nodes: &mut Vec<Node>,
    job: &Job,
) -> Result<usize, LodError> {
    if end - start >= POINTS_PER_CHECK {
        job.check()?;
    }
    let inside = &mut points[start..end];
    let none = (Vec3::INFINITY, Vec3::NEG_INFINITY, u32::MAX);
    let (low, high, least_label) = inside.iter().fold(none, |(low, high, least), point| {
        (low.min(point.position), high.max(point.position), least.min(point.label))
    });
    let number = nodes.len();
    nodes.push(Node { low, high, least_label, halves: None, start, end });
    if inside.len() > BUCKET {
        let axis = (high - low).max_position();
        let middle = inside.len() / 2;
        inside.select_nth_unstable_by(middle, |a, b| {
            a.position[axis].total_cmp(&b.position[axis]).then(a.label.cmp(&b.label))
        });
        let middle = start + middle;
        let first = halve(points, start, middle, nodes, job)?;
        let second = halve(points, middle, end, nodes, job)?;
        nodes[number].halves = Some([first, second]);
    }
    Ok(number)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_nearest_and_of_equals_the_lower_label() {
        let point = |x: f32, label| Labelled { position: Vec3::X * x, label };
        let points = vec![point(3.0, 7), point(1.0, 5), point(-1.0, 2)];
        let points = NearPoints::new(points, &Job::default()).expect("runs");
        assert_eq!(points.nearest(DVec3::X * 2.5, 9), Some((0.5, 7)), "the nearest");
        assert_eq!(points.nearest(DVec3::X * 2.5, 7), Some((1.5, 5)), "below 7");
        assert_eq!(points.nearest(DVec3::ZERO, 9), Some((1.0, 2)), "equally far");
        assert_eq!(points.nearest(DVec3::ZERO, 2), None, "none below");
    }

    proptest! {
        #[test]
        fn as_found_one_by_one(
            places in prop::collection::vec((-4_i8..5, -4_i8..5, -4_i8..5), 1..200),
            at in (-5_i8..6, -5_i8..6, -5_i8..6),
            end in 1_u32..8,
        ) {
            let vector = |(x, y, z): (i8, i8, i8)| Vec3::new(x.into(), y.into(), z.into());
            let labelled = (0_u32..).zip(places).map(|(number, place)| Labelled {
                position: vector(place), label: number * 5 % 8,
            });
            let points: Vec<Labelled> = labelled.collect();
            let place = vector(at).as_dvec3();
            let below = points.iter().filter(|point| point.label < end);
            let all = below.map(|p| (p.position.as_dvec3().distance_squared(place), p.label));
            let expected = all.min_by(|a, b| a.partial_cmp(b).expect("finite"));
            let expected = expected.map(|(distance_sq, label)| (distance_sq.sqrt(), label));
            let points = NearPoints::new(points, &Job::default()).expect("runs");
            prop_assert_eq!(points.nearest(place, end), expected);
        }
    }
}
