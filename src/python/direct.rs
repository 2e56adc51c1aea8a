//! Lights that are no patches, and what they bring.

use std::sync::Arc;

use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{table, values};
use super::error::to_python;
use super::run::run;
use super::scene::Scene;
use crate::direct::sky::Distribution;
use crate::direct::{self, Cone, Light, Lights as CoreLights, Sky};
use crate::geometry::Vec3;

type Vector = [f64; 3];
/// Direction and irradiance.
type Sun = (Vector, Vec<f64>);
/// Position, intensity, and of a spot axis and the angles of beam and cutoff.
type Point = (Vector, Vec<f64>, Option<(Vector, f64, f64)>);
/// What it is ("constant", "overcast" or "table"), rows, columns, up, north, radiance.
type Dome<'py> = (String, usize, usize, Vector, Vector, PyReadonlyArray2<'py, f64>);

#[pyclass(frozen, module = "radiosity._core")]
pub(super) struct Lights {
    pub(super) lights: Arc<CoreLights>,
}

#[pymethods]
impl Lights {
    #[new]
    fn new(bands: usize, suns: Vec<Sun>, points: Vec<Point>, skies: Vec<Dome<'_>>) -> PyResult<Lights> {
        let mut lights = Vec::new();
        lights.extend(suns.into_iter().map(|(towards, irradiance)| Light::Sun { towards: towards.into(), irradiance }));
        let cone = |(axis, beam, cutoff): (Vector, f64, f64)| Cone { axis: axis.into(), beam, cutoff };
        lights.extend(points.into_iter().map(|(position, intensity, spot)| Light::Point {
            position: position.into(),
            intensity,
            cone: spot.map(cone),
        }));
        for (what, rows, columns, up, north, radiance) in skies {
            let distribution = match what.as_str() {
                "constant" => Distribution::Constant,
                "overcast" => Distribution::Overcast,
                _ => Distribution::Table { rows, columns },
            };
            let radiance = values(&radiance)?;
            lights.push(Light::Sky(Sky::new(distribution, up.into(), north.into(), radiance, bands)));
        }
        let lights = CoreLights::new(lights, bands).map_err(to_python)?;
        Ok(Lights { lights: Arc::new(lights) })
    }
}

/// What arrives straight from lights: H0, its standard error, and the relative error reached.
type Direct<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, f64);

/// Returns H0 and its standard error, n x b each, and the relative error reached.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (scene, lights, tolerance, seed, memory, threads, progress))]
pub(super) fn direct_irradiance<'py>(
    py: Python<'py>,
    scene: &Scene,
    lights: &Lights,
    tolerance: f64,
    seed: u64,
    memory: u64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Direct<'py>> {
    let (scene, lights) = (Arc::clone(&scene.scene), Arc::clone(&lights.lights));
    let bands = scene.bands();
    let found = run(py, threads, progress.as_ref(), move |progress| {
        direct::irradiance(&scene, &lights, tolerance, seed, memory, progress)
    })?;
    Ok((table(py, found.values, bands)?, table(py, found.standard_error, bands)?, found.error_estimate))
}

/// Returns the daylight coefficients, n x (rows x columns).
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of one Python function, passed on in order")]
#[pyo3(signature = (scene, rows, columns, up, north, rays, seed, memory, threads, progress))]
pub(super) fn sky_coefficients<'py>(
    py: Python<'py>,
    scene: &Scene,
    rows: usize,
    columns: usize,
    up: Vector,
    north: Vector,
    rays: u32,
    seed: u64,
    memory: u64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let scene = Arc::clone(&scene.scene);
    let (up, north) = (Vec3::from_array(up), Vec3::from_array(north));
    let found = run(py, threads, progress.as_ref(), move |progress| {
        direct::coefficients(&scene, [rows, columns], up, north, rays, seed, memory, progress)
    })?;
    table(py, found, rows * columns)
}
