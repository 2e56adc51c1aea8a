//! Between numpy arrays and the core's flat vectors. Python has already checked types and shapes.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::geometry::Vec3;

/// An (m, 3) array as points.
pub(super) fn points(array: &PyReadonlyArray2<f64>) -> PyResult<Vec<Vec3>> {
    let [_, width] = *array.shape() else { return Err(shape_error("(m, 3)", array.shape())) };
    if width != 3 {
        return Err(shape_error("(m, 3)", array.shape()));
    }
    Ok(array.as_array().rows().into_iter().map(|row| Vec3::new(row[0], row[1], row[2])).collect())
}

/// The rows of an (m, 3) array.
pub(super) type Rows<'a> = &'a [[f64; 3]];

/// An (m, 3) array in place, row by row in memory.
pub(super) fn rows<'a>(array: &'a PyReadonlyArray2<f64>) -> PyResult<Rows<'a>> {
    match (array.shape(), array.as_slice()) {
        ([_, 3], Ok(slice)) if array.is_c_contiguous() => Ok(slice.as_chunks().0),
        _ => Err(shape_error("(m, 3), C-contiguous,", array.shape())),
    }
}

/// The error for an array of the wrong shape.
pub(super) fn shape_error(expected: &str, got: &[usize]) -> PyErr {
    PyValueError::new_err(format!("an array of shape {expected} is expected, not {got:?}"))
}

/// Any two-dimensional array, row-major.
pub(super) fn values<T: Copy + numpy::Element>(array: &PyReadonlyArray2<T>) -> Vec<T> {
    array.as_array().iter().copied().collect()
}

/// Points as an (m, 3) array.
pub(super) fn from_points<'py>(py: Python<'py>, points: &[Vec3]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    table(py, points.iter().flat_map(Vec3::to_array).collect(), 3)
}

/// A flat vector as an array with `columns` columns.
pub(super) fn table<T: numpy::Element>(
    py: Python<'_>,
    values: Vec<T>,
    columns: usize,
) -> PyResult<Bound<'_, PyArray2<T>>> {
    let rows = values.len().checked_div(columns).unwrap_or(0);
    let array = Array2::from_shape_vec((rows, columns), values).map_err(|e| PyValueError::new_err(e.to_string()))?;
    Ok(array.into_pyarray(py))
}

/// A flat vector as a one-dimensional array.
pub(super) fn vector<T: numpy::Element>(py: Python<'_>, values: Vec<T>) -> Bound<'_, PyArray1<T>> {
    values.into_pyarray(py)
}
