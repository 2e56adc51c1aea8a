//! Rows of sampled form factors, for processes that hold a part of F each.

use std::ops::Range;
use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;

use super::assembly::estimator;
use super::convert::{shape_error, table, vector};
use super::error::to_python;
use super::run::{in_pool, run};
use super::scene::Scene;
use crate::assembly::{Block as CoreBlock, SampledOptions};
use crate::memory::filled;
use crate::progress::Progress;

#[pyclass(frozen, module = "radiosity._core")]
pub(super) struct Block {
    block: Arc<CoreBlock>,
}

impl Block {
    /// What `product` makes of the radiosities x, in a pool of `threads` threads, as a table of their bands.
    fn of<'py>(
        &self,
        py: Python<'py>,
        x: &PyReadonlyArray2<f64>,
        threads: Option<usize>,
        product: impl FnOnce(&CoreBlock, &[f64], usize) -> crate::Result<Vec<f64>> + Send,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let [rows, bands] = *x.shape() else { return Err(shape_error("(n, b)", x.shape())) };
        let (Ok(x), true) = (x.as_slice(), rows == self.block.patches() && bands > 0) else {
            return Err(shape_error(&format!("({}, b), C-contiguous,", self.block.patches()), x.shape()));
        };
        let out = py.detach(|| in_pool(threads, || product(&self.block, x, bands)))?.map_err(to_python)?;
        table(py, out, bands)
    }
}

#[pymethods]
impl Block {
    /// Rows `first` to `last` - 1 of the form factors of a scene, sampled by `method`.
    #[staticmethod]
    #[pyo3(signature = (scene, method, tolerance, seed, first, last, memory, threads, progress))]
    #[expect(clippy::too_many_arguments, reason = "one for each argument of the Python function")]
    fn sampled(
        py: Python<'_>,
        scene: &Scene,
        method: &str,
        tolerance: f64,
        seed: u64,
        first: usize,
        last: usize,
        memory: u64,
        threads: Option<usize>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Block> {
        let (tree, scene) = (scene.later_tree(), Arc::clone(&scene.scene));
        let estimator = estimator(method)?;
        let options = SampledOptions { tolerance, seed, memory };
        let work = move |progress: &Progress| {
            CoreBlock::new(&scene, &tree(), estimator, options, Range { start: first, end: last }, progress)
        };
        Ok(Block { block: Arc::new(run(py, threads, progress.as_ref(), work)?) })
    }

    #[getter]
    fn nbytes(&self) -> usize {
        self.block.nbytes()
    }

    #[getter]
    fn entries(&self) -> usize {
        self.block.entries()
    }

    #[getter]
    fn error_estimate(&self) -> f64 {
        self.block.error_estimate()
    }

    #[getter]
    fn rays(&self) -> u64 {
        self.block.rays()
    }

    fn row_sums<'py>(&self, py: Python<'py>, threads: Option<usize>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let sums = py.detach(|| in_pool(threads, || self.block.row_sums()))?;
        Ok(vector(py, sums))
    }

    /// Row `k` of the block.
    fn row<'py>(&self, py: Python<'py>, k: usize) -> PyResult<Bound<'py, PyArray1<f64>>> {
        if k >= self.block.len() {
            return Err(PyIndexError::new_err(format!("row {k} is outside 0 .. {}", self.block.len())));
        }
        let mut row = filled(self.block.patches(), 0.0).map_err(to_python)?;
        self.block.row(k, &mut row);
        Ok(vector(py, row))
    }

    fn apply<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray2<f64>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.of(py, &x, threads, |block, x, bands| {
            let mut out = filled(block.len() * bands, 0.0)?;
            block.apply(x, bands, &mut out);
            Ok(out)
        })
    }

    fn standard_error<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray2<f64>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.of(py, &x, threads, |block, x, bands| Ok(block.standard_error(x, bands)))
    }

    /// `before` entries are in the rows before these.
    fn sampling_error<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray2<f64>,
        draw: u64,
        before: u64,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.of(py, &x, threads, |block, x, bands| Ok(block.sampling_error(x, bands, draw, before)))
    }
}
