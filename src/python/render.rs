//! Pictures.

use std::sync::{Arc, Mutex, PoisonError};

use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray3, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::convert::values;
use super::error::to_python;
use super::run::run;
use super::scene::Scene;
use crate::error::Error;
use crate::geometry::Vec3;
use crate::render::{self as core, Camera, GatherOptions, Image, Shading};

#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (scene, radiosity, irradiance, origin, target, up, fov, width, height, smooth, memory, threads, progress))]
pub(super) fn render<'py>(
    py: Python<'py>,
    scene: &Scene,
    radiosity: PyReadonlyArray2<f64>,
    irradiance: PyReadonlyArray2<f64>,
    origin: [f64; 3],
    target: [f64; 3],
    up: [f64; 3],
    fov: f64,
    width: usize,
    height: usize,
    smooth: bool,
    memory: u64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let camera = Camera::new(Vec3::from(origin), Vec3::from(target), Vec3::from(up), fov).map_err(to_python)?;
    let image = Image { width, height, shading: if smooth { Shading::Smooth } else { Shading::Flat } };
    let (radiosity, irradiance) = (values(&radiosity), values(&irradiance));
    let bands = scene.scene.bands();
    let (tree, scene) = (scene.tree(py)?, Arc::clone(&scene.scene));
    let pixels = run(py, threads, progress.as_ref(), move |progress| {
        core::render(&scene, &tree, &radiosity, &irradiance, &camera, image, memory, progress)
    })?;
    image_array(py, pixels, [height, width, bands])
}

fn image_array(py: Python<'_>, pixels: Vec<f64>, shape: [usize; 3]) -> PyResult<Bound<'_, PyArray3<f64>>> {
    let array = Array3::from_shape_vec(shape, pixels).map_err(|e| PyValueError::new_err(e.to_string()))?;
    Ok(array.into_pyarray(py))
}

/// Returns the picture, the estimate of its error, the passes and the rays cast.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (scene, irradiance, origin, target, up, fov, width, height, tolerance, seed, memory, on_image, threads, progress))]
pub(super) fn gather<'py>(
    py: Python<'py>,
    scene: &Scene,
    irradiance: PyReadonlyArray2<f64>,
    origin: [f64; 3],
    target: [f64; 3],
    up: [f64; 3],
    fov: f64,
    width: usize,
    height: usize,
    tolerance: f64,
    seed: u64,
    memory: u64,
    on_image: Option<Py<PyAny>>,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray3<f64>>, f64, usize, u64)> {
    let camera = Camera::new(Vec3::from(origin), Vec3::from(target), Vec3::from(up), fov).map_err(to_python)?;
    let options = GatherOptions { width, height, tolerance, seed, memory };
    let irradiance = values(&irradiance);
    let shape = [height, width, scene.scene.bands()];
    let (tree, scene) = (scene.tree(py)?, Arc::clone(&scene.scene));
    // An exception raised by `on_image` waits here until the worker has stopped.
    let raised: Arc<Mutex<Option<PyErr>>> = Arc::default();
    let slot = Arc::clone(&raised);
    let outcome = run(py, threads, progress.as_ref(), move |progress| {
        let mut observe = |pixels: &[f64], error: f64| {
            let Some(callback) = &on_image else { return Ok(()) };
            Python::attach(|py| {
                let call =
                    || image_array(py, pixels.to_vec(), shape).and_then(|image| callback.call1(py, (image, error)));
                call().map(|_| ()).map_err(|error| {
                    *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                    Error::Interrupted
                })
            })
        };
        core::gather(&scene, &tree, &irradiance, &camera, &options, &mut observe, progress)
    });
    if let Some(error) = raised.lock().unwrap_or_else(PoisonError::into_inner).take() {
        return Err(error);
    }
    let gathered = outcome?;
    Ok((image_array(py, gathered.pixels, shape)?, gathered.error_estimate, gathered.passes, gathered.rays))
}

/// (n, 3, b): the irradiance at the corners of every patch that smooth pictures interpolate.
#[pyfunction]
#[pyo3(signature = (scene, irradiance, threads))]
pub(super) fn corner_irradiance<'py>(
    py: Python<'py>,
    scene: &Scene,
    irradiance: PyReadonlyArray2<f64>,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let irradiance = values(&irradiance);
    let scene = Arc::clone(&scene.scene);
    let shape = [scene.len(), 3, scene.bands()];
    let corners = run(py, threads, None, move |_| Ok(core::corner_irradiance(&scene, &irradiance)))?;
    image_array(py, corners, shape)
}
