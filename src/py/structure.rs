//! How a grown plant branches, as arrays: for a plant that travels to another process.

use std::sync::Arc;

use glam::Vec3;
use numpy::{PyReadonlyArray1, PyReadonlyArray2, ToPyArray};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{matrix, rows, slice};
use crate::plant::{Branch, Structure};

/// Parent of a trunk.
const NO_PARENT: i64 = -1;

/// Branches as Python states them: one row a branch, but for `leaf_branches`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct StructureArrays<'py> {
    parents: PyReadonlyArray1<'py, i64>,
    levels: PyReadonlyArray1<'py, u32>,
    starts: PyReadonlyArray2<'py, f32>,
    ends: PyReadonlyArray2<'py, f32>,
    radii: PyReadonlyArray1<'py, f32>,
    wood_triangles: PyReadonlyArray2<'py, u32>,
    leaves: PyReadonlyArray2<'py, u32>,
    leaf_branches: PyReadonlyArray1<'py, u32>,
}

impl StructureArrays<'_> {
    pub(super) fn structure(&self) -> PyResult<Structure> {
        let parents = slice("parents", &self.parents)?;
        let levels = slice("levels", &self.levels)?;
        let radii = slice("radii", &self.radii)?;
        let starts: Vec<Vec3> = rows("starts", &self.starts)?;
        let ends: Vec<Vec3> = rows("ends", &self.ends)?;
        let wood: Vec<[u32; 2]> = rows("wood_triangles", &self.wood_triangles)?;
        let leaves: Vec<[u32; 2]> = rows("leaves", &self.leaves)?;
        let lengths =
            [levels.len(), radii.len(), starts.len(), ends.len(), wood.len(), leaves.len()];
        if lengths.iter().any(|&length| length != parents.len()) {
            let text = format!("structure has {} parents and rows of {lengths:?}", parents.len());
            return Err(PyValueError::new_err(text));
        }
        let branches = (0..parents.len())
            .map(|id| {
                let parent = match parents[id] {
                    NO_PARENT => None,
                    parent => Some(u32::try_from(parent).map_err(|_| {
                        let text = format!("structure: branch {id} has the parent {parent}");
                        PyValueError::new_err(text)
                    })?),
                };
                Ok(Branch {
                    parent,
                    level: levels[id],
                    start: starts[id],
                    end: ends[id],
                    radius: radii[id],
                    wood_triangles: wood[id][0]..wood[id][1],
                    leaves: leaves[id][0]..leaves[id][1],
                })
            })
            .collect::<PyResult<Vec<_>>>()?;
        let leaf_branches = slice("leaf_branches", &self.leaf_branches)?.to_vec();
        Ok(Structure { branches, leaf_branches })
    }
}

/// The arrays that [`StructureArrays`] reads.
pub(super) fn structure_arrays<'py>(
    py: Python<'py>,
    structure: &Arc<Structure>,
) -> PyResult<Bound<'py, PyDict>> {
    let of = &structure.branches;
    let parents: Vec<i64> =
        of.iter().map(|branch| branch.parent.map_or(NO_PARENT, i64::from)).collect();
    let levels: Vec<u32> = of.iter().map(|branch| branch.level).collect();
    let radii: Vec<f32> = of.iter().map(|branch| branch.radius).collect();
    let starts: Vec<Vec3> = of.iter().map(|branch| branch.start).collect();
    let ends: Vec<Vec3> = of.iter().map(|branch| branch.end).collect();
    let wood: Vec<[u32; 2]> =
        of.iter().map(|branch| [branch.wood_triangles.start, branch.wood_triangles.end]).collect();
    let leaves: Vec<[u32; 2]> =
        of.iter().map(|branch| [branch.leaves.start, branch.leaves.end]).collect();
    let arrays = PyDict::new(py);
    arrays.set_item("parents", parents.to_pyarray(py))?;
    arrays.set_item("levels", levels.to_pyarray(py))?;
    arrays.set_item("starts", matrix::<f32, Vec3>(py, &starts)?)?;
    arrays.set_item("ends", matrix::<f32, Vec3>(py, &ends)?)?;
    arrays.set_item("radii", radii.to_pyarray(py))?;
    arrays.set_item("wood_triangles", matrix::<u32, [u32; 2]>(py, &wood)?)?;
    arrays.set_item("leaves", matrix::<u32, [u32; 2]>(py, &leaves)?)?;
    arrays.set_item("leaf_branches", structure.leaf_branches.to_pyarray(py))?;
    Ok(arrays)
}
