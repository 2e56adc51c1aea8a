//! Form-factor matrices that the user brings: plain dense or sparse (CSR), without areas.
//!
//! No areas means that reciprocity and an energy audit cannot be had, and that solvers weigh all patches alike.

use rayon::prelude::*;

use super::FormFactors;
use crate::error::{Error, Result};

/// out_b += f x_b for the bands of one patch.
#[inline]
pub(super) fn add_scaled(f: f64, x: &[f64], out: &mut [f64]) {
    for (out, x) in out.iter_mut().zip(x) {
        *out += f * x;
    }
}

/// A dense matrix, row-major.
#[derive(Debug, Clone)]
pub struct DenseMatrix {
    n: usize,
    values: Vec<f64>,
}

impl DenseMatrix {
    /// # Errors
    /// [`Error::Invalid`] when the length is not n^2 or an entry is outside [0, 1].
    pub fn new(n: usize, values: Vec<f64>) -> Result<DenseMatrix> {
        if values.len() != n * n {
            return Err(Error::Invalid(format!("{} values do not make an {n} x {n} matrix", values.len())));
        }
        check_entries(values.iter().enumerate().map(|(k, v)| (k / n, k % n, *v)))?;
        Ok(DenseMatrix { n, values })
    }
}

impl FormFactors for DenseMatrix {
    fn len(&self) -> usize {
        self.n
    }

    fn areas(&self) -> Option<&[f64]> {
        None
    }

    fn gather(&self, i: usize, x: &[f64], out: &mut [f64]) {
        let bands = out.len();
        out.fill(0.0);
        for (f, x) in self.values[i * self.n..][..self.n].iter().zip(x.chunks_exact(bands)) {
            add_scaled(*f, x, out);
        }
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        for (f, out) in self.values[i..].iter().step_by(self.n).zip(out.chunks_exact_mut(amount.len())) {
            add_scaled(*f, amount, out);
        }
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        out.copy_from_slice(&self.values[i * self.n..][..self.n]);
    }

    fn nbytes(&self) -> usize {
        size_of_val(self.values.as_slice())
    }
}

/// Compressed rows: row i holds entries `start[i] .. start[i + 1]`.
#[derive(Debug, Clone)]
pub struct Compressed {
    pub(super) start: Vec<usize>,
    pub(super) index: Vec<u32>,
    pub(super) value: Vec<f64>,
}

impl Compressed {
    /// From the three arrays of compressed sparse rows (CSR) of a square matrix.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the arrays do not fit together, or an entry is outside [0, 1].
    pub fn square(start: Vec<usize>, index: Vec<u32>, value: Vec<f64>) -> Result<Compressed> {
        let n = start.len().saturating_sub(1);
        let fits = start.first() == Some(&0)
            && start.windows(2).all(|w| w[0] <= w[1])
            && start.last() == Some(&index.len())
            && index.len() == value.len()
            && index.iter().all(|&j| (j as usize) < n);
        if !fits {
            return Err(Error::Invalid("the sparse arrays do not describe a square matrix in CSR form".to_string()));
        }
        let rows = Compressed { start, index, value };
        check_entries((0..n).flat_map(|i| rows.row(i).map(move |(j, f)| (i, j, f))))?;
        Ok(rows)
    }

    /// The three arrays: starts, columns and values.
    pub fn parts(&self) -> (&[usize], &[u32], &[f64]) {
        (&self.start, &self.index, &self.value)
    }

    /// Number of rows.
    pub(super) fn len(&self) -> usize {
        self.start.len() - 1
    }

    /// out_b = sum over j of F_ij x_jb.
    pub(super) fn gather(&self, i: usize, x: &[f64], out: &mut [f64]) {
        let bands = out.len();
        out.fill(0.0);
        for (j, f) in self.row(i) {
            add_scaled(f, &x[j * bands..][..bands], out);
        }
    }

    /// The product of all rows with x.
    pub(super) fn apply(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        out.par_chunks_mut(bands).enumerate().for_each(|(i, out)| self.gather(i, x, out));
    }

    /// out_jb += F_ij amount_b.
    pub(super) fn scatter(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        let bands = amount.len();
        for (j, f) in self.row(i) {
            add_scaled(f, amount, &mut out[j * bands..][..bands]);
        }
    }

    pub(super) fn nbytes(&self) -> usize {
        size_of_val(self.start.as_slice()) + size_of_val(self.index.as_slice()) + size_of_val(self.value.as_slice())
    }

    pub(super) fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.start[i]..self.start[i + 1];
        self.index[range.clone()].iter().map(|&j| j as usize).zip(self.value[range].iter().copied())
    }

    /// The columns of square rows, as rows.
    pub(super) fn transposed(&self) -> Compressed {
        let n = self.len();
        let mut start = vec![0; n + 1];
        self.index.iter().for_each(|&j| start[j as usize + 1] += 1);
        for j in 0..n {
            start[j + 1] += start[j];
        }
        let mut next = start.clone();
        let (mut index, mut value) = (vec![0; self.index.len()], vec![0.0; self.index.len()]);
        for i in 0..n {
            for (j, f) in self.row(i) {
                index[next[j]] = i as u32;
                value[next[j]] = f;
                next[j] += 1;
            }
        }
        Compressed { start, index, value }
    }
}

/// A sparse matrix. Rows serve gathering, columns shooting; both are kept.
#[derive(Debug, Clone)]
pub struct SparseMatrix {
    rows: Compressed,
    columns: Compressed,
}

impl SparseMatrix {
    /// From the three arrays of compressed sparse rows (CSR).
    ///
    /// # Errors
    /// [`Error::Invalid`] when the arrays do not fit together, or an entry is outside [0, 1].
    pub fn new(start: Vec<usize>, index: Vec<u32>, value: Vec<f64>) -> Result<SparseMatrix> {
        let rows = Compressed::square(start, index, value)?;
        let columns = rows.transposed();
        Ok(SparseMatrix { rows, columns })
    }
}

impl FormFactors for SparseMatrix {
    fn len(&self) -> usize {
        self.rows.len()
    }

    fn areas(&self) -> Option<&[f64]> {
        None
    }

    fn gather(&self, i: usize, x: &[f64], out: &mut [f64]) {
        self.rows.gather(i, x, out);
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        self.columns.scatter(i, amount, out);
    }

    fn apply_transposed(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        self.columns.apply(x, bands, out);
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        out.fill(0.0);
        self.rows.scatter(i, &[1.0], out);
    }

    fn nbytes(&self) -> usize {
        self.rows.nbytes() + self.columns.nbytes()
    }
}

fn check_entries(entries: impl Iterator<Item = (usize, usize, f64)>) -> Result<()> {
    // A factor of 1 may have been rounded to six digits in a file.
    let bad = entries.filter(|(_, _, f)| !(*f >= 0.0 && *f <= 1.0 + 1e-6)).take(8);
    Error::from_problems(bad.map(|(i, j, f)| format!("F[{i}, {j}] = {f} is outside [0, 1]")).collect())
}
