//! Matrix inversion: LU factorisation of I - rho F (Goral et al. 1984), by the faer crate.
//!
//! O(n^3) time and O(n^2) memory; the reference that the iterations are tested against. Bands with the same reflectances
//! share one factorisation.

use faer::Mat;
use faer::linalg::solvers::Solve;

use super::{Options, Run, System, irradiance, residual};
use crate::error::{Error, Result};

pub(super) fn solve(system: &System, options: &Options, run: &mut Run) -> Result<Vec<f64>> {
    let System { form_factors, emission, reflectance, bands } = *system;
    let n = form_factors.len();
    // The matrix and its factors.
    let needed = 2 * 8 * (n as u64) * (n as u64);
    if needed > options.memory {
        return Err(Error::Memory {
            what: format!("the LU factorisation of {n} patches"),
            needed,
            available: options.memory,
            remedy: "use an iterative method such as \"gauss_seidel\"".to_string(),
        });
    }
    let mut radiosity = vec![0.0; n * bands];
    let mut pending: Vec<usize> = (0..bands).collect();
    while let Some(&first) = pending.first() {
        let same = |&b: &usize| (0..n).all(|i| reflectance[i * bands + b] == reflectance[i * bands + first]);
        let (group, rest): (Vec<usize>, Vec<usize>) = pending.iter().partition(|b| same(b));
        pending = rest;
        let mut row = vec![0.0; n];
        let mut matrix = Mat::<f64>::identity(n, n);
        for i in 0..n {
            form_factors.row(i, &mut row);
            let rho = reflectance[i * bands + first];
            for (j, f) in row.iter().enumerate() {
                matrix[(i, j)] -= rho * f;
            }
        }
        let rhs = Mat::from_fn(n, group.len(), |i, k| emission[i * bands + group[k]]);
        let solution = matrix.partial_piv_lu().solve(&rhs);
        for (k, b) in group.iter().enumerate() {
            for i in 0..n {
                radiosity[i * bands + b] = solution[(i, k)];
            }
        }
    }
    let unshot = residual(system, &irradiance(system, &radiosity), &radiosity);
    // One step is all there is: if its residual misses the tolerance, more steps would not mend it.
    run.step(&radiosity, &unshot, 1)?;
    Ok(radiosity)
}
