//! Scenes solved on links.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::convert::{table, vector};
use super::run::run;
use super::scene::Scene;
use crate::assembly::Blockers;
use crate::hierarchy::Solver;

/// Returns a dictionary: the patches' irradiance, the leaves as a mesh with theirs, what was reached and done.
#[pyfunction]
#[pyo3(signature = (scene, tolerance, seed, memory, threads, progress))]
pub(super) fn solve_hierarchical<'py>(
    py: Python<'py>,
    scene: &Scene,
    tolerance: f64,
    seed: u64,
    memory: u64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let scene = Arc::clone(&scene.scene);
    let bands = scene.bands();
    let work = move |progress: &crate::Progress| {
        let blockers = Blockers::of_scene(&scene);
        let mut solver = Solver::new(&scene, &blockers, seed, memory)?;
        solver.refine_to(tolerance, progress)?;
        let (mesh, on_faces) = solver.mesh();
        let links = solver.links();
        let counts = (solver.leaves(), links.found.links.len());
        Ok((
            solver.patch_irradiance(),
            mesh,
            on_faces,
            counts,
            solver.link_error,
            solver.audit(),
            solver.history,
            solver.done,
        ))
    };
    let (irradiance, mesh, on_faces, (leaves, links), error, audit, history, done) =
        run(py, threads, progress.as_ref(), work)?;
    let dict = PyDict::new(py);
    dict.set_item("irradiance", table(py, irradiance, bands)?)?;
    dict.set_item("error_estimate", error)?;
    dict.set_item("vertices", table(py, mesh.vertices.iter().flat_map(crate::geometry::Vec3::to_array).collect(), 3)?)?;
    let faces: Vec<i64> = mesh.faces.iter().flatten().map(|&v| i64::from(v)).collect();
    let faces: Bound<'py, PyArray2<i64>> = PyArray1::from_vec(py, faces).reshape([mesh.faces.len(), 3])?;
    dict.set_item("faces", faces)?;
    dict.set_item("parents", PyArray1::from_iter(py, mesh.patches.iter().map(|&i| i64::from(i))))?;
    dict.set_item("on_faces", table(py, on_faces, bands)?)?;
    dict.set_item("leaves", leaves)?;
    dict.set_item("links", links)?;
    dict.set_item("segments", done.segments)?;
    dict.set_item("stopped", done.stopped)?;
    dict.set_item("out_of_memory", done.out_of_memory)?;
    dict.set_item("residuals", vector(py, history.iter().map(|step| step.residual).collect()))?;
    dict.set_item("unshot", table(py, history.into_iter().flat_map(|step| step.unshot).collect(), bands)?)?;
    let audit = [audit.emitted, audit.absorbed, audit.left, audit.unshot];
    dict.set_item("audit", audit.map(|power| vector(py, power)))?;
    Ok(dict)
}
