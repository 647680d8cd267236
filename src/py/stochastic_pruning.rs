//! Stochastic pruning for Python.

use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::lod::{Representation, wood_from};
use super::plant::Plant;
use super::run::run;
use super::view::CameraFacts;
use crate::lod::stochastic_pruning::{self as core, Params};

/// Leaves in a random order, of which a prefix is drawn. Immutable.
#[pyclass(frozen, module = "treelod._core")]
pub(super) struct StochasticPruning {
    inner: core::StochasticPruning,
}

#[pymethods]
impl StochasticPruning {
    /// What is drawn.
    fn representation(&self) -> Representation {
        Representation { inner: Arc::new(self.inner.clone()) }
    }

    /// The same with a fixed share of the leaves.
    fn at(&self, kept_share: f64) -> PyResult<Self> {
        Ok(Self { inner: self.inner.at(kept_share)? })
    }

    /// How the leaves are drawn for a camera.
    fn level<'py>(&self, py: Python<'py>, camera: CameraFacts) -> PyResult<Bound<'py, PyDict>> {
        let level = self.inner.level(&camera.view()?);
        let facts = PyDict::new(py);
        facts.set_item("kept_share", level.kept_share)?;
        facts.set_item("window", level.window)?;
        facts.set_item("area_scale", level.area_scale)?;
        facts.set_item("contrast", level.contrast)?;
        Ok(facts)
    }
}

/// Puts a plant's leaves in a random order.
#[pyfunction]
#[pyo3(signature = (
    plant, *, leaf_width_px, half_ratio, shrink, contrast, seed, wood, wood_triangle_count
))]
#[expect(clippy::too_many_arguments, reason = "called from one place, by its Python face")]
pub(super) fn stochastic_pruning(
    py: Python<'_>,
    plant: &Plant,
    leaf_width_px: f64,
    half_ratio: f64,
    shrink: f64,
    contrast: bool,
    seed: u64,
    wood: bool,
    wood_triangle_count: Option<usize>,
) -> PyResult<StochasticPruning> {
    let plant = Arc::clone(&plant.inner);
    let wood = wood_from(wood, wood_triangle_count);
    let params = Params { leaf_width_px, half_ratio, shrink, contrast, seed, wood };
    let inner =
        run(py, None, None, move |job| core::StochasticPruning::build(&plant, &params, job))?;
    Ok(StochasticPruning { inner })
}
