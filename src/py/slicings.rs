//! Slicings for Python.

use std::sync::Arc;

use glam::DVec3;
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::rows;
use super::lod::{CorrectionFacts, Representation, choice, correction_from, wood_from};
use super::plant::Plant;
use super::run::run;
use super::view::CameraFacts;
use crate::error::{LodError, check_in};
use crate::lod::level_rule::LevelRule;
use crate::lod::slicings::{LargeLeaves, Params, Slicings};
use crate::lod::view_blend::{ViewBlend, circle, sphere};
use crate::texture::Format;

/// Parameters as the Python face states them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct SlicingsFacts {
    slice_counts: Vec<usize>,
    level_error_px: f64,
    level_distances: Option<Vec<f64>>,
    resolution: (u32, u32),
    samples: u32,
    correction: CorrectionFacts,
    large_leaves: String,
    vertical: bool,
    mirrored: bool,
    drop_back: usize,
    sub_slices: usize,
    quadtree: Option<u32>,
    branch_level: Option<u32>,
    format: String,
    wood: bool,
    wood_triangle_count: Option<usize>,
    views: Option<Vec<CameraFacts>>,
}

impl SlicingsFacts {
    fn params(self, blend: ViewBlend) -> PyResult<Params> {
        let large = [("split", LargeLeaves::Split), ("mesh", LargeLeaves::Mesh)];
        let views = self.views.map(|views| views.iter().map(CameraFacts::view).collect());
        Ok(Params {
            blend: if self.vertical { blend.with_vertical()? } else { blend },
            slice_counts: self.slice_counts,
            rule: self
                .level_distances
                .map_or(LevelRule::Pixels(self.level_error_px), LevelRule::Distances),
            resolution: self.resolution,
            sample_count: self.samples,
            correction: correction_from(self.correction)?,
            large_leaves: choice("large_leaves", &self.large_leaves, &large)?,
            drop_back: self.drop_back,
            mirrored: self.mirrored,
            sub_slices: self.sub_slices,
            quadtree: self.quadtree,
            branch_level: self.branch_level,
            format: choice("format", &self.format, &Format::ALL)?,
            wood: wood_from(self.wood, self.wood_triangle_count),
            views: views.transpose()?,
        })
    }
}

/// Slices through the crown; also what was measured while baking, and which slicings were baked.
#[pyfunction]
#[pyo3(signature = (plant, orientations, sphere_triangles, params, *, threads, progress))]
pub(super) fn slicings<'py>(
    py: Python<'py>,
    plant: &Plant,
    orientations: PyReadonlyArray2<'py, f64>,
    sphere_triangles: Option<PyReadonlyArray2<'py, u32>>,
    params: SlicingsFacts,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Representation, Bound<'py, PyDict>)> {
    let directions: Vec<[f64; 3]> = rows("orientations", &orientations)?;
    let directions: Vec<DVec3> = directions.into_iter().map(DVec3::from).collect();
    let triangles =
        sphere_triangles.map(|t| rows::<u32, [u32; 3]>("sphere_triangles", &t)).transpose()?;
    let params = params.params(ViewBlend::new(&directions, triangles)?)?;
    let plant = Arc::clone(&plant.inner);
    let (built, measured) =
        run(py, threads, progress, move |job| Slicings::build(&plant, &params, job))?;
    let facts = PyDict::new(py);
    let levels: PyResult<Vec<Bound<'py, PyDict>>> = measured
        .levels
        .iter()
        .map(|level| {
            let facts = PyDict::new(py);
            facts.set_item("slice_count", level.slice_count)?;
            facts.set_item("m", level.m)?;
            facts.set_item("fitted", level.fitted)?;
            facts.set_item("tau", level.tau)?;
            facts.set_item("error", level.error)?;
            Ok(facts)
        })
        .collect();
    facts.set_item("levels", levels?)?;
    facts.set_item("large_leaf_count", measured.large_leaf_count)?;
    facts.set_item("part_count", measured.part_count)?;
    facts.set_item("baked", built.baked())?;
    Ok((Representation { inner: Arc::new(built) }, facts))
}

/// Points on the unit sphere, evenly: shape (count, 3).
#[pyfunction]
pub(super) fn sphere_directions(count: usize) -> Result<Vec<[f64; 3]>, LodError> {
    check_in("slicing_count", count, 1..=4096)?;
    Ok(sphere(count).into_iter().map(|direction| direction.to_array()).collect())
}

/// Points on the horizontal unit circle, evenly, from +z, counter-clockwise from above.
#[pyfunction]
pub(super) fn circle_directions(count: usize) -> Result<Vec<[f64; 3]>, LodError> {
    check_in("slicing_count", count, 1..=4096)?;
    Ok(circle(count).into_iter().map(|direction| direction.to_array()).collect())
}
