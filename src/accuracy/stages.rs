//! What took how long.

use std::time::Instant;

/// Seconds by stage, in the order of their first appearance.
#[derive(Default, Clone)]
pub(super) struct Stages(pub(super) Vec<(&'static str, f64)>);

impl Stages {
    pub(super) fn time<T>(&mut self, stage: &'static str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let out = work();
        let seconds = start.elapsed().as_secs_f64();
        match self.0.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, sum)) => *sum += seconds,
            None => self.0.push((stage, seconds)),
        }
        out
    }

    /// Of some stages together, since an earlier state.
    pub(super) fn since(&self, before: &Stages, stages: &[&str]) -> f64 {
        let sum =
            |all: &Stages| -> f64 { all.0.iter().filter(|(name, _)| stages.contains(name)).map(|(_, s)| s).sum() };
        sum(self) - sum(before)
    }
}
