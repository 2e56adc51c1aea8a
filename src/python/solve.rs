//! Solvers.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::assembly::FormFactors;
use super::convert::{table, values, vector};
use super::error::to_python;
use super::run::run;
use crate::error::Result;
use crate::solve::states::{self, States};
use crate::solve::{Audit, Method, Options, Solved, Step, System, adjoint};

/// Radiosity, irradiance, steps, residuals, error estimate, failure.
type StatesOf<'py> =
    (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, usize, Bound<'py, PyArray1<f64>>, f64, Option<String>);

/// Returns a dictionary: the fields of the core's solution, and `failure`, the message when the iteration did not converge. With a
/// radiosity to start from the method is GMRES.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (form_factors, emission, reflectance, method, tolerance, max_iterations, memory, on_iteration, start, threads, progress))]
pub(super) fn solve<'py>(
    py: Python<'py>,
    form_factors: &FormFactors,
    emission: PyReadonlyArray2<f64>,
    reflectance: PyReadonlyArray2<f64>,
    method: &str,
    tolerance: f64,
    max_iterations: Option<usize>,
    memory: u64,
    on_iteration: Option<Py<PyAny>>,
    start: Option<PyReadonlyArray2<f64>>,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let method: Method = method.parse().map_err(to_python)?;
    let operator = Arc::clone(&form_factors.operator);
    let bands = emission.as_array().ncols();
    let (emission, reflectance) = (values(&emission)?, values(&reflectance)?);
    let start = start.map(|start| values(&start)).transpose()?;
    let raised = form_factors.raised.clone().unwrap_or_default();
    let slot = raised.clone();
    let outcome = run(py, threads, progress.as_ref(), move |progress| {
        let system = System { form_factors: operator.as_ref(), emission: &emission, reflectance: &reflectance, bands };
        let options = Options { tolerance, max_iterations, memory };
        let mut count = 0usize;
        let mut observe = |_: &Step, radiosity: &[f64], unshot: &[f64]| -> Result<()> {
            slot.check()?;
            count += 1;
            progress.expect(1);
            progress.advance(1)?;
            let Some(callback) = &on_iteration else { return Ok(()) };
            slot.call(|py| {
                let (b, r) = (table(py, radiosity.to_vec(), bands)?, table(py, unshot.to_vec(), bands)?);
                callback.call1(py, (count, b, r)).map(|_| ())
            })
        };
        match &start {
            Some(start) => crate::solve::solve_from(&system, start, &options, &mut observe),
            None => crate::solve::solve(&system, method, &options, &mut observe),
        }
    });
    let outcome = raised.or(outcome);
    // A worker that was left behind by Ctrl-C may be about to ask for a product.
    raised.close();
    to_dict(py, outcome?, bands)
}

fn to_dict(py: Python<'_>, solved: Solved, bands: usize) -> PyResult<Bound<'_, PyDict>> {
    let Solved { radiosity, irradiance, standard_error, history, residual, failure, error_estimate, bound, audit } =
        solved;
    let dict = PyDict::new(py);
    dict.set_item("radiosity", table(py, radiosity, bands)?)?;
    dict.set_item("irradiance", table(py, irradiance, bands)?)?;
    dict.set_item("standard_error", standard_error.map(|errors| table(py, errors, bands)).transpose()?)?;
    dict.set_item("residuals", vector(py, history.iter().map(|step| step.residual).collect()))?;
    dict.set_item("unshot", table(py, history.into_iter().flat_map(|step| step.unshot).collect(), bands)?)?;
    dict.set_item("residual", residual)?;
    dict.set_item("error_estimate", error_estimate)?;
    dict.set_item("bound", vector(py, bound))?;
    let audit = audit.map(|Audit { emitted, absorbed, left, unshot }| {
        [emitted, absorbed, left, unshot].map(|power| vector(py, power))
    });
    dict.set_item("audit", audit)?;
    dict.set_item("failure", failure)?;
    Ok(dict)
}

/// Solves for many emissions, (n, b k) with the states of each band side by side. Returns radiosity and irradiance in the same
/// shape, steps, residuals (k,), the error estimate, and the message when an iteration did not converge.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (form_factors, emission, reflectance, method, tolerance, max_iterations, memory, threads, progress))]
pub(super) fn solve_states<'py>(
    py: Python<'py>,
    form_factors: &FormFactors,
    emission: PyReadonlyArray2<f64>,
    reflectance: PyReadonlyArray2<f64>,
    method: &str,
    tolerance: f64,
    max_iterations: Option<usize>,
    memory: u64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<StatesOf<'py>> {
    let method: Method = method.parse().map_err(to_python)?;
    let operator = Arc::clone(&form_factors.operator);
    let bands = reflectance.as_array().ncols();
    let columns = emission.as_array().ncols();
    let (emission, reflectance) = (values(&emission)?, values(&reflectance)?);
    let raised = form_factors.raised.clone().unwrap_or_default();
    let outcome = run(py, threads, progress.as_ref(), move |progress| {
        let system = System { form_factors: operator.as_ref(), emission: &emission, reflectance: &reflectance, bands };
        let options = Options { tolerance, max_iterations, memory };
        states::solve(&system, columns / bands.max(1), method, &options, progress)
    });
    let outcome = raised.or(outcome);
    raised.close();
    let solved = outcome?;
    let States { radiosity, irradiance, steps, residuals, failure, error_estimate } = solved;
    let [radiosity, irradiance] = [table(py, radiosity, columns)?, table(py, irradiance, columns)?];
    Ok((radiosity, irradiance, steps, vector(py, residuals), error_estimate, failure))
}

/// F^T (I - rho F^T)^-1 w for weights w, (n, b).
#[pyfunction]
#[pyo3(signature = (form_factors, reflectance, weights, tolerance, threads, progress))]
pub(super) fn importance<'py>(
    py: Python<'py>,
    form_factors: &FormFactors,
    reflectance: PyReadonlyArray2<f64>,
    weights: PyReadonlyArray2<f64>,
    tolerance: f64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let operator = Arc::clone(&form_factors.operator);
    let bands = weights.as_array().ncols();
    let (reflectance, weights) = (values(&reflectance)?, values(&weights)?);
    let found = run(py, threads, progress.as_ref(), move |progress| {
        let mut observe = |_: &Step, _: &[f64], _: &[f64]| {
            progress.expect(1);
            progress.advance(1)
        };
        adjoint::importance(operator.as_ref(), &reflectance, bands, &weights, tolerance, &mut observe)
    })?;
    table(py, found, bands)
}

/// The ambient radiosity per band of an unfinished Southwell solution.
#[pyfunction]
pub(super) fn ambient<'py>(
    py: Python<'py>,
    areas: PyReadonlyArray1<f64>,
    unshot: PyReadonlyArray2<f64>,
    reflectance: PyReadonlyArray2<f64>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let bands = unshot.as_array().ncols();
    let ambient = crate::solve::southwell::ambient(&values(&areas)?, &values(&unshot)?, &values(&reflectance)?, bands);
    Ok(vector(py, ambient))
}
