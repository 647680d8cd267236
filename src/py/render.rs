//! Scenes and renderers for Python.

use std::sync::{Arc, Mutex, MutexGuard, TryLockError};
use std::time::Instant;

use glam::{DAffine3, DMat3, DVec3, Vec3, Vec4};
use numpy::{IntoPyArray, PyArray1, PyArrayMethods, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::gpu::{Backend, Card};
use super::lod::Representation;
use super::run::run;
use super::variety::VarietyFacts;
use super::view::CameraFacts;
use super::wind::WindFacts;
use crate::error::LodError;
use crate::job::Job;
use crate::raster::{self, Frame, Outputs, Settings, Stats};
use crate::scene;
use crate::simd::Level;
use crate::view::View;
use crate::view_state::ViewState;

/// Representations and where their copies stand. Immutable.
#[pyclass(frozen, module = "treelod._core")]
pub(super) struct Scene {
    inner: Arc<scene::Scene>,
}

#[pymethods]
impl Scene {
    /// Pairs of a representation and an (N, 4, 4) array of transforms; the wind that blows there, and how
    /// copies differ.
    #[new]
    #[pyo3(signature = (groups, *, wind = None, variety = None))]
    fn new(
        py: Python<'_>,
        groups: Vec<(PyRef<'_, Representation>, PyReadonlyArray3<'_, f64>)>,
        wind: Option<WindFacts>,
        variety: Option<VarietyFacts>,
    ) -> PyResult<Self> {
        let wind = wind.map(|facts| facts.wind()).transpose()?;
        let variety = variety.map(|facts| facts.variety()).transpose()?;
        let mut parts = Vec::new();
        for (representation, transforms) in &groups {
            parts.push((Arc::clone(&representation.inner), affine_rows(transforms)?));
        }
        drop(groups);
        let inner = run(py, None, None, move |_| {
            let mut scene = scene::Scene::default();
            for (representation, transforms) in parts {
                scene.add(representation, &transforms)?;
            }
            if let Some(wind) = wind {
                scene = scene.in_wind(wind)?;
            }
            if let Some(variety) = variety {
                scene = scene.varied(variety)?;
            }
            Ok(scene)
        })?;
        Ok(Self { inner: Arc::new(inner) })
    }

    #[getter]
    fn instance_count(&self) -> u64 {
        self.inner.instance_count()
    }

    /// Lowest and highest corner of the box around all copies, or None without any.
    #[getter]
    fn bounds(&self) -> Option<([f64; 3], [f64; 3])> {
        self.inner.bounds().map(|(low, high)| (low.to_array(), high.to_array()))
    }

    /// Pixels (left, top, right, bottom) of a camera's picture that the box around all can touch.
    fn bounds_px(&self, camera: CameraFacts) -> PyResult<(u32, u32, u32, u32)> {
        let view = camera.view()?;
        let [left, top, right, bottom] =
            self.inner.bounds().map_or([0; 4], |(low, high)| view.bounds_px(low, high));
        Ok((left, top, right, bottom))
    }
}

fn affine_rows(transforms: &PyReadonlyArray3<'_, f64>) -> PyResult<Vec<DAffine3>> {
    let &[count, rows, columns] = transforms.shape() else { unreachable!("three dimensions") };
    if (rows, columns) != (4, 4) {
        let text =
            format!("transforms must have shape (N, 4, 4), got ({count}, {rows}, {columns})");
        return Err(PyValueError::new_err(text));
    }
    let flat = transforms.as_slice()?;
    flat.chunks_exact(16)
        .enumerate()
        .map(|(index, m)| {
            if m[12..16] != [0.0, 0.0, 0.0, 1.0] {
                let text = format!("transforms must end in a row 0 0 0 1: number {index} does not");
                return Err(PyValueError::new_err(text));
            }
            let column = |c: usize| DVec3::new(m[c], m[4 + c], m[8 + c]);
            let matrix3 = DMat3::from_cols(column(0), column(1), column(2));
            Ok(DAffine3 { matrix3, translation: column(3) })
        })
        .collect()
}

/// The CPU renderer with its memory, for one thread at a time.
#[pyclass(frozen, module = "treelod._core")]
pub(super) struct Renderer {
    inner: Mutex<(raster::Renderer, ViewState)>,
}

#[pymethods]
impl Renderer {
    /// Vector instructions by name; `None`: what `TREELOD_SIMD` asks for, else the best.
    #[new]
    #[pyo3(signature = (*, simd = None))]
    fn new(simd: Option<&str>) -> Result<Self, LodError> {
        let renderer = match simd {
            Some(name) => raster::Renderer::with_simd(Level::named("simd", name)?),
            None => raster::Renderer::default(),
        };
        Ok(Self { inner: Mutex::new((renderer, ViewState::default())) })
    }

    /// Planes by name, and what drawing took.
    #[pyo3(signature = (
        scene, camera, *, samples, background, outputs, threads, backend = "cpu", adapter = None
    ))]
    #[expect(clippy::too_many_arguments, reason = "called from one place, by its Python face")]
    fn render<'py>(
        &self,
        py: Python<'py>,
        scene: &Scene,
        camera: CameraFacts,
        samples: u32,
        background: [f32; 4],
        outputs: Vec<String>,
        threads: Option<usize>,
        backend: &str,
        adapter: Option<String>,
    ) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyDict>)> {
        let view = camera.view()?;
        let settings = Settings {
            sample_count: samples,
            outputs: outputs_from(&outputs)?,
            background: Vec4::from(background),
            counts_fragments: true,
        };
        let backend = Backend::named(backend, adapter)?;
        let scene = Arc::clone(&scene.inner);
        let (frame, card) = run(py, threads, None, |job| {
            let mut guard = self.taken()?;
            let (renderer, state) = &mut *guard;
            let (list, emit_millis) = emit(&scene, &view, settings.outputs, state)?;
            let (mut frame, card) = backend.render(renderer, &list, &view, &settings, job)?;
            frame.stats.emit_millis = emit_millis;
            Ok((frame, card))
        })?;
        let stats = stats_facts(py, &frame.stats, card)?;
        Ok((planes(py, frame)?, stats))
    }

    /// Draws into warm memory without handing anything out: what a time contains.
    #[pyo3(signature = (scene, camera, *, samples, threads, backend = "cpu", adapter = None))]
    #[expect(clippy::too_many_arguments, reason = "called by its Python face alone")]
    fn time<'py>(
        &self,
        py: Python<'py>,
        scene: &Scene,
        camera: CameraFacts,
        samples: u32,
        threads: Option<usize>,
        backend: &str,
        adapter: Option<String>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let view = camera.view()?;
        let settings = Settings {
            sample_count: samples,
            outputs: Outputs::COLOR,
            background: Vec4::ZERO,
            counts_fragments: false,
        };
        let backend = Backend::named(backend, adapter)?;
        let scene = Arc::clone(&scene.inner);
        let (stats, card) = run(py, threads, None, |job: &Job| {
            let mut guard = self.taken()?;
            let (renderer, state) = &mut *guard;
            let (list, emit_millis) = emit(&scene, &view, settings.outputs, state)?;
            let (stats, card) = backend.draw(renderer, &list, &view, &settings, job)?;
            Ok((Stats { emit_millis, ..stats }, card))
        })?;
        stats_facts(py, &stats, card)
    }

    /// What a view draws, item by item in paint order: kind, count, and a key of what is drawn that holds
    /// in this process.
    fn signature(
        &self,
        py: Python<'_>,
        scene: &Scene,
        camera: CameraFacts,
    ) -> PyResult<Vec<(&'static str, u64, u64)>> {
        let view = camera.view()?;
        let scene = Arc::clone(&scene.inner);
        run(py, None, None, |_| {
            let mut guard = self.taken()?;
            let (_, state) = &mut *guard;
            let (list, _) = emit(&scene, &view, Outputs::COLOR, state)?;
            Ok(list.signature().iter().map(|item| (item.kind, item.count, item.key)).collect())
        })
    }
}

impl Renderer {
    /// The renderer, unless it is drawing for another thread: waiting for it inside the pool could
    /// keep that other picture from ever being finished.
    fn taken(&self) -> Result<MutexGuard<'_, (raster::Renderer, ViewState)>, LodError> {
        match self.inner.try_lock() {
            Ok(guard) => Ok(guard),
            Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => {
                let why = "is drawing for another thread; make one for each".to_owned();
                Err(LodError::Invalid { name: "renderer", why })
            }
        }
    }
}

/// Seconds in which the renderer's slow twin draws a scene.
#[pyfunction]
#[pyo3(signature = (scene, camera, *, samples))]
pub(super) fn time_naive(
    py: Python<'_>,
    scene: &Scene,
    camera: CameraFacts,
    samples: u32,
) -> PyResult<f64> {
    let view = camera.view()?;
    let scene = Arc::clone(&scene.inner);
    run(py, Some(1), None, |job| {
        let (list, _) = emit(&scene, &view, Outputs::COLOR_DEPTH, &mut ViewState::default())?;
        let start = Instant::now();
        raster::draw_naive(&list, &view, samples, job)?;
        Ok(start.elapsed().as_secs_f64())
    })
}

/// Multiplications and additions of `f32` a second that a thread does at best, with the vectors that
/// kernels use.
#[pyfunction]
pub(super) fn peak_rate(py: Python<'_>) -> PyResult<f64> {
    let level = Level::chosen()?;
    Ok(py.detach(|| crate::simd::peak_rate(level)))
}

/// The one list that draws a scene, and the milliseconds it took to make.
fn emit(
    scene: &scene::Scene,
    view: &View,
    targets: Outputs,
    state: &mut ViewState,
) -> Result<(crate::draw_list::DrawList, f64), LodError> {
    let start = Instant::now();
    let mut passes = scene.plan(view, targets, state)?;
    let last = passes.pop().expect("a scene has a pass that makes its picture");
    Ok((last.list, start.elapsed().as_secs_f64() * 1e3))
}

fn outputs_from(names: &[String]) -> PyResult<Outputs> {
    let mut outputs = Outputs { color: false, ..Outputs::COLOR };
    for name in names {
        match name.as_str() {
            "color" => outputs.color = true,
            "depth" => outputs.depth = true,
            "ids" => outputs.ids = true,
            "normal" => outputs.normal = true,
            "albedo" => outputs.albedo = true,
            "color8" => outputs.color8 = true,
            other => {
                let text = format!(
                    "outputs may hold 'color', 'depth', 'ids', 'normal', 'albedo' and 'color8', \
                     got {other:?}"
                );
                return Err(PyValueError::new_err(text));
            }
        }
    }
    Ok(outputs)
}

fn planes(py: Python<'_>, frame: Frame) -> PyResult<Bound<'_, PyDict>> {
    let size = [frame.height, frame.width];
    let planes = PyDict::new(py);
    let four = |plane: &[Vec4]| {
        let flat = bytemuck::cast_slice::<Vec4, f32>(plane);
        PyArray1::from_slice(py, flat).reshape([size[0], size[1], 4])
    };
    if !frame.color.is_empty() {
        planes.set_item("color", four(&frame.color)?)?;
    }
    if !frame.albedo.is_empty() {
        planes.set_item("albedo", four(&frame.albedo)?)?;
    }
    if !frame.depth.is_empty() {
        planes.set_item("depth", frame.depth.into_pyarray(py).reshape(size)?)?;
    }
    if !frame.ids.is_empty() {
        planes.set_item("ids", frame.ids.into_pyarray(py).reshape(size)?)?;
    }
    if !frame.normal.is_empty() {
        let flat = bytemuck::cast_slice::<Vec3, f32>(&frame.normal);
        let normal = PyArray1::from_slice(py, flat).reshape([size[0], size[1], 3])?;
        planes.set_item("normal", normal)?;
    }
    if !frame.color8.is_empty() {
        let flat = bytemuck::cast_slice::<[u8; 4], u8>(&frame.color8);
        let color8 = PyArray1::from_slice(py, flat).reshape([size[0], size[1], 4])?;
        planes.set_item("color8", color8)?;
    }
    Ok(planes)
}

fn stats_facts<'py>(
    py: Python<'py>,
    stats: &Stats,
    card: Option<Card>,
) -> PyResult<Bound<'py, PyDict>> {
    let facts = PyDict::new(py);
    facts.set_item("emit_millis", stats.emit_millis)?;
    facts.set_item("draw_millis", stats.draw_millis)?;
    facts.set_item("triangles", stats.triangle_count)?;
    facts.set_item("cards", stats.card_count)?;
    facts.set_item("lines", stats.line_count)?;
    facts.set_item("points", stats.point_count)?;
    facts.set_item("vertices", stats.vertex_count)?;
    facts.set_item("items", stats.item_count)?;
    facts.set_item("textures", stats.texture_count)?;
    if let Some(count) = stats.fragment_count {
        facts.set_item("fragments", count)?;
    }
    facts.set_item("threads", stats.thread_count)?;
    facts.set_item("gpu_millis", stats.gpu_millis)?;
    facts.set_item("backend", if card.is_some() { "gpu" } else { "cpu" })?;
    let (adapter, driver) = card.map(|card| (card.name, card.driver)).unzip();
    facts.set_item("adapter", adapter)?;
    facts.set_item("driver", driver)?;
    Ok(facts)
}
