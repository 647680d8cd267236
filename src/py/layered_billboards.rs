//! Layered billboards for Python.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use numpy::{PyArray1, PyArray3, PyArrayMethods};
use pyo3::prelude::*;

use super::lod::{Representation, choice, wood_from};
use super::plant::Plant;
use super::run::run;
use super::view::CameraFacts;
use super::wind::WindFacts;
use crate::error::check_in;
use crate::lod::Crown;
use crate::lod::Representation as _;
use crate::lod::layered_billboards::{
    self as core, Drawing, Grouping, Motion, Params, Turn, WoodAs,
};
use crate::lod::wind::Gust;
use crate::texture::Format;

/// Parameters as the Python face states them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct LayerFacts {
    direction: [f64; 3],
    groups: String,
    layer_count: usize,
    tilt: bool,
    turn: String,
    max_turn_deg: f64,
    motion: String,
    growth: f64,
    drawing: String,
    resolution: u32,
    samples: u32,
    format: String,
    wood: bool,
    wood_triangle_count: Option<usize>,
    wood_as: String,
    views: Option<Vec<CameraFacts>>,
}

impl LayerFacts {
    fn params(self) -> PyResult<Params> {
        // also where nothing turns, so that it is not found out later
        check_in("max_turn_deg", self.max_turn_deg, 0.0..=180.0)?;
        let groupings = [
            ("auto", Grouping::Auto),
            ("branches", Grouping::Branches),
            ("slabs", Grouping::Slabs),
        ];
        let turns = [
            ("fixed", Turn::Fixed),
            ("viewer", Turn::Viewer { max_turn: self.max_turn_deg.to_radians() }),
        ];
        let motions = [("rotate", Motion::Rotate), ("shear", Motion::Shear)];
        let drawings = [("blend", Drawing::Blend), ("test", Drawing::Test)];
        let woods = [("baked", WoodAs::Baked), ("mesh", WoodAs::Mesh)];
        let views = self.views.map(|views| views.iter().map(CameraFacts::view).collect());
        Ok(Params {
            direction: self.direction.into(),
            grouping: choice("groups", &self.groups, &groupings)?,
            layer_count: self.layer_count,
            tilt: self.tilt,
            turn: choice("turn", &self.turn, &turns)?,
            motion: choice("motion", &self.motion, &motions)?,
            growth: self.growth,
            drawing: choice("drawing", &self.drawing, &drawings)?,
            resolution: self.resolution,
            sample_count: self.samples,
            format: choice("format", &self.format, &Format::ALL)?,
            wood: wood_from(self.wood, self.wood_triangle_count),
            wood_as: choice("wood_as", &self.wood_as, &woods)?,
            views: views.transpose()?,
        })
    }
}

/// Flat layers of a plant, hung one from the other. Immutable.
#[pyclass(frozen, module = "treelod._core")]
pub(super) struct LayeredBillboards {
    inner: Arc<core::LayeredBillboards>,
}

/// Name, parent, anchor, corners (4, 3), its x, y, width and height in the texture, leaves, triangles
/// of wood.
type LayerRow =
    (String, Option<usize>, [f64; 3], Option<[[f64; 3]; 4]>, Option<[u32; 4]>, usize, usize);

#[pymethods]
impl LayeredBillboards {
    /// What is drawn.
    fn representation(&self) -> Representation {
        let inner = Arc::clone(&self.inner);
        Representation { inner }
    }

    /// Facts of each layer, a parent before its children; places are the world's.
    #[getter]
    fn layers(&self) -> Vec<LayerRow> {
        let origin = self.inner.origin();
        let world = |point: DVec3| (point + origin).to_array();
        let row = |layer: &core::Layer| {
            (
                layer.name.clone(),
                layer.parent,
                world(layer.anchor),
                layer.corners.map(|corners| corners.map(world)),
                layer.texels,
                layer.leaf_count,
                layer.wood_triangle_count,
            )
        };
        self.inner.layers().iter().map(row).collect()
    }

    /// Share of the texture that layers cover.
    #[getter]
    fn atlas_fill(&self) -> f64 {
        self.inner.fill()
    }

    /// Where each layer of a copy goes from where it was built, in the world: shape (N, 4, 4).
    #[pyo3(signature = (camera, *, wind, copy))]
    fn poses<'py>(
        &self,
        py: Python<'py>,
        camera: CameraFacts,
        wind: Option<WindFacts>,
        copy: (u32, u32),
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let view = camera.view()?;
        let origin = DAffine3::from_translation(self.inner.origin());
        let wind = wind.map(|facts| facts.wind()).transpose()?;
        let gust = wind.map(|wind| Gust { wind, time_secs: view.time_secs, key: copy });
        let crown = Crown { key: copy, wind: gust, ..Crown::alone(origin) };
        let poses = py.detach(|| self.inner.poses(&view, &crown));
        let mut rows = Vec::with_capacity(poses.len() * 16);
        for pose in &poses {
            let world = origin * *pose * origin.inverse();
            // rows of a column-vector matrix
            let columns = [world.x_axis, world.y_axis, world.z_axis, world.translation];
            rows.extend([0, 1, 2].into_iter().flat_map(|row| columns.map(|column| column[row])));
            rows.extend([0.0, 0.0, 0.0, 1.0]);
        }
        PyArray1::from_vec(py, rows).reshape([poses.len(), 4, 4])
    }
}

/// Groups limbs or cuts slabs, and bakes a layer for each.
#[pyfunction]
#[pyo3(signature = (plant, facts, *, threads, progress))]
pub(super) fn layered_billboards(
    py: Python<'_>,
    plant: &Plant,
    facts: LayerFacts,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<LayeredBillboards> {
    let plant = Arc::clone(&plant.inner);
    let params = facts.params()?;
    let inner = run(py, threads, progress, move |job| {
        core::LayeredBillboards::build(&plant, &params, job)
    })?;
    Ok(LayeredBillboards { inner: Arc::new(inner) })
}
