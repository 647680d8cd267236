//! Cameras for Python.

use glam::DVec3;
use pyo3::prelude::*;

use crate::error::{LodError, check_in};
use crate::view::{Projection, View};

/// Thirty years either way: a period of a second is then still resolved to a millionth.
const MAX_TIME_SECS: f64 = 1e9;

/// A camera as Python states it; exactly one of `fov_y_deg` and `height` is given.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct CameraFacts {
    eye: [f64; 3],
    target: [f64; 3],
    up: [f64; 3],
    fov_y_deg: Option<f64>,
    height: Option<f64>,
    size: (u32, u32),
    near: f64,
    time_secs: f64,
}

impl CameraFacts {
    pub(super) fn view(&self) -> Result<View, LodError> {
        let projection = match (self.fov_y_deg, self.height) {
            (Some(degrees), None) => Projection::Perspective { fov_y: degrees.to_radians() },
            (None, Some(height)) => Projection::Orthographic { height },
            _ => {
                let why = "needs fov_y_deg or height, and not both".to_owned();
                return Err(LodError::Invalid { name: "camera", why });
            }
        };
        let [eye, target, up] = [self.eye, self.target, self.up].map(DVec3::from);
        check_in("time_secs", self.time_secs, -MAX_TIME_SECS..=MAX_TIME_SECS)?;
        let mut view = View::new(eye, target, up, projection, self.size, self.near)?;
        view.time_secs = self.time_secs;
        Ok(view)
    }
}
