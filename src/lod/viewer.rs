//! A camera as a crown sees it: where the eye is, in which order parallel slices lie behind one another,
//! and how fine the pictures must be that some cameras need.

use glam::{DAffine3, DVec3};

use crate::bake::BakeRect;
use crate::error::LodError;
use crate::job::Job;
use crate::lod::Crown;
use crate::lod::leaves::Leaves;
use crate::view::View;

/// An eye nearer to the centre than this share of the radius sees along its own direction.
const INSIDE: f64 = 1e-3;

/// A camera in a crown's coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Viewer {
    /// Relative to the crown's centre; `None` for parallel views.
    pub(crate) eye: Option<DVec3>,
    /// From the crown to the viewer, any length.
    pub(crate) toward: DVec3,
    /// The picture's up.
    pub(crate) up: DVec3,
    /// Against the direction that the camera looks along, unit length.
    back: DVec3,
}

impl Viewer {
    pub(crate) fn new(view: &View, crown: &Crown, center: DVec3, radius: f64) -> Self {
        let back = crown.local_direction(view.back);
        let eye = (!view.is_orthographic()).then(|| crown.local_eye(view) - center);
        let viewer = Self { eye, toward: back, up: crown.local_direction(view.up), back };
        Self { toward: viewer.toward_from(DVec3::ZERO, radius), ..viewer }
    }

    /// From a point, relative to the crown's centre, to the viewer.
    pub(crate) fn toward_from(&self, point: DVec3, radius: f64) -> DVec3 {
        // equal where both are 0
        let outside = self.eye.map(|eye| eye - point).filter(|to| to.length() > INSIDE * radius);
        outside.unwrap_or(self.back)
    }

    /// How far behind others of its stack a slice is seen. No ray from an eye meets slices on both
    /// sides of it, so the distance from the slice's plane orders those in front as well as those
    /// behind; a parallel view sees all from the same side.
    pub(crate) fn distance(&self, direction: DVec3, offset: f64) -> f64 {
        match self.eye {
            Some(eye) => (eye.dot(direction) - offset).abs(),
            None if self.toward.dot(direction) < 0.0 => offset,
            None => -offset,
        }
    }
}

/// Pixels a metre of the nearest of some views that mixes each of `count` pictures of a crown; `None`
/// for a picture that no view mixes. `mixed` gives the pictures of a view.
///
/// # Errors
/// `views` without any view; what `mixed` fails with; [`LodError::Cancelled`].
pub(crate) fn needed(
    views: &[View],
    leaves: &Leaves<'_>,
    count: usize,
    mixed: impl Fn(&View, &Crown, &Viewer) -> Result<Vec<usize>, LodError>,
    job: &Job,
) -> Result<Vec<Option<f64>>, LodError> {
    if views.is_empty() {
        let why = "give at least one camera, or None for all directions";
        return Err(LodError::Empty { name: "views", why });
    }
    // placed as a scene places a single copy, so that both come to the same shares
    let crown = Crown::alone(DAffine3::from_translation(leaves.plant.origin));
    let mut needed: Vec<Option<f64>> = vec![None; count];
    for view in views {
        job.check()?;
        let viewer = Viewer::new(view, &crown, leaves.center, leaves.radius);
        let from_eye = viewer.eye.map_or(0.0, DVec3::length);
        let nearest = (from_eye - leaves.radius).max(view.near);
        let per_metre = 1.0 / view.pixel_size_at(nearest);
        for number in mixed(view, &crown, &viewer)? {
            let most = needed[number].get_or_insert(0.0);
            *most = most.max(per_metre);
        }
    }
    Ok(needed)
}

/// Texels, width and height, with which a rectangle has so many a metre, at most a limit.
pub(crate) fn texels(per_metre: f64, rect: &BakeRect, limit: (u32, u32)) -> (u32, u32) {
    let texels = |metres: f64, limit: u32| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let texels = (per_metre * metres).ceil().clamp(1.0, f64::from(limit)) as u32;
        texels
    };
    (texels(rect.width, limit.0), texels(rect.height, limit.1))
}
