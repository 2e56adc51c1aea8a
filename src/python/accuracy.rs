//! Scenes solved to a tolerance.

use std::sync::Arc;

use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::convert::{table, values, vector};
use super::direct::Lights;
use super::run::run;
use super::scene::Scene;
use crate::accuracy::{self, Options, Outcome};
use crate::assembly::Order;
use crate::solve::Audit;

fn options(tolerance: f64, linear: bool, refine: bool, seed: u64, memory: u64) -> Options {
    let order = if linear { Order::Linear } else { Order::Constant };
    Options { tolerance, order, refine, seed, memory }
}

/// Returns a dictionary: the fields of the core's outcome.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (scene, lights, tolerance, linear, refine, seed, memory, threads, progress))]
pub(super) fn solve_scene<'py>(
    py: Python<'py>,
    scene: &Scene,
    lights: &Lights,
    tolerance: f64,
    linear: bool,
    refine: bool,
    seed: u64,
    memory: u64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (scene, lights) = (Arc::clone(&scene.scene), Arc::clone(&lights.lights));
    let bands = scene.bands();
    let options = options(tolerance, linear, refine, seed, memory);
    let outcome =
        run(py, threads, progress.as_ref(), move |progress| accuracy::solve(&scene, &lights, &options, progress))?;
    let error_estimate = outcome.error_estimate();
    let Outcome { radiosity, irradiance, standard_error, sampling_error, discretisation_error, .. } = outcome;
    let Outcome { corrected, patches, rays, segments, history, audit, seconds, .. } = outcome;
    let dict = PyDict::new(py);
    dict.set_item("radiosity", table(py, radiosity, bands)?)?;
    dict.set_item("irradiance", table(py, irradiance, bands)?)?;
    dict.set_item("standard_error", table(py, standard_error, bands)?)?;
    dict.set_item("error_estimate", error_estimate)?;
    dict.set_item("sampling_error", sampling_error)?;
    dict.set_item("discretisation_error", discretisation_error)?;
    dict.set_item("corrected", corrected)?;
    dict.set_item("patches", patches)?;
    dict.set_item("rays", rays)?;
    dict.set_item("segments", segments)?;
    dict.set_item("residuals", vector(py, history.iter().map(|step| step.residual).collect()))?;
    dict.set_item("unshot", table(py, history.into_iter().flat_map(|step| step.unshot).collect(), bands)?)?;
    let audit = audit.map(|Audit { emitted, absorbed, left, unshot }| {
        [emitted, absorbed, left, unshot].map(|power| vector(py, power))
    });
    dict.set_item("audit", audit)?;
    dict.set_item("seconds", seconds)?;
    Ok(dict)
}

/// Seconds and bytes that a solve would take.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (scene, lights, tolerance, linear, refine, seed, memory, threads, progress))]
pub(super) fn forecast_scene(
    py: Python<'_>,
    scene: &Scene,
    lights: &Lights,
    tolerance: f64,
    linear: bool,
    refine: bool,
    seed: u64,
    memory: u64,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(f64, u64)> {
    let (scene, lights) = (Arc::clone(&scene.scene), Arc::clone(&lights.lights));
    let options = options(tolerance, linear, refine, seed, memory);
    let forecast =
        run(py, threads, progress.as_ref(), move |progress| accuracy::forecast(&scene, &lights, &options, progress))?;
    Ok((forecast.seconds, forecast.bytes))
}

/// The true relative error of an irradiance, and the rays that it took to tell.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (scene, lights, irradiance, tolerance, seed, memory, threads, progress))]
pub(super) fn assess(
    py: Python<'_>,
    scene: &Scene,
    lights: &Lights,
    irradiance: PyReadonlyArray2<f64>,
    tolerance: f64,
    seed: u64,
    memory: u64,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(f64, u64)> {
    let (scene, lights) = (Arc::clone(&scene.scene), Arc::clone(&lights.lights));
    let irradiance = values(&irradiance)?;
    let options = options(tolerance, false, false, seed, memory);
    let assessment = run(py, threads, progress.as_ref(), move |progress| {
        accuracy::assess(&scene, &lights, &irradiance, &options, progress)
    })?;
    Ok((assessment.error, assessment.rays))
}
