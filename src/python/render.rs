//! Pictures.

use std::sync::Arc;

use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray3, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::convert::values;
use super::error::to_python;
use super::run::run;
use super::scene::Scene;
use crate::geometry::Vec3;
use crate::render::{Camera, Image, Shading, render as core_render};

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
    let (core, tree) = (Arc::clone(&scene.scene), scene.tree(py)?);
    let pixels = run(py, threads, progress.as_ref(), move |progress| {
        core_render(&core, &tree, &radiosity, &irradiance, &camera, image, memory, progress)
    })?;
    let array =
        Array3::from_shape_vec((height, width, bands), pixels).map_err(|e| PyValueError::new_err(e.to_string()))?;
    Ok(array.into_pyarray(py))
}
