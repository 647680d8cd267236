//! Simplified meshes for Python.

use std::sync::Arc;

use pyo3::prelude::*;

use super::lod::{Representation, choice, filter_from, wood_from};
use super::plant::Plant;
use super::run::run;
use crate::lod::simplified_mesh::{Params, SimplifiedMesh, Target};
use crate::lod::simplify::{EdgeOptions, Method};

/// Parameters as the Python face states them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct SimplifiedMeshFacts {
    triangle_count: Option<usize>,
    keep_fraction: f64,
    method: String,
    target_error_rel: Option<f64>,
    prune: bool,
    lock_border: bool,
    normal_weight: f32,
    uv_weight: f32,
    wood: bool,
    wood_triangle_count: Option<usize>,
    filter: String,
}

impl SimplifiedMeshFacts {
    fn params(&self) -> PyResult<Params> {
        let options = EdgeOptions { prune: self.prune, lock_border: self.lock_border };
        let attributes = Method::Attributes {
            options,
            normal_weight: self.normal_weight,
            uv_weight: self.uv_weight,
        };
        let methods = [
            ("simplify", Method::Edges(options)),
            ("attributes", attributes),
            ("sloppy", Method::Sloppy),
        ];
        Ok(Params {
            target: self
                .triangle_count
                .map_or(Target::Share(self.keep_fraction), Target::Triangles),
            method: choice("method", &self.method, &methods)?,
            target_error_rel: self.target_error_rel,
            wood: wood_from(self.wood, self.wood_triangle_count),
            filter: filter_from(&self.filter)?,
        })
    }
}

/// The foliage simplified; also the triangles left of it, and meshoptimizer's error in metres.
#[pyfunction]
#[pyo3(signature = (plant, facts, *, progress))]
pub(super) fn simplified_mesh(
    py: Python<'_>,
    plant: &Plant,
    facts: SimplifiedMeshFacts,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Representation, usize, f64)> {
    let params = facts.params()?;
    let plant = Arc::clone(&plant.inner);
    let built = run(py, None, progress, move |job| SimplifiedMesh::build(&plant, &params, job))?;
    let (count, error) = (built.triangle_count(), built.error());
    Ok((Representation { inner: Arc::new(built) }, count, error))
}
