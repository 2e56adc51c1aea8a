//! Pictures.

use std::sync::Arc;

use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray3, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::convert::values;
use super::direct::Lights;
use super::error::to_python;
use super::run::{Raised, run};
use super::scene::Scene;
use crate::geometry::Vec3;
use crate::render::{self as core, Camera, GatherOptions, Image, Shading};

/// Origin, target, up and field of view of a camera.
pub(super) type Viewpoint = ([f64; 3], [f64; 3], [f64; 3], f64);

pub(super) fn camera((origin, target, up, fov): Viewpoint) -> PyResult<Camera> {
    Camera::new(Vec3::from(origin), Vec3::from(target), Vec3::from(up), fov).map_err(to_python)
}

/// `light` is the irradiance for smooth pictures, else the radiosity.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (scene, light, viewpoint, width, height, smooth, memory, threads, progress))]
pub(super) fn render<'py>(
    py: Python<'py>,
    scene: &Scene,
    light: PyReadonlyArray2<f64>,
    viewpoint: Viewpoint,
    width: usize,
    height: usize,
    smooth: bool,
    memory: u64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let camera = camera(viewpoint)?;
    let light = values(&light)?;
    let bands = scene.scene.bands();
    let corners = smooth.then(|| scene.corners(py)).transpose()?;
    let (tree, scene) = (scene.tree(py)?, Arc::clone(&scene.scene));
    let pixels = run(py, threads, progress.as_ref(), move |progress| {
        let shading = corners.as_deref().map_or(Shading::Flat(&light), |corners| Shading::Smooth(corners, &light));
        core::render(&scene, &tree, &camera, Image { width, height, shading }, memory, progress)
    })?;
    image_array(py, pixels, [height, width, bands])
}

pub(super) fn image_array(py: Python<'_>, pixels: Vec<f64>, shape: [usize; 3]) -> PyResult<Bound<'_, PyArray3<f64>>> {
    let array = Array3::from_shape_vec(shape, pixels).map_err(|e| PyValueError::new_err(e.to_string()))?;
    Ok(array.into_pyarray(py))
}

/// Returns the picture, the estimate of its error, and the passes.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (scene, lights, irradiance, viewpoint, width, height, tolerance, seed, memory, on_image, threads, progress))]
pub(super) fn gather<'py>(
    py: Python<'py>,
    scene: &Scene,
    lights: &Lights,
    irradiance: PyReadonlyArray2<f64>,
    viewpoint: Viewpoint,
    width: usize,
    height: usize,
    tolerance: f64,
    seed: u64,
    memory: u64,
    on_image: Option<Py<PyAny>>,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray3<f64>>, f64, usize)> {
    let camera = camera(viewpoint)?;
    let options = GatherOptions { width, height, tolerance, seed, memory };
    let (irradiance, lights) = (values(&irradiance)?, Arc::clone(&lights.lights));
    let shape = [height, width, scene.scene.bands()];
    let (tree, scene) = (scene.tree(py)?, Arc::clone(&scene.scene));
    let raised = Raised::default();
    let slot = raised.clone();
    let outcome = run(py, threads, progress.as_ref(), move |progress| {
        let mut observe = |pixels: &[f64], error: f64| {
            let Some(callback) = &on_image else { return Ok(()) };
            slot.call(|py| {
                let image = image_array(py, pixels.to_vec(), shape)?;
                callback.call1(py, (image, error)).map(|_| ())
            })
        };
        core::gather(&scene, &tree, &lights, &irradiance, &camera, &options, &mut observe, progress)
    });
    let gathered = raised.or(outcome)?;
    Ok((image_array(py, gathered.pixels, shape)?, gathered.error_estimate, gathered.passes))
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
    let irradiance = values(&irradiance)?;
    let (corners, scene) = (scene.corners(py)?, Arc::clone(&scene.scene));
    let shape = [scene.len(), 3, scene.bands()];
    let corners = run(py, threads, None, move |_| Ok(corners.irradiance(&scene, &irradiance)))?;
    image_array(py, corners, shape)
}
