//! An operator whose products are made elsewhere: Python is asked for each of them.
//!
//! The solvers of the core then work on what is held by other processes, with the same bits as on their own if the answers
//! have the same bits.

use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::convert::{table, values};
use super::run::Raised;
use crate::assembly::FormFactors;

/// What the other side has told beforehand, and whom to ask for the rest.
pub(super) struct Remote {
    pub(super) areas: Vec<f64>,
    pub(super) row_sums: Vec<f64>,
    pub(super) nbytes: usize,
    /// An object with the methods `apply(x)`, `row(i)`, `standard_error(x)` and `sampling_error(x, draw)`.
    pub(super) door: Py<PyAny>,
    /// An exception of the door: the answer then is not a number, which ends every solver, and nobody asks again.
    pub(super) raised: Raised,
}

impl Remote {
    /// Puts the answer of `ask` into `out`, which it must fill.
    fn answer(&self, out: &mut [f64], ask: impl FnOnce(Python<'_>) -> PyResult<Vec<f64>>) {
        let asked = self.raised.check().and_then(|()| {
            self.raised.call(|py| {
                let answer = ask(py)?;
                if answer.len() != out.len() {
                    let (got, wanted) = (answer.len(), out.len());
                    return Err(PyValueError::new_err(format!("the answer has {got} numbers, not {wanted}")));
                }
                out.copy_from_slice(&answer);
                Ok(())
            })
        });
        if asked.is_err() {
            out.fill(f64::NAN);
        }
    }

    /// The answer of `method` to x and what else it takes.
    fn of_table(&self, method: &str, x: &[f64], bands: usize, draw: Option<u64>, out: &mut [f64]) {
        self.answer(out, |py| {
            let x = table(py, x.to_vec(), bands)?;
            let answer = match draw {
                Some(draw) => self.door.call_method1(py, method, (x, draw))?,
                None => self.door.call_method1(py, method, (x,))?,
            };
            values(&answer.extract::<PyReadonlyArray2<f64>>(py)?)
        });
    }
}

impl FormFactors for Remote {
    fn len(&self) -> usize {
        self.areas.len()
    }

    fn areas(&self) -> Option<&[f64]> {
        Some(&self.areas)
    }

    /// A whole product, of which one row is used.
    fn gather(&self, i: usize, x: &[f64], out: &mut [f64]) {
        let bands = out.len();
        let mut all = vec![0.0; x.len()];
        self.apply(x, bands, &mut all);
        out.copy_from_slice(&all[i * bands..][..bands]);
    }

    /// A whole product of what is 0 but for patch i.
    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        let bands = amount.len();
        let (mut x, mut sent) = (vec![0.0; out.len()], vec![0.0; out.len()]);
        x[i * bands..][..bands].copy_from_slice(amount);
        self.apply(&x, bands, &mut sent);
        out.iter_mut().zip(sent).for_each(|(out, sent)| *out += sent);
    }

    fn apply(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        self.of_table("apply", x, bands, None, out);
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        self.answer(out, |py| {
            let row = self.door.call_method1(py, "row", (i,))?;
            values(&row.extract::<PyReadonlyArray1<f64>>(py)?)
        });
    }

    fn row_sums(&self) -> Vec<f64> {
        self.row_sums.clone()
    }

    fn standard_error(&self, x: &[f64], bands: usize) -> Option<Vec<f64>> {
        let mut out = vec![0.0; x.len()];
        self.of_table("standard_error", x, bands, None, &mut out);
        Some(out)
    }

    fn sampling_error(&self, x: &[f64], bands: usize, draw: u64) -> Option<Vec<f64>> {
        let mut out = vec![0.0; x.len()];
        self.of_table("sampling_error", x, bands, Some(draw), &mut out);
        Some(out)
    }

    fn nbytes(&self) -> usize {
        self.nbytes
    }
}
