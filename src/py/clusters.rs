//! Clusters of leaves for Python.

use glam::{DVec3, Vec3};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{matrix, rows, slice};
use super::run::run;
use crate::lod::leaf_clusters::kmeans::{Init, Method, Params, cluster_by};
use crate::lod::leaf_clusters::misses;
use crate::lod::leaf_clusters::peak::{OPS_PER_PAIR, ops_per_sec};
use crate::lod::leaf_clusters::plane::{Eigen, Plane};
use crate::simd::Level;

/// A name, planes of shape (K, 4), or ids of shape (L,).
#[derive(FromPyObject)]
pub(super) enum InitFacts<'py> {
    Named(String),
    Planes(PyReadonlyArray2<'py, f64>),
    Ids(PyReadonlyArray1<'py, u32>),
}

impl InitFacts<'_> {
    fn init(&self) -> PyResult<Init> {
        match self {
            Self::Named(name) => match name.as_str() {
                "random" => Ok(Init::Random),
                "plus_plus" => Ok(Init::PlusPlus),
                _ => Err(unknown("init", name, &["plus_plus", "random"])),
            },
            Self::Planes(planes) => {
                let rows: Vec<[f64; 4]> = rows("init", planes)?;
                let plane = |[x, y, z, d]: [f64; 4]| Plane { normal: DVec3::new(x, y, z), d };
                Ok(Init::Planes(rows.into_iter().map(plane).collect()))
            }
            Self::Ids(ids) => Ok(Init::Ids(slice("init", ids)?.to_vec())),
        }
    }
}

fn unknown(argument: &str, value: &str, known: &[&str]) -> PyErr {
    let known: Vec<String> = known.iter().map(|name| format!("{name:?}")).collect();
    PyValueError::new_err(format!("{argument} must be {}, got {value:?}", known.join(" or ")))
}

type ClusteringFacts<'py> =
    (Bound<'py, PyArray1<u32>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>, bool);

/// Ids (L,), planes (K, 4), the error after each turn, and whether it converged.
#[pyfunction]
#[pyo3(signature = (
    centers, normals, *, cluster_count, alpha, init, seed, restarts, max_iterations, eigen,
    method="pruned", simd=None, threads=None, progress=None
))]
#[expect(clippy::too_many_arguments, reason = "as many as there are parameters")]
pub(super) fn cluster_leaves<'py>(
    py: Python<'py>,
    centers: PyReadonlyArray2<'py, f32>,
    normals: PyReadonlyArray2<'py, f32>,
    cluster_count: usize,
    alpha: f64,
    init: InitFacts<'py>,
    seed: u64,
    restarts: usize,
    max_iterations: usize,
    eigen: &str,
    method: &str,
    simd: Option<&str>,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<ClusteringFacts<'py>> {
    let eigen = match eigen {
        "exact" => Eigen::Exact,
        "paper" => Eigen::Paper,
        _ => return Err(unknown("eigen", eigen, &["exact", "paper"])),
    };
    let method = match method {
        "pruned" => Method::Pruned,
        "full" => Method::Full,
        "naive" => Method::Naive,
        _ => return Err(unknown("method", method, &["pruned", "full", "naive"])),
    };
    let level = match simd {
        Some(name) => Level::named("simd", name)?,
        None => Level::chosen()?,
    };
    let init = init.init()?;
    let params = Params { cluster_count, alpha, init, seed, restarts, max_iterations, eigen };
    let centers: Vec<Vec3> = rows("centers", &centers)?;
    let normals: Vec<Vec3> = rows("normals", &normals)?;
    let found = run(py, threads, progress, |job| {
        cluster_by(method, level, &centers, &normals, &params, job)
    })?;
    Ok((
        PyArray1::from_vec(py, found.cluster_ids),
        matrix(py, &found.planes.iter().map(plane_row).collect::<Vec<_>>())?,
        PyArray1::from_vec(py, found.errors),
        found.converged,
    ))
}

/// Per cluster: leaves, the best plane and the paper's (K, 4), and their errors.
#[pyfunction]
#[pyo3(signature = (centers, normals, cluster_ids, *, cluster_count, alpha, threads=None))]
pub(super) fn plane_misses<'py>(
    py: Python<'py>,
    centers: PyReadonlyArray2<'py, f32>,
    normals: PyReadonlyArray2<'py, f32>,
    cluster_ids: PyReadonlyArray1<'py, u32>,
    cluster_count: usize,
    alpha: f64,
    threads: Option<usize>,
) -> PyResult<MissFacts<'py>> {
    let centers: Vec<Vec3> = rows("centers", &centers)?;
    let normals: Vec<Vec3> = rows("normals", &normals)?;
    let ids = slice("cluster_ids", &cluster_ids)?.to_vec();
    let found = run(py, threads, None, |job| {
        misses::misses(&centers, &normals, &ids, cluster_count, alpha, job)
    })?;
    let planes = |plane: fn(&misses::Miss) -> &Plane| {
        matrix(py, &found.iter().map(|miss| plane_row(plane(miss))).collect::<Vec<_>>())
    };
    Ok((
        PyArray1::from_iter(py, found.iter().map(|miss| miss.leaf_count)),
        (planes(|miss| &miss.best)?, planes(|miss| &miss.paper)?),
        PyArray1::from_iter(py, found.iter().map(|miss| miss.best_cost)),
        PyArray1::from_iter(py, found.iter().map(|miss| miss.paper_cost)),
    ))
}

type MissFacts<'py> = (
    Bound<'py, PyArray1<u64>>,
    (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>),
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
);

/// Operations that a pair of leaf and plane takes, and how many a core does a second.
#[pyfunction]
pub(super) fn vector_peak(py: Python<'_>) -> PyResult<(u32, f64)> {
    let level = Level::chosen()?;
    let rate = run(py, Some(1), None, |_| Ok(ops_per_sec(level, 20)))?;
    Ok((OPS_PER_PAIR, rate))
}

fn plane_row(plane: &Plane) -> [f64; 4] {
    let DVec3 { x, y, z } = plane.normal;
    [x, y, z, plane.d]
}
