//! The rounds of pilot, base and probe until the estimate of the error meets the tolerance.

use super::measure::{Measure, Mesh, bytes_to_follow};
use super::options::Options;
use super::pilot::{Pilot, pilot_rays};
use super::plan::{Plan, cheapest};
use super::stages::Stages;
use super::transport::{FIRST_SEGMENTS, Ground, Tally, Transport};
use crate::assembly::rays::BYTES_OF_TRIP;
use crate::direct::{Lights, SCRAMBLES};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::solve::{Audit, Step};

/// The share of the tolerance that is planned for; the rest is for what plans do not see.
const SHARE: f64 = 0.92;
/// The pilot takes more rays where its operator would leave more than this share of the squared goal: by this factor, up to so many
/// from one patch.
const PILOT_SHARE: f64 = 0.1;
const PILOT_GROWTH: usize = 4;
const MOST_PILOT_RAYS: usize = 4096;
/// Rounds of sampling on one mesh, and meshes.
const ROUNDS: usize = 12;
const MESHES: usize = 8;
/// A round grows a sample by no more than this: what few rays tell of many is not to be trusted further.
const MOST_GROWTH: f64 = 16.0;
/// A forecast is made after so many rounds; no sample grows by more than this between them.
const FORECAST_ROUNDS: usize = 2;
const FORECAST_GROWTH: f64 = 2.0;
/// Rounds that a solve takes from there on, about.
const MORE_ROUNDS: f64 = 2.0;
/// What a segment costs when it is cast with many others, in rays.
const SEGMENT_COST: f64 = 0.5;

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
    /// Seconds that the tolerance would still have taken; 0 where it is met, or where more rays would not help.
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

/// Solves a scene under some lights beside its own.
///
/// # Errors
/// [`Error::Invalid`] for options out of range or a scene without finite solution, [`Error::Memory`], [`Error::Interrupted`].
pub fn solve(scene: &Scene, lights: &Lights, options: &Options, progress: &Progress) -> Result<Outcome> {
    let outcome = run(scene, lights, options, &Limits { rounds: ROUNDS, growth: MOST_GROWTH }, progress)?;
    let bands = scene.bands();
    match outcome.radiosity.iter().position(|b| !b.is_finite()) {
        Some(k) => Err(Error::Invalid(format!(
            "patch {}: its radiosity comes out as {} (band {}): emission, or its product with areas, is near the limits of \
             floating-point numbers; choose other units",
            k / bands,
            outcome.radiosity[k],
            k % bands
        ))),
        None => Ok(outcome),
    }
}

/// What [`solve`] would take, from its first rounds.
///
/// # Errors
/// Those of [`solve`].
pub fn forecast(scene: &Scene, lights: &Lights, options: &Options, progress: &Progress) -> Result<Forecast> {
    let outcome = run(scene, lights, options, &Limits { rounds: FORECAST_ROUNDS, growth: FORECAST_GROWTH }, progress)?;
    let spent: f64 = outcome.seconds.iter().map(|(_, seconds)| seconds).sum();
    Ok(Forecast { seconds: spent + outcome.missing, bytes: outcome.bytes })
}

fn run(scene: &Scene, lights: &Lights, options: &Options, limits: &Limits, progress: &Progress) -> Result<Outcome> {
    options.check(scene, lights)?;
    let mut seconds = Stages::default();
    let whole = Mesh { scene, whole: scene, parents: None };
    let mut max_edge = longest_edge(scene);
    let mut outcome = on_mesh(whole, lights, options, limits, options.refine, &mut seconds, progress)?;
    let mut meshes = 0;
    loop {
        if let Some(outcome) = outcome {
            return Ok(Outcome { seconds: seconds.0, ..outcome });
        }
        meshes += 1;
        max_edge *= 0.5;
        let (fine, parents) = scene.subdivide(max_edge, options.memory, progress)?;
        let fine = Mesh { scene: &fine, whole: scene, parents: Some(&parents) };
        outcome = on_mesh(fine, lights, options, limits, meshes < MESHES, &mut seconds, progress)?;
    }
}

/// Returns the bytes that are needed.
pub(super) fn refuse_lack_of_memory(n: usize, bands: usize, views: u64, options: &Options) -> Result<u64> {
    let needed = bytes(n, bands, views, options);
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

/// Bytes that a solve on `n` patches takes at its peak: the two trees, what every patch sees of the lamps (`views`), the pilot's
/// rays, the field, the sums of base and probe, and what is followed of them.
fn bytes(n: usize, bands: usize, views: u64, options: &Options) -> u64 {
    const TREES: u64 = 500;
    let values = bands as u64 * size_of::<f64>() as u64;
    let pilot = pilot_rays(options.tolerance) as u64 * BYTES_OF_TRIP;
    let field = options.order.coefficients() as u64 * values;
    // Sums, solutions, and some copies on the way.
    let by_scramble = (2 * 2 * SCRAMBLES as u64 + 8) * values;
    views + n as u64 * (TREES + pilot + field + by_scramble) + bytes_to_follow(n, bands)
}

/// `None` when the patches of the mesh are too coarse, and may be cut.
fn on_mesh(
    mesh: Mesh,
    lights: &Lights,
    options: &Options,
    limits: &Limits,
    may_cut: bool,
    stages: &mut Stages,
    progress: &Progress,
) -> Result<Option<Outcome>> {
    let scene = mesh.scene;
    let (n, bands) = (scene.len(), scene.bands());
    refuse_lack_of_memory(n, bands, 0, options)?;
    let ground = stages.time("trees", || Ground::new(scene, lights))?;
    let kernels = (0.05 * options.tolerance).clamp(1e-8, 1e-3);
    let mut transport = stages.time("lamps", || Transport::new(scene, &ground, kernels, options.seed, progress))?;
    let bytes = refuse_lack_of_memory(n, bands, transport.direct.nbytes(), options)?;
    let most = ((options.memory - bytes) / n as u64 / BYTES_OF_TRIP) as usize;
    let mut count = pilot_rays(options.tolerance);
    let mut pilot = Pilot::new(scene, &transport, options, count, stages, progress)?;
    let mut before = stages.clone();
    let has_rays = pilot.operator.is_some() || !ground.lamps.glow.is_empty();

    let goal = (SHARE * options.tolerance).powi(2);
    let (mut base, mut probe) = (Tally::new(n, bands), Tally::new(n, bands));
    let first = (count / SCRAMBLES) as u32;
    let mut sizes = [FIRST_SEGMENTS, first, (first / 4).max(1)];
    let mut shares = Vec::new();
    let mut round = 1;
    loop {
        let field = pilot.field.as_ref();
        let of_patch = |i: usize| {
            let share = shares.get(i).copied().unwrap_or(1.0);
            (share * f64::from(sizes[1])).ceil() as u32
        };
        let mut measure = Measure::new(mesh, field);
        if has_rays {
            stages.time("base", || transport.gather(&mut base, field, of_patch, progress))?;
            let residuals = measure.residuals(&base);
            if let Some(field) = field {
                stages.time("probe", || transport.probe(&mut probe, field, residuals, |_| sizes[2], progress))?;
                let mut observe = |_: &Step, _: &[f64], _: &[f64]| progress.advance(0);
                stages.time("bounces", || {
                    measure.follow_by_halves(&pilot, options.tolerance, &mut observe)?;
                    measure.follow(&pilot, &probe, options.tolerance, &mut observe)
                })?;
                measure.balance(&base, &transport.direct);
            }
        }
        let direct = &transport.direct;
        let errors = stages.time("errors", || measure.errors(direct));
        if round == 1 && errors.pilot > PILOT_SHARE * goal && PILOT_GROWTH * count <= most.min(MOST_PILOT_RAYS) {
            count *= PILOT_GROWTH;
            let (rays, segments) =
                (pilot.rays + base.total() + 2 * probe.total(), pilot.segments + base.segments + probe.segments);
            pilot = Pilot::new(scene, &transport, options, count, stages, progress)?;
            (pilot.rays, pilot.segments) = (pilot.rays + rays, pilot.segments + segments);
            (base, probe) = (Tally::new(n, bands), Tally::new(n, bands));
            before = stages.clone();
            continue;
        }
        let costs = [
            SEGMENT_COST * direct.partial_segments() as f64,
            base.total() as f64 + SEGMENT_COST * base.segments as f64,
            2.0 * probe.total() as f64 + SEGMENT_COST * probe.segments as f64,
        ];
        let plan = cheapest(&errors, &costs, goal, options.refine);
        // Without a field the pilot's system has hardly any solution, and neither has the scene.
        let has_solution = pilot.field.is_some() || pilot.operator.is_none();
        let is_finite = has_solution && measure.is_finite();
        if plan.is_none() && may_cut && is_finite {
            break;
        }
        let plan = plan.unwrap_or(Plan::DONE);
        if plan.is_met() || round == limits.rounds || !is_finite {
            let (irradiance, error) = measure.irradiance(direct, plan.corrected);
            let rho = mesh.whole.reflectance();
            let radiosity = mesh.whole.emission().iter().zip(rho).zip(&irradiance).map(|((e, rho), h)| e + rho * h);
            let [sampling, mut discretisation] = errors.parts(plan.corrected);
            let (mut missing, sampled) = (0.0, costs.iter().sum::<f64>());
            if !plan.is_met() {
                // What is not known counts as if it were there.
                discretisation += errors.doubt;
                let rounds = stages.since(&before, &["bounces", "errors"]) / round as f64;
                missing = plan.extra_cost(&costs) / sampled.max(1.0)
                    * stages.since(&before, &["direct", "base", "probe"])
                    + MORE_ROUNDS * rounds;
            }
            return Ok(Some(Outcome {
                radiosity: radiosity.collect(),
                standard_error: error.iter().zip(rho).map(|(error, rho)| rho * error).collect(),
                audit: measure.audit(&base, direct, &irradiance),
                irradiance,
                sampling_error: if is_finite { sampling.sqrt() } else { f64::INFINITY },
                discretisation_error: discretisation.sqrt(),
                corrected: plan.corrected,
                patches: n,
                rays: pilot.rays + base.total() + 2 * probe.total(),
                segments: direct.segments + pilot.segments + base.segments + probe.segments,
                history: pilot.history,
                seconds: Vec::new(),
                bytes: bytes + n as u64 * (count - pilot_rays(options.tolerance)) as u64 * BYTES_OF_TRIP,
                missing,
            }));
        }
        sizes = plan.grown(sizes, limits.growth);
        if round == 1 {
            shares = measure.shares();
        }
        drop(measure);
        stages.time("direct", || transport.direct.sample(|_| sizes[0], progress))?;
        round += 1;
    }
    Ok(None)
}
