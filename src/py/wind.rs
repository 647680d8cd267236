//! Winds for Python.

use pyo3::prelude::*;

use crate::error::{LodError, check_in};
use crate::lod::wind::Wind;

/// A wind as Python states it; without an azimuth it blows to the right of the picture.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct WindFacts {
    lean: f64,
    sway: f64,
    period_secs: f64,
    azimuth_deg: Option<f64>,
    seed: u64,
}

impl WindFacts {
    pub(super) fn wind(&self) -> Result<Wind, LodError> {
        let Self { lean, sway, period_secs, azimuth_deg, seed } = *self;
        if let Some(azimuth_deg) = azimuth_deg {
            check_in("azimuth_deg", azimuth_deg, -360.0..=360.0)?;
        }
        let toward = azimuth_deg.map(Wind::direction_of);
        let wind = Wind { lean, sway, period_secs, toward, seed };
        wind.check()?;
        Ok(wind)
    }
}
