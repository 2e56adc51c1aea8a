//! Southwell relaxation: the patch with the most unshot power shoots it to all others.
//!
//! dB_i -> B_i; dB_j += rho_j F_ji dB_i; dB_i = 0. This is the progressive refinement of Cohen, Chen, Wallace & Greenberg
//! 1988, who rediscovered Southwell 1946 (Gortler, Cohen & Slusallek 1994): the picture is useful after few shots, and
//! a shot touches one column of F.
//!
//! For display, the light still under way may be spread evenly over the scene ([`ambient`], ibid. eq. 13 to 16). It is never
//! part of the solution.

use super::{Run, System};
use crate::error::Result;

/// Shots allowed per patch.
const MOST_SHOTS_A_PATCH: usize = 10_000;

pub(super) fn solve(system: &System, run: &mut Run) -> Result<Vec<f64>> {
    let System { form_factors, emission, reflectance, bands } = *system;
    let n = form_factors.len();
    let area = |i: usize| form_factors.areas().map_or(1.0, |areas| areas[i]);
    let mut radiosity = vec![0.0; n * bands];
    let mut unshot = emission.to_vec();
    let mut received = vec![0.0; n * bands];
    loop {
        let power = |i: usize| area(i) * unshot[i * bands..][..bands].iter().sum::<f64>();
        // The lowest number among equals, so that the order of shots is the same every time.
        let brightest =
            (0..n).map(|i| (i, power(i))).fold((0, -1.0), |best, next| if next.1 > best.1 { next } else { best }).0;
        let range = brightest * bands..(brightest + 1) * bands;
        let amount = unshot[range.clone()].to_vec();
        radiosity[range.clone()].iter_mut().zip(&amount).for_each(|(b, r)| *b += r);
        unshot[range].fill(0.0);
        received.fill(0.0);
        form_factors.shoot(brightest, &amount, &mut received);
        for ((r, rho), h) in unshot.iter_mut().zip(reflectance).zip(&received) {
            *r += rho * h;
        }
        if run.step(&radiosity, &unshot, MOST_SHOTS_A_PATCH * n)? {
            return Ok(radiosity);
        }
    }
}

/// The ambient radiosity per band: the mean unshot radiosity, times the bounces 1 / (1 - mean rho) that it has ahead.
/// Shown as B_i + rho_i ambient.
pub fn ambient(areas: &[f64], unshot: &[f64], reflectance: &[f64], bands: usize) -> Vec<f64> {
    let total: f64 = areas.iter().sum();
    let mean =
        |x: &[f64], b: usize| areas.iter().enumerate().map(|(i, area)| area * x[i * bands + b]).sum::<f64>() / total;
    (0..bands).map(|b| mean(unshot, b) / (1.0 - mean(reflectance, b))).collect()
}
