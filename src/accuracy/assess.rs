//! The true error of a solution that came from elsewhere, by rays.
//!
//! Its irradiance H, constant on every patch, takes the place of the pilot's field: what base and probe find that it lacks,
//! followed through all bounces, is its error, sampling and discretisation together. The square of that is estimated from
//! products of independent scrambles, so that it may be far below the noise of a patch; without bias but for what the pilot's
//! operator leaves, a small part of the error.

use super::measure::{Measure, Mesh};
use super::options::Options;
use super::pilot::{Pilot, pilot_rays};
use super::solver::refuse_lack_of_memory;
use super::stages::Stages;
use super::transport::{FIRST_SEGMENTS, Ground, Tally, Transport};
use crate::assembly::Order;
use crate::assembly::rays::Field;
use crate::direct::{Lights, SCRAMBLES};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::solve::Step;

/// Rounds, each of four times the rays of the one before.
const ROUNDS: usize = 6;
/// The squared error is known well enough when its standard error is this share of it, or of the tolerance's square.
const DOUBT: f64 = 0.15;

/// What is known of the error.
#[derive(Debug, Clone, Copy)]
pub struct Assessment {
    /// Relative error of B - E against the continuous solution, the worst band.
    pub error: f64,
    /// Rays cast.
    pub rays: u64,
}

/// Assesses the irradiance of a scene's patches, n x b, under some lights beside its own.
///
/// # Errors
/// [`Error::Invalid`] for options or values out of range, [`Error::Memory`], [`Error::Interrupted`].
pub fn assess(
    scene: &Scene,
    lights: &Lights,
    irradiance: &[f64],
    options: &Options,
    progress: &Progress,
) -> Result<Assessment> {
    options.check(scene, lights)?;
    let (n, bands, seed) = (scene.len(), scene.bands(), options.seed);
    if irradiance.len() != n * bands || irradiance.iter().any(|h| !h.is_finite()) {
        return Err(Error::Invalid(format!("irradiance must hold {n} x {bands} finite numbers")));
    }
    refuse_lack_of_memory(n, bands, 0, options)?;
    let ground = Ground::new(scene, lights)?;
    let mut transport = Transport::new(scene, &ground, 1e-4, seed, progress)?;
    refuse_lack_of_memory(n, bands, transport.direct.nbytes(), options)?;
    let constant = Options { order: Order::Constant, ..*options };
    let count = pilot_rays(options.tolerance);
    let pilot = Pilot::new(scene, &transport, &constant, count, &mut Stages::default(), progress)?;
    let mut sizes = [FIRST_SEGMENTS, (count / SCRAMBLES).max(2) as u32, (count / SCRAMBLES / 2).max(1) as u32];
    let (mut round, mut rays) = (1, pilot.rays);
    loop {
        let mesh = Mesh { scene, whole: scene, parents: None };
        let mut arriving = vec![0.0; n * bands];
        arriving.chunks_exact_mut(bands).enumerate().for_each(|(i, out)| transport.direct.irradiance(i, out));
        let bounced = irradiance.iter().zip(arriving).map(|(h, d)| h - d).collect();
        let field = Field::new(Order::Constant, bands, bounced);
        let mut measure = Measure::new(mesh, Some(&field));
        // The field changes with the segments: the rays of a round are all its own.
        let (mut base, mut probe) = (Tally::new(n, bands), Tally::new(n, bands));
        transport.gather(&mut base, Some(&field), |_| sizes[1], progress)?;
        let residuals = measure.residuals(&base);
        transport.probe(&mut probe, &field, residuals, |_| sizes[2], progress)?;
        // What the segments towards lamps and lights leave is noise of each scramble, too.
        measure.add_spread_of_direct(&transport.direct);
        measure.follow(&pilot, &probe, options.tolerance, &mut |_: &Step, _: &[f64], _: &[f64]| progress.advance(0))?;
        rays += base.total() + 2 * probe.total();
        let (square, doubt) = measure.distance(irradiance);
        if round == ROUNDS || doubt <= DOUBT * square.max(options.tolerance.powi(2)) || !measure.is_finite() {
            let error = if measure.is_finite() { square.max(0.0).sqrt() } else { f64::INFINITY };
            return Ok(Assessment { error, rays });
        }
        sizes = sizes.map(|size| 4 * size);
        drop(measure);
        transport.direct.sample(|_| sizes[0], progress)?;
        round += 1;
    }
}
