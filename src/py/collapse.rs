//! Collapsing leaves for Python.

use glam::{DVec3, Vec3};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{matrix, rows, slice};
use super::lod::choice;
use super::run::run;
use crate::lod::foliage_hierarchy::collapse::{CollapseParams, collapse};
use crate::lod::foliage_hierarchy::cost::Distance;
use crate::lod::foliage_hierarchy::forest::Forest;
use crate::lod::foliage_hierarchy::naive::collapse_naive;
use crate::lod::foliage_hierarchy::new_leaf::Choice;

/// Parameters as the Python face states them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct CollapseFacts {
    distance: String,
    weight: f64,
    d_ref: Option<f64>,
    choice: String,
    keep_area: bool,
    target_leaf_count: usize,
    max_cost: Option<f64>,
}

impl CollapseFacts {
    pub(super) fn params(&self) -> PyResult<CollapseParams> {
        let distances = [("centre", Distance::Centre), ("hausdorff", Distance::Hausdorff)];
        let choices = [("balanced", Choice::Balanced), ("paper", Choice::Paper)];
        Ok(CollapseParams {
            distance: choice("distance", &self.distance, &distances)?,
            weight: self.weight,
            d_ref: self.d_ref,
            choice: choice("choice", &self.choice, &choices)?,
            keep_area: self.keep_area,
            target_leaf_count: self.target_leaf_count,
            max_cost: self.max_cost.unwrap_or(f64::INFINITY),
        })
    }
}

/// The arrays of a forest, with positions moved by `origin`.
pub(super) fn forest_arrays<'py>(
    py: Python<'py>,
    forest: &Forest,
    origin: DVec3,
) -> PyResult<Bound<'py, PyDict>> {
    let positions: Vec<[f64; 3]> =
        forest.positions.iter().map(|p| (p.as_dvec3() + origin).to_array()).collect();
    let vertices: Vec<[u32; 4]> = forest.nodes.iter().map(|node| node.vertices).collect();
    // -1 where there is none
    let link = |node: u32| i64::from(node.cast_signed());
    let children: Vec<[i64; 2]> = forest.nodes.iter().map(|node| node.children.map(link)).collect();
    let parents = forest.nodes.iter().map(|node| link(node.parent));
    let corners: Vec<[u32; 2]> = forest.corners.iter().map(|c| [c.leaf, c.turn]).collect();
    let spheres = forest.spheres.iter().map(|ball| {
        let center = ball.center.as_dvec3() + origin;
        [center.x, center.y, center.z, f64::from(ball.radius)]
    });
    let spheres: Vec<[f64; 4]> = spheres.collect();
    let facts = PyDict::new(py);
    let positions: Bound<'py, PyArray2<f64>> = matrix(py, &positions)?;
    facts.set_item("positions", positions)?;
    let vertices: Bound<'py, PyArray2<u32>> = matrix(py, &vertices)?;
    facts.set_item("vertices", vertices)?;
    let children: Bound<'py, PyArray2<i64>> = matrix(py, &children)?;
    facts.set_item("children", children)?;
    facts.set_item("parents", PyArray1::from_iter(py, parents))?;
    facts.set_item("costs", PyArray1::from_slice(py, &forest.costs))?;
    facts.set_item("areas", PyArray1::from_slice(py, &forest.areas))?;
    facts.set_item("scales", PyArray1::from_slice(py, &forest.scales))?;
    let corners: Bound<'py, PyArray2<u32>> = matrix(py, &corners)?;
    facts.set_item("texture_corners", corners)?;
    let spheres: Bound<'py, PyArray2<f64>> = matrix(py, &spheres)?;
    facts.set_item("balls", spheres)?;
    Ok(facts)
}

/// The arrays of the forest of some quads, with how many costs were computed and the `d_ref` in use.
#[pyfunction]
#[pyo3(signature = (corners, areas, facts, *, naive=false, threads=None, progress=None))]
pub(super) fn collapse_leaves<'py>(
    py: Python<'py>,
    corners: PyReadonlyArray2<'py, f32>,
    areas: PyReadonlyArray1<'py, f64>,
    facts: CollapseFacts,
    naive: bool,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyDict>, u64, f64)> {
    let flat: Vec<[[f32; 3]; 4]> = rows("corners", &corners)?;
    let quads: Vec<[Vec3; 4]> = flat.into_iter().map(|quad| quad.map(Vec3::from)).collect();
    let areas = slice("areas", &areas)?.to_vec();
    let params = facts.params()?;
    let collapse = if naive { collapse_naive } else { collapse };
    let found = run(py, threads, progress, |job| collapse(&quads, &areas, &params, job))?;
    let arrays = forest_arrays(py, &found.forest, DVec3::ZERO)?;
    Ok((arrays, found.cost_count, found.rule.d_ref))
}
