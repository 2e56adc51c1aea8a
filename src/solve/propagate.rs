//! What arrives of sources of light after all bounces, in many columns at once.
//!
//! Sources may be of any sign: errors are propagated like light.

use super::{Method, Observer, Options, Run, System, gmres};
use crate::error::Result;

/// Steps after which the system is taken for one that has no finite solution.
const MOST_STEPS: usize = 500;

/// F (I - rho F)^-1 of every source, n x b each, to the relative residual `tolerance`; `None` when that has no end.
///
/// # Errors
/// What `observe` returns, after any step.
pub(crate) fn propagated(
    system: &System,
    sources: &[Vec<f64>],
    tolerance: f64,
    observe: &mut Observer,
) -> Result<Option<Vec<Vec<f64>>>> {
    let System { form_factors, reflectance, bands, .. } = *system;
    let (n, columns) = (form_factors.len(), bands * sources.len());
    let mut emission = vec![0.0; n * columns];
    let mut weights = vec![0.0; n * columns];
    // Each in units of its largest number: emissions of 1e-300 are as good as others.
    let unit = |source: &Vec<f64>| source.iter().fold(0.0f64, |peak, x| peak.max(x.abs())).max(f64::MIN_POSITIVE);
    let units: Vec<f64> = sources.iter().map(unit).collect();
    for i in 0..n {
        for (s, source) in sources.iter().enumerate() {
            for b in 0..bands {
                emission[i * columns + s * bands + b] = source[i * bands + b] / units[s];
                weights[i * columns + s * bands + b] = reflectance[i * bands + b];
            }
        }
    }
    let wide = System { form_factors, emission: &emission, reflectance: &weights, bands: columns };
    let options = Options { tolerance, max_iterations: Some(MOST_STEPS), memory: u64::MAX };
    let mut run = Run::new(&wide, Method::Gmres, &options, observe);
    let (_, arriving) = gmres::solve(&wide, emission.clone(), &mut run)?;
    if run.failure.is_some() {
        return Ok(None);
    }
    let row_of = |row: &[f64], s: usize| row[s * bands..][..bands].iter().map(|x| x * units[s]).collect::<Vec<_>>();
    let column = |s: usize| arriving.chunks_exact(columns).flat_map(|row| row_of(row, s)).collect();
    Ok(Some((0..sources.len()).map(column).collect()))
}
