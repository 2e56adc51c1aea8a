//! GMRES: the combination of bounces with the least residual.
//!
//! Saad & Schultz 1986, algorithm 4, on (I - rho F) B = E, restarted after [`RESTART`] vectors; inner products weighted by
//! area, so that its residual is the one that all methods report. The bands share every product with F and are otherwise
//! independent.

use super::{Run, System, irradiance, norms, residual};
use crate::error::Result;

/// Krylov vectors kept. A bounce loses a good part of the light, so few scenes ever need a second cycle.
const RESTART: usize = 60;
/// Steps allowed.
const MOST_STEPS: usize = 10_000;

/// One band's small least-squares problem: the Hessenberg matrix, kept triangular by Givens rotations.
struct Small {
    /// Columns of R.
    columns: Vec<Vec<f64>>,
    rotations: Vec<(f64, f64)>,
    /// The rotated right-hand side; its last entry is the residual.
    rhs: Vec<f64>,
}

impl Small {
    fn new(norm: f64) -> Small {
        Small { columns: Vec::new(), rotations: Vec::new(), rhs: vec![norm] }
    }

    /// Adds a column of the Hessenberg matrix.
    fn push(&mut self, mut h: Vec<f64>) {
        let k = self.columns.len();
        for (j, (c, s)) in self.rotations.iter().enumerate() {
            (h[j], h[j + 1]) = (c * h[j] + s * h[j + 1], c * h[j + 1] - s * h[j]);
        }
        let r = h[k].hypot(h[k + 1]);
        let (c, s) = if r > 0.0 { (h[k] / r, h[k + 1] / r) } else { (1.0, 0.0) };
        (h[k], h[k + 1]) = (r, 0.0);
        self.rotations.push((c, s));
        let last = self.rhs[k];
        self.rhs[k] = c * last;
        self.rhs.push(-s * last);
        self.columns.push(h);
    }

    /// Coefficients of the Krylov vectors.
    fn solve(&self) -> Vec<f64> {
        let n = self.columns.len();
        let mut y = self.rhs[..n].to_vec();
        for k in (0..n).rev() {
            y[k] = if self.columns[k][k] > 0.0 { y[k] / self.columns[k][k] } else { 0.0 };
            for j in 0..k {
                y[j] -= self.columns[k][j] * y[k];
            }
        }
        y
    }

    /// Coefficients of the residual in the Krylov vectors: what the rotations have left, rotated back.
    fn residual(&self) -> Vec<f64> {
        let n = self.columns.len();
        let mut x = vec![0.0; n + 1];
        x[n] = self.rhs[n];
        for (j, (c, s)) in self.rotations.iter().enumerate().rev() {
            (x[j], x[j + 1]) = (c * x[j] - s * x[j + 1], s * x[j] + c * x[j + 1]);
        }
        x
    }
}

/// The radiosity, and what it makes arrive: F B. The nearer `start` is to it, the fewer steps it takes.
pub(super) fn solve(system: &System, start: Vec<f64>, run: &mut Run) -> Result<(Vec<f64>, Vec<f64>)> {
    let bands = system.bands;
    let mut start = start;
    loop {
        let unshot = residual(system, &irradiance(system, &start), &start);
        let sizes = norms(system, &unshot);
        let mut basis = vec![scaled(&unshot, &inverse(&sizes))];
        let mut small: Vec<Small> = sizes.iter().map(|&norm| Small::new(norm)).collect();
        for k in 0..RESTART {
            let reflected = irradiance(system, &basis[k]);
            let mut w: Vec<f64> =
                basis[k].iter().zip(&reflected).zip(system.reflectance).map(|((v, h), rho)| v - rho * h).collect();
            // Modified Gram-Schmidt, every band on its own.
            let mut columns = vec![Vec::with_capacity(k + 2); bands];
            for v in &basis {
                let products = inner_products(system, &w, v);
                for (w, v) in w.chunks_exact_mut(bands).zip(v.chunks_exact(bands)) {
                    w.iter_mut().zip(v).zip(&products).for_each(|((w, v), product)| *w -= product * v);
                }
                columns.iter_mut().zip(products).for_each(|(column, h)| column.push(h));
            }
            let lengths = norms(system, &w);
            for ((small, mut column), length) in small.iter_mut().zip(columns).zip(&lengths) {
                column.push(*length);
                small.push(column);
            }
            basis.push(scaled(&w, &inverse(&lengths)));
            let mut radiosity = start.clone();
            combine(&mut radiosity, &basis, &small.iter().map(Small::solve).collect::<Vec<_>>());
            let mut unshot = vec![0.0; radiosity.len()];
            combine(&mut unshot, &basis, &small.iter().map(Small::residual).collect::<Vec<_>>());
            let mut arriving = Vec::new();
            if run.ends_with(&unshot, MOST_STEPS) {
                // What was carried along has rounding errors of its own: the last word has the system.
                arriving = irradiance(system, &radiosity);
                unshot = residual(system, &arriving, &radiosity);
            }
            if run.step(&radiosity, &unshot, MOST_STEPS)? {
                return Ok((radiosity, arriving));
            }
            start = if k + 1 == RESTART { radiosity } else { start };
        }
    }
}

/// out += sum over k of y_k v_k, the coefficients y band by band.
fn combine(out: &mut [f64], basis: &[Vec<f64>], coefficients: &[Vec<f64>]) {
    let bands = coefficients.len();
    for (k, v) in basis.iter().take(coefficients[0].len()).enumerate() {
        let factors: Vec<f64> = coefficients.iter().map(|y| y[k]).collect();
        for (out, v) in out.chunks_exact_mut(bands).zip(v.chunks_exact(bands)) {
            out.iter_mut().zip(v).zip(&factors).for_each(|((out, v), factor)| *out += factor * v);
        }
    }
}

/// 1/x, or 0 for a band that is already exact.
fn inverse(norms: &[f64]) -> Vec<f64> {
    norms.iter().map(|&x| if x > 0.0 { 1.0 / x } else { 0.0 }).collect()
}

fn scaled(x: &[f64], factors: &[f64]) -> Vec<f64> {
    x.chunks_exact(factors.len()).flat_map(|row| row.iter().zip(factors).map(|(x, factor)| x * factor)).collect()
}

/// Area-weighted inner products, one a band.
fn inner_products(system: &System, x: &[f64], y: &[f64]) -> Vec<f64> {
    let bands = system.bands;
    let mut sums = vec![0.0; bands];
    for (i, (x, y)) in x.chunks_exact(bands).zip(y.chunks_exact(bands)).enumerate() {
        let area = system.form_factors.areas().map_or(1.0, |areas| areas[i]);
        for b in 0..bands {
            sums[b] += area * x[b] * y[b];
        }
    }
    sums
}
