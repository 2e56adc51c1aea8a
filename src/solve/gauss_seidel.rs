//! Gauss-Seidel iteration: every patch in turn gathers from all others, using what is new at once.
//!
//! B_i <- E_i + rho_i sum over j of F_ij B_j (Cohen & Greenberg 1985). About half the steps of Jacobi; the order of the
//! patches matters, so a sweep is sequential. The residual is computed afresh after each sweep, by all threads.

use super::{Run, System, irradiance, residual};
use crate::error::Result;

/// Enough for rho = 0.9999 to fall by 1e-13.
const MOST_SWEEPS: usize = 300_000;

pub(super) fn solve(system: &System, run: &mut Run) -> Result<Vec<f64>> {
    let System { form_factors, emission, reflectance, bands } = *system;
    let mut radiosity = emission.to_vec();
    let mut gathered = vec![0.0; bands];
    loop {
        for i in 0..form_factors.len() {
            form_factors.gather(i, &radiosity, &mut gathered);
            for b in 0..bands {
                let k = i * bands + b;
                radiosity[k] = emission[k] + reflectance[k] * gathered[b];
            }
        }
        let unshot = residual(system, &irradiance(system, &radiosity), &radiosity);
        if run.step(&radiosity, &unshot, MOST_SWEEPS)? {
            return Ok(radiosity);
        }
    }
}
