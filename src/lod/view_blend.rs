//! Which of a plant's baked directions a view mixes, and in what shares.
//!
//! On the circle: the two directions that bracket the viewer's, each with the share of the arc on the
//! other one's side. On the sphere: the triangle of directions that holds the viewer's, with the
//! barycentric coordinates of the point where the ray leaves the triangle. A direction met exactly has
//! share 1, the middle of two 0.5.
//!
//! This work is based on:
//! Aleks Jakulin. Interactive Vegetation Rendering with Slicing and Blending. 2000

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::error::{LodError, check_finite};

/// Directions this far from horizontal still count as lying on the circle.
const LEVEL_TOLERANCE: f64 = 1e-9;

/// How far outside a triangle, in barycentric units, a ray may pass and still hit it: rounding.
const HIT_TOLERANCE: f64 = 1e-9;

/// Shares below this are rounding, not a second direction.
const MIN_SHARE: f64 = 1e-9;

/// Directions with the law that mixes them.
#[derive(Debug, Clone)]
pub struct ViewBlend {
    directions: Vec<DVec3>,
    law: Law,
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
        let level = units.iter().all(|unit| unit.y.abs() <= LEVEL_TOLERANCE);
        let law = if units.len() == 1 {
            Law::Single
        } else if level {
            let mut sorted: Vec<(usize, f64)> =
                units.iter().map(|&unit| azimuth(unit)).enumerate().collect();
            sorted.sort_by(|a, b| a.1.total_cmp(&b.1));
            Law::Circle(sorted)
        } else {
            let triangles = triangles.unwrap_or_default();
            if !surrounds(&units, &triangles) {
                let why = "must all be horizontal, or surround the plant on every side";
                return Err(invalid(why.to_owned()));
            }
            Law::Sphere(triangles)
        };
        Ok(Self { directions: units, law })
    }

    /// Unit directions, in the order given.
    pub fn directions(&self) -> &[DVec3] {
        &self.directions
    }

    /// Directions to mix towards a viewer, with shares that add up to 1: ascending share, the last
    /// is primary; of equal shares the lower index is primary. `up` decides where the viewer stands
    /// straight above or below a circle.
    pub fn shares(&self, toward: DVec3, up: DVec3) -> Vec<(usize, f64)> {
        let mut shares = match &self.law {
            Law::Single => vec![(0, 1.0)],
            Law::Circle(sorted) => on_circle(sorted, level_direction(toward, up)),
            Law::Sphere(triangles) => self.on_sphere(triangles, toward),
        };
        shares.retain(|&(_, share)| share > MIN_SHARE);
        shares.sort_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
        shares
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
        shares.iter_mut().for_each(|(_, share)| *share = share.max(0.0));
        let total: f64 = shares.iter().map(|(_, share)| share).sum();
        shares.iter_mut().for_each(|(_, share)| *share /= total);
        shares
    }
}

/// The horizontal part of a direction; straight above or below, what the picture's up points at.
fn level_direction(toward: DVec3, up: DVec3) -> DVec3 {
    let level = DVec3::new(toward.x, 0.0, toward.z);
    if level.length() >= 1e-6 * toward.length() {
        return level;
    }
    // Tipping the camera down from the horizon to straight down turns what was ahead into up, so
    // the viewer came from where up points away from; seen from below it is the other way round.
    let up = DVec3::new(up.x, 0.0, up.z);
    if toward.y > 0.0 { -up } else { up }
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
        triangles.pop();
        let open = ViewBlend::new(&axes, Some(triangles));
        assert!(open.is_err(), "a side is missing");
        assert!(ViewBlend::new(&axes, None).is_err(), "neither level nor closed");
    }

    #[test]
    fn bad_directions_are_refused() {
        for bad in [vec![], vec![DVec3::ZERO], vec![DVec3::NAN], vec![DVec3::X, DVec3::X * 2.0]] {
            let message = ViewBlend::new(&bad, None).expect_err("bad").to_string();
            assert!(message.starts_with("orientations"), "{bad:?}: {message}");
        }
    }
}
