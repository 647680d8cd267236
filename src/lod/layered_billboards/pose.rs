//! How layers move: in the wind by forward kinematics, and towards a viewer about their anchors.
//!
//! A layer turns about its anchor in its own plane, or is sheared there, and everything that grows from
//! it goes with it: its place is that of its parent times its own motion. With no wind every motion is
//! the identity, to the bit.
//!
//! This work is based on:
//! Daniel Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming. 2003 (chapter 20)

use glam::{DAffine3, DMat3, DVec3};

use crate::lod::Crown;
use crate::lod::layered_billboards::frame::Frame;
use crate::lod::wind::Gust;
use crate::random::{Purpose, Stream};
use crate::view::View;

const PHASE: Purpose = Purpose::named("layered_billboards.phase");

/// How a layer moves about its anchor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// It turns.
    Rotate,
    /// What is above the anchor moves along the layer's width, what is below moves the other way.
    Shear,
}

/// What a layer hangs from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Joint {
    /// Index of a joint before it.
    pub(super) parent: Option<usize>,
    /// Stays where its parent puts it.
    pub(super) anchor: DVec3,
    /// How many joints are between it and the ground.
    pub(super) level: u32,
    /// Share of a swing by which it is behind, if it stands on the ground.
    pub(super) lag: f64,
}

/// No layer swings more than so many times as far as the plant: what leans that far lies flat, and sums
/// along the longest chain of layers stay finite.
const MAX_SWING: f64 = 1e3;

/// How many times as far as the whole plant a layer swings.
pub(super) fn swing(growth: f64, level: u32) -> f64 {
    libm::pow(growth, f64::from(level)).min(MAX_SWING)
}

/// How far each layer leans, in metres a metre from its anchor.
///
/// What stands on the ground swings as the whole plant would. The others swing about where that puts
/// them, at phases of their own, `growth` times as far for each level, as far as [`MAX_SWING`].
pub(super) fn slopes(joints: &[Joint], gust: &Gust, growth: f64) -> Vec<f64> {
    let (group, copy) = gust.key;
    let mut phases = Stream::new(gust.wind.seed, PHASE, u64::from(group) << 32 | u64::from(copy));
    let phase = gust.phase();
    joints
        .iter()
        .map(|joint| {
            let own = phases.unit();
            if joint.parent.is_none() {
                return gust.slope_at(phase - joint.lag);
            }
            (gust.slope_at(own) - gust.wind.lean) * swing(growth, joint.level)
        })
        .collect()
}

/// Where each layer goes when it leans by `slopes` along the frame's right.
pub(super) fn poses(
    joints: &[Joint],
    slopes: &[f64],
    frame: &Frame,
    motion: Motion,
) -> Vec<DAffine3> {
    let mut poses: Vec<DAffine3> = Vec::with_capacity(joints.len());
    for (joint, &slope) in joints.iter().zip(slopes) {
        let own = about(joint.anchor, lean(slope, frame, motion));
        let pose = joint.parent.map_or(own, |parent| poses[parent] * own);
        poses.push(pose);
    }
    poses
}

/// A linear motion about a point, which stays.
fn about(anchor: DVec3, matrix3: DMat3) -> DAffine3 {
    DAffine3 { matrix3, translation: anchor - matrix3 * anchor }
}

/// What leans up to the right by a slope.
fn lean(slope: f64, frame: &Frame, motion: Motion) -> DMat3 {
    let (right, up) = (frame.right, frame.up);
    // the matrix whose product with v is a (b . v)
    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
    match motion {
        Motion::Shear => DMat3::IDENTITY + outer(right, up) * slope,
        Motion::Rotate => {
            let cosine = 1.0 / (1.0 + slope * slope).sqrt();
            let sine = slope * cosine;
            let plane = outer(right, right) + outer(up, up);
            DMat3::IDENTITY + plane * (cosine - 1.0) + (outer(right, up) - outer(up, right)) * sine
        }
    }
}

/// Places of the layers of a copy in the wind that blows there; `None` where none does.
pub(super) fn in_wind(
    joints: &[Joint],
    frame: &Frame,
    motion: Motion,
    growth: f64,
    crown: &Crown,
    view: &View,
) -> Option<Vec<DAffine3>> {
    let gust = crown.wind.as_ref()?;
    // a wind that blows towards the viewer moves nothing in the picture's plane
    let share = crown.local_direction(gust.toward(view)).dot(frame.right);
    let slopes: Vec<f64> =
        slopes(joints, gust, growth).into_iter().map(|slope| slope * share).collect();
    Some(poses(joints, &slopes, frame, motion))
}

/// The turn, first in pitch and then in yaw, that makes what faces along the frame's `toward` face
/// along a direction, each by at most `max_turn` radians.
pub(super) fn facing(frame: &Frame, direction: DVec3, max_turn: f64) -> DMat3 {
    let Frame { right, up, toward } = *frame;
    let (x, y, z) = (direction.dot(right), direction.dot(up), direction.dot(toward));
    let yaw = libm::atan2(x, z).clamp(-max_turn, max_turn);
    let pitch = libm::atan2(y, x.hypot(z)).clamp(-max_turn, max_turn);
    let (sin_yaw, cos_yaw) = (libm::sin(yaw), libm::cos(yaw));
    let (sin_pitch, cos_pitch) = (libm::sin(pitch), libm::cos(pitch));
    // where right, up and toward go, in the frame's own coordinates
    let turned = DMat3::from_cols(
        DVec3::new(cos_yaw, 0.0, -sin_yaw),
        DVec3::new(-sin_pitch * sin_yaw, cos_pitch, -sin_pitch * cos_yaw),
        DVec3::new(cos_pitch * sin_yaw, sin_pitch, cos_pitch * cos_yaw),
    );
    let axes = DMat3::from_cols(right, up, toward);
    axes * turned * axes.transpose()
}

/// A pose whose layer is then turned about its anchor.
pub(super) fn turned(pose: &DAffine3, anchor: DVec3, turn: DMat3) -> DAffine3 {
    let matrix3 = turn * pose.matrix3;
    DAffine3 { matrix3, translation: pose.transform_point3(anchor) - matrix3 * anchor }
}
