//! Growing for Python.

use pyo3::prelude::*;

use super::plant::{LightingFacts, Plant};
use super::run::run;
use crate::plant::{Lighting, grow as core};

/// A plant of a preset.
#[pyfunction]
#[pyo3(signature = (preset, seed, leaf_count, lighting, *, progress=None))]
pub(super) fn grow(
    py: Python<'_>,
    preset: &str,
    seed: u64,
    leaf_count: Option<usize>,
    lighting: LightingFacts,
    progress: Option<Py<PyAny>>,
) -> PyResult<Plant> {
    let lighting = Lighting::from(lighting);
    let plant = run(py, None, progress, |job| core::grow(preset, seed, leaf_count, lighting, job))?;
    Ok(plant.into())
}

/// Names that `grow` takes.
#[pyfunction]
pub(super) fn preset_names() -> Vec<&'static str> {
    core::preset_names().collect()
}
