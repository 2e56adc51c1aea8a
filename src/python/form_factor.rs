//! Form factors of pairs.

use numpy::ndarray::ArrayView1;
use numpy::{PyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use rayon::prelude::*;

use super::convert::{points, vector};
use super::error::to_python;
use super::run::run;
use crate::error::Error;
use crate::form_factor::{Accuracy, Scratch, Shape, exchange};
use crate::geometry::polygon::defect;
use crate::geometry::{Triangle, Vec3};

/// Pairs computed between two looks at the stop flag.
const BATCH: usize = 256;

#[pyfunction]
pub(super) fn form_factor(
    polygon_a: PyReadonlyArray2<f64>,
    polygon_b: PyReadonlyArray2<f64>,
    tolerance: f64,
) -> PyResult<f64> {
    let (a, b) = (points(&polygon_a)?, points(&polygon_b)?);
    let accuracy = Accuracy::new(tolerance).map_err(to_python)?;
    let problems = [("polygon_a", &a), ("polygon_b", &b)]
        .into_iter()
        .filter_map(|(name, corners)| defect(corners).map(|what| format!("{name} {what}")));
    Error::from_problems(problems.collect()).map_err(to_python)?;
    let (a, b) = (Shape::new(&a), Shape::new(&b));
    Ok(exchange(&a, &b, accuracy, &mut Scratch::default()) / a.area)
}

#[pyfunction]
#[pyo3(signature = (a, b, tolerance, threads, progress))]
pub(super) fn pair_form_factors<'py>(
    py: Python<'py>,
    a: PyReadonlyArray3<f64>,
    b: PyReadonlyArray3<f64>,
    tolerance: f64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (a, b) = (triangles(&a), triangles(&b));
    let accuracy = Accuracy::new(tolerance).map_err(to_python)?;
    let factors = run(py, threads, progress.as_ref(), move |progress| {
        let mut problems = Vec::new();
        for (name, triangles) in [("a", &a), ("b", &b)] {
            let bad = triangles.iter().enumerate().filter_map(|(k, t)| Some((k, defect(t)?))).take(8);
            problems.extend(bad.map(|(k, what)| format!("pair {k}: triangle {name} {what}")));
        }
        Error::from_problems(problems)?;
        progress.expect(a.len() as u64);
        let batches: Result<Vec<Vec<f64>>, Error> = a
            .par_chunks(BATCH)
            .zip(b.par_chunks(BATCH))
            .map_init(Scratch::default, |scratch, (a, b)| {
                progress.advance(a.len() as u64)?;
                let factor = |(a, b): (&Triangle, &Triangle)| {
                    let (a, b) = (Shape::new(a), Shape::new(b));
                    exchange(&a, &b, accuracy, scratch) / a.area
                };
                Ok(a.iter().zip(b).map(factor).collect())
            })
            .collect();
        Ok(batches?.concat())
    })?;
    Ok(vector(py, factors))
}

fn triangles(array: &PyReadonlyArray3<f64>) -> Vec<Triangle> {
    let corner = |row: ArrayView1<f64>| Vec3::new(row[0], row[1], row[2]);
    let outer = array.as_array();
    outer.outer_iter().map(|t| [corner(t.row(0)), corner(t.row(1)), corner(t.row(2))]).collect()
}
