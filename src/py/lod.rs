//! Techniques for Python: each builds a representation, which is then drawn and looked at.

use std::sync::Arc;

use numpy::{PyArray1, PyArray3, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::plant::Plant;
use super::run::run;
use crate::lod;
use crate::lod::full_mesh::FullMesh;
use crate::lod::opacity::Correction;
use crate::lod::wood::Wood;
use crate::texture::Filter;

/// A plant as one technique stands for it. Immutable.
#[pyclass(frozen, module = "treelod._core")]
pub(super) struct Representation {
    pub(super) inner: Arc<dyn lod::Representation>,
}

#[pymethods]
impl Representation {
    /// Counts and bytes by name.
    #[getter]
    fn footprint<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let footprint = self.inner.footprint();
        let facts = PyDict::new(py);
        facts.set_item("triangles", footprint.triangle_count)?;
        facts.set_item("cards", footprint.card_count)?;
        facts.set_item("lines", footprint.line_count)?;
        facts.set_item("points", footprint.point_count)?;
        facts.set_item("geometry_bytes", footprint.geometry_bytes)?;
        facts.set_item("texture_bytes", footprint.texture_bytes)?;
        Ok(facts)
    }

    /// Name, levels as (H, W, 4) uint8 arrays, and corners (4, 3) in the plant's world or None.
    #[getter]
    fn textures<'py>(&self, py: Python<'py>) -> PyResult<Vec<TextureFacts<'py>>> {
        let origin = self.inner.origin();
        self.inner
            .textures()
            .into_iter()
            .map(|named| {
                let levels = named.texture.levels().iter().map(|level| {
                    let shape = [level.height as usize, level.width as usize, 4];
                    PyArray1::from_slice(py, bytemuck::cast_slice::<[u8; 4], u8>(&level.texels))
                        .reshape(shape)
                });
                let corners = named
                    .rect
                    .map(|rect| rect.corners().map(|corner| (corner + origin).to_array()));
                Ok((named.name, levels.collect::<PyResult<_>>()?, corners))
            })
            .collect()
    }
}

type TextureFacts<'py> = (String, Vec<Bound<'py, PyArray3<u8>>>, Option<[[f64; 3]; 4]>);

pub(super) fn wood_from(wood: bool, triangle_count: Option<usize>) -> Wood {
    match (wood, triangle_count) {
        (false, _) => Wood::None,
        (true, None) => Wood::Full,
        (true, Some(count)) => Wood::Simplified(count),
    }
}

pub(super) fn filter_from(name: &str) -> PyResult<Filter> {
    let filters = [
        ("nearest", Filter::Nearest),
        ("bilinear", Filter::Bilinear),
        ("trilinear", Filter::Trilinear),
    ];
    choice("filter", name, &filters)
}

pub(super) fn choice<T: Copy>(
    name: &'static str,
    value: &str,
    choices: &[(&str, T)],
) -> PyResult<T> {
    let found = choices.iter().find(|(text, _)| *text == value);
    found.map(|&(_, chosen)| chosen).ok_or_else(|| {
        let known: Vec<String> = choices.iter().map(|(text, _)| format!("{text:?}")).collect();
        PyValueError::new_err(format!("{name} must be {}, got {value:?}", known.join(" or ")))
    })
}

/// The plant as it is.
#[pyfunction]
#[pyo3(signature = (plant, *, wood, wood_triangle_count, filter))]
pub(super) fn full_mesh(
    py: Python<'_>,
    plant: &Plant,
    wood: bool,
    wood_triangle_count: Option<usize>,
    filter: &str,
) -> PyResult<Representation> {
    let filter = filter_from(filter)?;
    let wood = wood_from(wood, wood_triangle_count);
    let plant = Arc::clone(&plant.inner);
    let built = run(py, None, None, move |job| FullMesh::build(&plant, wood, filter, job))?;
    Ok(Representation { inner: Arc::new(built) })
}

/// A number, or the name of a rule that finds it.
#[derive(FromPyObject)]
pub(super) enum CorrectionFacts {
    Linear(f64),
    Named(String),
}

pub(super) fn correction_from(facts: CorrectionFacts) -> PyResult<Correction> {
    let corrections = [("fit", Correction::Fit), ("optical", Correction::Optical)];
    match facts {
        CorrectionFacts::Linear(m) => Ok(Correction::Linear(m)),
        CorrectionFacts::Named(name) => choice("correction", &name, &corrections),
    }
}
