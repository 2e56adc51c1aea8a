//! A numpy array as memory of the core, for arrays too large to be copied: those of a mapped file.

use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A read-only array, kept alive for as long as the core reads it.
pub(super) struct Mapped {
    start: *const f64,
    count: usize,
    _owner: Py<PyArray1<f64>>,
}

impl Mapped {
    /// # Errors
    /// `ValueError` for an array that may be written to, or does not lie in memory as a slice does.
    pub(super) fn new(array: &Bound<'_, PyArray1<f64>>) -> PyResult<Mapped> {
        let is_writeable: bool = array.getattr("flags")?.getattr("writeable")?.extract()?;
        let view = array.try_readonly()?;
        let numbers = view.as_slice()?;
        if is_writeable || !numbers.as_ptr().is_aligned() {
            return Err(PyValueError::new_err("a read-only, aligned array is expected"));
        }
        Ok(Mapped { start: numbers.as_ptr(), count: numbers.len(), _owner: array.clone().unbind() })
    }
}

impl AsRef<[f64]> for Mapped {
    fn as_ref(&self) -> &[f64] {
        // SAFETY: `start` and `count` are those of a slice of the array, aligned, which lives as long as this. Nobody writes to
        // it: `python/radiosity/keep.py` makes these arrays, of files that it maps to be read only and of copies of its own, and
        // hands them to nobody else. Files are never written to in place, but replaced by others, as all of ours are.
        unsafe { std::slice::from_raw_parts(self.start, self.count) }
    }
}

// SAFETY: the numbers are only read, from any thread; the owner is only dropped, which pyo3 allows without the GIL.
unsafe impl Send for Mapped {}
// SAFETY: as above.
unsafe impl Sync for Mapped {}
