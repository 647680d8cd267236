//! Growing for Python.

use pyo3::prelude::*;

use super::plant::{LightingFacts, Plant};
use super::run::run;
use crate::plant::{Lighting, grow as core};

/// A plant of a preset.
#[pyfunction]
pub(super) fn grow(
    py: Python<'_>,
    preset: &str,
    seed: u64,
    leaf_count: Option<usize>,
    lighting: LightingFacts,
) -> PyResult<Plant> {
    let lighting = Lighting::from(lighting);
    let plant = run(py, None, None, |job| {
        lighting.check()?;
        let light = lighting.without_occlusion();
        core::grow(preset, seed, leaf_count, light)?.relit(lighting, job)
    })?;
    Ok(plant.into())
}

/// Names that `grow` takes.
#[pyfunction]
pub(super) fn preset_names() -> Vec<&'static str> {
    core::preset_names().collect()
}
