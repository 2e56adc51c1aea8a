//! The rounds of pilot, base and probe until the estimate of the error meets the tolerance.

use std::time::Instant;

use super::measure::{Measure, Mesh, bytes_to_follow};
use super::plan::{Plan, cheapest};
use super::transport::{FIRST_SEGMENTS, Ground, Tally, Transport};
use crate::assembly::rays::{BYTES_OF_TRIP, Field};
use crate::assembly::{Order, Rays, Trips};
use crate::direct::patches::{BYTES_OF_VIEW, SCRAMBLES};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::solve::{Audit, Step, System, propagated, without_loss};

/// The share of the tolerance that is planned for; the rest is for what plans do not see.
const SHARE: f64 = 0.95;
/// Rounds of sampling on one mesh, and meshes.
const ROUNDS: usize = 12;
const MESHES: usize = 8;
/// A round grows a sample by no more than this: what few rays tell of many is not to be trusted further.
const MOST_GROWTH: f64 = 16.0;
/// A forecast is made after so many rounds, and no sample grows by more in one.
const FORECAST_ROUNDS: usize = 2;
const FORECAST_GROWTH: f64 = 2.0;
/// Rounds that a solve takes from there on, about.
const MORE_ROUNDS: f64 = 2.0;
/// What a segment costs when it is cast with many others, in rays.
const SEGMENT_COST: f64 = 0.5;
/// Of the pilot's solve, relative: what it leaves is measured with its other errors.
const RESIDUAL: f64 = 1e-3;

/// What is asked for.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Error to be reached, in (0, 1).
    pub tolerance: f64,
    /// How radiosity varies over a patch.
    pub order: Order,
    /// Whether light may be followed below the patches where they are too coarse.
    pub refine: bool,
    /// Seed of all samples.
    pub seed: u64,
    /// Bytes that may be used.
    pub memory: u64,
}

/// A scene solved.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// B, n x b, W/m^2.
    pub radiosity: Vec<f64>,
    /// H, n x b, W/m^2.
    pub irradiance: Vec<f64>,
    /// Standard error of B, n x b, W/m^2.
    pub standard_error: Vec<f64>,
    /// Part of the relative error that sampling leaves, the band with the largest error.
    pub sampling_error: f64,
    /// Part of it that discretisation leaves.
    pub discretisation_error: f64,
    /// Whether light was followed one bounce further point by point, to lower the discretisation error.
    pub corrected: bool,
    /// Patches that were worked on, more than the scene has where those were too coarse.
    pub patches: usize,
    /// Rays cast.
    pub rays: u64,
    /// Segments cast towards lamps.
    pub segments: u64,
    /// Steps of the pilot's solve.
    pub history: Vec<Step>,
    /// Where the power went, to the error of the solution.
    pub audit: Option<Audit>,
    /// Stages of the work and the seconds that they took.
    pub seconds: Vec<(&'static str, f64)>,
    /// Bytes that this takes, by estimate.
    pub bytes: u64,
    /// What the tolerance would still have cost, in parts of the rays and segments that were cast: 0 where it is met.
    pub missing: f64,
}

impl Outcome {
    /// Estimate of the relative error of B - E, the worst band.
    pub fn error_estimate(&self) -> f64 {
        self.sampling_error.hypot(self.discretisation_error)
    }
}

/// What a solve would take.
#[derive(Debug, Clone, Copy)]
pub struct Forecast {
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Bytes.
    pub bytes: u64,
}

/// How far the rounds go.
struct Limits {
    rounds: usize,
    growth: f64,
}

/// Solves a scene.
///
/// # Errors
/// [`Error::Invalid`] for options out of range or a scene without finite solution, [`Error::Memory`], [`Error::Interrupted`].
pub fn solve(scene: &Scene, options: &Options, progress: &Progress) -> Result<Outcome> {
    run(scene, options, &Limits { rounds: ROUNDS, growth: MOST_GROWTH }, progress)
}

/// What [`solve`] would take, from its first rounds.
///
/// # Errors
/// Those of [`solve`].
pub fn forecast(scene: &Scene, options: &Options, progress: &Progress) -> Result<Forecast> {
    let outcome = run(scene, options, &Limits { rounds: FORECAST_ROUNDS, growth: FORECAST_GROWTH }, progress)?;
    let seconds = |stages: &[&str]| -> f64 {
        outcome.seconds.iter().filter(|(stage, _)| stages.contains(stage)).map(|(_, seconds)| seconds).sum()
    };
    let more = outcome.missing * seconds(&["direct", "pilot", "base", "probe"]);
    let rounds = if outcome.missing > 0.0 { MORE_ROUNDS / FORECAST_ROUNDS as f64 } else { 0.0 };
    let spent: f64 = outcome.seconds.iter().map(|(_, seconds)| seconds).sum();
    Ok(Forecast { seconds: spent + more + rounds * seconds(&["bounces", "errors"]), bytes: outcome.bytes })
}

fn run(scene: &Scene, options: &Options, limits: &Limits, progress: &Progress) -> Result<Outcome> {
    check(options)?;
    let mut stages = Stages::default();
    let whole = Mesh { scene, whole: scene, parents: None };
    let mut max_edge = longest_edge(scene);
    let mut outcome = on_mesh(whole, options, limits, options.refine, &mut stages, progress)?;
    let mut meshes = 0;
    loop {
        if let Some(outcome) = outcome {
            return Ok(Outcome { seconds: stages.0, ..outcome });
        }
        meshes += 1;
        max_edge *= 0.5;
        let (fine, parents) = scene.subdivide(max_edge, options.memory, progress)?;
        let fine = Mesh { scene: &fine, whole: scene, parents: Some(&parents) };
        outcome = on_mesh(fine, options, limits, meshes < MESHES, &mut stages, progress)?;
    }
}

pub(super) fn check(options: &Options) -> Result<()> {
    if !(options.tolerance > 0.0 && options.tolerance < 1.0) {
        return Err(Error::Invalid(format!("tolerance {} is outside (0, 1)", options.tolerance)));
    }
    Ok(())
}

/// Returns the bytes that are needed.
pub(super) fn refuse_lack_of_memory(n: usize, bands: usize, lamps: usize, options: &Options) -> Result<u64> {
    let needed = bytes(n, bands, lamps, options);
    if needed <= options.memory {
        return Ok(needed);
    }
    Err(Error::Memory {
        what: format!("the solution of {n} patches to a tolerance of {}", options.tolerance),
        needed,
        available: options.memory,
        remedy: "use fewer patches (a larger max_edge) or a looser tolerance".to_string(),
    })
}

fn longest_edge(scene: &Scene) -> f64 {
    let longest = |[a, b, c]: [crate::geometry::Vec3; 3]| a.distance(b).max(b.distance(c)).max(c.distance(a));
    (0..scene.len()).map(|i| longest(scene.triangle(i))).fold(0.0, f64::max)
}

/// Seconds by stage, in the order of their first appearance.
#[derive(Default)]
struct Stages(Vec<(&'static str, f64)>);

impl Stages {
    fn time<T>(&mut self, stage: &'static str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let out = work();
        let seconds = start.elapsed().as_secs_f64();
        match self.0.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, sum)) => *sum += seconds,
            None => self.0.push((stage, seconds)),
        }
        out
    }
}

/// Rays of the pilot from each patch: noise of its field is an error of the second order only, and so may be some times the
/// tolerance.
pub(super) fn pilot_rays(tolerance: f64) -> usize {
    ((0.6 / tolerance).clamp(16.0, 1024.0) as usize).next_power_of_two()
}

/// Bytes that a solve on `n` patches lit by so many lamps takes at its peak: the two trees, what every patch sees of the lamps,
/// the pilot's rays, the field, the sums of base and probe, and what is followed of them.
fn bytes(n: usize, bands: usize, lamps: usize, options: &Options) -> u64 {
    const TREES: u64 = 400;
    let values = bands as u64 * size_of::<f64>() as u64;
    let pilot = pilot_rays(options.tolerance) as u64 * BYTES_OF_TRIP;
    let field = options.order.coefficients() as u64 * values;
    let by_scramble = 2 * 2 * SCRAMBLES as u64 * values;
    n as u64 * (TREES + BYTES_OF_VIEW * lamps as u64 + pilot + field + by_scramble) + bytes_to_follow(n, bands)
}

/// What a solve starts from.
struct Pilot {
    /// The operator; `None` where nothing is reflected.
    operator: Option<Rays>,
    /// The field; `None` also where it has no end.
    field: Option<Field>,
    /// Rays and segments cast.
    rays: u64,
    segments: u64,
    history: Vec<Step>,
}

impl Pilot {
    fn new(
        scene: &Scene,
        transport: &Transport,
        options: &Options,
        stages: &mut Stages,
        progress: &Progress,
    ) -> Result<Pilot> {
        let mut history = Vec::new();
        if scene.reflectance().iter().all(|rho| *rho == 0.0) {
            return Ok(Pilot { operator: None, field: None, rays: 0, segments: 0, history });
        }
        let count = pilot_rays(options.tolerance);
        let (trips, source, segments) = stages.time("pilot", || transport.pilot(options.order, count, progress))?;
        refuse_lossless(scene, trips.rays())?;
        let field = stages.time("bounces", || first_field(scene, &trips, source, &mut history, progress))?;
        Ok(Pilot { operator: Some(trips.into_rays()), field, rays: (scene.len() * count) as u64, segments, history })
    }
}

/// `None` when the patches of the mesh are too coarse, and may be cut.
fn on_mesh(
    mesh: Mesh,
    options: &Options,
    limits: &Limits,
    may_cut: bool,
    stages: &mut Stages,
    progress: &Progress,
) -> Result<Option<Outcome>> {
    let scene = mesh.scene;
    let (n, bands) = (scene.len(), scene.bands());
    let ground = stages.time("trees", || Ground::of_scene(scene))?;
    let bytes = refuse_lack_of_memory(n, bands, ground.lamps.lamps.len(), options)?;
    let kernels = (0.05 * options.tolerance).clamp(1e-8, 1e-3);
    let mut transport = stages.time("direct", || Transport::new(scene, &ground, kernels, options.seed, progress))?;
    let pilot = Pilot::new(scene, &transport, options, stages, progress)?;
    let field = pilot.field.as_ref();
    // Without a field the pilot's system has hardly any solution, and neither has the scene.
    let has_solution = field.is_some() || pilot.operator.is_none();
    let has_rays = pilot.operator.is_some() || !ground.lamps.glow.is_empty();

    let goal = (SHARE * options.tolerance).powi(2);
    let (mut base, mut probe) = (Tally::new(n, bands), Tally::new(n, bands));
    let first = (pilot_rays(options.tolerance) / SCRAMBLES) as u32;
    let mut sizes = [FIRST_SEGMENTS, first, (first / 4).max(1)];
    let mut shares = Vec::new();
    for round in 1.. {
        let of_patch = |i: usize| {
            let share = shares.get(i).copied().unwrap_or(1.0);
            (share * f64::from(sizes[1])).ceil() as u32
        };
        let mut measure = Measure::new(mesh, field);
        if has_rays {
            stages.time("base", || transport.gather(&mut base, field, of_patch, progress))?;
            let residuals = measure.residuals(&base);
            if let (Some(field), Some(operator)) = (field, &pilot.operator) {
                stages.time("probe", || transport.probe(&mut probe, field, residuals, |_| sizes[2], progress))?;
                let mut observe = |_: &Step, _: &[f64], _: &[f64]| progress.advance(0);
                stages.time("bounces", || measure.follow(operator, &probe, &mut observe))?;
            }
        }
        let direct = &transport.direct;
        let errors = stages.time("errors", || measure.errors(direct));
        let costs = [
            SEGMENT_COST * direct.partial_segments() as f64,
            base.total() as f64 + SEGMENT_COST * base.segments as f64,
            2.0 * probe.total() as f64 + SEGMENT_COST * probe.segments as f64,
        ];
        let plan = cheapest(&errors, &costs, goal, options.refine);
        if plan.is_none() && may_cut {
            break;
        }
        let plan = plan.unwrap_or(Plan::DONE);
        if plan.is_met() || round == limits.rounds || !has_solution || !measure.is_finite() {
            let (irradiance, error) = measure.irradiance(direct, plan.corrected);
            let rho = mesh.whole.reflectance();
            let radiosity = mesh.whole.emission().iter().zip(rho).zip(&irradiance).map(|((e, rho), h)| e + rho * h);
            let [sampling, discretisation] = errors.parts(plan.corrected).map(f64::sqrt);
            let is_finite = has_solution && measure.is_finite();
            let spent = costs.iter().sum::<f64>() + pilot.rays as f64 + SEGMENT_COST * pilot.segments as f64;
            return Ok(Some(Outcome {
                radiosity: radiosity.collect(),
                standard_error: error.iter().zip(rho).map(|(error, rho)| rho * error).collect(),
                audit: measure.audit(&base, &irradiance),
                irradiance,
                sampling_error: if is_finite { sampling } else { f64::INFINITY },
                discretisation_error: discretisation,
                corrected: plan.corrected,
                patches: n,
                rays: pilot.rays + base.total() + 2 * probe.total(),
                segments: direct.segments + pilot.segments + base.segments + probe.segments,
                history: pilot.history,
                seconds: Vec::new(),
                bytes,
                missing: if plan.is_met() { 0.0 } else { plan.extra_cost(&costs) / spent },
            }));
        }
        sizes = plan.grown(sizes, limits.growth);
        if round == 1 {
            shares = measure.shares();
        }
        drop(measure);
        stages.time("direct", || transport.direct.sample(|_| sizes[0], progress))?;
    }
    Ok(None)
}

/// Without a loss anywhere the light never dies.
fn refuse_lossless(scene: &Scene, operator: &Rays) -> Result<()> {
    let bands = scene.bands();
    for band in 0..bands {
        if operator.is_closed() && scene.reflectance().iter().skip(band).step_by(bands).all(|rho| *rho == 1.0) {
            return Err(without_loss(band));
        }
    }
    Ok(())
}

/// The field u = T0 (D + u), from the source T0 D; `None` where that has no end. The bounces are followed with constant
/// radiosity on every patch, and the last of them brings what is linear.
fn first_field(
    scene: &Scene,
    trips: &Trips,
    mut source: Field,
    history: &mut Vec<Step>,
    progress: &Progress,
) -> Result<Option<Field>> {
    let (bands, rho) = (scene.bands(), scene.reflectance());
    let mut light: Vec<f64> = source.means().iter().zip(rho).map(|(h, rho)| rho * h).collect();
    let system = System { form_factors: trips.rays(), emission: &[], reflectance: rho, bands };
    let mut observe = |step: &Step, _: &[f64], _: &[f64]| {
        history.push(step.clone());
        progress.advance(0)
    };
    let Some(arriving) = propagated(&system, std::slice::from_ref(&light), RESIDUAL, &mut observe)? else {
        return Ok(None);
    };
    for ((light, h), rho) in light.iter_mut().zip(&arriving[0]).zip(rho) {
        *light += rho * h;
    }
    trips.add_gathered(&light, &mut source);
    Ok(Some(source))
}
