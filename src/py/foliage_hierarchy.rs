//! Collapsing foliage for Python.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use super::collapse::{CollapseFacts, forest_arrays};
use super::criteria::{criterion, rule};
use super::lod::{Representation, filter_from, wood_from};
use super::plant::Plant;
use super::run::run;
use super::view::CameraFacts;
use crate::error::{check_in, check_limit};
use crate::lod::foliage_hierarchy::cut::Steps;
use crate::lod::foliage_hierarchy::forest::Forest;
use crate::lod::foliage_hierarchy::stored::{self, Stored};
use crate::lod::foliage_hierarchy::{self as core, Drawing, Effort, Params, Selection};
use crate::lod::{Crown, Representation as _};
use crate::view_state::ViewState;

/// How it is drawn, as the Python face states it.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct HierarchyFacts<'py> {
    selection: SelectionFacts<'py>,
    filter: String,
    wood: bool,
    wood_triangle_count: Option<usize>,
    wood_levels: bool,
    wood_error_px: f64,
}

/// What is drawn: the first that is given.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct SelectionFacts<'py> {
    leaf_count: Option<usize>,
    quad_px: Option<f64>,
    criterion: Option<Bound<'py, PyAny>>,
    rule: String,
}

impl SelectionFacts<'_> {
    fn selection(&self, forest: &Arc<Forest>, origin: DVec3) -> PyResult<Selection> {
        let rule = rule(&self.rule)?;
        if let Some(leaf_count) = self.leaf_count {
            return Ok(Selection::Level { leaf_count });
        }
        if let Some(quad_px) = self.quad_px {
            return Ok(Selection::Uniform { quad_px });
        }
        let facts = self.criterion.as_ref().expect("the face gives one of the three");
        let criterion = criterion(facts, forest, origin)?;
        Ok(Selection::Variable { criterion, rule })
    }
}

impl HierarchyFacts<'_> {
    fn drawing(&self) -> PyResult<Drawing> {
        Ok(Drawing {
            filter: filter_from(&self.filter)?,
            wood: wood_from(self.wood, self.wood_triangle_count),
            has_wood_levels: self.wood_levels,
            wood_error_px: self.wood_error_px,
        })
    }
}

/// Leaves that collapse, and which of them are drawn. Immutable.
#[pyclass(frozen, module = "treelod._core")]
pub(super) struct FoliageHierarchy {
    inner: core::FoliageHierarchy,
}

#[pymethods]
impl FoliageHierarchy {
    /// What is drawn.
    fn representation(&self) -> Representation {
        Representation { inner: Arc::new(self.inner.clone()) }
    }

    /// The same hierarchy with another selection.
    fn with_selection(&self, selection: SelectionFacts<'_>) -> PyResult<Self> {
        let selection = selection.selection(self.inner.forest(), self.inner.origin())?;
        Ok(Self { inner: self.inner.with_selection(selection)? })
    }

    /// The forest's arrays.
    fn forest<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        forest_arrays(py, self.inner.forest(), self.inner.origin())
    }

    /// The forest as bytes, with 32 bytes that name its plant, and a note.
    fn stored<'py>(
        &self,
        py: Python<'py>,
        plant: [u8; 32],
        note: &[u8],
    ) -> PyResult<Bound<'py, PyBytes>> {
        check_limit("note", note.len() as u64, stored::MAX_NOTE_BYTES as u64, "bytes")?;
        let forest = Arc::clone(self.inner.forest());
        let bytes = run(py, None, None, |_| Ok(stored::write(&forest, &plant, note)))?;
        Ok(PyBytes::new(py, &bytes))
    }

    #[getter]
    fn leaf_count(&self) -> u32 {
        self.inner.forest().leaf_count
    }

    #[getter]
    fn root_count(&self) -> usize {
        self.inner.forest().root_count()
    }

    /// Bytes of nodes and vertices, and of all else that the forest holds.
    #[getter]
    fn forest_bytes(&self) -> (u64, u64) {
        (self.inner.forest().structure_bytes(), self.inner.forest().side_bytes())
    }

    /// Triangles and error in metres of each level of the wood.
    #[getter]
    fn wood_levels(&self) -> Vec<(usize, f64)> {
        let wood = self.inner.wood();
        wood.triangle_counts().iter().copied().zip(wood.errors().iter().copied()).collect()
    }

    /// Nodes that some cameras draw, one after the other, and what each took.
    fn walk<'py>(
        &self,
        py: Python<'py>,
        cameras: Vec<CameraFacts>,
        threads: Option<usize>,
    ) -> PyResult<Vec<ActiveFacts<'py>>> {
        let views = cameras.iter().map(CameraFacts::view).collect::<Result<Vec<_>, _>>()?;
        let inner = self.inner.clone();
        let found = run(py, threads, None, move |job| {
            // one copy, where the plant's file put it
            let world_from_local = DAffine3::from_translation(inner.origin());
            let crown = Crown::alone(world_from_local);
            let mut state = ViewState::default();
            let mut found = Vec::with_capacity(views.len());
            for view in &views {
                job.check()?;
                found.push(inner.active(view, &crown, &mut state)?);
            }
            Ok(found)
        })?;
        found
            .into_iter()
            .map(|(nodes, steps)| Ok((nodes.into_pyarray(py), step_facts(py, &steps)?)))
            .collect()
    }
}

type ActiveFacts<'py> = (Bound<'py, PyArray1<u32>>, Bound<'py, PyDict>);

fn step_facts<'py>(py: Python<'py>, steps: &Steps) -> PyResult<Bound<'py, PyDict>> {
    let facts = PyDict::new(py);
    facts.set_item("collapse_count", steps.collapse_count)?;
    facts.set_item("forced_collapse_count", steps.forced_collapse_count)?;
    facts.set_item("split_count", steps.split_count)?;
    facts.set_item("forced_split_count", steps.forced_split_count)?;
    facts.set_item("asked_node_count", steps.asked_node_count)?;
    facts.set_item("asked_ball_count", steps.asked_ball_count)?;
    facts.set_item("passed_count", steps.passed_count)?;
    Ok(facts)
}

/// Collapses a plant's leaves; with how many costs were computed and the `d_ref` in use.
#[pyfunction]
#[pyo3(signature = (plant, collapse, facts, *, keep_coverage, threads, progress))]
pub(super) fn foliage_hierarchy(
    py: Python<'_>,
    plant: &Plant,
    collapse: CollapseFacts,
    facts: HierarchyFacts<'_>,
    keep_coverage: bool,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(FoliageHierarchy, u64, f64)> {
    let plant = Arc::clone(&plant.inner);
    let params = Params { collapse: collapse.params()?, keep_coverage, drawing: facts.drawing()? };
    // refused before the work begins; the criterion is made again for the forest that it serves
    facts.selection.selection(&Arc::default(), plant.origin)?.check()?;
    if let Some(leaf_count) = facts.selection.leaf_count {
        check_in("leaf_count", leaf_count, 1..=plant.foliage.leaf_count().max(1))?;
    }
    let (inner, Effort { cost_count, d_ref }) =
        run(py, threads, progress, move |job| core::FoliageHierarchy::build(&plant, &params, job))?;
    let selected = FoliageHierarchy { inner }.with_selection(facts.selection)?;
    Ok((selected, cost_count, d_ref))
}

/// A hierarchy whose forest was stored, for the plant that it was made of, and the note beside it.
#[pyfunction]
#[pyo3(signature = (plant, bytes, digest, facts, *, threads))]
pub(super) fn stored_hierarchy<'py>(
    py: Python<'py>,
    plant: &Plant,
    bytes: &[u8],
    digest: [u8; 32],
    facts: HierarchyFacts<'_>,
    threads: Option<usize>,
) -> PyResult<(FoliageHierarchy, Bound<'py, PyBytes>)> {
    let plant = Arc::clone(&plant.inner);
    let drawing = facts.drawing()?;
    let (inner, note) = run(py, threads, None, move |job| {
        let Stored { forest, note, .. } = stored::read(bytes, Some(&digest))?;
        Ok((core::FoliageHierarchy::from_forest(&plant, forest, &drawing, job)?, note))
    })?;
    let selected = FoliageHierarchy { inner }.with_selection(facts.selection)?;
    Ok((selected, PyBytes::new(py, &note)))
}
