//! Southwell relaxation: the patch with the most unshot power shoots it to all others.
//!
//! dB_i -> B_i; dB_j += rho_j F_ji dB_i; dB_i = 0. This is the progressive refinement of Cohen, Chen, Wallace & Greenberg
//! 1988, who rediscovered Southwell 1946 (Gortler, Cohen & Slusallek 1994): the picture is useful after few shots, and
//! a shot touches one column of F.
//!
//! *Overshooting* (Feda & Purgathofer 1992, "Accelerating radiosity by overshooting") shoots also what is going to arrive: with
//! the ambient radiosity a of all that is under way, the patch sends dB_i + rho_i a, and owes what it has sent too early,
//! dB_i = -rho_i a, which later light pays, or a shot of negative light. In a white room that saves most of the shots.
//!
//! For display, the light still under way may be spread evenly over the scene ([`ambient`], Cohen et al. 1988, eq. 13 to 16). It is never
//! part of the solution.

use super::{Run, System};
use crate::error::Result;

/// Shots allowed per patch.
const MOST_SHOTS_A_PATCH: usize = 10_000;

pub(super) fn solve(system: &System, run: &mut Run, overshoots: bool) -> Result<Vec<f64>> {
    let System { form_factors, emission, reflectance, bands } = *system;
    let n = form_factors.len();
    let area = |i: usize| form_factors.areas().map_or(1.0, |areas| areas[i]);
    // What is under way is lit once more by 1 / (1 - mean of rho times row sum), a geometric series; not where that has no end.
    let (row_sums, total) = (form_factors.row_sums(), (0..n).map(area).sum::<f64>());
    let series = |b: usize| {
        let loss = 1.0 - (0..n).map(|i| area(i) * reflectance[i * bands + b] * row_sums[i]).sum::<f64>() / total;
        if overshoots && loss > 0.0 { 1.0 / (loss * total) } else { 0.0 }
    };
    let series: Vec<f64> = (0..bands).map(series).collect();
    let mut radiosity = vec![0.0; n * bands];
    let mut unshot = emission.to_vec();
    let mut received = vec![0.0; n * bands];
    loop {
        let mut ambient = vec![0.0; bands];
        if overshoots {
            for (i, row) in unshot.chunks_exact(bands).enumerate() {
                (0..bands).for_each(|b| ambient[b] += series[b] * area(i) * row[b]);
            }
        }
        let due = |k: usize| unshot[k] + reflectance[k] * ambient[k % bands];
        let power = |i: usize| area(i) * (i * bands..(i + 1) * bands).map(|k| due(k).abs()).sum::<f64>();
        // The lowest number among equals, so that the order of shots is the same every time.
        let brightest =
            (0..n).map(|i| (i, power(i))).fold((0, -1.0), |best, next| if next.1 > best.1 { next } else { best }).0;
        let range = brightest * bands..(brightest + 1) * bands;
        let amount: Vec<f64> = range.clone().map(due).collect();
        radiosity[range.clone()].iter_mut().zip(&amount).for_each(|(b, r)| *b += r);
        unshot[range].iter_mut().zip(&amount).for_each(|(r, sent)| *r -= sent);
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
