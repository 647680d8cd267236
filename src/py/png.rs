//! Pictures as PNG files' bytes.

use numpy::{PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::run::run;
use crate::png;

/// A PNG of an (H, W, 3) or (H, W, 4) uint8 array.
#[pyfunction]
pub(super) fn encode_png<'py>(
    py: Python<'py>,
    picture: PyReadonlyArray3<'py, u8>,
) -> PyResult<Bound<'py, PyBytes>> {
    let &[height, width, channels] = picture.shape() else { unreachable!("three dimensions") };
    let pixels = picture
        .as_slice()
        .map_err(|error| PyValueError::new_err(format!("picture must be C-contiguous: {error}")))?;
    let bytes = run(py, None, None, |_| png::encode(width, height, channels, pixels))?;
    Ok(PyBytes::new(py, &bytes))
}
