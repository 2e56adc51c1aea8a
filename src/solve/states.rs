//! Many states of light at once: B_s = E_s + rho F B_s for s = 1 .. k, with one F and one rho.
//!
//! All states share every reading of F, and LU its factors: what remains of one is its share of a product of matrices. Their errors are
//! estimated for all together. A combination of states with random signs is a state itself, and the mean square of its error is the
//! sum of theirs (Hutchinson 1990, "A stochastic estimator of the trace of the influence matrix"): a few combinations stand for all.

use super::{
    Method, Options, Run, Step, System, estimate, irradiance, iterate, norms, out_of_range, residual, validate, worse,
};
use crate::error::{Error, Result};
use crate::geometry::sampling::hash;
use crate::memory::filled;
use crate::progress::Progress;

/// Numbers a patch that iterations work on at a time: enough to share the reading of F, few enough for the cache.
const COLUMNS: usize = 96;
/// Combinations that stand for all states.
const COMBINATIONS: usize = 4;

/// The solutions of all states, or what was reached of them.
#[derive(Debug, Clone)]
pub struct States {
    /// B, n x b x k, W/m^2.
    pub radiosity: Vec<f64>,
    /// H = F B, n x b x k, W/m^2.
    pub irradiance: Vec<f64>,
    /// Steps of the state with the most.
    pub steps: usize,
    /// Relative residual of each state, the largest over its bands.
    pub residuals: Vec<f64>,
    /// Why the tolerance was not met; `None` when it was.
    pub failure: Option<String>,
    /// Estimated distance of all states to their solutions with exact F on the same patches, relative to all B - E, the largest over
    /// the bands.
    pub error_estimate: f64,
}

/// Solves `system` for `states` emissions, n x b x k numbers in the place of n x b.
///
/// # Errors
/// Those of [`super::solve`].
pub fn solve(system: &System, states: usize, method: Method, options: &Options, progress: &Progress) -> Result<States> {
    let System { form_factors, emission, reflectance, bands } = *system;
    let n = form_factors.len();
    validate(&System { emission: &vec![0.0; n * bands], ..*system }, options)?;
    check(emission, n, bands, states)?;
    let columns = bands * states;
    let mut out = States {
        radiosity: filled(n * columns, 0.0)?,
        irradiance: filled(n * columns, 0.0)?,
        steps: 0,
        residuals: vec![0.0; states],
        failure: None,
        error_estimate: 0.0,
    };
    let width = if method == Method::Direct { states } else { (COLUMNS / bands).clamp(1, states) };
    // ||B - E|| of every band and state.
    let mut light = vec![0.0; columns];
    progress.expect(states as u64);
    for first in (0..states).step_by(width) {
        let width = width.min(states - first);
        let places: Vec<usize> = (0..bands).flat_map(|b| (first..first + width).map(move |s| b * states + s)).collect();
        let some = |values: &[f64]| -> Vec<f64> {
            values.chunks_exact(columns).flat_map(|row| places.iter().map(|&k| row[k])).collect()
        };
        let wide = repeated(reflectance, width);
        let emission = some(emission);
        let system = System { form_factors, emission: &emission, reflectance: &wide, bands: places.len() };
        let mut steps = 0;
        let mut observe = |_: &Step, _: &[f64], _: &[f64]| {
            steps += 1;
            progress.advance(0)
        };
        let mut run = Run::new(&system, method, options, &mut observe);
        let radiosity = iterate(&system, method, options, &mut run)?;
        let failure = run.failure;
        let arriving = irradiance(&system, &radiosity);
        let unshot = residual(&system, &arriving, &radiosity);
        let sizes = norms(&system, &unshot).into_iter().zip(norms(&system, &emission));
        for (k, (size, of_emission)) in sizes.enumerate() {
            let relative = if of_emission > 0.0 { size / of_emission } else { size };
            let of_state = &mut out.residuals[first + k % width];
            *of_state = worse(*of_state, relative);
        }
        places.iter().zip(estimate::reflected(&system, &radiosity)).for_each(|(&k, size)| light[k] = size);
        for (to, from) in [(&mut out.radiosity, &radiosity), (&mut out.irradiance, &arriving)] {
            for (to, from) in to.chunks_exact_mut(columns).zip(from.chunks_exact(places.len())) {
                places.iter().zip(from).for_each(|(&k, value)| to[k] = *value);
            }
        }
        out.steps = out.steps.max(steps);
        out.failure = out.failure.or(failure);
        progress.advance(width as u64)?;
    }
    out.error_estimate = error(system, states, &out, &light)?;
    Ok(out)
}

/// Refuses emissions out of range, by state.
fn check(emission: &[f64], n: usize, bands: usize, states: usize) -> Result<()> {
    if states == 0 {
        return Err(Error::Invalid("there are no states of light; at least 1 is needed".to_string()));
    }
    if emission.len() != n * bands * states {
        // One band of all states: only the number is wrong.
        return Error::from_problems(out_of_range("emission", emission, n, bands * states, f64::MAX));
    }
    let of_place = |(k, e): (usize, &f64)| {
        let (patch, band, state) = (k / (bands * states), k / states % bands, k % states);
        format!("patch {patch}: emission {e} is outside [0, inf) (band {band}, state {state})")
    };
    let bad = emission.iter().enumerate().filter(|(_, e)| !(**e >= 0.0 && e.is_finite())).take(8);
    Error::from_problems(bad.map(of_place).collect())
}

/// Every number `times` times.
fn repeated(values: &[f64], times: usize) -> Vec<f64> {
    values.iter().flat_map(|&value| std::iter::repeat_n(value, times)).collect()
}

/// See [`States::error_estimate`].
fn error(system: &System, states: usize, all: &States, light: &[f64]) -> Result<f64> {
    let System { form_factors, emission, reflectance, bands } = *system;
    let sign = |c: usize, s: usize| if hash(hash(c as u64) ^ s as u64) & 1 == 0 { 1.0 } else { -1.0 };
    // n x (b x combinations) numbers.
    let combined = |values: &[f64]| -> Vec<f64> {
        let of_band = |of_states: &[f64]| -> Vec<f64> {
            (0..COMBINATIONS).map(|c| of_states.iter().enumerate().map(|(s, x)| sign(c, s) * x).sum()).collect()
        };
        values.chunks_exact(states).flat_map(of_band).collect()
    };
    let [e, b, h] = [emission, &all.radiosity, &all.irradiance].map(combined);
    let wide = repeated(reflectance, COMBINATIONS);
    let system = System { form_factors, emission: &e, reflectance: &wide, bands: bands * COMBINATIONS };
    let unshot = residual(&system, &h, &b);
    let sizes = estimate::estimate(&system, &b, &h, &unshot)?.sizes;
    let all_of = |sizes: &[f64]| sizes.iter().fold(0.0f64, |sum, size| sum.hypot(*size));
    let relative = |(sizes, light): (&[f64], &[f64])| {
        let size = all_of(sizes) / (COMBINATIONS as f64).sqrt();
        if size == 0.0 { 0.0 } else { size / all_of(light) }
    };
    Ok(sizes.chunks_exact(COMBINATIONS).zip(light.chunks_exact(states)).map(relative).fold(0.0, worse))
}
