//! Form factors of a scene, and matrices that the user brings.

use std::sync::Arc;

use numpy::ndarray::ArrayView1;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;

use super::convert::{collected, copied, shape_error, table, values, vector};
use super::error::to_python;
use super::mapped::Mapped;
use super::remote::Remote;
use super::run::{Raised, in_pool, run};
use super::scene::Scene;
use crate::assembly::matrix::{Compressed, DenseMatrix, SparseMatrix};
use crate::assembly::{
    Dense, DenseOptions, Estimator, FormFactors as Operator, KeptDense, KeptSampled, Numbers, Pattern, Sampled,
    SampledOptions, Uncertain, Uncertainty, balance,
};
use crate::hierarchy::link::{Found, Link, NO_MATRIX};
use crate::hierarchy::oracle::{Exchange, Visibility};
use crate::hierarchy::{self, HierarchicalOptions, Links, Reached};
use crate::memory::{filled, room};
use crate::progress::Progress;

/// Links, a row each, and the patches in the order of the tree.
type Blocks<'py> = (Bound<'py, PyArray2<i64>>, Bound<'py, PyArray1<i64>>);
/// Starts and columns of the rows of the exchange.
type Entries<'py> = (Bound<'py, PyArray1<u64>>, Bound<'py, PyArray1<u32>>);
/// Starts and columns, pairs, standard errors, and the error of the kernels.
type DenseParts<'py> = (Option<Entries<'py>>, Bound<'py, PyArray2<u32>>, Bound<'py, PyArray1<f64>>, f64);
/// Starts, columns and values of sparse rows, and rays or errors.
type SampledParts<'py> = (
    Bound<'py, PyArray1<u64>>,
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray1<f64>>,
    Option<Bound<'py, PyArray1<u32>>>,
    Option<Bound<'py, PyArray1<f64>>>,
);
/// Nodes, places, visibilities, exchanges and matrices of links, and the mark of their tree.
type LinksParts<'py> = (
    Bound<'py, PyArray2<u32>>,
    Bound<'py, PyArray1<u64>>,
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    u64,
);

#[pyclass(frozen, module = "radiosity._core")]
pub(super) struct FormFactors {
    pub(super) operator: Arc<dyn Operator>,
    /// The same once more where it is dense: what can be balanced.
    dense: Option<Arc<Dense>>,
    /// The same once more where its rows are sampled.
    sampled: Option<Arc<Sampled>>,
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

/// Places in an array. What does not fit becomes too large to be in range, and is refused by the core.
fn places(array: &PyReadonlyArray1<u64>) -> PyResult<Vec<usize>> {
    collected(array.len(), array.as_array().iter().map(|&k| usize::try_from(k).unwrap_or(usize::MAX)))
}

impl FormFactors {
    fn brought(operator: impl Operator + 'static) -> FormFactors {
        FormFactors {
            operator: Arc::new(operator),
            dense: None,
            sampled: None,
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
        FormFactors { operator, dense: Some(dense), sampled: None, links: None, raised: None, error_estimate, segments }
    }

    fn of_sampled(sampled: Sampled) -> FormFactors {
        let (error_estimate, segments) = (sampled.error_estimate(), sampled.rays());
        let sampled = Arc::new(sampled);
        let operator: Arc<dyn Operator> = sampled.clone();
        FormFactors {
            operator,
            dense: None,
            sampled: Some(sampled),
            links: None,
            raised: None,
            error_estimate,
            segments,
        }
    }

    fn of_links(links: Links, reached: Reached) -> FormFactors {
        let Reached { error_estimate, segments } = reached;
        let links = Arc::new(links);
        let operator: Arc<dyn Operator> = links.clone();
        FormFactors { operator, dense: None, sampled: None, links: Some(links), raised: None, error_estimate, segments }
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
        Ok(FormFactors::of_sampled(run(py, threads, progress.as_ref(), work)?))
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
        Ok(FormFactors::of_links(links, reached))
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

    /// Some of the exchange of a dense operator, in the order of its rows; `None` for others.
    fn exchange<'py>(&self, py: Python<'py>, start: usize, stop: usize) -> PyResult<Option<Bound<'py, PyArray1<f64>>>> {
        let Some(dense) = &self.dense else { return Ok(None) };
        let exchange = &dense.kept().exchange;
        let Some(part) = exchange.get(start..stop) else {
            return Err(PyIndexError::new_err(format!("{start}..{stop} is outside 0..{}", exchange.len())));
        };
        Ok(Some(vector(py, copied(part)?)))
    }

    /// What a dense operator is made of beside its exchange: (n + 1,) starts of its rows and (m,) columns, or `None` where every
    /// pair has an entry; (k, 2) pairs whose visibility was sampled, (k,) their standard errors, and the error of the kernels.
    fn dense_parts<'py>(&self, py: Python<'py>) -> PyResult<Option<DenseParts<'py>>> {
        let Some(dense) = &self.dense else { return Ok(None) };
        let kept = dense.kept();
        let count = kept.uncertain.len();
        let pairs = collected(2 * count, kept.uncertain.iter().flat_map(|u| [u.i, u.j]))?;
        let errors = collected(count, kept.uncertain.iter().map(|u| u.standard_error))?;
        let pattern = match kept.pattern.entries() {
            None => None,
            Some((start, column)) => {
                let start = collected(start.len(), start.iter().map(|&k| k as u64))?;
                Some((vector(py, start), vector(py, copied(column)?)))
            }
        };
        Ok(Some((pattern, table(py, pairs, 2)?, vector(py, errors), kept.kernel_error)))
    }

    /// A dense operator from its parts; the exchange is used where it is, and must never change.
    #[staticmethod]
    #[expect(clippy::too_many_arguments, reason = "the parts of a dense operator")]
    #[pyo3(signature = (scene, pattern, exchange, pairs, standard_errors, kernel_error, error_estimate, segments))]
    fn from_dense_parts(
        scene: &Scene,
        pattern: Option<(PyReadonlyArray1<u64>, PyReadonlyArray1<u32>)>,
        exchange: &Bound<'_, PyArray1<f64>>,
        pairs: PyReadonlyArray2<u32>,
        standard_errors: PyReadonlyArray1<f64>,
        kernel_error: f64,
        error_estimate: f64,
        segments: u64,
    ) -> PyResult<FormFactors> {
        let pairs = pairs.as_array();
        if pairs.shape() != [standard_errors.len(), 2] {
            return Err(shape_error(&format!("({}, 2)", standard_errors.len()), pairs.shape()));
        }
        let uncertain =
            |(pair, &standard_error): (ArrayView1<'_, u32>, &f64)| Uncertain { i: pair[0], j: pair[1], standard_error };
        let n = scene.scene.len();
        let pattern = match pattern {
            None => Pattern::whole(n),
            Some((start, column)) => Pattern::from_entries(n, places(&start)?, values(&column)?).map_err(to_python)?,
        };
        let kept = KeptDense {
            pattern,
            exchange: Numbers::of(Mapped::new(exchange)?),
            uncertain: collected(
                pairs.nrows(),
                pairs.rows().into_iter().zip(standard_errors.as_array()).map(uncertain),
            )?,
            kernel_error,
            error_estimate,
            segments,
        };
        Dense::from_kept(&scene.scene, kept).map(FormFactors::of_dense).map_err(to_python)
    }

    /// What a sampled operator is made of: the three arrays of compressed sparse rows, and (n,) rays of every row or (k,) errors
    /// of every entry.
    fn sampled_parts<'py>(&self, py: Python<'py>) -> PyResult<Option<SampledParts<'py>>> {
        let Some(sampled) = &self.sampled else { return Ok(None) };
        let kept = sampled.kept();
        let (start, index, value) = kept.rows.parts();
        let (rays, errors) = match &kept.uncertainty {
            Uncertainty::Rays(rays) => (Some(vector(py, copied(rays)?)), None),
            Uncertainty::Entries(errors) => (None, Some(vector(py, copied(errors)?))),
        };
        let start = vector(py, collected(start.len(), start.iter().map(|&k| k as u64))?);
        Ok(Some((start, vector(py, copied(index)?), vector(py, copied(value)?), rays, errors)))
    }

    /// A sampled operator from its parts: either rays or errors.
    #[staticmethod]
    #[expect(clippy::too_many_arguments, reason = "the parts of a sampled operator")]
    #[pyo3(signature = (scene, start, index, value, rays, errors, error_estimate, segments))]
    fn from_sampled_parts(
        scene: &Scene,
        start: PyReadonlyArray1<u64>,
        index: PyReadonlyArray1<u32>,
        value: PyReadonlyArray1<f64>,
        rays: Option<PyReadonlyArray1<u32>>,
        errors: Option<PyReadonlyArray1<f64>>,
        error_estimate: f64,
        segments: u64,
    ) -> PyResult<FormFactors> {
        let uncertainty = match (rays, errors) {
            (Some(rays), None) => Uncertainty::Rays(values(&rays)?),
            (None, Some(errors)) => Uncertainty::Entries(values(&errors)?),
            _ => return Err(PyValueError::new_err("either rays or errors are expected")),
        };
        let rows = Compressed::square(places(&start)?, values(&index)?, values(&value)?).map_err(to_python)?;
        let kept = KeptSampled { rows, uncertainty, error_estimate, rays: segments };
        Sampled::from_kept(&scene.scene, kept).map(FormFactors::of_sampled).map_err(to_python)
    }

    /// What links are made of beside their scene: (m, 2) nodes, (m,) places of their matrices, (m,) visibilities (0 full, 1 none,
    /// 2 partial), (m, 5) numbers of the exchange, the matrices, and the mark of the tree.
    fn links_parts<'py>(&self, py: Python<'py>) -> PyResult<Option<LinksParts<'py>>> {
        let Some(links) = &self.links else { return Ok(None) };
        let found = &links.found;
        let m = found.links.len();
        let mut exchanges = room(5 * m).map_err(to_python)?;
        for Exchange { unoccluded, kernel_error, fraction, unevenness, fraction_error, .. } in
            found.links.iter().map(|link| link.exchange)
        {
            exchanges.extend([unoccluded, kernel_error, fraction, unevenness, fraction_error]);
        }
        let nodes = collected(2 * m, found.links.iter().flat_map(|link| [link.p, link.q]))?;
        let places = found.links.iter().map(|link| if link.at == NO_MATRIX { u64::MAX } else { link.at as u64 });
        let visibility = collected(m, found.links.iter().map(|link| link.exchange.visibility as u8))?;
        Ok(Some((
            table(py, nodes, 2)?,
            vector(py, collected(m, places)?),
            vector(py, visibility),
            table(py, exchanges, 5)?,
            vector(py, copied(&found.matrices)?),
            links.tree_mark(),
        )))
    }

    /// Links from their parts.
    #[staticmethod]
    #[expect(clippy::too_many_arguments, reason = "the parts of links")]
    fn from_links_parts(
        py: Python<'_>,
        scene: &Scene,
        nodes: PyReadonlyArray2<u32>,
        places: PyReadonlyArray1<u64>,
        visibility: PyReadonlyArray1<u8>,
        exchanges: PyReadonlyArray2<f64>,
        matrices: PyReadonlyArray1<f64>,
        tree_mark: u64,
        error_estimate: f64,
        segments: u64,
    ) -> PyResult<FormFactors> {
        let m = places.len();
        let (nodes, exchanges) = (nodes.as_array(), exchanges.as_array());
        if nodes.shape() != [m, 2] || exchanges.shape() != [m, 5] || visibility.len() != m {
            return Err(PyValueError::new_err(format!("the arrays are not all of {m} links")));
        }
        let mut links = room(m).map_err(to_python)?;
        for (k, (&at, &seen)) in places.as_array().iter().zip(visibility.as_array()).enumerate() {
            let visibility = match seen {
                0 => Visibility::Full,
                1 => Visibility::None,
                2 => Visibility::Partial,
                _ => return Err(PyValueError::new_err(format!("link {k}: visibility {seen} is outside 0..2"))),
            };
            let numbers = exchanges.row(k);
            let exchange = Exchange {
                unoccluded: numbers[0],
                kernel_error: numbers[1],
                visibility,
                fraction: numbers[2],
                unevenness: numbers[3],
                fraction_error: numbers[4],
            };
            // What does not fit becomes too large to be in range, and is refused by the core.
            let at = if at == u64::MAX { NO_MATRIX } else { usize::try_from(at).unwrap_or(NO_MATRIX - 1) };
            links.push(Link { p: nodes[[k, 0]], q: nodes[[k, 1]], at, exchange });
        }
        let found = Found { links, matrices: values(&matrices)? };
        let reached = Reached { error_estimate, segments };
        let scene = Arc::clone(&scene.scene);
        let work = move |_: &Progress| hierarchy::from_kept(&scene, found, tree_mark, &reached);
        Ok(FormFactors::of_links(run(py, None, None, work)?, reached))
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
        Ok(FormFactors {
            operator,
            dense: None,
            sampled: None,
            links: None,
            raised: Some(raised),
            error_estimate,
            segments,
        })
    }

    /// Bytes that the dense operator of n patches holds at most, but for 16 a pair of which a part is hidden.
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
