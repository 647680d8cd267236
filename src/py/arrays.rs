//! `NumPy` arrays to slices of the core's types and back.
//!
//! Arrays handed to Python are copies: a view into a Rust structure would need unsafe code to say
//! how long it lives. The Python face keeps each copy, so an array is made at most once a plant.

use bytemuck::{Pod, cast_slice, pod_read_unaligned};
use numpy::{
    Element, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Rows of a C-contiguous array of shape (N, C) as values of C components.
///
/// # Errors
/// `ValueError` under `name` if the array has another row length or is not C-contiguous.
pub(super) fn rows<E: Element + Pod, T: Pod>(
    name: &str,
    array: &PyReadonlyArray2<'_, E>,
) -> PyResult<Vec<T>> {
    let width = size_of::<T>() / size_of::<E>();
    let [row_count, column_count] = [array.shape()[0], array.shape()[1]];
    if column_count != width {
        let text =
            format!("{name} must have shape (N, {width}), got ({row_count}, {column_count})");
        return Err(PyValueError::new_err(text));
    }
    let flat = array
        .as_slice()
        .map_err(|error| PyValueError::new_err(format!("{name} must be C-contiguous: {error}")))?;
    // unaligned: a Vec4 wants 16 bytes where `NumPy` promises the alignment of one float
    Ok(flat.chunks_exact(width).map(|row| pod_read_unaligned(cast_slice(row))).collect())
}

/// The values of a C-contiguous array of shape (N,).
///
/// # Errors
/// `ValueError` under `name` if the array is not C-contiguous.
pub(super) fn slice<'a, E: Element>(
    name: &str,
    array: &'a PyReadonlyArray1<'_, E>,
) -> PyResult<&'a [E]> {
    array
        .as_slice()
        .map_err(|error| PyValueError::new_err(format!("{name} must be C-contiguous: {error}")))
}

/// A copy of `rows` as an array of shape (N, C).
pub(super) fn matrix<'py, E: Element + Pod, T: Pod>(
    py: Python<'py>,
    rows: &[T],
) -> PyResult<Bound<'py, PyArray2<E>>> {
    let width = size_of::<T>() / size_of::<E>();
    PyArray1::<E>::from_slice(py, cast_slice(rows)).reshape([rows.len(), width])
}
