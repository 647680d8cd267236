//! A camera as an impostor sees it: from which direction it looks, and the card that it looks through.

use glam::{DVec2, DVec3};

use crate::lod::Crown;
use crate::lod::octahedral_impostor::ball::{Ball, VERTICAL};
use crate::view::{Projection, View};

/// An eye nearer to the centre than this share of the radius sees along its own direction.
const INSIDE: f64 = 1e-3;

/// An eye nearer than this many radii to the box around the plant looks through its whole picture: the
/// card behind what it sees grows without end as the eye comes near.
const NEAR: f64 = 0.1;

/// A camera as a crown sees it, in the crown's coordinates.
pub(super) struct Viewer {
    /// Relative to the crown's centre; `None` for parallel views.
    pub(super) eye: Option<DVec3>,
    /// From the crown to the viewer, unit length.
    pub(super) toward: DVec3,
    /// The picture's up.
    up: DVec3,
}

impl Viewer {
    pub(super) fn new(view: &View, crown: &Crown, ball: &Ball) -> Self {
        // a parallel view's rays in the crown's space; not how a normal would turn
        let back = crown.local_direction(view.back);
        let eye = (!view.is_orthographic()).then(|| crown.local_eye(view) - ball.center);
        let outside = eye.filter(|eye| eye.length() > INSIDE * ball.radius);
        let up = crown.local_direction(view.up);
        Self { eye, toward: outside.map_or(back, DVec3::normalize), up }
    }

    /// The direction whose frames of an upper half are shown: that of the viewer, but for one who is
    /// straight below, where there is none and the picture's up takes its place.
    pub(super) fn upright(&self) -> DVec3 {
        let level = self.toward.x.hypot(self.toward.z);
        let from_below = self.toward.y < 0.0 && level < VERTICAL;
        if from_below { self.up } else { self.toward }
    }

    /// Corners of a card in the crown's space behind which the box around the plant lies: in a plane through
    /// its middle, across the line to the viewer; or across the whole picture for an eye that is inside
    /// or near.
    pub(super) fn card(&self, view: &View, crown: &Crown, ball: &Ball) -> [DVec3; 4] {
        let right = DVec3::Y.cross(self.toward).try_normalize();
        let right = right.unwrap_or_else(|| self.toward.any_orthonormal_vector());
        let up = self.toward.cross(right);
        let distance = self.eye.map_or(f64::INFINITY, DVec3::length);
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for corner in 0..8 {
            let side = |axis: u32| if corner >> axis & 1 == 0 { -1.0 } else { 1.0 };
            let at = ball.half * DVec3::new(side(0), side(1), side(2));
            let before = distance - at.dot(self.toward);
            if before < NEAR * ball.radius {
                return self.whole_picture(view, crown, ball);
            }
            // 1 for an eye that is infinitely far
            let scale = if distance.is_finite() { distance / before } else { 1.0 };
            let on_card = DVec2::new(at.dot(right), at.dot(up)) * scale;
            (low, high) = (low.min(on_card), high.max(on_card));
        }
        let corner = |x: f64, y: f64| ball.center + right * x + up * y;
        [corner(low.x, low.y), corner(high.x, low.y), corner(high.x, high.y), corner(low.x, high.y)]
    }

    fn whole_picture(&self, view: &View, crown: &Crown, ball: &Ball) -> [DVec3; 4] {
        let local_from_world = crown.world_from_local.inverse();
        let scale = crown.world_from_local.matrix3.determinant().abs().cbrt();
        // as far away as the ball is large, so that local coordinates are exact enough
        let depth = (ball.radius * scale).max(2.0 * view.near);
        let Projection::Perspective { fov_y } = view.projection else {
            unreachable!("parallel views have no eye to be inside");
        };
        // a little more than the picture
        let high = depth * libm::tan(fov_y / 2.0) * 1.01;
        let wide = high * f64::from(view.width) / f64::from(view.height) / view.pixel_aspect;
        let corner = |x: f64, y: f64| {
            let world =
                view.eye - view.back * depth + view.right * (x * wide) + view.up * (y * high);
            local_from_world.transform_point3(world)
        };
        [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)]
    }
}
