//! Instant radiosity.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{from_points, points, table, values, vector};
use super::render::{Viewpoint, camera, image_array};
use super::run::run;
use super::scene::Scene;
use crate::direct::lamp::Point;
use crate::geometry::Vec3;
use crate::instant::{self as core, InstantOptions, Lights, SAMPLES, default_bound, sample_of};

/// Positions, flux, patch, bounce, the place in the pixels that each shines on; particles, the share that is left
/// out, and the bound.
type LightArrays<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    usize,
    f64,
    f64,
);

/// A picture, the share of its light that paths have found, and the bound of every light.
type Pictured<'py> = (Bound<'py, PyArray3<f64>>, f64, Bound<'py, PyArray1<f64>>);
/// Positions and patches of what is seen.
type Seen<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<i64>>);

#[pyfunction]
#[pyo3(signature = (scene, count, seed, memory, threads, progress))]
pub(super) fn virtual_lights<'py>(
    py: Python<'py>,
    scene: &Scene,
    count: usize,
    seed: u64,
    memory: u64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<LightArrays<'py>> {
    let (tree, scene) = (scene.tree(py)?, Arc::clone(&scene.scene));
    let bands = scene.bands();
    let (lights, bound) = run(py, threads, progress.as_ref(), move |progress| {
        let lights = core::virtual_lights(&scene, &tree, count, seed, memory, progress)?;
        Ok((lights, default_bound(&scene)))
    })?;
    let positions: Vec<Vec3> = lights.points.iter().map(|point| point.x).collect();
    Ok((
        from_points(py, &positions)?,
        table(py, lights.flux, bands)?,
        vector(py, lights.points.iter().map(|point| i64::from(point.patch)).collect()),
        vector(py, lights.bounce.iter().map(|&j| i64::from(j)).collect()),
        vector(py, sample_of(&lights.bounce).into_iter().map(|sample| sample as i64).collect()),
        lights.particles,
        lights.left_out,
        bound,
    ))
}

/// Returns the picture, the share of its reflected light that paths have found, and the bound of every light.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (
    scene, positions, flux, patch, bounce, viewpoint, width, height, bound, compensate, lit, seed, memory, threads,
    progress
))]
pub(super) fn instant<'py>(
    py: Python<'py>,
    scene: &Scene,
    positions: PyReadonlyArray2<f64>,
    flux: PyReadonlyArray2<f64>,
    patch: PyReadonlyArray1<i64>,
    bounce: PyReadonlyArray1<i64>,
    viewpoint: Viewpoint,
    width: usize,
    height: usize,
    bound: f64,
    compensate: bool,
    lit: bool,
    seed: u64,
    memory: u64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Pictured<'py>> {
    let camera = camera(viewpoint)?;
    let options = InstantOptions { width, height, bound, compensate, lit, seed, memory };
    let (tree, scene) = (scene.tree(py)?, Arc::clone(&scene.scene));
    let bands = scene.bands();
    let at = points(&positions)?.into_iter().zip(patch.as_array().iter().copied().collect::<Vec<i64>>());
    let normals = scene.normals();
    let point = |(x, patch): (Vec3, i64)| {
        let patch = u32::try_from(patch).unwrap_or(u32::MAX);
        Point { x, normal: normals.get(patch as usize).copied().unwrap_or_default(), patch }
    };
    let lights = Lights {
        points: at.map(point).collect(),
        flux: values(&flux)?,
        bounce: bounce.as_array().iter().map(|&j| j as u32).collect(),
        particles: 0,
        left_out: 0.0,
    };
    let picture = run(py, threads, progress.as_ref(), move |progress| {
        core::gather(&scene, &tree, &lights, &camera, &options, progress)
    })?;
    Ok((image_array(py, picture.pixels, [height, width, bands])?, picture.compensated, vector(py, picture.bounds)))
}

/// What is seen at every place of every pixel: positions (m, 3), patches (m,), -1 for none.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (scene, viewpoint, width, height, sample, seed, memory, threads))]
pub(super) fn places<'py>(
    py: Python<'py>,
    scene: &Scene,
    viewpoint: Viewpoint,
    width: usize,
    height: usize,
    sample: usize,
    seed: u64,
    memory: u64,
    threads: Option<usize>,
) -> PyResult<Seen<'py>> {
    let camera = camera(viewpoint)?;
    let options = InstantOptions { width, height, bound: 1.0, compensate: false, lit: false, seed, memory };
    let (tree, scene) = (scene.tree(py)?, Arc::clone(&scene.scene));
    let seen = run(py, threads, None, move |progress| {
        core::places(&scene, &tree, &camera, sample % SAMPLES, &options, progress)
    })?;
    let positions: Vec<Vec3> = seen.iter().map(|point| point.map_or(Vec3::ZERO, |point| point.x)).collect();
    let patch = seen.iter().map(|point| point.map_or(-1, |point| i64::from(point.patch))).collect();
    Ok((from_points(py, &positions)?, vector(py, patch)))
}
