//! Octahedral impostors for Python.

use std::sync::Arc;

use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::matrix;
use super::lod::{Representation, choice, wood_from};
use super::plant::{LightingFacts, Plant};
use super::run::run;
use super::view::CameraFacts;
use crate::lod::octahedral_impostor::octahedron::Grid;
use crate::lod::octahedral_impostor::{self as core, Drawing, Mix, Params, Shading};
use crate::texture::Format;

/// Parameters as the Python face states them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct OctahedralImpostorFacts {
    frame_count: usize,
    hemisphere: bool,
    resolution: u32,
    samples: u32,
    blend: String,
    drawing: String,
    cutoff: f32,
    parallax_steps: u32,
    depth_tolerance: Option<f64>,
    depth_bits: u32,
    shading: String,
    format: String,
    wood: bool,
    wood_triangle_count: Option<usize>,
    views: Option<Vec<CameraFacts>>,
}

impl OctahedralImpostorFacts {
    fn params(self) -> PyResult<Params> {
        let mixes = [("three", Mix::Three), ("nearest", Mix::Nearest)];
        let drawings = [
            ("test", Drawing::Test(self.cutoff)),
            ("coverage", Drawing::Coverage),
            ("blend", Drawing::Blend),
        ];
        let shadings = [("baked", Shading::Baked), ("relit", Shading::Relit)];
        // also where it is not in use
        core::check_cutoff(self.cutoff)?;
        let views = self.views.map(|views| views.iter().map(CameraFacts::view).collect());
        Ok(Params {
            grid: Grid::new(self.frame_count, self.hemisphere)?,
            resolution: self.resolution,
            sample_count: self.samples,
            mix: choice("blend", &self.blend, &mixes)?,
            drawing: choice("drawing", &self.drawing, &drawings)?,
            step_count: self.parallax_steps,
            tolerance: self.depth_tolerance,
            depth_bit_count: self.depth_bits,
            shading: choice("shading", &self.shading, &shadings)?,
            format: choice("format", &self.format, &Format::ALL)?,
            wood: wood_from(self.wood, self.wood_triangle_count),
            views: views.transpose()?,
        })
    }
}

/// Pictures of a plant from all around. Immutable.
#[pyclass(frozen, module = "treelod._core")]
pub(super) struct OctahedralImpostor {
    inner: Arc<core::OctahedralImpostor>,
}

#[pymethods]
impl OctahedralImpostor {
    /// What is drawn.
    fn representation(&self) -> Representation {
        Representation { inner: Arc::<core::OctahedralImpostor>::clone(&self.inner) }
    }

    /// Frames and weights that a camera sees.
    fn mixed(&self, py: Python<'_>, camera: CameraFacts) -> PyResult<Vec<(usize, f64)>> {
        let view = camera.view()?;
        Ok(py.detach(|| self.inner.mixed(&view)))
    }

    /// The same under another light.
    fn relit(&self, py: Python<'_>, lighting: LightingFacts) -> PyResult<Self> {
        let lighting = lighting.into();
        let inner = py.detach(|| self.inner.relit(&lighting))?;
        Ok(Self { inner: Arc::new(inner) })
    }

    /// What is known of the frames, by name.
    #[getter]
    fn facts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (center, radius) = self.inner.ball();
        let facts = PyDict::new(py);
        facts.set_item("center", center.to_array())?;
        facts.set_item("radius", radius)?;
        facts.set_item("baked", self.inner.baked())?;
        facts.set_item("atlas_fill", self.inner.atlas_fill())?;
        Ok(facts)
    }

    /// One row a frame: unit vectors to the viewer, right and up, and the upper left corner and the sides
    /// in the atlas as texture coordinates; all NaN where it was not baked. Shape (F, 13).
    #[getter]
    fn frames<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let parts = self.inner.frames().parts();
        let rows: Vec<[f64; 13]> = parts
            .frames
            .iter()
            .map(|frame| {
                frame.map_or([f64::NAN; 13], |frame| {
                    let [t, r, u] = [frame.toward, frame.right, frame.up].map(|v| v.as_dvec3());
                    let (at, size) = (frame.corner.as_dvec2(), parts.size.as_dvec2());
                    [t.x, t.y, t.z, r.x, r.y, r.z, u.x, u.y, u.z, at.x, at.y, size.x, size.y]
                })
            })
            .collect();
        matrix(py, &rows)
    }
}

/// Bakes the frames of a plant.
#[pyfunction]
#[pyo3(signature = (plant, facts, *, threads, progress))]
pub(super) fn octahedral_impostor(
    py: Python<'_>,
    plant: &Plant,
    facts: OctahedralImpostorFacts,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<OctahedralImpostor> {
    let plant = Arc::clone(&plant.inner);
    let params = facts.params()?;
    let inner = run(py, threads, progress, move |job| {
        core::OctahedralImpostor::build(&plant, &params, job)
    })?;
    Ok(OctahedralImpostor { inner: Arc::new(inner) })
}
