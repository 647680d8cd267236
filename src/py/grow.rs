//! Growing for Python.

use pyo3::prelude::*;

use super::plant::{LightingFacts, Plant};
use super::run::run;
use crate::plant::grow as core;

/// A plant of a preset.
#[pyfunction]
pub(super) fn grow(
    py: Python<'_>,
    preset: &str,
    seed: u64,
    leaf_count: Option<usize>,
    lighting: LightingFacts,
) -> PyResult<Plant> {
    let lighting = lighting.into();
    Ok(run(py, None, None, |_| core::grow(preset, seed, leaf_count, lighting))?.into())
}

/// Names that `grow` takes.
#[pyfunction]
pub(super) fn preset_names() -> Vec<&'static str> {
    core::preset_names().collect()
}
