//! A solver at work: what all methods do after a step, and at the end.

use super::{
    Method, Observer, Options, Solved, Step, System, audit, bound, estimate, irradiance, norms, residual, worse,
};
use crate::error::Result;

/// What every method does after a step: measure, record, tell, decide.
pub struct Run<'a, 'b> {
    system: &'a System<'a>,
    method: Method,
    tolerance: f64,
    max_iterations: Option<usize>,
    observe: &'a mut Observer<'b>,
    emission_norms: Vec<f64>,
    history: Vec<Step>,
    pub(super) failure: Option<String>,
}

impl<'a, 'b> Run<'a, 'b> {
    pub(super) fn new(
        system: &'a System<'a>,
        method: Method,
        options: &Options,
        observe: &'a mut Observer<'b>,
    ) -> Run<'a, 'b> {
        Run {
            system,
            method,
            tolerance: options.tolerance,
            max_iterations: options.max_iterations,
            observe,
            emission_norms: norms(system, system.emission),
            history: Vec::new(),
            failure: None,
        }
    }

    /// What there is to know of the last radiosity.
    pub(super) fn end(self, radiosity: Vec<f64>) -> Result<Solved> {
        let (system, history, failure) = (self.system, self.history, self.failure);
        let irradiance = irradiance(system, &radiosity);
        let unshot = residual(system, &irradiance, &radiosity);
        let estimate = estimate::estimate(system, &radiosity, &irradiance, &unshot)?;
        let error_estimate = estimate.relative(&estimate::reflected(system, &radiosity));
        let bound = bound(system, &radiosity, &unshot);
        let audit = system.form_factors.areas().map(|areas| audit(system, areas, &radiosity, &irradiance, &unshot));
        Ok(Solved {
            residual: history.last().map_or(0.0, |step| step.residual),
            radiosity,
            irradiance,
            standard_error: estimate.standard_error,
            history,
            failure,
            error_estimate,
            bound,
            audit,
        })
    }

    /// The largest residual of the bands, in units of their emission.
    fn relative(&self, unshot: &[f64]) -> f64 {
        let relative = |(r, e): (f64, &f64)| if *e > 0.0 { r / e } else { r };
        norms(self.system, unshot).into_iter().zip(&self.emission_norms).map(relative).fold(0.0, worse)
    }

    /// Whether the next step would be the last if it left this.
    pub(super) fn ends_with(&self, unshot: &[f64], own_limit: usize) -> bool {
        let residual = self.relative(unshot);
        residual <= self.tolerance || !residual.is_finite() || self.history.len() + 1 >= self.limit(own_limit)
    }

    /// Steps allowed.
    fn limit(&self, own_limit: usize) -> usize {
        self.max_iterations.unwrap_or(own_limit)
    }

    /// Records a step; true when there is to be no other: the tolerance is met, or never will be.
    pub(super) fn step(&mut self, radiosity: &[f64], unshot: &[f64], own_limit: usize) -> Result<bool> {
        let System { form_factors, bands, .. } = *self.system;
        let residual = self.relative(unshot);
        let mut power = vec![0.0; bands];
        for (i, row) in unshot.chunks_exact(bands).enumerate() {
            let area = form_factors.areas().map_or(1.0, |areas| areas[i]);
            row.iter().zip(&mut power).for_each(|(r, power)| *power += area * r.abs());
        }
        let step = Step { residual, unshot: power };
        let observed = (self.observe)(&step, radiosity, unshot);
        self.history.push(step);
        observed?;
        let steps = self.history.len();
        if residual <= self.tolerance {
            return Ok(true);
        }
        let (name, tolerance) = (self.method.name(), self.tolerance);
        self.failure = if !residual.is_finite() {
            Some(format!("{name} diverged at step {steps}: the rows of F times the reflectance exceed 1"))
        } else if self.method == Method::Direct {
            Some(format!(
                "direct left a relative residual of {residual:.3e}, above the tolerance {tolerance:.3e}: the system is too \
                 close to one without finite solution for double precision"
            ))
        } else if steps >= self.limit(own_limit) {
            Some(format!(
                "{name} stopped after {steps} steps at a relative residual of {residual:.3e}, above the tolerance \
                 {tolerance:.3e}; allow more iterations or choose another method (\"direct\" takes one step)"
            ))
        } else {
            return Ok(false);
        };
        Ok(true)
    }
}
