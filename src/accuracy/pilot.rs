//! The pilot: an operator T0 of few rays, and the field u0 = T0 (D + u0).

use super::options::Options;
use super::stages::Stages;
use super::transport::Transport;
use crate::assembly::rays::Field;
use crate::assembly::{Rays, Trips};
use crate::error::Result;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::solve::{Step, System, propagated, without_loss};

/// Of the solve, relative: what it leaves is measured with the other errors of the field.
const RESIDUAL: f64 = 1e-3;

/// What a solve starts from.
pub(super) struct Pilot {
    /// The operator T0 for radiosity that is constant on patches; `None` where nothing is reflected.
    pub(super) operator: Option<Rays>,
    /// The field u0; `None` also where it has no end.
    pub(super) field: Option<Field>,
    /// All the light over that of the first bounce, the largest of the bands.
    pub(super) amplification: f64,
    /// Rays and segments cast.
    pub(super) rays: u64,
    pub(super) segments: u64,
    pub(super) history: Vec<Step>,
}

/// Rays of the pilot from each patch, if nothing speaks against it: noise of its field is an error of the second order only, and
/// so may be some times the tolerance.
pub(super) fn pilot_rays(tolerance: f64) -> usize {
    ((0.6 / tolerance).clamp(16.0, 1024.0) as usize).next_power_of_two()
}

impl Pilot {
    /// With `count` rays from each patch.
    pub(super) fn new(
        scene: &Scene,
        transport: &Transport,
        options: &Options,
        count: usize,
        stages: &mut Stages,
        progress: &Progress,
    ) -> Result<Pilot> {
        let history = Vec::new();
        let mut pilot = Pilot { operator: None, field: None, amplification: 1.0, rays: 0, segments: 0, history };
        if scene.reflectance().iter().all(|rho| *rho == 0.0) {
            return Ok(pilot);
        }
        let (trips, source, segments) = stages.time("pilot", || transport.pilot(options.order, count, progress))?;
        pilot.rays = (scene.len() * count) as u64;
        pilot.segments = segments;
        refuse_lossless(scene, trips.rays())?;
        stages.time("bounces", || pilot.follow(scene, &trips, source, progress))?;
        pilot.operator = Some(trips.into_rays());
        Ok(pilot)
    }

    /// The field from its source T0 D. The bounces are followed with constant radiosity on every patch, and the last of them
    /// brings what is linear.
    fn follow(&mut self, scene: &Scene, trips: &Trips, mut source: Field, progress: &Progress) -> Result<()> {
        let (bands, rho) = (scene.bands(), scene.reflectance());
        let first: Vec<f64> = source.means().iter().zip(rho).map(|(h, rho)| rho * h).collect();
        let system = System { form_factors: trips.rays(), emission: &[], reflectance: rho, bands };
        let mut observe = |step: &Step, _: &[f64], _: &[f64]| {
            self.history.push(step.clone());
            progress.advance(0)
        };
        let Some(arriving) = propagated(&system, std::slice::from_ref(&first), RESIDUAL, &mut observe)? else {
            return Ok(());
        };
        let light: Vec<f64> =
            first.iter().zip(&arriving[0]).zip(rho).map(|((first, h), rho)| first + rho * h).collect();
        let power = |x: &[f64], b: usize| -> f64 {
            scene.areas().iter().zip(x.iter().skip(b).step_by(bands)).map(|(area, x)| area * x).sum()
        };
        let ratio = |b: usize| if power(&first, b) > 0.0 { power(&light, b) / power(&first, b) } else { 1.0 };
        self.amplification = (0..bands).map(ratio).fold(1.0, f64::max);
        trips.add_gathered(&light, &mut source);
        self.field = Some(source);
        Ok(())
    }
}

/// Without a loss anywhere the light never dies.
fn refuse_lossless(scene: &Scene, operator: &Rays) -> Result<()> {
    let bands = scene.bands();
    for band in 0..bands {
        if operator.is_closed() && (0..scene.len()).all(|i| scene.absorptance(i, band) == 0.0) {
            return Err(without_loss(band));
        }
    }
    Ok(())
}
