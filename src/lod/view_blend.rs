//! Which of a plant's baked directions a view mixes, and in what shares.
//!
//! On the circle: the two directions that bracket the viewer's, each with the share of the arc on the
//! other one's side. On the sphere: the triangle of directions that holds the viewer's, with the
//! barycentric coordinates of the point where the ray leaves the triangle. A direction met exactly has
//! share 1, the middle of two 0.5.
//!
//! This work is based on:
//! Aleks Jakulin. Interactive Vegetation Rendering with Slicing and Blending. 2000

use std::cmp::Reverse;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec3;

use crate::error::{LodError, check_finite};

/// Directions this far from horizontal still count as lying on the circle.
const LEVEL_TOLERANCE: f64 = 1e-9;

/// A ray at least this far inside a triangle, in barycentric units, hits no other one.
const HIT_TOLERANCE: f64 = 1e-9;

/// Shares below this are rounding, not a second direction.
const MIN_SHARE: f64 = 1e-9;

/// Shares that differ by less than this are equal: half way between two directions neither share is
/// exactly one half.
const TIE: f64 = 1e-9;

/// Least volume of three unit directions and the centre that still are a side of the sphere; a
/// triangle through the centre has none, and a ray through it no barycentric coordinates.
const MIN_VOLUME: f64 = 1e-9;

/// Directions with the law that mixes them.
#[derive(Debug, Clone)]
pub struct ViewBlend {
    directions: Vec<DVec3>,
    law: Law,
    /// Whether the last direction is up and stands for all elevations.
    vertical: bool,
}

#[derive(Debug, Clone)]
enum Law {
    /// One direction is all there is.
    Single,
    /// Indices and azimuths, sorted by azimuth.
    Circle(Vec<(usize, f64)>),
    /// Triangles of indices that close the sphere.
    Sphere(Vec<[u32; 3]>),
}

/// Azimuth of a direction: 0 towards +z, counter-clockwise from above, in [0, 2 pi).
pub fn azimuth(direction: DVec3) -> f64 {
    let angle = libm::atan2(direction.x, direction.z);
    if angle < 0.0 { angle + TAU } else { angle }
}

/// `count` directions evenly on the horizontal circle, from +z, counter-clockwise from above.
pub fn circle(count: usize) -> Vec<DVec3> {
    (0..count)
        .map(|index| {
            let angle = index as f64 * TAU / count as f64;
            DVec3::new(libm::sin(angle), 0.0, libm::cos(angle))
        })
        .collect()
}

/// `count` directions evenly on the sphere: a Fibonacci lattice.
pub fn sphere(count: usize) -> Vec<DVec3> {
    let golden = PI * (3.0 - 5.0_f64.sqrt());
    (0..count)
        .map(|index| {
            let y = 1.0 - (2.0 * index as f64 + 1.0) / count as f64;
            let across = (1.0 - y * y).sqrt();
            let angle = golden * index as f64;
            DVec3::new(across * libm::sin(angle), y, across * libm::cos(angle))
        })
        .collect()
}

impl ViewBlend {
    /// Takes directions of any length. `triangles` closes the sphere around them and is left out
    /// where all are horizontal, or where there is only one.
    ///
    /// # Errors
    /// [`LodError::Invalid`] under `orientations`: none, a zero vector, two equal ones, or some that
    /// are not horizontal without triangles that surround the plant.
    pub fn new(directions: &[DVec3], triangles: Option<Vec<[u32; 3]>>) -> Result<Self, LodError> {
        check_finite("orientations", directions)?;
        let invalid = |why: String| LodError::Invalid { name: "orientations", why };
        if directions.is_empty() {
            return Err(LodError::Empty { name: "orientations", why: "at least one is needed" });
        }
        let units: Vec<DVec3> = directions.iter().map(|d| d.normalize_or_zero()).collect();
        if let Some(index) = units.iter().position(|&unit| unit == DVec3::ZERO) {
            return Err(invalid(format!("orientation {index} is the zero vector")));
        }
        for (index, a) in units.iter().enumerate() {
            if let Some(other) = units[..index].iter().position(|b| a.distance(*b) < 1e-6) {
                return Err(invalid(format!("orientations {other} and {index} are equal")));
            }
        }
        let mut blend = Self { directions: units, law: Law::Single, vertical: false };
        let units = &blend.directions;
        blend.law = if units.len() == 1 {
            Law::Single
        } else if blend.is_level() {
            let mut sorted: Vec<(usize, f64)> =
                units.iter().map(|&unit| azimuth(unit)).enumerate().collect();
            sorted.sort_by(|a, b| a.1.total_cmp(&b.1));
            Law::Circle(sorted)
        } else {
            let triangles = triangles.unwrap_or_default();
            if !surrounds(units, &triangles) {
                let why = "must all be horizontal, or surround the plant on every side";
                return Err(invalid(why.to_owned()));
            }
            Law::Sphere(triangles)
        };
        Ok(blend)
    }

    /// The same directions, all horizontal, and up: the share of up grows with the angle above or
    /// below the horizon, from 0 there to 1 straight above and below.
    ///
    /// # Errors
    /// [`LodError::Invalid`] under `vertical` if a direction is not horizontal.
    pub fn with_vertical(mut self) -> Result<Self, LodError> {
        if !self.is_level() {
            let why = "is for orientations that are all horizontal".to_owned();
            return Err(LodError::Invalid { name: "vertical", why });
        }
        self.directions.push(DVec3::Y);
        self.vertical = true;
        Ok(self)
    }

    /// Unit directions, in the order given; up comes last where it was added.
    pub fn directions(&self) -> &[DVec3] {
        &self.directions
    }

    /// Whether up was added to directions that are all horizontal.
    pub fn is_vertical(&self) -> bool {
        self.vertical
    }

    /// Whether all directions are horizontal.
    pub fn is_level(&self) -> bool {
        self.directions.iter().all(|unit| unit.y.abs() <= LEVEL_TOLERANCE)
    }

    /// Directions to mix towards a viewer, with shares that add up to 1: ascending share, the last
    /// is primary; of equal shares the lower index is primary. `up` decides where the viewer stands
    /// straight above or below a circle; a viewer at the centre counts as standing at azimuth 0, and
    /// so does one above or below whose picture's up is vertical too.
    pub fn shares(&self, toward: DVec3, up: DVec3) -> Vec<(usize, f64)> {
        let mut shares = match &self.law {
            Law::Single => vec![(0, 1.0)],
            Law::Circle(sorted) => on_circle(sorted, level_direction(toward, up)),
            Law::Sphere(triangles) => self.on_sphere(triangles, toward),
        };
        if self.vertical {
            let elevation = libm::atan2(toward.y.abs(), toward.x.hypot(toward.z));
            let of_up = elevation / FRAC_PI_2;
            shares.iter_mut().for_each(|(_, share)| *share *= 1.0 - of_up);
            shares.push((self.directions.len() - 1, of_up));
        }
        ordered(shares)
    }

    /// Largest angle, along the horizon where all directions lie there, between a viewer and the
    /// nearest direction.
    pub fn largest_angle(&self) -> f64 {
        match &self.law {
            Law::Single => PI,
            Law::Circle(sorted) => {
                let next = sorted.iter().cycle().skip(1);
                let arcs = sorted.iter().zip(next).map(|(a, b)| (b.1 - a.1).rem_euclid(TAU));
                arcs.fold(0.0, f64::max) / 2.0
            }
            Law::Sphere(triangles) => {
                let angle = |triangle: &[u32; 3]| {
                    let [a, b, c] = triangle.map(|index| self.directions[index as usize]);
                    let middle = (b - a).cross(c - a).normalize_or_zero();
                    libm::acos(middle.dot(a).abs().min(1.0))
                };
                triangles.iter().map(angle).fold(0.0, f64::max)
            }
        }
    }

    fn on_sphere(&self, triangles: &[[u32; 3]], toward: DVec3) -> Vec<(usize, f64)> {
        // rounding may leave a ray on an edge outside both triangles: the least outside wins
        let mut best = (f64::NEG_INFINITY, Vec::new());
        for triangle in triangles {
            let corners = triangle.map(|index| self.directions[index as usize]);
            let Some(weights) = barycentric(corners, toward) else { continue };
            let inside = weights.iter().copied().fold(f64::INFINITY, f64::min);
            if inside > best.0 {
                let pairs = triangle.iter().map(|&index| index as usize).zip(weights);
                best = (inside, pairs.collect());
            }
            if inside >= HIT_TOLERANCE {
                break;
            }
        }
        let mut shares: Vec<(usize, f64)> = best.1;
        if shares.is_empty() {
            // no direction at all: the viewer stands at the centre
            return self.on_sphere(triangles, DVec3::Z);
        }
        shares.iter_mut().for_each(|(_, share)| *share = share.max(0.0));
        let total: f64 = shares.iter().map(|(_, share)| share).sum();
        shares.iter_mut().for_each(|(_, share)| *share /= total);
        shares
    }
}

/// Shares in the order in which they are drawn: ascending, of equal ones the higher index first; without
/// those that are nothing but rounding.
pub(crate) fn ordered(mut shares: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    shares.retain(|&(_, share)| share > MIN_SHARE);
    if let [(_, share)] = &mut shares[..] {
        *share = 1.0;
    }
    shares.sort_by(|a, b| a.1.total_cmp(&b.1));
    for equals in shares.chunk_by_mut(|a, b| b.1 - a.1 < TIE) {
        equals.sort_by_key(|&(number, _)| Reverse(number));
    }
    shares
}

/// The horizontal part of a direction; straight above or below, what the picture's up points at.
pub(crate) fn level_direction(toward: DVec3, up: DVec3) -> DVec3 {
    let level = DVec3::new(toward.x, 0.0, toward.z);
    if level.length() >= 1e-6 * toward.length() && toward != DVec3::ZERO {
        return level;
    }
    // Tipping the camera down from the horizon to straight down turns what was ahead into up, so
    // the viewer came from where up points away from; seen from below it is the other way round.
    let up = DVec3::new(up.x, 0.0, up.z);
    if toward == DVec3::ZERO || up.length() < 1e-6 {
        DVec3::Z
    } else if toward.y > 0.0 {
        -up
    } else {
        up
    }
}

fn on_circle(sorted: &[(usize, f64)], toward: DVec3) -> Vec<(usize, f64)> {
    let angle = azimuth(toward);
    let after = sorted.partition_point(|&(_, azimuth)| azimuth <= angle);
    let count = sorted.len();
    let (before, before_azimuth) = sorted[(after + count - 1) % count];
    let (next, next_azimuth) = sorted[after % count];
    let from_before = (angle - before_azimuth).rem_euclid(TAU);
    let to_next = (next_azimuth - angle).rem_euclid(TAU);
    let arc = from_before + to_next;
    vec![(before, to_next / arc), (next, from_before / arc)]
}

/// Barycentric coordinates of the point where a ray from the centre meets a triangle's plane.
fn barycentric([a, b, c]: [DVec3; 3], ray: DVec3) -> Option<[f64; 3]> {
    let weights = [ray.dot(b.cross(c)), ray.dot(c.cross(a)), ray.dot(a.cross(b))];
    let volume = a.dot(b.cross(c));
    let signed = weights.map(|weight| weight * volume.signum());
    let total: f64 = signed.iter().sum();
    // the plane lies on the other side, or the ray runs along it
    (total > 0.0).then(|| signed.map(|weight| weight / total))
}

/// Whether every direction hits a triangle: the solid angles of all triangles add up to a sphere.
fn surrounds(directions: &[DVec3], triangles: &[[u32; 3]]) -> bool {
    let mut total = 0.0;
    for triangle in triangles {
        if triangle.iter().any(|&index| index as usize >= directions.len()) {
            return false;
        }
        let [a, b, c] = triangle.map(|index| directions[index as usize]);
        let volume = a.dot(b.cross(c)).abs();
        if volume < MIN_VOLUME {
            return false;
        }
        let edges = 1.0 + a.dot(b) + b.dot(c) + c.dot(a);
        total += 2.0 * libm::atan2(volume, edges);
    }
    (total - 4.0 * PI).abs() < 1e-6
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(degrees: f64) -> DVec3 {
        let angle = degrees.to_radians();
        DVec3::new(angle.sin(), 0.3, angle.cos())
    }

    fn shares(blend: &ViewBlend, toward: DVec3) -> Vec<(usize, f64)> {
        let rounded = |share: f64| (share * 1e9).round() / 1e9;
        blend.shares(toward, DVec3::Y).into_iter().map(|(i, s)| (i, rounded(s))).collect()
    }

    #[test]
    fn the_pair_on_the_circle_follows_the_arc() {
        //   directions at 0, 60, 120, ... 300 degrees
        let blend = ViewBlend::new(&circle(6), None).expect("even circle");
        assert_eq!(shares(&blend, at(0.0)), [(0, 1.0)], "on a direction");
        assert_eq!(
            shares(&blend, at(30.0)),
            [(1, 0.5), (0, 0.5)],
            "half way: the lower is primary"
        );
        assert_eq!(shares(&blend, at(15.0)), [(1, 0.25), (0, 0.75)], "a quarter");
        assert_eq!(shares(&blend, at(345.0)), [(5, 0.25), (0, 0.75)], "across 0");
        assert_eq!(shares(&blend, at(330.0)), [(5, 0.5), (0, 0.5)], "half way across 0");
        assert_eq!(shares(&blend, at(180.0)), [(3, 1.0)], "opposite");
    }

    #[test]
    fn uneven_circles_measure_along_the_arc() {
        let directions = [at(0.0), at(90.0)].map(|d| DVec3::new(d.x, 0.0, d.z));
        let blend = ViewBlend::new(&directions, None).expect("two");
        assert_eq!(shares(&blend, at(22.5)), [(1, 0.25), (0, 0.75)], "the short arc");
        // the long arc from 90 to 360 is 270 degrees
        assert_eq!(shares(&blend, at(180.0)), [(0, 0.333_333_333), (1, 0.666_666_667)], "a third");
    }

    #[test]
    fn straight_above_the_pictures_up_decides() {
        let blend = ViewBlend::new(&circle(4), None).expect("even circle");
        let above = blend.shares(DVec3::Y, DVec3::NEG_Z);
        assert_eq!(above, [(0, 1.0)], "up is -z: as from +z with the head bent");
        let below = blend.shares(DVec3::NEG_Y, DVec3::NEG_Z);
        assert_eq!(below, [(2, 1.0)], "from below the other way round");
    }

    #[test]
    fn one_direction_takes_all() {
        let blend = ViewBlend::new(&[DVec3::new(0.0, 2.0, 0.0)], None).expect("one");
        assert_eq!(blend.shares(DVec3::NEG_Y, DVec3::X), [(0, 1.0)], "from anywhere");
    }

    #[test]
    fn up_takes_over_with_the_elevation() {
        let blend = ViewBlend::new(&circle(4), None).and_then(ViewBlend::with_vertical);
        let blend = blend.expect("level");
        assert_eq!(blend.directions().last(), Some(&DVec3::Y), "the fifth");
        assert_eq!(shares(&blend, DVec3::Z), [(0, 1.0)], "level");
        assert_eq!(shares(&blend, DVec3::new(0.0, 3.0, 3.0)), [(4, 0.5), (0, 0.5)], "45 degrees");
        let thirds = DVec3::new(0.0, -1.0, 3.0_f64.sqrt());
        let third = 0.333_333_333;
        assert_eq!(shares(&blend, thirds), [(4, third), (0, 0.666_666_667)], "30 degrees below");
        let between = DVec3::new(1.0, 2.0_f64.sqrt(), 1.0);
        assert_eq!(shares(&blend, between), [(1, 0.25), (0, 0.25), (4, 0.5)], "three of them");
        for pole in [DVec3::Y, DVec3::NEG_Y] {
            assert_eq!(blend.shares(pole, DVec3::NEG_Z), [(4, 1.0)], "alone at {pole}");
        }
        assert_eq!(blend.shares(DVec3::ZERO, DVec3::Y), [(0, 1.0)], "from the centre: level");
        let single = ViewBlend::new(&[DVec3::X], None).and_then(ViewBlend::with_vertical);
        let single = single.expect("level");
        assert_eq!(shares(&single, DVec3::new(0.0, 1.0, 1.0)), [(1, 0.5), (0, 0.5)], "and one");
        let steep = ViewBlend::new(&[DVec3::ONE], None).expect("one").with_vertical();
        assert!(steep.expect_err("not level").to_string().starts_with("vertical"), "refused");
    }

    #[test]
    fn the_largest_angle_is_half_the_widest_gap() {
        let blend = |directions: &[DVec3]| ViewBlend::new(directions, None).expect("level");
        let degrees = |blend: &ViewBlend| blend.largest_angle().to_degrees();
        assert!((degrees(&blend(&circle(6))) - 30.0).abs() < 1e-9, "six");
        assert!((degrees(&blend(&[DVec3::Z, DVec3::X])) - 135.0).abs() < 1e-9, "two of four");
        assert!((degrees(&blend(&[DVec3::Z])) - 180.0).abs() < 1e-9, "one");
        let axes = [DVec3::X, DVec3::Y, DVec3::Z, DVec3::splat(-1.0)];
        let triangles = vec![[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];
        let closed = ViewBlend::new(&axes, Some(triangles)).expect("closed");
        // the widest is around (a, a, -c), as far from x and y as from -(1, 1, 1)
        let middle = DVec3::new(1.0, 1.0, -2.0 - 3.0_f64.sqrt()).normalize();
        let wanted = libm::acos(middle.x).to_degrees();
        assert!((degrees(&closed) - wanted).abs() < 1e-9, "{} for {wanted}", degrees(&closed));
    }

    #[test]
    fn on_the_sphere_three_directions_share() {
        // an octahedron: +x -x +y -y +z -z
        let axes = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z];
        let mut triangles = Vec::new();
        for x in [0, 1] {
            for y in [2, 3] {
                for z in [4, 5] {
                    triangles.push([x, y, z]);
                }
            }
        }
        let blend = ViewBlend::new(&axes, Some(triangles.clone())).expect("closed");
        assert_eq!(shares(&blend, DVec3::X * 9.0), [(0, 1.0)], "on a direction");
        let diagonal = shares(&blend, DVec3::new(1.0, -1.0, 1.0));
        let third = 0.333_333_333;
        assert_eq!(diagonal, [(4, third), (3, third), (0, third)], "a face's middle");
        assert_eq!(shares(&blend, DVec3::new(3.0, 1.0, 0.0)), [(2, 0.25), (0, 0.75)], "an edge");
        let edge = blend.shares(DVec3::new(0.0, 0.3, -0.3), DVec3::Y);
        let places: Vec<usize> = edge.iter().map(|&(index, _)| index).collect();
        assert_eq!(places, [5, 2], "half way on an edge: the lower is primary");
        assert_eq!(blend.shares(DVec3::ZERO, DVec3::Y), [(4, 1.0)], "from the centre: as from +z");
        triangles.pop();
        let open = ViewBlend::new(&axes, Some(triangles));
        assert!(open.is_err(), "a side is missing");
        assert!(ViewBlend::new(&axes, None).is_err(), "neither level nor closed");
    }

    #[test]
    fn equal_shares_go_to_the_lower_index_despite_rounding() {
        for count in [2, 3, 5, 6, 7, 12, 36] {
            let blend = ViewBlend::new(&circle(count), None).expect("even circle");
            for number in 0..count {
                let next = (number + 1) % count;
                let middle = (number as f64 + 0.5) * TAU / count as f64;
                let toward = DVec3::new(libm::sin(middle), -0.2, libm::cos(middle)) * 37.0;
                let order: Vec<usize> =
                    blend.shares(toward, DVec3::Y).iter().map(|&(index, _)| index).collect();
                assert_eq!(order, [number.max(next), number.min(next)], "{number} of {count}");
                let onto = blend.shares(blend.directions()[number] * 3.0, DVec3::Y);
                assert_eq!(onto, [(number, 1.0)], "exactly on {number} of {count}");
            }
        }
    }

    #[test]
    fn shares_are_continuous_and_add_up_to_one() {
        let (five, wide) = (circle(5), [at(10.0), at(40.0), at(300.0)]);
        let level = wide.map(|d| DVec3::new(d.x, 0.0, d.z)).to_vec();
        for directions in [five, level] {
            let blend = ViewBlend::new(&directions, None).expect("level");
            let of = |degrees: f64| {
                let mut shares = vec![0.0; directions.len()];
                for (index, share) in blend.shares(at(degrees), DVec3::Y) {
                    shares[index] = share;
                }
                shares
            };
            for tenth in 0..3600 {
                let (here, there) = (of(f64::from(tenth) / 10.0), of(f64::from(tenth + 1) / 10.0));
                assert!((here.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{tenth}: {here:?}");
                let step = here.iter().zip(&there).map(|(a, b)| (a - b).abs());
                // 0.1 degrees of an arc of 30 or more
                assert!(step.fold(0.0, f64::max) < 0.1 / 29.0, "{tenth}: {here:?} to {there:?}");
            }
        }
    }

    #[test]
    fn where_nothing_is_level_azimuth_0_is_taken() {
        let blend = ViewBlend::new(&circle(4), None).expect("even circle");
        for up in [DVec3::Y, DVec3::NEG_Y, DVec3::new(-0.0, 1.0, -0.0)] {
            assert_eq!(blend.shares(DVec3::Y, up), [(0, 1.0)], "above, {up} is up");
            assert_eq!(blend.shares(DVec3::NEG_Y, up), [(0, 1.0)], "below, {up} is up");
            assert_eq!(blend.shares(DVec3::ZERO, up), [(0, 1.0)], "at the centre");
        }
    }

    #[test]
    fn half_a_sphere_does_not_surround() {
        // the square below passes through the centre: from there no triangle has a side to show
        let axes = [DVec3::X, -DVec3::X, DVec3::Z, -DVec3::Z, DVec3::Y];
        let roof = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4]];
        let floor = [[0, 1, 2], [0, 1, 3]];
        let closed = roof.iter().chain(&floor).copied().collect();
        assert!(ViewBlend::new(&axes, Some(closed)).is_err(), "with a floor");
        assert!(ViewBlend::new(&axes, Some(roof.to_vec())).is_err(), "without one");
    }

    #[test]
    fn the_lattice_lies_on_the_sphere() {
        for count in [1, 4, 36] {
            let lattice = sphere(count);
            assert_eq!(lattice.len(), count, "as many as asked for");
            assert!(lattice.iter().all(|d| (d.length() - 1.0).abs() < 1e-12), "unit length");
            let mean = lattice.iter().sum::<DVec3>() / count as f64;
            assert!(mean.y.abs() < 1e-12, "as many above as below: {mean}");
        }
    }

    #[test]
    fn bad_directions_are_refused() {
        for bad in [vec![], vec![DVec3::ZERO], vec![DVec3::NAN], vec![DVec3::X, DVec3::X * 2.0]] {
            let message = ViewBlend::new(&bad, None).expect_err("bad").to_string();
            assert!(message.starts_with("orientations"), "{bad:?}: {message}");
        }
    }
}
