//! The operator F: what one bounce of light does to a vector of radiosities.

use rayon::prelude::*;

/// Form factors as a linear operator. Vectors hold one row of `bands` numbers a patch.
pub trait FormFactors: Send + Sync {
    /// Number of patches n.
    fn len(&self) -> usize;

    /// Whether there are no patches.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Patch areas A, m^2, where they are known. With them the operator obeys A_i F_ij = A_j F_ji: exactly where it is
    /// stored so, within the error of sampling where every row was sampled for itself.
    fn areas(&self) -> Option<&[f64]>;

    /// The irradiance of patch i: out_b = sum over j of F_ij x_jb.
    fn gather(&self, i: usize, x: &[f64], out: &mut [f64]);

    /// What patch i sends to every other: out_jb += F_ji amount_b.
    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]);

    /// The irradiance of every patch, out = F x, `bands` numbers a patch. Same bits for any number of threads.
    fn apply(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        out.par_chunks_mut(bands).enumerate().for_each(|(i, out)| self.gather(i, x, out));
    }

    /// The same backwards, out = F^T x: out_jb = sum over i of F_ij x_ib. Operators that need not be read row by row say how.
    fn apply_transposed(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        let mut row = vec![0.0; self.len()];
        out.fill(0.0);
        for (i, x) in x.chunks_exact(bands).enumerate() {
            self.row(i, &mut row);
            for (f, out) in row.iter().zip(out.chunks_exact_mut(bands)) {
                out.iter_mut().zip(x).for_each(|(out, x)| *out += f * x);
            }
        }
    }

    /// Row i: out_j = F_ij.
    fn row(&self, i: usize, out: &mut [f64]);

    /// Sum over j of F_ij for every i.
    fn row_sums(&self) -> Vec<f64> {
        let mut sums = vec![0.0; self.len()];
        self.apply(&vec![1.0; self.len()], 1, &mut sums);
        sums
    }

    /// A bound on the relative error of every F_ij apart from sampling.
    fn kernel_error(&self) -> f64 {
        0.0
    }

    /// The standard error of (F x)_ib that the sampling of F leaves; `None` when F was not sampled.
    fn standard_error(&self, _x: &[f64], _bands: usize) -> Option<Vec<f64>> {
        None
    }

    /// (dF x)_ib for one realisation of the sampling error dF, number `draw`; `None` when F was not sampled.
    fn sampling_error(&self, _x: &[f64], _bands: usize, _draw: u64) -> Option<Vec<f64>> {
        None
    }

    /// Bytes held.
    fn nbytes(&self) -> usize;
}

/// F^T x where reciprocity A_i F_ij = A_j F_ji is exact: F^T = A F A^-1.
pub(crate) fn apply_reciprocal(f: &dyn FormFactors, areas: &[f64], x: &[f64], bands: usize, out: &mut [f64]) {
    let by_area: Vec<f64> = x.iter().enumerate().map(|(k, x)| x / areas[k / bands]).collect();
    f.apply(&by_area, bands, out);
    out.iter_mut().enumerate().for_each(|(k, out)| *out *= areas[k / bands]);
}

/// F^T as an operator: light that runs backwards. It has no areas: its vectors are powers, not radiosities.
pub struct Transposed<'a>(pub &'a dyn FormFactors);

impl FormFactors for Transposed<'_> {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn areas(&self) -> Option<&[f64]> {
        None
    }

    fn gather(&self, i: usize, x: &[f64], out: &mut [f64]) {
        let mut all = vec![0.0; x.len()];
        self.0.apply_transposed(x, out.len(), &mut all);
        out.copy_from_slice(&all[i * out.len()..][..out.len()]);
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        let mut row = vec![0.0; self.len()];
        self.0.row(i, &mut row);
        for (f, out) in row.iter().zip(out.chunks_exact_mut(amount.len())) {
            out.iter_mut().zip(amount).for_each(|(out, amount)| *out += f * amount);
        }
    }

    fn apply(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        self.0.apply_transposed(x, bands, out);
    }

    fn apply_transposed(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        self.0.apply(x, bands, out);
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        out.fill(0.0);
        self.0.shoot(i, &[1.0], out);
    }

    fn nbytes(&self) -> usize {
        self.0.nbytes()
    }
}
