//! Leaf clusters for Python.

use std::sync::Arc;

use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;

use super::arrays::matrix;
use super::lod::{Representation, choice, wood_from};
use super::plant::Plant;
use super::run::run;
use super::view::CameraFacts;
use crate::lod::Representation as _;
use crate::lod::leaf_clusters::impostor::{Flatten, Outline};
use crate::lod::leaf_clusters::indirect::Indirect;
use crate::lod::leaf_clusters::kmeans::Init;
use crate::lod::leaf_clusters::plane::{Eigen, Plane};
use crate::lod::leaf_clusters::{self as core, Alpha, Drawing, Params, Texels, Transition};
use crate::lod::level_rule::LevelRule;
use crate::texture::Format;

/// Parameters as the Python face states them: one of each pair of alternatives is given.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct LeafClusterFacts {
    cluster_counts: Vec<usize>,
    alpha: Option<f64>,
    alpha_rel: f64,
    init: InitFacts,
    seed: u64,
    restarts: usize,
    max_iterations: usize,
    eigen: String,
    flatten: String,
    two_sided: bool,
    resolution: (u32, u32),
    texels_per_metre: Option<f64>,
    samples: u32,
    format: String,
    texturing: String,
    layers: usize,
    rotation_count: usize,
    leaf_resolution: u32,
    texels_per_leaf: u32,
    drawing: String,
    outline: Option<usize>,
    level_error_px: f64,
    level_distances: Option<Vec<f64>>,
    morph: bool,
    fade_share: f64,
    wood: bool,
    wood_triangle_count: Option<usize>,
    views: Option<Vec<CameraFacts>>,
}

/// The name of a rule, cluster ids, or planes.
#[derive(FromPyObject)]
enum InitFacts {
    Named(String),
    Ids(Vec<u32>),
    Planes(Vec<[f64; 4]>),
}

impl LeafClusterFacts {
    fn params(self, plant: &crate::plant::Plant) -> PyResult<Params> {
        let inits = [("plus_plus", Init::PlusPlus), ("random", Init::Random)];
        let init = match self.init {
            InitFacts::Named(name) => {
                let names: Vec<(&str, usize)> = vec![(inits[0].0, 0), (inits[1].0, 1)];
                inits[choice("init", &name, &names)?].1.clone()
            }
            InitFacts::Ids(ids) => Init::Ids(ids),
            InitFacts::Planes(planes) => Init::Planes(
                planes
                    .into_iter()
                    .map(|[x, y, z, d]| {
                        Plane { normal: [x, y, z].into(), d }.relative_to(plant.origin)
                    })
                    .collect(),
            ),
        };
        let eigens = [("exact", Eigen::Exact), ("paper", Eigen::Paper)];
        let flattens = [("project", Flatten::Project), ("rotate", Flatten::Rotate)];
        let drawings =
            [("test", Drawing::Test), ("coverage", Drawing::Coverage), ("blend", Drawing::Blend)];
        let texturings = [("direct", false), ("indirect", true)];
        let is_indirect = choice("texturing", &self.texturing, &texturings)?;
        let views = self.views.map(|views| views.iter().map(CameraFacts::view).collect());
        Ok(Params {
            cluster_counts: self.cluster_counts,
            alpha: self.alpha.map_or(Alpha::Relative(self.alpha_rel), Alpha::SquareMetres),
            init,
            seed: self.seed,
            restart_count: self.restarts,
            max_iterations: self.max_iterations,
            eigen: choice("eigen", &self.eigen, &eigens)?,
            flatten: choice("flatten", &self.flatten, &flattens)?,
            two_sided: self.two_sided,
            texels: self
                .texels_per_metre
                .map_or(Texels::Each(self.resolution.0, self.resolution.1), Texels::PerMetre),
            sample_count: self.samples,
            format: choice("format", &self.format, &Format::ALL)?,
            indirect: is_indirect.then_some(Indirect {
                layer_count: self.layers,
                rotation_count: self.rotation_count,
                leaf_resolution: self.leaf_resolution,
                texels_per_leaf: self.texels_per_leaf,
            }),
            drawing: choice("drawing", &self.drawing, &drawings)?,
            outline: self
                .outline
                .map_or(Outline::Rectangle, |max_corner_count| Outline::Hull { max_corner_count }),
            rule: self
                .level_distances
                .map_or(LevelRule::Pixels(self.level_error_px), LevelRule::Distances),
            transition: Transition { morph: self.morph, fade_share: self.fade_share },
            wood: wood_from(self.wood, self.wood_triangle_count),
            views: views.transpose()?,
        })
    }
}

/// Leaves in clusters with a card each, on one or several levels. Immutable.
#[pyclass(frozen, module = "treelod._core")]
pub(super) struct LeafClusters {
    inner: core::LeafClusters,
}

#[pymethods]
impl LeafClusters {
    /// What is drawn: levels as the view asks for them.
    fn representation(&self) -> Representation {
        Representation { inner: Arc::new(self.inner.clone()) }
    }

    /// The same at a fixed level, a share `t` of the way to the next.
    fn at(&self, level: usize, t: f64) -> PyResult<Self> {
        Ok(Self { inner: self.inner.at(level, t)? })
    }

    #[getter]
    fn level_count(&self) -> usize {
        self.inner.level_count()
    }

    /// Cluster of each leaf at a level, shape (L,).
    fn cluster_ids<'py>(
        &self,
        py: Python<'py>,
        level: usize,
    ) -> PyResult<Bound<'py, PyArray1<u32>>> {
        self.check(level)?;
        Ok(self.inner.cluster_ids(level).to_vec().into_pyarray(py))
    }

    /// Planes of a level in the world, shape (K, 4).
    fn planes<'py>(&self, py: Python<'py>, level: usize) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.check(level)?;
        let rows = self.inner.planes(level).into_iter();
        let rows: Vec<[f64; 4]> =
            rows.map(|Plane { normal, d }| [normal.x, normal.y, normal.z, d]).collect();
        matrix(py, &rows)
    }

    /// For each cluster of a level, its cluster of the next: shape (K,), or (0,) at the coarsest.
    fn parents<'py>(&self, py: Python<'py>, level: usize) -> PyResult<Bound<'py, PyArray1<u32>>> {
        self.check(level)?;
        Ok(self.inner.parents(level).to_vec().into_pyarray(py))
    }

    /// Metres, one a level.
    #[getter]
    fn level_errors(&self) -> Vec<f64> {
        self.inner.errors().to_vec()
    }

    /// Total error of k-means after each iteration, in square metres, and whether it converged.
    #[getter]
    fn kmeans_errors(&self) -> (Vec<f64>, bool) {
        let (errors, converged) = self.inner.kmeans_errors();
        (errors.to_vec(), converged)
    }

    #[getter]
    fn alpha(&self) -> f64 {
        self.inner.alpha()
    }

    /// Of each side of a level's cards: cluster, whether it is behind, corners of its picture (4, 3)
    /// and of the card (V, 3) in the world, and its x, y, width and height in the texture or None.
    fn card_sides(&self, level: usize) -> PyResult<Vec<SideFacts>> {
        self.check(level)?;
        let origin = self.inner.origin();
        let world = |point: glam::DVec3| (point + origin).to_array();
        let sides = self.inner.card_sides(level).into_iter();
        Ok(sides
            .map(|side| {
                let outline = side.outline.into_iter().map(world).collect();
                (side.cluster, side.is_back, side.rect.corners().map(world), outline, side.texels)
            })
            .collect())
    }

    #[getter]
    fn atlas_fills(&self) -> Vec<f64> {
        self.inner.atlas_fills()
    }
}

type SideFacts = (usize, bool, [[f64; 3]; 4], Vec<[f64; 3]>, Option<[u32; 4]>);

impl LeafClusters {
    fn check(&self, level: usize) -> PyResult<()> {
        let count = self.inner.level_count();
        if level < count {
            return Ok(());
        }
        Err(PyIndexError::new_err(format!("level {level} of {count}")))
    }
}

/// Clusters leaves and bakes their cards.
#[pyfunction]
#[pyo3(signature = (plant, facts, *, threads, progress))]
pub(super) fn leaf_clusters(
    py: Python<'_>,
    plant: &Plant,
    facts: LeafClusterFacts,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<LeafClusters> {
    let plant = Arc::clone(&plant.inner);
    let params = facts.params(&plant)?;
    let inner =
        run(py, threads, progress, move |job| core::LeafClusters::build(&plant, &params, job))?;
    Ok(LeafClusters { inner })
}
