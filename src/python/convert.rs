//! Between numpy arrays and the core's flat vectors. Python has already checked types and shapes.

use numpy::ndarray::{Array2, Dimension};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::error::to_python;
use crate::geometry::Vec3;
use crate::memory::room;

/// An (m, 3) array as points.
pub(super) fn points(array: &PyReadonlyArray2<f64>) -> PyResult<Vec<Vec3>> {
    let [_, width] = *array.shape() else { return Err(shape_error("(m, 3)", array.shape())) };
    if width != 3 {
        return Err(shape_error("(m, 3)", array.shape()));
    }
    let rows = array.as_array();
    let mut points = room(rows.nrows()).map_err(to_python)?;
    points.extend(rows.rows().into_iter().map(|row| Vec3::new(row[0], row[1], row[2])));
    Ok(points)
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

/// Any array, row-major.
pub(super) fn values<T: Copy + numpy::Element, D: Dimension>(array: &PyReadonlyArray<T, D>) -> PyResult<Vec<T>> {
    let mut values = room(array.len()).map_err(to_python)?;
    values.extend(array.as_array().iter().copied());
    Ok(values)
}

/// A copy of what the core holds.
pub(super) fn copied<T: Copy>(values: &[T]) -> PyResult<Vec<T>> {
    let mut out = room(values.len()).map_err(to_python)?;
    out.extend_from_slice(values);
    Ok(out)
}

/// What an iterator yields, `count` values.
pub(super) fn collected<T>(count: usize, values: impl Iterator<Item = T>) -> PyResult<Vec<T>> {
    let mut out = room(count).map_err(to_python)?;
    out.extend(values);
    Ok(out)
}

/// Points as an (m, 3) array.
pub(super) fn from_points<'py>(py: Python<'py>, points: &[Vec3]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let mut values = room(3 * points.len()).map_err(to_python)?;
    points.iter().for_each(|point| values.extend(point.to_array()));
    table(py, values, 3)
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
