//! From sums over rays to solutions, one for each scramble, and what their spread tells of the error.

use rayon::prelude::*;

use super::plan::{DECAY, Errors};
use super::transport::Tally;
use crate::assembly::Rays;
use crate::assembly::rays::Field;
use crate::direct::patches::{Direct, SCRAMBLES};
use crate::error::Result;
use crate::scene::Scene;
use crate::solve::{Audit, Observer, System, propagated};

/// Of what follows residuals through all bounces, relative: those are some per cent of the answer.
const RESIDUAL: f64 = 3e-2;
/// Numbers in the columns that are followed together.
const TOGETHER: usize = 1 << 18;

/// A mesh that stands for a scene: the scene itself, or its patches cut to pieces.
#[derive(Clone, Copy)]
pub(super) struct Mesh<'a> {
    pub(super) scene: &'a Scene,
    /// What is to be solved: its patches are those that are reported.
    pub(super) whole: &'a Scene,
    /// For each patch of the mesh the patch of the whole; `None` where they are the same.
    pub(super) parents: Option<&'a [u32]>,
}

impl Mesh<'_> {
    /// Averages over the patches of the whole of values on the mesh, `bands` numbers each.
    fn averaged(&self, values: Vec<f64>, bands: usize) -> Vec<f64> {
        let Some(parents) = self.parents else { return values };
        let mut out = vec![0.0; self.whole.len() * bands];
        for ((row, area), &p) in values.chunks_exact(bands).zip(self.scene.areas()).zip(parents) {
            let share = area / self.whole.areas()[p as usize];
            out[p as usize * bands..][..bands].iter_mut().zip(row).for_each(|(out, x)| *out += share * x);
        }
        out
    }
}

/// Solutions by scramble.
pub(super) struct Measure<'a> {
    mesh: Mesh<'a>,
    /// Patch averages of the pilot's field on the mesh.
    start: Vec<f64>,
    /// What the base adds to it, by scramble: at first the residuals, then what they become after all bounces.
    base: Vec<Vec<f64>>,
    /// The same of the probe.
    probe: Vec<Vec<f64>>,
    /// Whether a residual has no end.
    diverges: bool,
}

impl<'a> Measure<'a> {
    pub(super) fn new(mesh: Mesh<'a>, field: Option<&Field>) -> Measure<'a> {
        let start = field.map_or_else(|| vec![0.0; mesh.scene.emission().len()], Field::means);
        Measure { mesh, start, base: Vec::new(), probe: Vec::new(), diverges: false }
    }

    fn bands(&self) -> usize {
        self.mesh.scene.bands()
    }

    /// Residuals of the pilot's field by the base rays of every scramble.
    pub(super) fn residuals(&mut self, base: &Tally) -> &[Vec<f64>] {
        let residual = |s: usize| base.means(s).iter().zip(&self.start).map(|(mean, u)| mean - u).collect();
        self.base = (0..SCRAMBLES).map(residual).collect();
        &self.base
    }

    /// Follows the residuals, and those of the probe, through all bounces by the pilot's operator.
    pub(super) fn follow(&mut self, operator: &Rays, probe: &Tally, observe: &mut Observer) -> Result<()> {
        let (scene, bands) = (self.mesh.scene, self.bands());
        let rho = scene.reflectance();
        let system = System { form_factors: operator, emission: &[], reflectance: rho, bands };
        let own = std::mem::take(&mut self.base);
        let probes = (0..SCRAMBLES).filter(|_| probe.total() > 0).map(|s| probe.means(s));
        let mut residuals: Vec<Vec<f64>> = own.into_iter().chain(probes).collect();
        // Columns that go together share every ray, and take memory together.
        let together = (TOGETHER / residuals[0].len()).clamp(1, residuals.len());
        for residuals in residuals.chunks_mut(together) {
            let reflected = |r: &Vec<f64>| r.iter().zip(rho).map(|(r, rho)| r * rho).collect();
            let sources: Vec<Vec<f64>> = residuals.iter().map(reflected).collect();
            let Some(followed) = propagated(&system, &sources, RESIDUAL, observe)? else {
                self.diverges = true;
                break;
            };
            for (residual, arriving) in residuals.iter_mut().zip(followed) {
                residual.iter_mut().zip(arriving).for_each(|(r, h)| *r += h);
            }
        }
        self.probe = residuals.split_off(SCRAMBLES);
        self.base = residuals;
        Ok(())
    }

    /// How much more than its neighbours every patch of the mesh should be sampled by the base: for variances A V_i m_i^-p
    /// the best m_i is in proportion to (A V_i)^(1 / (p + 1)). Eight scrambles tell V_i roughly, hence the mean is mixed in.
    pub(super) fn shares(&self) -> Vec<f64> {
        let (scene, bands) = (self.mesh.scene, self.bands());
        let weights = weights(scene);
        let count = self.base.len() as f64;
        let variance = |k: usize| {
            let mean = self.base.iter().map(|x| x[k]).sum::<f64>() / count;
            self.base.iter().map(|x| (x[k] - mean).powi(2)).sum::<f64>() * weights[k] * weights[k]
        };
        // Bands of any size count alike.
        let of_band = |b: usize| (0..scene.len()).map(|i| scene.areas()[i] * variance(i * bands + b)).collect();
        let variances: Vec<Vec<f64>> = (0..bands).map(of_band).collect();
        let means: Vec<f64> = variances.iter().map(|v| v.iter().sum::<f64>() / v.len() as f64).collect();
        let share = |i: usize| {
            let relative = variances.iter().zip(&means).map(|(v, mean)| if *mean > 0.0 { v[i] / mean } else { 1.0 });
            let relative = relative.sum::<f64>() / bands as f64;
            (0.5 + 0.5 * relative).powf(1.0 / (DECAY + 1.0))
        };
        (0..scene.len()).map(share).collect()
    }

    /// Whether the solution is finite.
    pub(super) fn is_finite(&self) -> bool {
        !self.diverges
    }

    /// Direct irradiance of the patches of the whole, by scramble.
    fn direct(&self, direct: &Direct) -> Vec<Vec<f64>> {
        let bands = self.bands();
        let of_scramble = |s: usize| {
            let mut out = vec![0.0; self.start.len()];
            let rows = out.par_chunks_mut(bands).enumerate();
            rows.for_each(|(i, out)| direct.irradiance_of_scramble(i, s, out));
            self.mesh.averaged(out, bands)
        };
        (0..SCRAMBLES).map(of_scramble).collect()
    }

    /// The squared errors of the band with the largest.
    pub(super) fn errors(&self, direct: &Direct) -> Errors {
        let (whole, bands) = (self.mesh.whole, self.bands());
        let weights = weights(whole);
        let direct = self.direct(direct);
        let mean = self.mean_and_error(&direct, false).0;
        let average = |x: &Vec<f64>| self.mesh.averaged(x.clone(), bands);
        let kinds: [Vec<Vec<f64>>; 3] =
            [direct, self.base.iter().map(average).collect(), self.probe.iter().map(average).collect()];
        let product = |b: usize, x: &[f64], y: &[f64]| inner_product(whole, &weights, b, x, y);
        let of_band = |b: usize| {
            let light = product(b, &mean, &mean);
            let unit = if light > 0.0 { 1.0 / light } else { 0.0 };
            let spreads = kinds.each_ref().map(|solutions| Spread::new(solutions, |x, y| unit * product(b, x, y)));
            let variances = spreads.each_ref().map(|spread| spread.variance);
            Errors { variances, discretisation: spreads[2].square, doubt: spreads[2].doubt }
        };
        let size = |errors: &Errors| errors.parts(false).iter().sum::<f64>();
        let none = Errors { variances: [0.0; 3], discretisation: 0.0, doubt: 0.0 };
        (0..bands).map(of_band).max_by(|a, b| size(a).total_cmp(&size(b))).unwrap_or(none)
    }

    /// The square of what base and probe together add to the field, in units of `irradiance` squared, and the standard error of
    /// that: of the band with the largest.
    pub(super) fn distance(&self, irradiance: &[f64]) -> (f64, f64) {
        let whole = self.mesh.whole;
        let weights = weights(whole);
        let sum = |s: usize| self.base[s].iter().zip(&self.probe[s]).map(|(x, y)| x + y).collect();
        let both: Vec<Vec<f64>> = (0..self.base.len()).map(sum).collect();
        let of_band = |b: usize| {
            let light = inner_product(whole, &weights, b, irradiance, irradiance);
            let unit = if light > 0.0 { 1.0 / light } else { 0.0 };
            let spread = Spread::new(&both, |x, y| unit * inner_product(whole, &weights, b, x, y));
            (spread.square, spread.doubt)
        };
        (0..self.bands()).map(of_band).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0.0))
    }

    /// Irradiance of the patches of the whole, and its standard error.
    pub(super) fn irradiance(&self, direct: &Direct, corrected: bool) -> (Vec<f64>, Vec<f64>) {
        self.mean_and_error(&self.direct(direct), corrected)
    }

    fn mean_and_error(&self, direct: &[Vec<f64>], corrected: bool) -> (Vec<f64>, Vec<f64>) {
        let bands = self.bands();
        let solution = |s: usize| {
            let mut out = self.start.clone();
            let parts = [self.base.get(s), self.probe.get(s).filter(|_| corrected)];
            for part in parts.into_iter().flatten() {
                out.iter_mut().zip(part).for_each(|(out, x)| *out += x);
            }
            let mut out = self.mesh.averaged(out, bands);
            out.iter_mut().zip(&direct[s]).for_each(|(out, x)| *out += x);
            out
        };
        let solutions: Vec<Vec<f64>> = (0..SCRAMBLES).map(solution).collect();
        let count = SCRAMBLES as f64;
        let mean: Vec<f64> =
            (0..solutions[0].len()).map(|k| solutions.iter().map(|x| x[k]).sum::<f64>() / count).collect();
        let spread = |k: usize| solutions.iter().map(|x| (x[k] - mean[k]).powi(2)).sum::<f64>();
        let error = (0..mean.len()).map(|k| (spread(k) / (count * (count - 1.0))).sqrt()).collect();
        (mean, error)
    }

    /// Where the power goes for the irradiance H of the patches of the whole. What leaves the scene is what base rays have found
    /// to: `None` where there were none.
    pub(super) fn audit(&self, base: &Tally, irradiance: &[f64]) -> Option<Audit> {
        let (whole, bands) = (self.mesh.whole, self.bands());
        if base.total() == 0 {
            return None;
        }
        let lost = (0..self.mesh.scene.len()).map(|i| f64::from(base.lost[i]) / base.rays(i) as f64).collect();
        let lost = self.mesh.averaged(lost, 1);
        let (emission, rho) = (whole.emission(), whole.reflectance());
        let total = |value: &dyn Fn(usize, usize) -> f64| {
            let sum = |b| whole.areas().iter().enumerate().map(|(i, area)| area * value(i, i * bands + b)).sum();
            (0..bands).map(sum).collect()
        };
        Some(Audit {
            emitted: total(&|_, k| emission[k]),
            absorbed: total(&|_, k| (1.0 - rho[k]) * irradiance[k]),
            left: total(&|i, k| (emission[k] + rho[k] * irradiance[k]) * lost[i]),
            unshot: vec![0.0; bands],
        })
    }
}

/// What the error of the irradiance counts for: rho, or 1 in a band that nothing reflects.
fn weights(scene: &Scene) -> Vec<f64> {
    let bands = scene.bands();
    let rho = scene.reflectance();
    let reflects: Vec<bool> = (0..bands).map(|b| rho.iter().skip(b).step_by(bands).any(|rho| *rho > 0.0)).collect();
    rho.iter().enumerate().map(|(k, rho)| if reflects[k % bands] { *rho } else { 1.0 }).collect()
}

/// sum over i of A_i w_i^2 x_i y_i of one band.
fn inner_product(scene: &Scene, weights: &[f64], b: usize, x: &[f64], y: &[f64]) -> f64 {
    let terms = scene.areas().iter().enumerate().map(|(i, area)| (area, i * scene.bands() + b));
    terms.map(|(area, k)| area * weights[k] * weights[k] * x[k] * y[k]).sum()
}

/// What independent vectors x_s of one mean tell of it, by their inner products.
struct Spread {
    /// Of the mean of all: the sum over its components.
    variance: f64,
    /// |E x|^2, without bias.
    square: f64,
    /// The standard error of that.
    doubt: f64,
}

impl Spread {
    fn new(x: &[Vec<f64>], product: impl Fn(&[f64], &[f64]) -> f64) -> Spread {
        let count = x.len() as f64;
        if x.len() < 2 {
            return Spread { variance: 0.0, square: 0.0, doubt: 0.0 };
        }
        let own = x.iter().map(|x| product(x, x)).sum::<f64>() / count;
        let pairs = || (1..x.len()).flat_map(|s| (0..s).map(move |t| (s, t)));
        let products: Vec<f64> = pairs().map(|(s, t)| product(&x[s], &x[t])).collect();
        let number = products.len() as f64;
        let square = products.iter().sum::<f64>() / number;
        // Products of different pairs are uncorrelated where the mean is 0, which is where the doubt matters.
        let spread = products.iter().map(|p| (p - square).powi(2)).sum::<f64>() / (number - 1.0);
        Spread { variance: ((own - square) / count).max(0.0), square, doubt: (spread / number).sqrt() }
    }
}
