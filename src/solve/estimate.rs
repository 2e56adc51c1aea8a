//! How far a radiosity is from the solution with exact form factors.
//!
//! With exact factors F + dF the residual of B is r + rho dF B, so B is off by
//!
//!   dB = (I - rho F)^-1 (r + rho dF B)
//!
//! to first order. Three sources are followed through all bounces, which a bound by 1 / (1 - q) would exaggerate in most
//! scenes and one bounce alone would understate in white ones:
//!
//! - the iteration: r itself
//! - the kernels: every F_ij off by its bound in the same direction, dF B = bound x H
//! - the sampling: realisations of dF with random signs and the standard errors of the pairs
//!
//! One GMRES run to a few per cent carries all of them, each as a band of its own.

use super::{System, norms, propagated};
use crate::error::Result;

/// Realisations of the sampling error. Its part that all patches share, which matters in white rooms, is known from them
/// to 1 / sqrt(2 x 4) = 35 %.
const DRAWS: u64 = 4;
/// An estimate need not be better than this.
const TOLERANCE: f64 = 0.03;

/// The error of a radiosity.
pub(super) struct Estimate {
    /// ||dB||, one a band; infinite where the system has hardly any solution.
    pub sizes: Vec<f64>,
    /// Per patch and band, from sampling alone; `None` when F was not sampled.
    pub standard_error: Option<Vec<f64>>,
}

impl Estimate {
    /// The error relative to that of `light`, ||B - E|| of every band, the largest over the bands.
    pub fn relative(&self, light: &[f64]) -> f64 {
        let relative = |(size, light): (&f64, &f64)| if *size == 0.0 { 0.0 } else { size / light };
        self.sizes.iter().zip(light).map(relative).fold(0.0, super::worse)
    }
}

/// ||B - E||, one a band.
pub(super) fn reflected(system: &System, radiosity: &[f64]) -> Vec<f64> {
    let reflected: Vec<f64> = radiosity.iter().zip(system.emission).map(|(b, e)| b - e).collect();
    norms(system, &reflected)
}

pub(super) fn estimate(system: &System, radiosity: &[f64], irradiance: &[f64], unshot: &[f64]) -> Result<Estimate> {
    let System { form_factors, reflectance, bands, .. } = *system;
    let bound = form_factors.kernel_error();
    let mut sources = vec![unshot.to_vec()];
    sources.push(reflectance.iter().zip(irradiance).map(|(rho, h)| bound * rho * h).collect());
    for draw in 0..DRAWS {
        let Some(realisation) = form_factors.sampling_error(radiosity, bands, draw) else { break };
        sources.push(reflectance.iter().zip(realisation).map(|(rho, h)| rho * h).collect());
    }
    let Some(arriving) = propagated(system, &sources, TOLERANCE, &mut |_, _, _| Ok(()))? else {
        return Ok(Estimate { sizes: vec![f64::INFINITY; bands], standard_error: None });
    };
    // Of every source: what it becomes in all later bounces, and all together.
    let later: Vec<Vec<f64>> =
        arriving.iter().map(|h| h.iter().zip(reflectance).map(|(h, rho)| rho * h).collect()).collect();
    let sum = |(source, later): (&Vec<f64>, &Vec<f64>)| source.iter().zip(later).map(|(s, l)| s + l).collect();
    let errors: Vec<Vec<f64>> = sources.iter().zip(&later).map(sum).collect();
    let sizes: Vec<Vec<f64>> = errors.iter().map(|error| norms(system, error)).collect();
    let draws = sizes.len() - 2;
    let of_band = |b: usize| {
        let sampling = (sizes[2..].iter().map(|size| size[b] * size[b]).sum::<f64>() / draws.max(1) as f64).sqrt();
        (sizes[0][b] + sizes[1][b]).hypot(sampling)
    };
    let sizes_of_bands: Vec<f64> = (0..bands).map(of_band).collect();
    let standard_error = (draws > 0).then(|| {
        // The first bounce is known patch by patch; what later ones add is smooth, and known as a mean.
        let later: Vec<Vec<f64>> = later[2..].iter().map(|later| norms(system, later)).collect();
        let area: f64 = form_factors.areas().map_or(form_factors.len() as f64, |areas| areas.iter().sum());
        let mean = |b: usize| (later.iter().map(|x| x[b] * x[b]).sum::<f64>() / (draws as f64 * area)).sqrt();
        let later: Vec<f64> = (0..bands).map(mean).collect();
        let first = form_factors.standard_error(radiosity, bands).unwrap_or_default();
        let both = first.iter().zip(reflectance).enumerate();
        // Where nothing is reflected, no error of F matters.
        both.map(|(k, (h, rho))| if *rho > 0.0 { (rho * h).hypot(later[k % bands]) } else { 0.0 }).collect()
    });
    Ok(Estimate { sizes: sizes_of_bands, standard_error })
}
