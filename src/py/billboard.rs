//! Billboards for Python: built, looked at, and turned into representations.

use std::sync::Arc;

use glam::DAffine3;
use pyo3::prelude::*;

use super::lod::{Representation, choice, wood_from};
use super::plant::Plant;
use super::run::run;
use super::view::CameraFacts;
use crate::error::check_in;
use crate::lod::Crown;
use crate::lod::Representation as _;
use crate::lod::billboard::alignment::{Align, Axis};
use crate::lod::billboard::{self as core, Drawing, Params, PictureBlend, Quad, WoodAs};
use crate::texture::Format;

/// Parameters by name, as the Python face has checked their types.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct BillboardFacts {
    align: String,
    axis: String,
    max_turn_deg: f64,
    view_count: usize,
    elevations_deg: Vec<f64>,
    view_blend: String,
    resolution: (u32, u32),
    samples: u32,
    drawing: String,
    format: String,
    views: Option<Vec<CameraFacts>>,
    wood: bool,
    wood_triangle_count: Option<usize>,
    wood_as: String,
}

impl BillboardFacts {
    fn params(self) -> PyResult<Params> {
        let aligns = [
            ("camera", Align::Camera),
            ("view_plane", Align::ViewPlane),
            ("limited", Align::Limited(self.max_turn_deg.to_radians())),
        ];
        let blends = [("nearest", PictureBlend::Nearest), ("cross_fade", PictureBlend::CrossFade)];
        let drawings =
            [("test", Drawing::Test), ("coverage", Drawing::Coverage), ("blend", Drawing::Blend)];
        let woods = [("picture", WoodAs::Picture), ("mesh", WoodAs::Mesh)];
        // also where it is not in use
        check_in("max_turn_deg", self.max_turn_deg, 0.0..=180.0)?;
        let views = self.views.map(|views| views.iter().map(CameraFacts::view).collect());
        Ok(Params {
            align: choice("align", &self.align, &aligns)?,
            axis: choice(
                "axis",
                &self.axis,
                &[("vertical", Axis::Vertical), ("free", Axis::Free)],
            )?,
            view_count: self.view_count,
            elevations: self.elevations_deg.into_iter().map(f64::to_radians).collect(),
            picture_blend: choice("view_blend", &self.view_blend, &blends)?,
            resolution: self.resolution,
            sample_count: self.samples,
            drawing: choice("drawing", &self.drawing, &drawings)?,
            format: choice("format", &self.format, &Format::ALL)?,
            wood: wood_from(self.wood, self.wood_triangle_count),
            wood_as: choice("wood_as", &self.wood_as, &woods)?,
            views: views.transpose()?,
        })
    }
}

/// A plant as one quad. Immutable.
#[pyclass(frozen, module = "treelod._core")]
pub(super) struct Billboard {
    inner: Arc<core::Billboard>,
}

type PictureFacts = (usize, [[f64; 3]; 4], [u32; 4]);
type QuadFacts = (usize, f32, [[f64; 3]; 4]);

#[pymethods]
impl Billboard {
    /// What is drawn.
    fn representation(&self) -> Representation {
        Representation { inner: Arc::clone(&self.inner) as _ }
    }

    /// Of each picture that was taken: its number, its corners (4, 3) in the plant's world, and its
    /// x, y, width and height in the texture.
    #[getter]
    fn pictures(&self) -> Vec<PictureFacts> {
        let origin = self.inner.origin();
        let pictures = self.inner.pictures().into_iter();
        pictures
            .map(|facts| {
                let corners = facts.corners.map(|corner| (corner + origin).to_array());
                (facts.number, corners, facts.texels)
            })
            .collect()
    }

    /// The quads of a copy that stands where the plant's file put it: of each, the picture's number,
    /// its fade, and its corners (4, 3) in the world.
    fn quads(&self, py: Python<'_>, camera: CameraFacts) -> PyResult<Vec<QuadFacts>> {
        let crown = Crown::alone(DAffine3::from_translation(self.inner.origin()));
        let view = camera.view()?;
        let quads: Vec<Quad> = py.detach(|| self.inner.quads(&view, &crown))?;
        let facts = |quad: Quad| {
            let corners = quad.corners.map(|corner| corner.to_array());
            (quad.number, quad.fade, corners)
        };
        Ok(quads.into_iter().map(facts).collect())
    }
}

/// Billboards of several plants that share one texture.
#[pyfunction]
#[pyo3(signature = (plants, facts, *, threads, progress))]
pub(super) fn billboards(
    py: Python<'_>,
    plants: Vec<PyRef<'_, Plant>>,
    facts: BillboardFacts,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Vec<Billboard>> {
    let params = facts.params()?;
    let plants: Vec<_> = plants.iter().map(|plant| Arc::clone(&plant.inner)).collect();
    let built = run(py, threads, progress, move |job| {
        let borrowed: Vec<_> = plants.iter().map(|plant| &**plant).collect();
        core::Billboard::forest(&borrowed, &params, job)
    })?;
    Ok(built.into_iter().map(|built| Billboard { inner: Arc::new(built) }).collect())
}
