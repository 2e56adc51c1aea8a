//! Form factors of a scene, and matrices that the user brings.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;

use super::convert::{table, values, vector};
use super::error::to_python;
use super::remote::Remote;
use super::run::{Raised, in_pool, run};
use super::scene::Scene;
use crate::assembly::matrix::{DenseMatrix, SparseMatrix};
use crate::assembly::{Dense, DenseOptions, Estimator, FormFactors as Operator, Sampled, SampledOptions, balance};
use crate::hierarchy::{self, HierarchicalOptions, Links, Reached};
use crate::memory::{filled, room};
use crate::progress::Progress;

/// Links, a row each, and the patches in the order of the tree.
type Blocks<'py> = (Bound<'py, PyArray2<i64>>, Bound<'py, PyArray1<i64>>);

#[pyclass(frozen, module = "radiosity._core")]
pub(super) struct FormFactors {
    pub(super) operator: Arc<dyn Operator>,
    /// The same once more where it is dense: what can be balanced.
    dense: Option<Arc<Dense>>,
    /// The same once more where it is made of links.
    links: Option<Arc<Links>>,
    /// What products that are made elsewhere have raised.
    pub(super) raised: Option<Raised>,
    error_estimate: f64,
    segments: u64,
}

/// The estimator by its public name.
pub(super) fn estimator(method: &str) -> PyResult<Estimator> {
    match method {
        "monte_carlo" => Ok(Estimator::MonteCarlo),
        "hemicube" => Ok(Estimator::Hemicube),
        _ => Err(PyValueError::new_err(format!("unknown method {method:?}"))),
    }
}

impl FormFactors {
    fn brought(operator: impl Operator + 'static) -> FormFactors {
        FormFactors {
            operator: Arc::new(operator),
            dense: None,
            links: None,
            raised: None,
            error_estimate: 0.0,
            segments: 0,
        }
    }

    fn of_dense(dense: Dense) -> FormFactors {
        let (error_estimate, segments) = (dense.error_estimate(), dense.segments());
        let dense = Arc::new(dense);
        let operator: Arc<dyn Operator> = dense.clone();
        FormFactors { operator, dense: Some(dense), links: None, raised: None, error_estimate, segments }
    }
}

#[pymethods]
impl FormFactors {
    /// The dense operator of a scene.
    #[staticmethod]
    #[pyo3(signature = (scene, tolerance, seed, memory, threads, progress))]
    fn dense(
        py: Python<'_>,
        scene: &Scene,
        tolerance: f64,
        seed: u64,
        memory: u64,
        threads: Option<usize>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<FormFactors> {
        let scene = Arc::clone(&scene.scene);
        let options = DenseOptions { tolerance, seed, memory };
        let dense = run(py, threads, progress.as_ref(), move |progress| Dense::new(&scene, options, progress))?;
        Ok(FormFactors::of_dense(dense))
    }

    /// The operator of a scene whose rows are sampled by `method`, "monte_carlo" or "hemicube".
    #[staticmethod]
    #[pyo3(signature = (scene, method, tolerance, seed, memory, threads, progress))]
    #[expect(clippy::too_many_arguments, reason = "one for each argument of the Python function")]
    fn sampled(
        py: Python<'_>,
        scene: &Scene,
        method: &str,
        tolerance: f64,
        seed: u64,
        memory: u64,
        threads: Option<usize>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<FormFactors> {
        let scene = Arc::clone(&scene.scene);
        let estimator = estimator(method)?;
        let options = SampledOptions { tolerance, seed, memory };
        let work = move |progress: &Progress| Sampled::new(&scene, estimator, options, progress);
        let sampled = run(py, threads, progress.as_ref(), work)?;
        let (error_estimate, segments) = (sampled.error_estimate(), sampled.rays());
        Ok(FormFactors {
            operator: Arc::new(sampled),
            dense: None,
            links: None,
            raised: None,
            error_estimate,
            segments,
        })
    }

    /// The operator of a scene as links between clusters of all sizes.
    #[staticmethod]
    #[pyo3(signature = (scene, tolerance, seed, memory, threads, progress))]
    fn hierarchical(
        py: Python<'_>,
        scene: &Scene,
        tolerance: f64,
        seed: u64,
        memory: u64,
        threads: Option<usize>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<FormFactors> {
        let scene = Arc::clone(&scene.scene);
        let options = HierarchicalOptions { tolerance, seed, memory };
        let work = move |progress: &Progress| hierarchy::form_factors(&scene, &options, progress);
        let (links, reached) = run(py, threads, progress.as_ref(), work)?;
        let Reached { error_estimate, segments } = reached;
        let links = Arc::new(links);
        let operator: Arc<dyn Operator> = links.clone();
        Ok(FormFactors { operator, dense: None, links: Some(links), raised: None, error_estimate, segments })
    }

    /// For every link its two nodes' ranges in the order of the tree, their levels, and its visibility (0 full, 1 none, 2
    /// partial), (m, 7); and the patches in that order. `None` where there are no links.
    fn links<'py>(&self, py: Python<'py>) -> PyResult<Option<Blocks<'py>>> {
        let Some(links) = &self.links else { return Ok(None) };
        let mut rows = Vec::with_capacity(7 * links.found.links.len());
        for link in &links.found.links {
            let [p, q] = [link.p, link.q].map(|k| &links.tree.nodes[k as usize]);
            rows.extend([p, q].iter().flat_map(|node| [i64::from(node.patches.start), i64::from(node.patches.end)]));
            rows.extend([i64::from(p.level), i64::from(q.level), link.exchange.visibility as i64]);
        }
        let rows = PyArray1::from_vec(py, rows).reshape([links.found.links.len(), 7])?;
        let order = PyArray1::from_iter(py, links.tree.sorted.iter().map(|&i| i64::from(i)));
        Ok(Some((rows, order)))
    }

    /// The same with row sums of 1, and the largest change of a row.
    fn balance(&self, py: Python<'_>, memory: u64) -> PyResult<(FormFactors, f64)> {
        let Some(dense) = self.dense.clone() else {
            return Err(PyValueError::new_err("only factors with exact reciprocity can be balanced"));
        };
        let work = move |progress: &Progress| balance::balanced(&dense, memory, progress);
        let (dense, moved) = run(py, None, None, work)?;
        Ok((FormFactors::of_dense(dense), moved))
    }

    /// An (n, n) array that the user brings.
    #[staticmethod]
    fn from_array(array: PyReadonlyArray2<f64>) -> PyResult<FormFactors> {
        let n = array.as_array().nrows();
        DenseMatrix::new(n, values(&array)?).map(FormFactors::brought).map_err(to_python)
    }

    /// The three arrays of compressed sparse rows that the user brings.
    #[staticmethod]
    fn from_csr(
        start: PyReadonlyArray1<i64>,
        index: PyReadonlyArray1<i64>,
        value: PyReadonlyArray1<f64>,
    ) -> PyResult<FormFactors> {
        let (mut starts, mut indices) = (room(start.len()).map_err(to_python)?, room(index.len()).map_err(to_python)?);
        // What does not fit becomes too large to be in range, and is refused by the core.
        starts.extend(start.as_array().iter().map(|&k| usize::try_from(k).unwrap_or(usize::MAX)));
        indices.extend(index.as_array().iter().map(|&j| u32::try_from(j).unwrap_or(u32::MAX)));
        SparseMatrix::new(starts, indices, values(&value)?).map(FormFactors::brought).map_err(to_python)
    }

    /// An operator whose products `door` makes: an object with the methods `apply(x)`, `row(i)`, `standard_error(x)` and
    /// `sampling_error(x, draw)`. An exception of it ends what asks.
    #[staticmethod]
    fn remote(
        areas: PyReadonlyArray1<f64>,
        row_sums: PyReadonlyArray1<f64>,
        nbytes: usize,
        error_estimate: f64,
        segments: u64,
        door: Py<PyAny>,
    ) -> PyResult<FormFactors> {
        let (areas, row_sums) = (values(&areas)?, values(&row_sums)?);
        if areas.len() != row_sums.len() {
            return Err(PyValueError::new_err(format!("{} areas, but {} row sums", areas.len(), row_sums.len())));
        }
        let raised = Raised::default();
        let operator = Arc::new(Remote { areas, row_sums, nbytes, door, raised: raised.clone() });
        Ok(FormFactors { operator, dense: None, links: None, raised: Some(raised), error_estimate, segments })
    }

    /// Bytes that the dense operator of n patches holds at least.
    #[staticmethod]
    fn dense_forecast(n: usize) -> u64 {
        Dense::forecast(n)
    }

    #[getter]
    fn n(&self) -> usize {
        self.operator.len()
    }

    #[getter]
    fn nbytes(&self) -> usize {
        self.operator.nbytes()
    }

    #[getter]
    fn error_estimate(&self) -> f64 {
        self.error_estimate
    }

    #[getter]
    fn segments(&self) -> u64 {
        self.segments
    }

    #[getter]
    fn areas<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        Some(vector(py, self.operator.areas()?.to_vec()))
    }

    #[getter]
    fn row_sums<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let sums = py.detach(|| in_pool(None, || self.operator.row_sums()))?;
        Ok(vector(py, sums))
    }

    #[getter]
    fn remainder<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let remainder = py.detach(|| in_pool(None, || balance::remainder(self.operator.as_ref())))?;
        Ok(vector(py, remainder))
    }

    fn reciprocity_error(&self, py: Python<'_>) -> PyResult<Option<f64>> {
        py.detach(|| in_pool(None, || balance::reciprocity_error(self.operator.as_ref())))
    }

    /// F x, or F^T x.
    #[pyo3(signature = (x, transposed=false))]
    fn apply<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray2<f64>,
        transposed: bool,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let bands = x.as_array().ncols();
        let x = values(&x)?;
        let product = || {
            let mut out = filled(x.len(), 0.0)?;
            if transposed {
                self.operator.apply_transposed(&x, bands, &mut out);
            } else {
                self.operator.apply(&x, bands, &mut out);
            }
            Ok(out)
        };
        let out = py.detach(|| in_pool(None, product))?.map_err(to_python)?;
        table(py, out, bands)
    }

    fn row<'py>(&self, py: Python<'py>, i: usize) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let n = self.operator.len();
        if i >= n {
            return Err(PyIndexError::new_err(format!("row {i} is outside 0 .. {n}")));
        }
        let mut row = vec![0.0; n];
        self.operator.row(i, &mut row);
        Ok(vector(py, row))
    }

    fn toarray<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let n = self.operator.len();
        let rows = py.detach(|| {
            let mut rows = vec![0.0; n * n];
            rows.chunks_exact_mut(n).enumerate().for_each(|(i, row)| self.operator.row(i, row));
            rows
        });
        table(py, rows, n)
    }
}
