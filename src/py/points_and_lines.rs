//! Points and lines for Python.

use std::sync::Arc;

use glam::Vec3;
use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{matrix, rows};
use super::lod::{Representation, choice, wood_from};
use super::plant::Plant;
use super::run::run;
use super::view::CameraFacts;
use crate::draw_list::Buffers;
use crate::lod::Representation as _;
use crate::lod::cloud::Cloud;
use crate::lod::points_and_lines::parts::{Class, Wishes};
use crate::lod::points_and_lines::{
    self as core, Antialias, Drawing, PairOrder, Params, Sampling, SplatFactor,
};

/// A number, or the name of a rule that finds it.
#[derive(FromPyObject)]
enum FactorFacts {
    Fixed(f64),
    Named(String),
}

/// What can be chosen without building anew.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct DrawingFacts {
    splat_factor: FactorFacts,
    sample_distance_px: f64,
    antialias: String,
}

impl DrawingFacts {
    fn drawing(&self) -> PyResult<Drawing> {
        let rules = [("coverage", SplatFactor::Coverage)];
        let antialias = [
            ("off", Antialias::Off),
            ("coverage", Antialias::Coverage),
            ("blend", Antialias::Blend),
        ];
        Ok(Drawing {
            splat_factor: match &self.splat_factor {
                FactorFacts::Fixed(factor) => SplatFactor::Fixed(*factor),
                FactorFacts::Named(name) => choice("splat_factor", name, &rules)?,
            },
            sample_distance_px: self.sample_distance_px,
            antialias: choice("antialias", &self.antialias, &antialias)?,
        })
    }
}

/// Parameters as the Python face states them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct PointsAndLinesFacts {
    drawing: DrawingFacts,
    sampling: String,
    pair_order: String,
    classes: Vec<(String, String)>,
    importance: Vec<(String, f64)>,
    automatic_importance: bool,
    orientation_factor: f64,
    octree_depth: usize,
    cell_triangle_count: u64,
    seed: u64,
    wood: bool,
    wood_triangle_count: Option<usize>,
}

const CLASSES: [(&str, Class); 3] =
    [("mesh", Class::Mesh), ("points", Class::Points), ("lines", Class::Lines)];

impl PointsAndLinesFacts {
    fn params(self) -> PyResult<Params> {
        let samplings = [
            ("auto", None),
            ("stratified", Some(Sampling::Stratified)),
            ("area", Some(Sampling::Area)),
        ];
        let orders = [("split", PairOrder::Split), ("paired", PairOrder::Paired)];
        let mut classes = vec![("auto", None)];
        classes.extend(CLASSES.map(|(name, class)| (name, Some(class))));
        let named = self.classes.into_iter();
        let named = named.map(|(part, class)| Ok((part, choice("classes", &class, &classes)?)));
        Ok(Params {
            drawing: self.drawing.drawing()?,
            sampling: choice("sampling", &self.sampling, &samplings)?,
            pair_order: choice("pair_order", &self.pair_order, &orders)?,
            wishes: Wishes {
                classes: named.collect::<PyResult<_>>()?,
                importance: self.importance,
                automatic_importance: self.automatic_importance,
            },
            orientation_factor: self.orientation_factor,
            octree_depth: self.octree_depth,
            cell_triangle_count: self.cell_triangle_count,
            seed: self.seed,
            wood: wood_from(self.wood, self.wood_triangle_count),
        })
    }
}

type SampleArrays<'py> = (Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<f32>>);

/// A plant as points, lines and the triangles they stand for. Immutable.
#[pyclass(frozen, module = "treelod._core")]
pub(super) struct PointsAndLines {
    inner: core::PointsAndLines,
}

fn class_name(class: Class) -> &'static str {
    let found = CLASSES.iter().find(|(_, known)| *known == class);
    found.map_or("mesh", |(name, _)| name)
}

#[pymethods]
impl PointsAndLines {
    /// What is drawn.
    fn representation(&self) -> Representation {
        Representation { inner: Arc::new(self.inner.clone()) }
    }

    /// The same points and lines, drawn otherwise.
    #[pyo3(signature = (facts, *, threads))]
    fn drawn(&self, py: Python<'_>, facts: DrawingFacts, threads: Option<usize>) -> PyResult<Self> {
        let drawing = facts.drawing()?;
        let inner = run(py, threads, None, move |job| self.inner.drawn(drawing, job))?;
        Ok(Self { inner })
    }

    /// Facts of each part.
    #[getter]
    fn parts<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let part_facts = |part: &crate::lod::points_and_lines::parts::Part| {
            let facts = PyDict::new(py);
            facts.set_item("name", &part.name)?;
            facts.set_item("is_wood", part.is_wood)?;
            facts.set_item("drawn_as", class_name(part.class))?;
            facts.set_item("importance", part.importance)?;
            facts.set_item("color", part.color.to_array())?;
            facts.set_item("area", part.area)?;
            facts.set_item("piece_count", part.piece_count)?;
            Ok(facts)
        };
        self.inner.parts().iter().map(part_facts).collect()
    }

    /// Facts of each group.
    #[getter]
    fn groups<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let origin = self.inner.origin();
        let group_facts = |group: &crate::lod::points_and_lines::groups::Group| {
            let facts = PyDict::new(py);
            facts.set_item("part", group.part)?;
            facts.set_item("cell", group.cell)?;
            facts.set_item("drawn_as", class_name(group.class))?;
            let stratified = group.sampling == Sampling::Stratified;
            facts.set_item("sampling", if stratified { "stratified" } else { "area" })?;
            facts.set_item("triangle_count", group.triangles.end - group.triangles.start)?;
            facts.set_item("opaque_triangle_count", group.opaque_count)?;
            facts.set_item("point_count", group.points.end - group.points.start)?;
            facts.set_item("line_count", group.lines.end - group.lines.start)?;
            facts.set_item("seen_area", group.seen_area)?;
            facts.set_item("line_length", group.line_length)?;
            facts.set_item("deviation", group.deviation)?;
            facts.set_item("center", (group.center + origin).to_array())?;
            facts.set_item("radius", group.radius)?;
            Ok(facts)
        };
        self.inner.groups().iter().map(group_facts).collect()
    }

    /// What a view needs of each group.
    fn selection<'py>(
        &self,
        py: Python<'py>,
        camera: CameraFacts,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let chosen_facts = |chosen: core::Chosen| {
            let facts = PyDict::new(py);
            facts.set_item("group", chosen.group)?;
            facts.set_item("distance", chosen.distance)?;
            facts.set_item("needed", chosen.needed)?;
            facts.set_item("line_share", chosen.line_share)?;
            facts.set_item("vertices", chosen.vertex_count())?;
            facts.set_item("triangles", chosen.triangle_count)?;
            let points: u32 = chosen.points.iter().map(|range| range.end - range.start).sum();
            facts.set_item("points", points)?;
            facts.set_item("lines", chosen.lines.end - chosen.lines.start)?;
            facts.set_item("point_size_px", chosen.sizes_px[0])?;
            facts.set_item("line_width_px", chosen.sizes_px[1])?;
            Ok(facts)
        };
        let view = camera.view()?;
        let chosen = py.detach(|| self.inner.selection(&view));
        chosen.into_iter().map(chosen_facts).collect()
    }

    /// Positions in the world and lit front colours of points, then of lines' ends: shape (N, 3) each.
    #[getter]
    fn samples<'py>(&self, py: Python<'py>) -> PyResult<[SampleArrays<'py>; 2]> {
        let origin = self.inner.origin().as_vec3();
        let arrays = |buffers: &Buffers| -> PyResult<SampleArrays<'py>> {
            let positions: Vec<Vec3> = buffers.positions.iter().map(|&p| p + origin).collect();
            Ok((matrix(py, &positions)?, matrix(py, &buffers.front)?))
        };
        let [points, lines] = self.inner.samples();
        Ok([arrays(points)?, arrays(lines)?])
    }

    /// Splat factors that cover as polygons do, from 2 points a triangle on, halved at each step.
    #[getter]
    fn factors(&self) -> Vec<f64> {
        self.inner.factors().to_vec()
    }

    /// Bytes of points and lines, and of triangles.
    #[getter]
    fn bytes(&self) -> [u64; 2] {
        self.inner.bytes()
    }
}

/// Given points, or lines between each two of them, as they are.
#[pyfunction]
#[pyo3(signature = (positions, colors, *, lines, size_px))]
pub(super) fn cloud(
    py: Python<'_>,
    positions: PyReadonlyArray2<'_, f32>,
    colors: PyReadonlyArray2<'_, f32>,
    lines: bool,
    size_px: f32,
) -> PyResult<Representation> {
    let positions: Vec<Vec3> = rows("positions", &positions)?;
    let colors: Vec<Vec3> = rows("colors", &colors)?;
    let built = py.detach(|| Cloud::new(&positions, &colors, lines, size_px))?;
    Ok(Representation { inner: Arc::new(built) })
}

/// Turns a plant into points and lines.
#[pyfunction]
#[pyo3(signature = (plant, facts, *, threads, progress))]
pub(super) fn points_and_lines(
    py: Python<'_>,
    plant: &Plant,
    facts: PointsAndLinesFacts,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<PointsAndLines> {
    let plant = Arc::clone(&plant.inner);
    let params = facts.params()?;
    let inner =
        run(py, threads, progress, move |job| core::PointsAndLines::build(&plant, &params, job))?;
    Ok(PointsAndLines { inner })
}
