//! Form factors of pairs.

use numpy::ndarray::ArrayView1;
use numpy::{PyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use rayon::prelude::*;

use super::convert::{points, vector};
use super::error::to_python;
use super::run::run;
use crate::error::Error;
use crate::form_factor::{Accuracy, Batch, Patch, Shape, exchange};
use crate::geometry::polygon::defect;
use crate::geometry::{Triangle, Vec3};

/// Pairs computed between two looks at the stop flag.
const BATCH: usize = 4096;

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
    Ok(exchange(&a, &b, &accuracy) / a.area)
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
        let patches = |triangles: &[Triangle]| triangles.iter().map(|t| Patch::new(*t)).collect::<Vec<_>>();
        let (a, b) = (patches(&a), patches(&b));
        let pairs: Vec<[u32; 2]> = (0..BATCH as u32).map(|k| [k, k]).collect();
        let batches: Result<Vec<Vec<f64>>, Error> = a
            .par_chunks(BATCH)
            .zip(b.par_chunks(BATCH))
            .map_init(Batch::new, |batch, (a, b)| {
                progress.advance(a.len() as u64)?;
                let mut factors = vec![0.0; a.len()];
                batch.exchange_pairs(a, b, &pairs[..a.len()], &accuracy, &mut factors)?;
                factors.iter_mut().zip(a).for_each(|(f, a)| *f /= a.area);
                Ok(factors)
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
