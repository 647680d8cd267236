//! Criteria of foliage for Python, and functions of the caller's own as criteria.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use glam::{DAffine3, DVec3};
use numpy::{IntoPyArray, PyReadonlyArray1};
use pyo3::exceptions::{PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyTuple};

use super::arrays::{matrix, slice};
use super::lod::choice;
use super::run::run;
use super::view::CameraFacts;
use crate::error::LodError;
use crate::lod::foliage_hierarchy::criteria::{Criterion, MAX_DEPTH, Mask, Placed};
use crate::lod::foliage_hierarchy::cut::{Rule, scratch};
use crate::lod::foliage_hierarchy::depth_first::DepthFirst;
use crate::lod::foliage_hierarchy::forest::{Forest, NONE};
use crate::lod::foliage_hierarchy::quad::measure;
use crate::lod::foliage_hierarchy::stored;
use crate::lod::foliage_hierarchy::walk::walk;
use crate::lod::foliage_hierarchy::zone::{Zone, stretch};
use crate::view::{Projection, View};

/// What functions have raised, until the kernel that called them has returned.
static RAISED: Mutex<BTreeMap<u64, PyErr>> = Mutex::new(BTreeMap::new());

thread_local! {
    /// Whether a function of the caller's runs on this thread.
    static INSIDE: Cell<bool> = const { Cell::new(false) };
}

fn inside<T>(call: impl FnOnce() -> T) -> T {
    INSIDE.set(true);
    let answer = call();
    INSIDE.set(false);
    answer
}

/// Refuses a kernel that a criterion's function asks for: it would wait for the thread it runs on.
pub(super) fn check_not_inside() -> PyResult<()> {
    if INSIDE.get() {
        let text = "a criterion's function must not draw or build anything with treelod";
        return Err(PyRuntimeError::new_err(text));
    }
    Ok(())
}

/// Forgets what functions have raised in a call that ends for another reason.
pub(super) fn forget_raised(error: &LodError) {
    if let LodError::Callback { id } = error {
        drop(take_raised(*id));
    }
}

/// Keeps an exception while the core passes its number on.
fn raised(error: PyErr) -> LodError {
    static NEXT_ID: AtomicU64 = AtomicU64::new(0);
    let id = NEXT_ID.fetch_add(1, Ordering::Relaxed);
    RAISED.lock().unwrap_or_else(PoisonError::into_inner).insert(id, error);
    LodError::Callback { id }
}

/// The exception behind a number.
pub(super) fn take_raised(id: u64) -> Option<PyErr> {
    RAISED.lock().unwrap_or_else(PoisonError::into_inner).remove(&id)
}

/// A criterion from name and values, as `treelod.criteria` hands it over: places are in the world that
/// the plant's file has, `origin` being where the forest's own zero is. It serves this forest alone.
///
/// # Errors
/// `ValueError` or `TypeError` if it is none, or its numbers have no meaning.
pub(super) fn criterion(
    facts: &Bound<'_, PyAny>,
    forest: &Arc<Forest>,
    origin: DVec3,
) -> PyResult<Criterion> {
    let criterion = part(facts, forest, origin, 1)?;
    criterion.check()?;
    Ok(criterion)
}

fn part(
    facts: &Bound<'_, PyAny>,
    forest: &Arc<Forest>,
    origin: DVec3,
    depth: u64,
) -> PyResult<Criterion> {
    crate::error::check_limit("criterion", depth, MAX_DEPTH, "criteria within one another")?;
    let facts = facts.cast::<PyTuple>().map_err(|_| {
        PyTypeError::new_err("criterion must be a tuple of a name and what belongs to it")
    })?;
    let below = |item: &Bound<'_, PyAny>| part(item, forest, origin, depth + 1);
    let parts = || -> PyResult<Vec<Criterion>> {
        facts.get_item(1)?.cast::<PyList>()?.iter().map(|item| below(&item)).collect()
    };
    let vector = |at: usize| -> PyResult<DVec3> {
        facts.get_item(at)?.extract::<[f64; 3]>().map(DVec3::from)
    };
    let name: String = facts.get_item(0)?.extract()?;
    Ok(match name.as_str() {
        "sphere" => Criterion::Sphere {
            center: vector(1)? - origin,
            radius: facts.get_item(2)?.extract()?,
            is_fine_inside: facts.get_item(3)?.extract()?,
            growth: facts.get_item(4)?.extract()?,
        },
        "plane" => Criterion::Plane { point: vector(1)? - origin, normal: vector(2)? },
        "frustum" => Criterion::Frustum,
        "screen_size" => Criterion::ScreenSize { pixels: facts.get_item(1)?.extract()? },
        "distance" => Criterion::Distance { max_distance: facts.get_item(1)?.extract()? },
        "and" => Criterion::And(parts()?),
        "or" => Criterion::Or(parts()?),
        "not" => Criterion::Not(Box::new(below(&facts.get_item(1)?)?)),
        "function" => {
            let function = Function {
                function: facts.get_item(1)?.unbind(),
                forest: Arc::clone(forest),
                arrays: Mutex::default(),
            };
            Criterion::Mask(Mask::new(move |forest, placed| function.ask(forest, placed)))
        }
        _ => return Err(PyValueError::new_err(format!("criterion {name:?} is none"))),
    })
}

/// A function of the caller's own, with what it is given.
struct Function {
    function: Py<PyAny>,
    forest: Arc<Forest>,
    /// As made for the last transform.
    arrays: Mutex<Option<(DAffine3, Py<PyTuple>)>>,
}

impl Function {
    fn ask(&self, forest: &Forest, placed: &Placed<'_>) -> Result<Vec<bool>, LodError> {
        assert!(
            std::ptr::eq(forest, &raw const *self.forest),
            "asked for the forest it was made for"
        );
        Python::attach(|py| self.call(py, placed)).map_err(raised)
    }

    fn call(&self, py: Python<'_>, placed: &Placed<'_>) -> PyResult<Vec<bool>> {
        let arrays = self.arrays(py, &placed.world_from_local)?;
        let camera = camera(py, placed.view)?;
        let answer = inside(|| self.function.call1(py, (arrays, camera)))?;
        let answer: PyReadonlyArray1<'_, bool> = answer.extract(py)?;
        Ok(slice("criterion", &answer)?.to_vec())
    }

    /// The lock is never held while Python runs, which may hand the interpreter to a thread that
    /// waits for the lock.
    fn arrays<'py>(&self, py: Python<'py>, at: &DAffine3) -> PyResult<Bound<'py, PyTuple>> {
        let lock = || self.arrays.lock().unwrap_or_else(PoisonError::into_inner);
        let known = lock()
            .as_ref()
            .filter(|(made_for, _)| made_for == at)
            .map(|(_, known)| known.clone_ref(py));
        if let Some(known) = known {
            return Ok(known.into_bound(py));
        }
        let made = arrays(py, &self.forest, at)?;
        let replaced = lock().replace((*at, made.clone().unbind()));
        drop(replaced);
        Ok(made)
    }
}

/// In the order of `treelod.criteria.Nodes`.
fn arrays<'py>(py: Python<'py>, forest: &Forest, at: &DAffine3) -> PyResult<Bound<'py, PyTuple>> {
    let nodes = (0_u32..).zip(&forest.nodes);
    let place = |point: DVec3| at.transform_point3(point);
    let centers: Vec<DVec3> = nodes
        .clone()
        // rounded as the core's own criteria see them
        .map(|(node, _)| place(measure(&forest.quad(node)).center.as_vec3().as_dvec3()))
        .collect();
    let balls: Vec<DVec3> =
        forest.spheres.iter().map(|ball| place(ball.center.as_dvec3())).collect();
    let stretch = stretch(&at.matrix3);
    let radii: Vec<f64> =
        forest.spheres.iter().map(|ball| f64::from(ball.radius) * stretch).collect();
    let leaf_count = forest.leaf_count as usize;
    let costs: Vec<f64> =
        std::iter::repeat_n(0.0, leaf_count).chain(forest.costs.iter().copied()).collect();
    let parents: Vec<i64> = nodes
        .clone()
        .map(|(_, node)| if node.parent == NONE { -1 } else { i64::from(node.parent) })
        .collect();
    let is_leaf: Vec<bool> = nodes.map(|(_, node)| node.is_leaf()).collect();
    (
        matrix::<f64, DVec3>(py, &centers)?,
        matrix::<f64, DVec3>(py, &balls)?,
        radii.into_pyarray(py),
        forest.areas.clone().into_pyarray(py),
        costs.into_pyarray(py),
        parents.into_pyarray(py),
        is_leaf.into_pyarray(py),
    )
        .into_pyobject(py)
}

/// The arguments of a `treelod.Camera` that shows a view.
fn camera<'py>(py: Python<'py>, view: &View) -> PyResult<Bound<'py, PyDict>> {
    // far enough not to be lost in rounding
    let target = view.eye - view.back * view.eye.length().max(1.0);
    let (fov_y_deg, height) = match view.projection {
        Projection::Perspective { fov_y } => (Some(fov_y.to_degrees()), None),
        Projection::Orthographic { height } => (None, Some(height)),
    };
    let facts = PyDict::new(py);
    facts.set_item("eye", view.eye.to_array())?;
    facts.set_item("target", target.to_array())?;
    facts.set_item("up", view.up.to_array())?;
    facts.set_item("fov_y_deg", fov_y_deg)?;
    facts.set_item("height", height)?;
    facts.set_item("size", (view.width, view.height))?;
    facts.set_item("near", view.near)?;
    Ok(facts)
}

/// The name of a rule.
pub(super) fn rule(name: &str) -> PyResult<Rule> {
    choice("rule", name, &[("inclusive", Rule::Inclusive), ("paper", Rule::Paper)])
}

/// A stored forest, and copies of it seen by cameras.
struct Seen {
    forest: Arc<Forest>,
    criterion: Criterion,
    views: Vec<View>,
    world_from_local: DAffine3,
}

impl Seen {
    fn new(
        stored: &[u8],
        origin: [f64; 3],
        criterion_facts: &Bound<'_, PyAny>,
        cameras: &[CameraFacts],
        transform: Option<[[f64; 4]; 3]>,
    ) -> PyResult<Self> {
        let origin = DVec3::from(origin);
        let forest = Arc::new(stored::read(stored, None)?.forest);
        let criterion = criterion(criterion_facts, &forest, origin)?;
        let views = cameras.iter().map(CameraFacts::view).collect::<Result<_, _>>()?;
        let to_scene = transform.map_or(DAffine3::IDENTITY, |[x, y, z]| {
            let column = |at: usize| DVec3::new(x[at], y[at], z[at]);
            DAffine3::from_cols(column(0), column(1), column(2), column(3))
        });
        let world_from_local = to_scene * DAffine3::from_translation(origin);
        Ok(Self { forest, criterion, views, world_from_local })
    }

    fn placed(&self) -> Vec<Placed<'_>> {
        let world_from_local = self.world_from_local;
        self.views.iter().map(|view| Placed { view, world_from_local }).collect()
    }
}

/// Active nodes of a stored forest for each camera, from scratch.
#[pyfunction]
#[pyo3(signature = (stored, criterion, cameras, *, origin, rule="inclusive", transform=None))]
pub(super) fn _cut_for_test(
    py: Python<'_>,
    stored: &[u8],
    criterion: &Bound<'_, PyAny>,
    cameras: Vec<CameraFacts>,
    origin: [f64; 3],
    rule: &str,
    transform: Option<[[f64; 4]; 3]>,
) -> PyResult<Vec<Vec<u32>>> {
    let seen = Seen::new(stored, origin, criterion, &cameras, transform)?;
    let rule = self::rule(rule)?;
    run(py, None, None, move |job| {
        let order = DepthFirst::new(&seen.forest);
        let cut = |placed: &Placed<'_>| {
            job.check()?;
            let zone = Zone::new(&seen.criterion, &seen.forest, &order, placed)?;
            Ok(scratch(&order, &zone, rule).0)
        };
        seen.placed().iter().map(cut).collect()
    })
}

type FrameFacts = (f64, f64, usize, usize, usize, usize, usize, usize);

/// For each camera: microseconds from scratch and followed, active and dirty entries, questions asked
/// from scratch and followed, blocks passed, collapses and splits.
#[pyfunction]
#[pyo3(signature = (stored, criterion, cameras, *, origin, rule="inclusive", rounds=9, threads=None))]
#[expect(clippy::too_many_arguments, reason = "called from one place, by a benchmark")]
pub(super) fn cut_times(
    py: Python<'_>,
    stored: &[u8],
    criterion: &Bound<'_, PyAny>,
    cameras: Vec<CameraFacts>,
    origin: [f64; 3],
    rule: &str,
    rounds: usize,
    threads: Option<usize>,
) -> PyResult<Vec<FrameFacts>> {
    let seen = Seen::new(stored, origin, criterion, &cameras, None)?;
    let rule = self::rule(rule)?;
    let frames = run(py, threads, None, move |job| {
        let order = DepthFirst::new(&seen.forest);
        walk(&seen.forest, &order, &seen.placed(), &seen.criterion, rule, rounds, job)
    })?;
    Ok(frames
        .into_iter()
        .map(|frame| {
            let (fresh, steps) = (frame.scratch_steps, frame.followed_steps);
            (
                frame.scratch_micros,
                frame.followed_micros,
                frame.active_count,
                frame.dirty_count,
                fresh.asked_node_count + fresh.asked_ball_count,
                steps.asked_node_count + steps.asked_ball_count,
                steps.passed_count,
                steps.collapse_count
                    + steps.forced_collapse_count
                    + steps.split_count
                    + steps.forced_split_count,
            )
        })
        .collect())
}
