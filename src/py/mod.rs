//! The Python extension `treelod._core`: glue only, one file per file of the core.
//!
//! Glue checks shapes, borrows slices, calls a kernel through [`run::run`] and hands arrays back.
//! It holds no algorithm. What the core refuses reaches Python as an exception of
//! `python/treelod/errors.py`, by the one conversion below.

mod arrays;
mod billboard;
mod clusters;
mod collapse;
mod criteria;
mod foliage_hierarchy;
mod gpu;
mod grow;
mod layered_billboards;
mod leaf_clusters;
mod lod;
mod octahedral_impostor;
mod orthogonal_slices;
mod plant;
mod png;
mod points_and_lines;
mod render;
mod run;
mod simplified_mesh;
mod slicings;
mod stochastic_pruning;
mod structure;
mod variety;
mod view;
mod wind;

use pyo3::exceptions::{PyKeyboardInterrupt, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;

use crate::error::LodError;

static LIMIT_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static FORKED_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static STORE_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static NO_ADAPTER_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static DEVICE_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static INTERNAL_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();

/// An instance of a class of `treelod.errors`, which is imported once.
fn package_error(
    class: &'static PyOnceLock<Py<PyType>>,
    name: &'static str,
    message: String,
) -> PyErr {
    Python::attach(|py| match class.import(py, "treelod.errors", name) {
        Ok(class) => PyErr::from_type(class.clone(), message),
        // a broken installation: better that error than none
        Err(error) => error,
    })
}

fn internal_error(message: String) -> PyErr {
    package_error(&INTERNAL_ERROR, "InternalError", message)
}

impl From<LodError> for PyErr {
    fn from(error: LodError) -> Self {
        let message = error.to_string();
        match error {
            LodError::OutOfRange { .. }
            | LodError::NotFinite { .. }
            | LodError::Empty { .. }
            | LodError::Invalid { .. } => PyValueError::new_err(message),
            LodError::Limit { .. } => package_error(&LIMIT_ERROR, "LimitError", message),
            LodError::Store { .. } => package_error(&STORE_ERROR, "StoreError", message),
            LodError::Callback { id } => {
                criteria::take_raised(id).unwrap_or_else(|| internal_error(message))
            }
            LodError::NoAdapter { .. } => {
                package_error(&NO_ADAPTER_ERROR, "NoAdapterError", message)
            }
            LodError::Device { .. } => package_error(&DEVICE_ERROR, "DeviceError", message),
            LodError::Forked => package_error(&FORKED_ERROR, "ForkedError", message),
            // `run` prefers the exception of whoever cancelled; this one is for the case of none
            LodError::Cancelled => PyKeyboardInterrupt::new_err(message),
        }
    }
}

/// The compiled part of treelod. Its face is the `treelod` package.
#[pymodule]
mod _core {
    use numpy::{PyArray1, PyArrayMethods};
    use pyo3::prelude::*;

    /// Touches what is otherwise made by the first call that needs it: a fork while another thread
    /// is making it would leave it half made in the child, which then waits for ever.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        PyArray1::<f32>::zeros(module.py(), 0, false).try_readonly()?;
        Ok(())
    }

    #[pymodule_export]
    use super::billboard::{Billboard, billboards};
    #[pymodule_export]
    use super::clusters::{cluster_leaves, plane_misses, vector_peak};
    #[pymodule_export]
    use super::collapse::collapse_leaves;
    #[pymodule_export]
    use super::criteria::{_cut_for_test, cut_times};
    #[pymodule_export]
    use super::foliage_hierarchy::{FoliageHierarchy, foliage_hierarchy, stored_hierarchy};
    #[pymodule_export]
    use super::gpu::{_fail_for_test, adapters, close_devices, release_devices};
    #[pymodule_export]
    use super::grow::{grow, preset_names};
    #[pymodule_export]
    use super::layered_billboards::{LayeredBillboards, layered_billboards};
    #[pymodule_export]
    use super::leaf_clusters::{LeafClusters, leaf_clusters};
    #[pymodule_export]
    use super::lod::{Representation, full_mesh};
    #[pymodule_export]
    use super::octahedral_impostor::{OctahedralImpostor, octahedral_impostor};
    #[pymodule_export]
    use super::orthogonal_slices::orthogonal_slices;
    #[pymodule_export]
    use super::plant::{Plant, smooth_normals, split_plant};
    #[pymodule_export]
    use super::png::encode_png;
    #[pymodule_export]
    use super::points_and_lines::{PointsAndLines, cloud, points_and_lines};
    #[pymodule_export]
    use super::render::{Renderer, Scene, peak_rate, time_naive};
    #[pymodule_export]
    use super::run::{_panic_for_test, _spin_for_test};
    #[pymodule_export]
    use super::simplified_mesh::simplified_mesh;
    #[pymodule_export]
    use super::slicings::{circle_directions, slicings, sphere_directions};
    #[pymodule_export]
    use super::stochastic_pruning::{StochasticPruning, stochastic_pruning};
    #[pymodule_export]
    use super::variety::variant;

    /// As in `Cargo.toml`, the one place that states it.
    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "an attribute of a Python module")]
    const __version__: &str = env!("CARGO_PKG_VERSION");

    /// Timings of a "debug" build say nothing.
    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "an attribute of a Python module")]
    const build_profile: &str = if cfg!(debug_assertions) { "debug" } else { "release" };

    /// Names the sources of the core and the versions of its libraries: two builds of the same ones
    /// compute the same numbers.
    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "an attribute of a Python module")]
    const source_hash: &str = env!("KERNEL_SOURCE_HASH");
}
