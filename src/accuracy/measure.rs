//! From sums over rays to solutions, one for each scramble, and what their spread tells of the error.

use std::borrow::Cow;

use rayon::prelude::*;

use super::pilot::Pilot;
use super::plan::{DECAY, Errors};
use super::statistics::{Unit, Weight, mean_and_error, spread_of_square, square_of_mean};
use super::transport::Tally;
use crate::assembly::Rays;
use crate::assembly::rays::Field;
use crate::direct::SCRAMBLES;
use crate::direct::patches::Direct;
use crate::error::Result;
use crate::scene::Scene;
use crate::solve::{Audit, Observer, System, propagated};

/// What following residuals through all bounces may leave, in tolerances, and the least and most of its relative residual.
const RESIDUAL: f64 = 0.1;
const RESIDUALS: [f64; 2] = [1e-6, 0.03];
/// Numbers in the columns that are followed together.
const TOGETHER: usize = 1 << 18;
/// Vectors of them that are alive at a time: those of Krylov, the sums on the way, sources and results.
const VECTORS: usize = 30;

/// Bytes that following the residuals takes for a while.
pub(super) fn bytes_to_follow(n: usize, bands: usize) -> u64 {
    let column = n * bands;
    let together = (2 * SCRAMBLES * column).min(TOGETHER.max(column));
    (VECTORS * together * size_of::<f64>()) as u64
}

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
    fn averaged<'a>(&self, values: impl Into<Cow<'a, [f64]>>, bands: usize) -> Cow<'a, [f64]> {
        let values = values.into();
        let Some(parents) = self.parents else { return values };
        let mut out = vec![0.0; self.whole.len() * bands];
        for ((row, area), &p) in values.chunks_exact(bands).zip(self.scene.areas()).zip(parents) {
            let share = area / self.whole.areas()[p as usize];
            out[p as usize * bands..][..bands].iter_mut().zip(row).for_each(|(out, x)| *out += share * x);
        }
        out.into()
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
    /// What the pilot's operator leaves, as either half of the scrambles has it.
    pilot: Vec<Vec<f64>>,
    /// Whether either half of the pilot's rays knows of an end; else nothing is known of what its operator leaves.
    halves_end: bool,
    /// Whether a residual has no end.
    diverges: bool,
}

impl<'a> Measure<'a> {
    pub(super) fn new(mesh: Mesh<'a>, field: Option<&Field>) -> Measure<'a> {
        let start = field.map_or_else(|| vec![0.0; mesh.scene.emission().len()], Field::means);
        Measure {
            mesh,
            start,
            base: Vec::new(),
            probe: Vec::new(),
            pilot: Vec::new(),
            halves_end: true,
            diverges: false,
        }
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

    /// Adds to the residual of every scramble by how much its own direct light is off that of all, on which the field rests.
    pub(super) fn add_spread_of_direct(&mut self, direct: &Direct) {
        let bands = self.bands();
        for (s, base) in self.base.iter_mut().enumerate() {
            base.par_chunks_mut(bands).enumerate().for_each(|(i, base)| {
                let (mut own, mut all) = (vec![0.0; bands], vec![0.0; bands]);
                direct.irradiance_of_scramble(i, s, &mut own);
                direct.irradiance(i, &mut all);
                base.iter_mut().zip(own.iter().zip(all)).for_each(|(base, (own, all))| *base += own - all);
            });
        }
    }

    /// The relative residual at which following ends: a residual r becomes A r at most, with A the amplification of light.
    fn end(&self, pilot: &Pilot, tolerance: f64) -> f64 {
        let share = |b: usize| {
            let largest = self.base.iter().map(|r| self.norm(r, b)).fold(0.0, f64::max);
            let share = self.norm(&self.start, b) / (largest * pilot.amplification);
            if share.is_finite() { share } else { 1.0 }
        };
        let share = (0..self.bands()).map(share).fold(1.0, f64::min);
        let most = (RESIDUALS[1] / pilot.amplification.sqrt()).max(RESIDUALS[0]);
        (RESIDUAL * tolerance * share).clamp(RESIDUALS[0], most)
    }

    /// What residuals r become, column by column: r + F (I - rho F)^-1 rho r. Whether that has an end.
    fn become_light(
        &self,
        operator: &Rays,
        residuals: &mut [Vec<f64>],
        tolerance: f64,
        observe: &mut Observer,
    ) -> Result<bool> {
        let rho = self.mesh.scene.reflectance();
        let system = System { form_factors: operator, emission: &[], reflectance: rho, bands: self.bands() };
        // Columns that go together share every ray, and take memory together.
        let together = (TOGETHER / residuals[0].len()).clamp(1, residuals.len());
        for residuals in residuals.chunks_mut(together) {
            let reflected = |r: &Vec<f64>| r.iter().zip(rho).map(|(r, rho)| r * rho).collect();
            let sources: Vec<Vec<f64>> = residuals.iter().map(reflected).collect();
            let Some(followed) = propagated(&system, &sources, tolerance, observe)? else { return Ok(false) };
            for (residual, arriving) in residuals.iter_mut().zip(followed) {
                residual.iter_mut().zip(arriving).for_each(|(r, h)| *r += h);
            }
        }
        Ok(true)
    }

    /// Measures what the pilot's operator leaves, before the residuals are followed.
    ///
    /// Following r by (I - T0)^-1 in place of (I - T)^-1 is a step of Newton's method with an approximate inverse. It leaves
    /// (I - T0)^-1 (T - T0) e with e = u - u0, which all scrambles share, and which none of their rays lowers. Where much light
    /// comes back again and again that is no small thing. It is measured by following the mean residual with either half
    /// of the pilot's rays, for two halves of the scrambles, the product of which is free of their noise.
    pub(super) fn follow_by_halves(&mut self, pilot: &Pilot, tolerance: f64, observe: &mut Observer) -> Result<()> {
        let Some(operator) = &pilot.operator else { return Ok(()) };
        let tolerance = self.end(pilot, tolerance);
        let half = |which: usize| {
            let part = &self.base[which * SCRAMBLES / 2..][..SCRAMBLES / 2];
            (0..self.start.len()).map(|k| part.iter().map(|r| r[k]).sum::<f64>() / part.len() as f64).collect()
        };
        let means: Vec<Vec<f64>> = vec![half(0), half(1)];
        let mut by_half = [means.clone(), means];
        for (which, means) in by_half.iter_mut().enumerate() {
            // All that is lost may be in one half of the rays.
            self.halves_end &= self.become_light(&operator.half(which), means, tolerance, observe)?;
        }
        let [first, second] = &by_half;
        let off = |(a, b): (&Vec<f64>, &Vec<f64>)| a.iter().zip(b).map(|(a, b)| 0.5 * (a - b)).collect();
        self.pilot = first.iter().zip(second).map(off).collect();
        Ok(())
    }

    /// Follows the residuals, and those of the probe, through all bounces by the pilot's operator.
    pub(super) fn follow(
        &mut self,
        pilot: &Pilot,
        probe: &Tally,
        tolerance: f64,
        observe: &mut Observer,
    ) -> Result<()> {
        let Some(operator) = &pilot.operator else { return Ok(()) };
        let tolerance = self.end(pilot, tolerance);
        let probes = (0..SCRAMBLES).filter(|_| probe.total() > 0).map(|s| probe.means(s));
        let mut residuals: Vec<Vec<f64>> = std::mem::take(&mut self.base).into_iter().chain(probes).collect();
        self.diverges = !self.become_light(operator, &mut residuals, tolerance, observe)?;
        self.probe = residuals.split_off(SCRAMBLES);
        self.base = residuals;
        Ok(())
    }

    /// In a closed scene all that is emitted is absorbed: sum A (E + H0) = sum A (1 - rho) (D + u), whatever the rays. What bounced is
    /// scaled until this holds, in every scramble for itself: of an error that all patches share, which a white room returns
    /// 1 / (1 - rho) times, nothing is left. So is nothing of it in what is known of the other errors. Only where most is absorbed
    /// after a bounce: in a dark room what is left for the bounced light has the error of the direct light, many times over.
    pub(super) fn balance(&mut self, base: &Tally, direct: &Direct) {
        if self.base.is_empty() || base.lost.iter().any(|lost| *lost > 0) {
            return;
        }
        let (scene, bands) = (self.mesh.scene, self.bands());
        let areas = scene.areas();
        let absorbed = |x: &[f64], b: usize| -> f64 {
            areas.iter().enumerate().map(|(i, area)| area * scene.absorptance(i, b) * x[i * bands + b]).sum()
        };
        // Of patches and lights: E + H0 of every patch, as a scramble has it, or as all have it.
        let emitted = |s: Option<usize>| {
            let mut sums = vec![0.0; bands];
            for (i, area) in areas.iter().enumerate() {
                let mut sent = scene.emission()[i * bands..][..bands].to_vec();
                direct.add_lights(i, s, &mut sent);
                sums.iter_mut().zip(sent).for_each(|(sum, e)| *sum += area * e);
            }
            sums
        };
        let all = emitted(None);
        let balances: Vec<bool> = (0..bands).map(|b| absorbed(&self.start, b) >= 0.5 * all[b]).collect();
        let mut mean = vec![0.0; self.start.len()];
        for (s, base) in self.base.iter_mut().enumerate() {
            let mut arriving = vec![0.0; mean.len()];
            let rows = arriving.par_chunks_mut(bands).enumerate();
            rows.for_each(|(i, out)| direct.irradiance_of_scramble(i, s, out));
            base.iter_mut().zip(&self.start).for_each(|(x, start)| *x += start);
            let emitted = emitted(Some(s));
            for b in 0..bands {
                let (wanted, found) = (emitted[b] - absorbed(&arriving, b), absorbed(base, b));
                let scale = if balances[b] && found > 0.0 && wanted > 0.0 { wanted / found } else { 1.0 };
                base.iter_mut().skip(b).step_by(bands).for_each(|x| *x *= scale);
            }
            mean.iter_mut().zip(base.iter()).for_each(|(mean, x)| *mean += x / SCRAMBLES as f64);
            base.iter_mut().zip(&self.start).for_each(|(x, start)| *x -= start);
        }
        for error in self.probe.iter_mut().chain(&mut self.pilot) {
            for b in (0..bands).filter(|b| balances[*b]) {
                let all = absorbed(&mean, b);
                let share = if all > 0.0 { absorbed(error, b) / all } else { 0.0 };
                let numbers = error.iter_mut().zip(&mean).skip(b).step_by(bands);
                numbers.for_each(|(x, mean)| *x -= share * mean);
            }
        }
    }

    /// The square root of the area-weighted sum of squares of one band.
    fn norm(&self, x: &[f64], b: usize) -> f64 {
        let band = x.iter().skip(b).step_by(self.bands()).zip(self.mesh.scene.areas());
        band.fold(0.0f64, |sum, (x, area)| sum.hypot(area.sqrt() * x))
    }

    /// How much more than its neighbours every patch of the mesh should be sampled by the base: for variances A V_i m_i^-p
    /// the best m_i is in proportion to (A V_i)^(1 / (p + 1)). Four scrambles tell V_i roughly, hence the mean is mixed in.
    pub(super) fn shares(&self) -> Vec<f64> {
        let (scene, bands) = (self.mesh.scene, self.bands());
        if self.base.is_empty() {
            return Vec::new();
        }
        let weight = Weight::new(scene);
        let error = mean_and_error(|s| self.base[s].as_slice().into()).1;
        // Bands of any size count alike.
        let of_band = |b: usize| {
            let unit = error.iter().skip(b).step_by(bands).fold(f64::MIN_POSITIVE, |peak, x| peak.max(*x));
            (b..error.len()).step_by(bands).map(|k| weight.of(k) * (error[k] / unit).powi(2)).collect()
        };
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

    /// Direct irradiance of the patches of the whole by scramble `s`.
    fn direct(&self, direct: &Direct, s: usize) -> Cow<'static, [f64]> {
        let bands = self.bands();
        let mut out = vec![0.0; self.start.len()];
        let rows = out.par_chunks_mut(bands).enumerate();
        rows.for_each(|(i, out)| direct.irradiance_of_scramble(i, s, out));
        self.mesh.averaged(out, bands)
    }

    /// Irradiance of the patches of the whole by scramble `s`.
    fn solution(&self, direct: &Direct, s: usize, corrected: bool) -> Cow<'static, [f64]> {
        let mut out = self.start.clone();
        let parts = [self.base.get(s), self.probe.get(s).filter(|_| corrected)];
        for part in parts.into_iter().flatten() {
            out.iter_mut().zip(part).for_each(|(out, x)| *out += x);
        }
        let mut out = self.mesh.averaged(out, self.bands()).into_owned();
        out.iter_mut().zip(self.direct(direct, s).iter()).for_each(|(out, x)| *out += x);
        out.into()
    }

    /// The squared errors of the band with the largest.
    pub(super) fn errors(&self, direct: &Direct) -> Errors {
        let bands = self.bands();
        let weight = Weight::new(self.mesh.whole);
        let light = mean_and_error(|s| self.solution(direct, s, false)).0;
        let units: Vec<Unit> = (0..bands).map(|b| Unit::new(&weight, b, &light)).collect();
        let square = |error: Vec<f64>| -> Vec<f64> { units.iter().map(|unit| unit.product(&error, &error)).collect() };
        let variance = |by_scramble: &[Vec<f64>]| match by_scramble {
            [] => vec![0.0; bands],
            _ => square(mean_and_error(|s| self.mesh.averaged(&by_scramble[s], bands)).1),
        };
        let variances =
            [square(mean_and_error(|s| self.direct(direct, s)).1), variance(&self.base), variance(&self.probe)];
        let spread = |corrected: bool| -> Vec<f64> {
            let mut solutions: Vec<_> = (0..SCRAMBLES).map(|s| self.solution(direct, s, corrected)).collect();
            let mean = mean_and_error(|s| solutions[s].as_ref().into()).0;
            for solution in &mut solutions {
                solution.to_mut().iter_mut().zip(&mean).for_each(|(x, mean)| *x -= mean);
            }
            units.iter().map(|unit| spread_of_square(&solutions, |x, y| unit.product(x, y))).collect()
        };
        let spreads = [spread(false), spread(true)];
        let probe: Vec<Cow<[f64]>> = self.probe.iter().map(|x| self.mesh.averaged(x, bands)).collect();
        let pilot: Vec<Cow<[f64]>> = self.pilot.iter().map(|x| self.mesh.averaged(x, bands)).collect();
        let of_band = |b: usize| {
            let (discretisation, doubt) = square_of_mean(&probe, |x, y| units[b].product(x, y));
            let (variances, spreads) = (variances.each_ref().map(|x| x[b]), spreads.each_ref().map(|x| x[b]));
            // Half the difference of halves has the variance of half the rays less that of all.
            let pilot = match pilot.as_slice() {
                _ if !self.halves_end => f64::INFINITY,
                [first, second] => units[b].product(first, second).max(0.0) / (2f64.powf(DECAY) - 1.0),
                _ => 0.0,
            };
            Errors { variances, spreads, pilot, discretisation, doubt }
        };
        let none = Errors { variances: [0.0; 3], spreads: [0.0; 2], pilot: 0.0, discretisation: 0.0, doubt: 0.0 };
        (0..bands).map(of_band).max_by(|a, b| a.at_worst().total_cmp(&b.at_worst())).unwrap_or(none)
    }

    /// The square of what base and probe together add to the field, in units of `irradiance` squared, and the standard error of
    /// that: of the band with the largest.
    pub(super) fn distance(&self, irradiance: &[f64]) -> (f64, f64) {
        let weight = Weight::new(self.mesh.whole);
        // Where nothing is reflected there is no probe.
        let sum = |s: usize| match self.probe.get(s) {
            Some(probe) => self.base[s].iter().zip(probe).map(|(x, y)| x + y).collect(),
            None => self.base[s].as_slice().into(),
        };
        let both: Vec<Cow<[f64]>> = (0..self.base.len()).map(sum).collect();
        let of_band = |b: usize| {
            let unit = Unit::new(&weight, b, irradiance);
            square_of_mean(&both, |x, y| unit.product(x, y))
        };
        (0..self.bands()).map(of_band).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0.0))
    }

    /// Irradiance of the patches of the whole, and its standard error.
    pub(super) fn irradiance(&self, direct: &Direct, corrected: bool) -> (Vec<f64>, Vec<f64>) {
        mean_and_error(|s| self.solution(direct, s, corrected))
    }

    /// Where the power goes for the irradiance H of the patches of the whole. What leaves the scene is what base rays have found
    /// to: `None` where there were none.
    pub(super) fn audit(&self, base: &Tally, direct: &Direct, irradiance: &[f64]) -> Option<Audit> {
        let (whole, bands) = (self.mesh.whole, self.bands());
        if base.total() == 0 {
            return None;
        }
        let share = |i: usize| f64::from(base.lost[i]) / base.rays(i) as f64;
        let lost = self.mesh.averaged((0..self.mesh.scene.len()).map(share).collect::<Vec<f64>>(), 1);
        let (emission, rho) = (whole.emission(), whole.reflectance());
        let mut arriving = vec![0.0; self.start.len()];
        arriving.chunks_exact_mut(bands).enumerate().for_each(|(i, out)| direct.add_lights(i, None, out));
        let arriving = self.mesh.averaged(arriving, bands);
        let total = |value: &dyn Fn(usize, usize) -> f64| {
            let sum = |b| whole.areas().iter().enumerate().map(|(i, area)| area * value(i, i * bands + b)).sum();
            (0..bands).map(sum).collect()
        };
        Some(Audit {
            emitted: total(&|_, k| emission[k] + arriving[k]),
            absorbed: total(&|i, k| whole.absorptance(i, k % bands) * irradiance[k]),
            left: total(&|i, k| (emission[k] + rho[k] * irradiance[k]) * lost[i]),
            unshot: vec![0.0; bands],
        })
    }
}
