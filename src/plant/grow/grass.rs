//! A tuft of grass: blades that rise from the ground and bend over, and nothing else.

use glam::DVec3;

use crate::error::LodError;
use crate::job::Job;
use crate::plant::Mesh;
use crate::plant::grow::Grown;
use crate::plant::grow::blade::Elements;
use crate::plant::grow::params::Vary;
use crate::plant::grow::turn::{around_axis, turn};
use crate::random::{Purpose, Stream};

const BLADE: Purpose = Purpose::named("grow.grass");

/// Half widths along a blade as shares of the largest; it ends in a point.
const HALF_WIDTHS: [f64; 5] = [0.7, 0.95, 1.0, 0.8, 0.5];

/// Left and right at each width, then the tip.
const TRIANGLES: [[u8; 3]; 9] = [
    [0, 1, 3],
    [0, 3, 2],
    [2, 3, 5],
    [2, 5, 4],
    [4, 5, 7],
    [4, 7, 6],
    [6, 7, 9],
    [6, 9, 8],
    [8, 9, 10],
];

/// A blade bends less until no part of it comes lower than this share of its length.
const LOWEST: f64 = 0.1;
const STRAIGHTEN: f64 = 0.8;

/// What a tuft is made of. Lengths in metres, angles in degrees.
#[derive(Debug)]
pub(super) struct Tuft {
    pub(super) name: &'static str,
    pub(super) blade_count: usize,
    /// Of the ground that blades rise from.
    pub(super) radius: f64,
    pub(super) length: Vary,
    pub(super) width: f64,
    /// Angle to the vertical at the ground of a blade at the rim.
    pub(super) lean: f64,
    /// By how much a blade bends over, in all.
    pub(super) bend: Vary,
    pub(super) color: [f64; 3],
    pub(super) other_color: [f64; 3],
    /// Of blades that have dried, and how many those are, as a share.
    pub(super) dry: ([f64; 3], f64),
}

/// A tuft of `blade_count` blades.
///
/// # Errors
/// [`LodError::Cancelled`].
pub(super) fn tuft(
    tuft: &Tuft,
    seed: u64,
    blade_count: usize,
    job: &Job,
) -> Result<Grown, LodError> {
    // more blades than usual are smaller ones, as leaves are
    let scale = (tuft.blade_count as f64 / blade_count as f64).min(1.0).sqrt();
    let mut foliage = Elements::new();
    job.begin(blade_count as u64);
    for id in 0..blade_count {
        job.check()?;
        add_blade(tuft, scale, Stream::new(seed, BLADE, id as u64), &mut foliage);
        job.advance();
    }
    Ok(Grown {
        stems: Vec::new(),
        wood: Mesh::default(),
        wood_ranges: Vec::new(),
        foliage,
        materials: &["leaves"],
        petals: 0..0,
    })
}

fn add_blade(tuft: &Tuft, scale: f64, mut stream: Stream, out: &mut Elements) {
    let from_middle = stream.unit().sqrt();
    let around = stream.unit() * std::f64::consts::TAU;
    let foot = around_axis(DVec3::Y, DVec3::X, around) * (from_middle * tuft.radius);
    let outward = around_axis(DVec3::Y, DVec3::X, around + 0.9 * stream.signed());
    let right = outward.cross(DVec3::Y);
    let length = tuft.length.at(stream.signed()) * scale * (1.0 - 0.25 * from_middle);
    let lean = (tuft.lean * (0.15 + from_middle) + 6.0 * stream.signed()).to_radians();
    let mut bend = tuft.bend.at(stream.signed()).max(5.0).to_radians();
    let twist = 0.5 * stream.signed();
    let mut axis = axis_of(foot, outward, length, lean, bend);
    while axis[1..].iter().any(|(point, _)| point.y < LOWEST * length) {
        bend *= STRAIGHTEN;
        axis = axis_of(foot, outward, length, lean, bend);
    }
    let mut points = Vec::with_capacity(2 * HALF_WIDTHS.len() + 1);
    let half = 0.5 * tuft.width * scale * (1.0 + 0.3 * stream.signed());
    for (k, (&(point, direction), share)) in axis.iter().zip(HALF_WIDTHS).enumerate() {
        // flat on the ground, turned a little more at each step
        let across = if k == 0 {
            right
        } else {
            turn(right, direction, twist * k as f64 / HALF_WIDTHS.len() as f64)
        };
        points.extend([point - across * (half * share), point + across * (half * share)]);
    }
    points.push(axis[HALF_WIDTHS.len()].0);

    let other = stream.unit();
    let is_dry = stream.unit() < tuft.dry.1;
    let color = DVec3::from(tuft.color).lerp(DVec3::from(tuft.other_color), other);
    let color = if is_dry { DVec3::from(tuft.dry.0) } else { color };
    let color = color * (1.0 + 0.15 * stream.signed());
    // paler and darker at the foot, where the sheaths are
    let shade = |k: usize| 0.55 + 0.5 * (k / 2) as f64 / HALF_WIDTHS.len() as f64;
    let colors = (0..points.len()).map(|k| color * shade(k));
    out.push_points(0, &points, &TRIANGLES, outward, colors);
}

/// Points and directions along a blade.
fn axis_of(foot: DVec3, outward: DVec3, length: f64, lean: f64, bend: f64) -> Vec<(DVec3, DVec3)> {
    let steps = HALF_WIDTHS.len();
    let mut point = foot;
    let mut axis = Vec::with_capacity(steps + 1);
    for step in 0..=steps {
        let along = step as f64 / steps as f64;
        // more and more towards the tip, as a blade is stiffest at its foot
        let angle = lean + bend * along * (0.3 + 0.7 * along);
        let direction = DVec3::Y * libm::cos(angle) + outward * libm::sin(angle);
        axis.push((point, direction));
        point += direction * (length / steps as f64);
    }
    axis
}
