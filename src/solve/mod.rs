//! Solvers of the radiosity equation B = E + rho F B. They see an operator, E and rho: no geometry, no rays.
//!
//! | method | file | one step is | B after step k |
//! |---|---|---|---|
//! | `direct` | [`direct`] | LU of I - rho F | the solution |
//! | `jacobi` | [`jacobi`] | one bounce of all the light | light after k bounces |
//! | `gauss_seidel` | [`gauss_seidel`] | every patch gathers once, in turn | |
//! | `southwell` | [`southwell`] | the brightest patch shoots | |
//! | `overshooting` | [`southwell`] | the same, with what is going to arrive | |
//! | `gmres` | [`gmres`] | one Krylov vector | least residual in k dimensions |
//!
//! The residual r = E + rho F B - B of a radiosity B is the *unshot* radiosity: light that has arrived but has not been
//! sent on. Every method reports it after every step, and stops when in each band
//!
//!   ||r|| / ||E|| <= tolerance,   ||x||^2 = sum over i of A_i x_i^2   (A = 1 where areas are unknown).
//!
//! How far B is from the solution is another question: see [`estimate`]. Many states of light at once: [`states`]. What a
//! number read off the solution owes to each patch: [`adjoint`].

pub mod adjoint;
pub mod direct;
mod estimate;
pub mod gauss_seidel;
pub mod gmres;
pub mod jacobi;
mod propagate;
mod run;
pub mod southwell;
pub mod states;

pub(crate) use propagate::propagated;
pub use run::Run;

use crate::assembly::FormFactors;
use crate::error::{Error, Result};

/// A radiosity equation: B = E + rho F B, in all bands at once.
#[derive(Clone, Copy)]
pub struct System<'a> {
    /// F.
    pub form_factors: &'a dyn FormFactors,
    /// E, n x b, W/m^2.
    pub emission: &'a [f64],
    /// rho, n x b, in [0, 1].
    pub reflectance: &'a [f64],
    /// Number of bands b.
    pub bands: usize,
}

/// The solvers, by their public names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// LU factorisation.
    Direct,
    /// Jacobi iteration: bounce by bounce.
    Jacobi,
    /// Gauss-Seidel: gathering.
    GaussSeidel,
    /// Southwell relaxation: progressive refinement, shooting.
    #[doc(alias = "progressive")]
    #[doc(alias = "shooting")]
    Southwell,
    /// Southwell relaxation that shoots ahead of what arrives.
    Overshooting,
    /// Generalised minimal residual.
    Gmres,
}

/// Every method with its public name.
pub const METHODS: [(&str, Method); 6] = [
    ("direct", Method::Direct),
    ("jacobi", Method::Jacobi),
    ("gauss_seidel", Method::GaussSeidel),
    ("southwell", Method::Southwell),
    ("overshooting", Method::Overshooting),
    ("gmres", Method::Gmres),
];

impl std::str::FromStr for Method {
    type Err = Error;

    fn from_str(name: &str) -> Result<Method> {
        METHODS.iter().find(|(known, _)| *known == name).map(|(_, method)| *method).ok_or_else(|| {
            let names: Vec<_> = METHODS.iter().map(|(known, _)| format!("\"{known}\"")).collect();
            Error::Invalid(format!("unknown method \"{name}\"; the solvers are {}", names.join(", ")))
        })
    }
}

impl Method {
    /// The public name.
    pub fn name(self) -> &'static str {
        METHODS.iter().find(|(_, method)| *method == self).map_or("", |(name, _)| *name)
    }
}

/// When to stop.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Relative residual to reach.
    pub tolerance: f64,
    /// Steps allowed; `None` for the method's own limit.
    pub max_iterations: Option<usize>,
    /// Bytes that may be used.
    pub memory: u64,
}

/// One entry of a solver's history.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Relative residual ||r|| / ||E||, the largest over the bands.
    pub residual: f64,
    /// Power that has not been sent on, sum over i of A_i |r_i|, per band, W.
    pub unshot: Vec<f64>,
}

/// Sees every step: the radiosity so far and what is unshot of it, n x b each. An error stops the solver.
pub type Observer<'a> = dyn FnMut(&Step, &[f64], &[f64]) -> Result<()> + Send + 'a;

/// A solution of the discrete equation, or what was reached of it.
#[derive(Debug, Clone)]
pub struct Solved {
    /// B, n x b, W/m^2.
    pub radiosity: Vec<f64>,
    /// H = F B, n x b, W/m^2.
    pub irradiance: Vec<f64>,
    /// Standard error of B from the sampling of F, n x b; `None` when F was not sampled.
    pub standard_error: Option<Vec<f64>>,
    /// One entry a step.
    pub history: Vec<Step>,
    /// Relative residual reached.
    pub residual: f64,
    /// Why the tolerance was not met; `None` when it was.
    pub failure: Option<String>,
    /// Estimated distance to the solution with exact F on the same patches, relative to ||B - E||, the largest over the
    /// bands.
    pub error_estimate: f64,
    /// How far any patch can be from the solution with this very F at most, W/m^2, one a band:
    ///
    ///   |B_i - B*_i|  <=  max over j of |r_j|  /  (1 - max over j of rho_j times row sum j)
    ///
    /// since (I - rho F)^-1 = 1 + rho F + (rho F)^2 + ... and no row of rho F sums to more (Neumann's series; F >= 0). Infinite
    /// where a row reflects all that it gathers.
    pub bound: Vec<f64>,
    /// Where the power went; `None` without areas.
    pub audit: Option<Audit>,
}

/// The energy audit, W per band: emitted = absorbed + left + unshot, to rounding.
#[derive(Debug, Clone)]
pub struct Audit {
    /// sum A E.
    pub emitted: Vec<f64>,
    /// sum A (1 - rho) H.
    pub absorbed: Vec<f64>,
    /// sum A B (1 - row sum): what leaves the scene.
    pub left: Vec<f64>,
    /// sum A r: what the iteration had not yet sent on.
    pub unshot: Vec<f64>,
}

/// Solves a system. Steps that run out are no error: the result holds what was reached, and why it is not more.
///
/// # Errors
/// [`Error::Invalid`] for shapes and values out of range or a system without finite solution, [`Error::Memory`] for a
/// matrix too large to factor, [`Error::Interrupted`].
pub fn solve(system: &System, method: Method, options: &Options, observe: &mut Observer) -> Result<Solved> {
    validate(system, options)?;
    let mut run = Run::new(system, method, options, observe);
    let radiosity = iterate(system, method, options, &mut run)?;
    run.end(radiosity)
}

/// The radiosity that a method comes to.
fn iterate(system: &System, method: Method, options: &Options, run: &mut Run) -> Result<Vec<f64>> {
    match method {
        Method::Direct => direct::solve(system, options, run),
        Method::Jacobi => jacobi::solve(system, run),
        Method::GaussSeidel => gauss_seidel::solve(system, run),
        Method::Southwell => southwell::solve(system, run, false),
        Method::Overshooting => southwell::solve(system, run, true),
        Method::Gmres => gmres::solve(system, system.emission.to_vec(), run).map(|(radiosity, _)| radiosity),
    }
}

/// Solves a system by GMRES from a radiosity that is near: that of other materials or lamps.
///
/// # Errors
/// Those of [`solve`].
pub fn solve_from(system: &System, start: &[f64], options: &Options, observe: &mut Observer) -> Result<Solved> {
    validate(system, options)?;
    check_vector("the radiosity to start from", start, system.form_factors.len(), system.bands)?;
    let mut run = Run::new(system, Method::Gmres, options, observe);
    let (radiosity, _) = gmres::solve(system, start.to_vec(), &mut run)?;
    run.end(radiosity)
}

/// Refuses what is not n x b finite numbers.
fn check_vector(name: &str, values: &[f64], n: usize, bands: usize) -> Result<()> {
    if values.len() != n * bands {
        let expected = n * bands;
        return Err(Error::Invalid(format!(
            "{name} has {} values; {n} patches of {bands} bands need {expected}",
            values.len()
        )));
    }
    let bad = values.iter().enumerate().filter(|(_, v)| !v.is_finite()).take(8);
    Error::from_problems(
        bad.map(|(k, v)| format!("patch {}: {name} is {v}, not finite (band {})", k / bands, k % bands)).collect(),
    )
}

/// What is wrong with n x b numbers that must lie in [0, limit], and be finite.
fn out_of_range(name: &str, values: &[f64], n: usize, bands: usize, limit: f64) -> Vec<String> {
    if values.len() != n * bands {
        let expected = n * bands;
        return vec![format!("{name} has {} values; {n} patches of {bands} bands need {expected}", values.len())];
    }
    let range = if limit == f64::MAX { "[0, inf)".to_string() } else { format!("[0, {limit}]") };
    let bad = values.iter().enumerate().filter(|(_, v)| !(**v >= 0.0 && **v <= limit)).take(8);
    bad.map(|(k, v)| format!("patch {}: {name} {v} is outside {range} (band {})", k / bands, k % bands)).collect()
}

fn validate(system: &System, options: &Options) -> Result<()> {
    let System { form_factors, emission, reflectance, bands } = *system;
    let n = form_factors.len();
    let mut problems = Vec::new();
    if n == 0 {
        problems.push("the form-factor matrix is empty".to_string());
    }
    if bands == 0 {
        problems.push("the system has no bands; at least 1 is needed".to_string());
    }
    if !(options.tolerance > 0.0 && options.tolerance < 1.0) {
        problems.push(format!("tolerance {} is outside (0, 1)", options.tolerance));
    }
    if options.max_iterations == Some(0) {
        problems.push("max_iterations 0 is below 1".to_string());
    }
    for (name, values, limit) in [("emission", emission, f64::MAX), ("reflectance", reflectance, 1.0)] {
        problems.extend(out_of_range(name, values, n, bands, limit));
    }
    Error::from_problems(problems)?;
    // Without a loss anywhere the light never dies: rho F has the eigenvalue 1.
    let row_sums = form_factors.row_sums();
    for band in 0..bands {
        let slack = 1e-9 + form_factors.kernel_error();
        let lossless = |(i, sum): (usize, &f64)| reflectance[i * bands + band] == 1.0 && *sum > 1.0 - slack;
        if row_sums.iter().enumerate().all(lossless) {
            return Err(without_loss(band));
        }
    }
    Ok(())
}

/// The error of a band in which light never dies.
pub(crate) fn without_loss(band: usize) -> Error {
    Error::Invalid(format!(
        "every patch has reflectance 1 in band {band} and no light leaves the scene: there is no finite solution"
    ))
}

/// The larger of two numbers; what is not a number counts as infinite.
fn worse(a: f64, b: f64) -> f64 {
    if b.is_nan() { f64::INFINITY } else { a.max(b) }
}

/// Area-weighted norms, one a band, of numbers of any size.
fn norms(system: &System, x: &[f64]) -> Vec<f64> {
    let bands = system.bands;
    let mut peaks = vec![0.0f64; bands];
    x.chunks_exact(bands)
        .for_each(|row| row.iter().zip(&mut peaks).for_each(|(x, peak)| *peak = worse(*peak, x.abs())));
    let mut sums = vec![0.0; bands];
    for (i, row) in x.chunks_exact(bands).enumerate() {
        let area = system.form_factors.areas().map_or(1.0, |areas| areas[i]);
        for b in 0..bands {
            // Divided by the largest, squares neither overflow nor vanish.
            let x = if peaks[b] > 0.0 { row[b] / peaks[b] } else { 0.0 };
            sums[b] += area * x * x;
        }
    }
    peaks.iter().zip(sums).map(|(peak, sum)| if *peak == f64::INFINITY { *peak } else { peak * sum.sqrt() }).collect()
}

/// E + rho H - B.
fn residual(system: &System, irradiance: &[f64], radiosity: &[f64]) -> Vec<f64> {
    let reflected = system.reflectance.iter().zip(irradiance).map(|(rho, h)| rho * h);
    system.emission.iter().zip(reflected).zip(radiosity).map(|((e, r), b)| e + r - b).collect()
}

/// F B.
fn irradiance(system: &System, radiosity: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; radiosity.len()];
    system.form_factors.apply(radiosity, system.bands, &mut out);
    out
}

/// See [`Solved::bound`].
fn bound(system: &System, radiosity: &[f64], unshot: &[f64]) -> Vec<f64> {
    let System { form_factors, reflectance, bands, .. } = *system;
    let row_sums = form_factors.row_sums();
    let most = |values: &[f64], b: usize| values.iter().skip(b).step_by(bands).fold(0.0f64, |m, x| worse(m, x.abs()));
    let of_band = |b: usize| {
        let returned = row_sums.iter().enumerate().fold(0.0f64, |m, (i, sum)| m.max(reflectance[i * bands + b] * sum));
        // The residual itself is a sum of n + 2 numbers that are no larger than the largest radiosity, to rounding.
        let rounding = (row_sums.len() + 2) as f64 * f64::EPSILON * most(radiosity, b);
        if returned < 1.0 { (most(unshot, b) + rounding) / (1.0 - returned) } else { f64::INFINITY }
    };
    (0..bands).map(of_band).collect()
}

fn audit(system: &System, areas: &[f64], radiosity: &[f64], irradiance: &[f64], unshot: &[f64]) -> Audit {
    let System { form_factors, emission, reflectance, bands } = *system;
    let row_sums = form_factors.row_sums();
    let total = |value: &dyn Fn(usize, usize) -> f64| {
        (0..bands).map(|b| areas.iter().enumerate().map(|(i, area)| area * value(i, i * bands + b)).sum()).collect()
    };
    Audit {
        emitted: total(&|_, k| emission[k]),
        absorbed: total(&|_, k| (1.0 - reflectance[k]) * irradiance[k]),
        left: total(&|i, k| radiosity[k] * (1.0 - row_sums[i])),
        unshot: total(&|_, k| unshot[k]),
    }
}
