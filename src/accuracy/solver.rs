//! The rounds of pilot, base and probe until the estimate of the error meets the tolerance.

use std::time::Instant;

use super::measure::{Measure, Mesh};
use super::plan::{Plan, cheapest};
use super::transport::{Tally, Transport};
use crate::assembly::rays::{BYTES_OF_RAY, Field};
use crate::assembly::{Order, Rays};
use crate::direct::Lamps;
use crate::direct::patches::{Direct, SCRAMBLES};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::solve::{Audit, Step, System, propagated, without_loss};
use crate::visibility::Bvh;

/// The share of the tolerance that the estimate may use; the rest is for the estimate's own error.
const SHARE: f64 = 0.85;
/// Rounds of sampling on one mesh, and meshes.
const ROUNDS: usize = 12;
const MESHES: usize = 8;
/// Segments that every scramble first sends from a patch towards the lamps.
pub(super) const FIRST_SEGMENTS: u32 = 4;
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

/// How work on one mesh ended.
enum End {
    Solved(Box<Outcome>),
    /// Patches must be cut.
    TooCoarse,
    Planned(Forecast),
}

/// Solves a scene.
///
/// # Errors
/// [`Error::Invalid`] for options out of range or a scene without finite solution, [`Error::Memory`], [`Error::Interrupted`].
pub fn solve(scene: &Scene, options: &Options, progress: &Progress) -> Result<Outcome> {
    match run(scene, options, false, progress)? {
        End::Solved(outcome) => Ok(*outcome),
        End::TooCoarse | End::Planned(_) => Err(Error::Invalid("the solve has not come to an end".to_string())),
    }
}

/// What [`solve`] would take, from its first rounds.
///
/// # Errors
/// Those of [`solve`].
pub fn forecast(scene: &Scene, options: &Options, progress: &Progress) -> Result<Forecast> {
    match run(scene, options, true, progress)? {
        End::Planned(forecast) => Ok(forecast),
        End::Solved(outcome) => Ok(Forecast {
            seconds: outcome.seconds.iter().map(|(_, seconds)| seconds).sum(),
            bytes: bytes(outcome.patches, scene.bands(), options),
        }),
        End::TooCoarse => Err(Error::Invalid("the forecast has not come to an end".to_string())),
    }
}

fn run(scene: &Scene, options: &Options, only_plan: bool, progress: &Progress) -> Result<End> {
    check(options)?;
    let mut seconds = Stages::default();
    let whole = Mesh { scene, whole: scene, parents: None };
    let mut end = on_mesh(whole, options, only_plan, options.refine, &mut seconds, progress)?;
    let mut max_edge = longest_edge(scene);
    for mesh in 1..=MESHES {
        if !matches!(end, End::TooCoarse) {
            break;
        }
        max_edge *= 0.5;
        let (fine, parents) = scene.subdivide(max_edge, options.memory, progress)?;
        let fine = Mesh { scene: &fine, whole: scene, parents: Some(&parents) };
        end = on_mesh(fine, options, only_plan, mesh < MESHES, &mut seconds, progress)?;
    }
    Ok(end)
}

pub(super) fn check(options: &Options) -> Result<()> {
    if !(options.tolerance > 0.0 && options.tolerance < 1.0) {
        return Err(Error::Invalid(format!("tolerance {} is outside (0, 1)", options.tolerance)));
    }
    Ok(())
}

/// Returns the bytes that are needed.
pub(super) fn refuse_lack_of_memory(n: usize, bands: usize, options: &Options) -> Result<u64> {
    let needed = bytes(n, bands, options);
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

    fn total(&self) -> f64 {
        self.0.iter().map(|(_, seconds)| seconds).sum()
    }
}

/// Rays of the pilot from each patch: noise of its field is an error of the second order only, and so may be some times the
/// tolerance.
pub(super) fn pilot_rays(tolerance: f64) -> usize {
    ((0.6 / tolerance).clamp(16.0, 1024.0) as usize).next_power_of_two()
}

/// Bytes that a solve on `n` patches takes: the pilot's rays, the sums of base and probe, the two trees, vectors of solutions.
fn bytes(n: usize, bands: usize, options: &Options) -> u64 {
    const TREES: u64 = 600;
    const VECTORS: u64 = 40;
    let values = bands as u64 * size_of::<f64>() as u64;
    let coefficients = options.order.coefficients() as u64;
    let pilot = pilot_rays(options.tolerance) as u64 * BYTES_OF_RAY;
    n as u64 * (TREES + pilot + (2 * SCRAMBLES as u64 + VECTORS) * values + 12 * coefficients * values)
}

fn on_mesh(
    mesh: Mesh,
    options: &Options,
    only_plan: bool,
    may_cut: bool,
    seconds: &mut Stages,
    progress: &Progress,
) -> Result<End> {
    let scene = mesh.scene;
    let (n, bands) = (scene.len(), scene.bands());
    let needed = refuse_lack_of_memory(n, bands, options)?;
    let (tree, blockers) = seconds.time("trees", || {
        let tree = Bvh::of_scene(scene);
        let blockers = Bvh::of_blockers(scene);
        (tree, blockers)
    });
    let lamps = Lamps::of_scene(scene)?;
    let kernels = (0.05 * options.tolerance).clamp(1e-8, 1e-3);
    let seed = options.seed;
    let mut direct =
        seconds.time("direct", || Direct::new(scene, &lamps, &blockers, kernels, seed, FIRST_SEGMENTS, progress))?;
    let reflects = scene.reflectance().iter().any(|rho| *rho > 0.0);
    let has_rays = reflects || !lamps.glow.is_empty();

    let count = pilot_rays(options.tolerance);
    let mut history = Vec::new();
    let (mut pilot_cost, mut pilot_segments) = (0.0, 0);
    let mut operator = Rays::new(options.order, if reflects { count } else { 0 }, scene.areas());
    let mut field = None;
    if reflects {
        let transport = Transport { scene, tree: &tree, blockers: &blockers, lamps: &lamps, direct: &direct, seed };
        progress.expect((n * count) as u64);
        let (source, segments) = seconds.time("pilot", || transport.pilot(&mut operator, count, progress))?;
        pilot_segments = segments;
        pilot_cost = (n * count) as f64 + SEGMENT_COST * segments as f64;
        refuse_lossless(scene, &operator)?;
        let values = seconds.time("bounces", || first_field(scene, &operator, &source, &mut history, progress))?;
        field = values.map(|values| Field::new(options.order, bands, values));
    }
    // Without a field the pilot's system has hardly any solution, and neither has the scene.
    let has_solution = field.is_some() || !reflects;
    let operator = operator.into_constant();

    let goal = (SHARE * options.tolerance).powi(2);
    let (mut base, mut probe) = (Tally::new(n, bands), Tally::new(n, bands));
    let first = (count / SCRAMBLES).max(2) as u32;
    let mut sizes = [FIRST_SEGMENTS, first, (first / 4).max(1)];
    let mut shares = Vec::new();
    let mut round = 1;
    loop {
        let of_patch = |i: usize| {
            let share = shares.get(i).copied().unwrap_or(1.0);
            (share * f64::from(sizes[1])).ceil() as u32
        };
        let transport = Transport { scene, tree: &tree, blockers: &blockers, lamps: &lamps, direct: &direct, seed };
        let mut measure = Measure::new(mesh, field.as_ref());
        if has_rays {
            seconds.time("base", || transport.gather(&mut base, field.as_ref(), of_patch, progress))?;
            let residuals = measure.residuals(&base);
            if let Some(field) = &field {
                seconds.time("probe", || transport.probe(&mut probe, field, residuals, |_| sizes[2], progress))?;
                let mut observe = |_: &Step, _: &[f64], _: &[f64]| progress.advance(0);
                seconds.time("bounces", || measure.follow(&operator, &probe, &mut observe))?;
            }
        }
        let errors = seconds.time("errors", || measure.errors(&direct));
        let costs = [
            SEGMENT_COST * direct.partial_segments() as f64,
            base.total() as f64 + SEGMENT_COST * base.segments as f64,
            2.0 * probe.total() as f64 + SEGMENT_COST * probe.segments as f64,
        ];
        let plan = cheapest(&errors, &costs, goal, options.refine);
        if plan.is_none() && may_cut {
            return Ok(End::TooCoarse);
        }
        let plan = plan.unwrap_or(Plan::DONE);
        if plan.is_met() || round == ROUNDS || !has_solution || !measure.is_finite() {
            let (irradiance, error) = measure.irradiance(&direct, plan.corrected);
            let rho = mesh.whole.reflectance();
            let radiosity = mesh.whole.emission().iter().zip(rho).zip(&irradiance).map(|((e, rho), h)| e + rho * h);
            let [sampling, discretisation] = errors.parts(plan.corrected).map(f64::sqrt);
            let is_finite = has_solution && measure.is_finite();
            return Ok(End::Solved(Box::new(Outcome {
                radiosity: radiosity.collect(),
                standard_error: error.iter().zip(rho).map(|(error, rho)| rho * error).collect(),
                audit: measure.audit(&base, &irradiance),
                irradiance,
                sampling_error: if is_finite { sampling } else { f64::INFINITY },
                discretisation_error: discretisation,
                corrected: plan.corrected,
                patches: n,
                rays: (if reflects { n * count } else { 0 }) as u64 + base.total() + 2 * probe.total(),
                segments: direct.segments + pilot_segments + base.segments + probe.segments,
                history,
                seconds: std::mem::take(&mut seconds.0),
            })));
        }
        if only_plan {
            let more = plan.extra_cost(&costs);
            let spent = costs.iter().sum::<f64>() + pilot_cost;
            return Ok(End::Planned(Forecast { seconds: seconds.total() * (1.0 + more / spent), bytes: needed }));
        }
        sizes = plan.grown(sizes);
        if round == 1 {
            shares = measure.shares();
        }
        drop(measure);
        seconds.time("direct", || direct.sample(|_| sizes[0], progress))?;
        round += 1;
    }
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

/// The coefficients of u = T0 (D + u), from the source T0 D; `None` where that has no end.
fn first_field(
    scene: &Scene,
    operator: &Rays,
    source: &[f64],
    history: &mut Vec<Step>,
    progress: &Progress,
) -> Result<Option<Vec<f64>>> {
    let (bands, count) = (scene.bands(), operator.coefficients());
    let rows = scene.reflectance().chunks_exact(bands);
    let rho: Vec<f64> = rows.flat_map(|row| std::iter::repeat_n(row, count)).flatten().copied().collect();
    let system = System { form_factors: operator, emission: &[], reflectance: &rho, bands };
    let reflected: Vec<f64> = source.iter().zip(&rho).map(|(h, rho)| rho * h).collect();
    let mut observe = |step: &Step, _: &[f64], _: &[f64]| {
        history.push(step.clone());
        progress.advance(0)
    };
    let Some(mut arriving) = propagated(&system, &[reflected], RESIDUAL, &mut observe)? else { return Ok(None) };
    let mut field = arriving.swap_remove(0);
    field.iter_mut().zip(source).for_each(|(u, h)| *u += h);
    Ok(Some(field))
}
