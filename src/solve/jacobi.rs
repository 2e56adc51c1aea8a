//! Jacobi iteration: B <- E + rho F B, one bounce of all the light a step.
//!
//! Started from B = E, step k holds exactly the light after k bounces (the Neumann series; Goral et al. 1984). The
//! residual of step k is the light of bounce k + 1, so knowing it costs nothing extra.

use super::{Run, System, irradiance, residual};
use crate::error::Result;

/// Enough for rho = 0.9999 to fall by 1e-13.
const MOST_BOUNCES: usize = 300_000;

pub(super) fn solve(system: &System, run: &mut Run) -> Result<Vec<f64>> {
    let mut radiosity = system.emission.to_vec();
    let mut unshot = residual(system, &irradiance(system, &radiosity), &radiosity);
    loop {
        radiosity.iter_mut().zip(&unshot).for_each(|(b, r)| *b += r);
        unshot = residual(system, &irradiance(system, &radiosity), &radiosity);
        if run.step(&radiosity, &unshot, MOST_BOUNCES)? {
            return Ok(radiosity);
        }
    }
}
