//! Orthogonal slices for Python.

use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::lod::{CorrectionFacts, Representation, choice, correction_from, wood_from};
use super::plant::Plant;
use super::run::run;
use super::view::CameraFacts;
use crate::error::check_in;
use crate::lod::orthogonal_slices::{K_RANGE, Law, Order, OrthogonalSlices, Params, Treetop};
use crate::texture::Format;

/// Parameters as the Python face states them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct OrthogonalSlicesFacts {
    axes: usize,
    slice_count: usize,
    resolution: (u32, u32),
    samples: u32,
    blend: String,
    k: f64,
    correction: CorrectionFacts,
    paint_order: String,
    treetop_slice_count: usize,
    treetop_height_rel: f64,
    format: String,
    wood: bool,
    wood_triangle_count: Option<usize>,
    bake_wood: bool,
    views: Option<Vec<CameraFacts>>,
}

impl OrthogonalSlicesFacts {
    fn params(self) -> PyResult<Params> {
        // one of the laws has no use for it, but a wrong number is wrong all the same
        check_in("k", self.k, K_RANGE)?;
        let laws = [("power", Law::Power { k: self.k }), ("linear", Law::Linear)];
        let orders = [("slices", Order::Slices), ("exact", Order::Exact)];
        let views = self.views.map(|views| views.iter().map(CameraFacts::view).collect());
        Ok(Params {
            axis_count: self.axes,
            slice_count: self.slice_count,
            resolution: self.resolution,
            sample_count: self.samples,
            law: choice("blend", &self.blend, &laws)?,
            correction: correction_from(self.correction)?,
            order: choice("paint_order", &self.paint_order, &orders)?,
            treetop: Treetop {
                slice_count: self.treetop_slice_count,
                height_rel: self.treetop_height_rel,
            },
            format: choice("format", &self.format, &Format::ALL)?,
            wood: wood_from(self.wood, self.wood_triangle_count),
            bakes_wood: self.bake_wood,
            views: views.transpose()?,
        })
    }
}

/// Slabs across two or three axes; also what was measured while baking, and which axes were baked.
#[pyfunction]
#[pyo3(signature = (plant, params, *, threads, progress))]
pub(super) fn orthogonal_slices<'py>(
    py: Python<'py>,
    plant: &Plant,
    params: OrthogonalSlicesFacts,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Representation, Bound<'py, PyDict>)> {
    let plant = Arc::clone(&plant.inner);
    let params = params.params()?;
    let (built, measured) =
        run(py, threads, progress, move |job| OrthogonalSlices::build(&plant, &params, job))?;
    let facts = PyDict::new(py);
    facts.set_item("m", measured.m)?;
    facts.set_item("fitted", measured.fitted)?;
    facts.set_item("tau", measured.tau)?;
    facts.set_item("treetop_leaf_count", measured.treetop_leaf_count)?;
    facts.set_item("baked", built.baked())?;
    Ok((Representation { inner: Arc::new(built) }, facts))
}
