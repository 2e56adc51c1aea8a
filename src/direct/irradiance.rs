//! The irradiance that suns, points, spots and skies bring straight to every patch, to a tolerance; and what each part of a sky
//! brings.
//!
//!   (sum over i of A_i dH0_i^2  /  sum over i of A_i H0_i^2)^(1/2) <= tolerance,   the worst band
//!
//! where dH0 is the standard error by [`SCRAMBLES`] scrambles. Patches take samples in proportion to what a sample lowers.
//!
//! Daylight coefficients (Tregenza & Waters 1983) are the matrix C of  H0_i = sum over cells c of C_ic L_c,  the projected solid
//! angle of every cell of a sky that a patch sees, sr. They are found once and serve every sky of those cells.

use rayon::prelude::*;

use super::lights::Lights;
use super::sky::{Distribution, Sky};
use super::{Lamps, Lighting, SCRAMBLES, Surroundings};
use crate::error::{Error, Result};
use crate::form_factor::emitter::Emitter;
use crate::geometry::Vec3;
use crate::geometry::sampling::{Sobol, cosine_direction, hash, point_in_triangle};
use crate::memory::filled;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::{Bvh, NO_PATCH, Segment};

/// Samples of a scramble that every patch begins with, and the most.
const FIRST: u32 = 16;
const MOST: u32 = 1 << 16;
/// A round takes at most this many times the samples of the one before, and at least so many times.
const GROWTH: [f64; 2] = [1.5, 8.0];
const ROUNDS: usize = 16;
/// The variance of m samples of a shadow that lies across a patch falls with about this power of m.
const DECAY: f64 = 1.4;
/// Bytes of the tree for a patch.
const TREE: u64 = 300;
/// Of random numbers, apart from those of other samples.
const STREAM: u64 = u64::MAX - 2;
/// Rays of a patch that are cast together.
const TOGETHER: u32 = 1024;

/// Irradiance of the patches.
#[derive(Debug, Clone)]
pub struct Irradiance {
    /// H0, n x b, W/m^2.
    pub values: Vec<f64>,
    /// Its standard error, n x b.
    pub standard_error: Vec<f64>,
    /// The relative error that was reached.
    pub error_estimate: f64,
    /// Segments cast.
    pub segments: u64,
}

/// The irradiance H0 of all patches by `lights` alone.
///
/// # Errors
/// [`Error::Invalid`] for a tolerance out of range or a scene with mirrors or glass, [`Error::Memory`], [`Error::Interrupted`].
pub fn irradiance(
    scene: &Scene,
    lights: &Lights,
    tolerance: f64,
    seed: u64,
    memory: u64,
    progress: &Progress,
) -> Result<Irradiance> {
    if !(tolerance > 0.0 && tolerance < 1.0) {
        return Err(Error::Invalid(format!("tolerance {tolerance} is outside (0, 1)")));
    }
    scene.require_diffuse("the light of suns, points and skies")?;
    let (n, bands) = (scene.len(), scene.bands());
    let numbers = (bands * (SCRAMBLES + 3) * size_of::<f64>() + lights.len()) as u64;
    refuse_lack_of_memory(scene, numbers, "the light on", memory)?;
    let (tree, lamps) = (Bvh::of_scene(scene), Lamps::none(bands));
    let surroundings = Surroundings { scene, lamps: &lamps, lights, tree: &tree, blockers: &tree };
    let mut lighting = Lighting::new(n, bands, lights);
    // Not the samples that a solve takes, by which what rests on this may be assessed.
    let seed = hash(seed ^ hash(STREAM));
    let mut wanted = filled(n, FIRST)?;
    let mut round = 0;
    loop {
        lighting.sample(&surroundings, |i| wanted[i], seed, progress)?;
        round += 1;
        let (values, standard_error) = mean_and_error(&lighting, n, bands)?;
        let relative = |b: usize| relative(scene, &values, &standard_error, b, bands);
        let error_estimate = (0..bands).map(relative).fold(0.0, f64::max);
        if error_estimate <= tolerance || round == ROUNDS || wanted.iter().all(|wanted| *wanted == MOST) {
            return Ok(Irradiance { values, standard_error, error_estimate, segments: lighting.segments });
        }
        let growth = (error_estimate / tolerance).powf(2.0 / DECAY).clamp(GROWTH[0], GROWTH[1]);
        // The best number of samples is in proportion to (A V)^(1 / (p + 1)) where variances V fall with the power p; four
        // scrambles tell V roughly, hence the mean is mixed in.
        let variance = |i: usize| -> f64 {
            let relative = |b: usize| {
                let peak = values.iter().skip(b).step_by(bands).fold(f64::MIN_POSITIVE, |peak, x| peak.max(*x));
                (standard_error[i * bands + b] / peak).powi(2)
            };
            scene.areas()[i] * (0..bands).map(relative).sum::<f64>()
        };
        let variances: Vec<f64> = (0..n).map(variance).collect();
        let mean = variances.iter().sum::<f64>() / n as f64;
        for (wanted, variance) in wanted.iter_mut().zip(variances) {
            let share = (0.5 + 0.5 * variance / mean).powf(1.0 / (DECAY + 1.0));
            *wanted = (growth * share * f64::from(*wanted)).ceil().min(f64::from(MOST)) as u32;
        }
    }
}

fn mean_and_error(lighting: &Lighting, n: usize, bands: usize) -> Result<(Vec<f64>, Vec<f64>)> {
    let (mut values, mut errors) = (filled(n * bands, 0.0)?, filled(n * bands, 0.0f64)?);
    let mut own = vec![0.0; bands];
    for (i, (values, errors)) in values.chunks_exact_mut(bands).zip(errors.chunks_exact_mut(bands)).enumerate() {
        lighting.add(i, None, values);
        for s in 0..SCRAMBLES {
            own.fill(0.0);
            lighting.add(i, Some(s), &mut own);
            errors.iter_mut().zip(&own).zip(&*values).for_each(|((error, x), mean)| *error = error.hypot(x - mean));
        }
        errors.iter_mut().for_each(|error| *error /= ((SCRAMBLES * (SCRAMBLES - 1)) as f64).sqrt());
    }
    Ok((values, errors))
}

/// The area-weighted RMS of one band of an error over that of the values; 0 where these are.
fn relative(scene: &Scene, values: &[f64], errors: &[f64], b: usize, bands: usize) -> f64 {
    let norm = |x: &[f64]| {
        let band = x.iter().skip(b).step_by(bands).zip(scene.areas());
        band.fold(0.0f64, |sum, (x, area)| sum.hypot(area.sqrt() * x))
    };
    let size = norm(values);
    if size > 0.0 { norm(errors) / size } else { 0.0 }
}

fn refuse_lack_of_memory(scene: &Scene, of_patch: u64, what: &str, memory: u64) -> Result<()> {
    let needed = (scene.len() as u64).saturating_mul(of_patch.saturating_add(TREE));
    if needed <= memory {
        return Ok(());
    }
    Err(Error::Memory {
        what: format!("{what} {} patches", scene.len()),
        needed,
        available: memory,
        remedy: "use fewer patches (a larger max_edge), or cells".to_string(),
    })
}

/// The daylight coefficients of all patches, n x (rows x columns), for tables of a sky with its zenith at `up`, by `rays` rays a
/// patch.
///
/// # Errors
/// [`Error::Invalid`] for a scene with mirrors or glass, [`Error::Memory`], [`Error::Interrupted`].
#[expect(clippy::too_many_arguments, reason = "a sky's cells and the options of one sample")]
pub fn coefficients(
    scene: &Scene,
    [rows, columns]: [usize; 2],
    up: Vec3,
    north: Vec3,
    rays: u32,
    seed: u64,
    memory: u64,
    progress: &Progress,
) -> Result<Vec<f64>> {
    scene.require_diffuse("the light of a sky")?;
    let cells = rows.saturating_mul(columns);
    refuse_lack_of_memory(scene, (cells as u64).saturating_mul(8), "the daylight coefficients of", memory)?;
    let sky = Sky::new(Distribution::Table { rows, columns }, up, north, vec![1.0; cells], 1);
    let tree = Bvh::of_scene(scene);
    let mut out = filled(scene.len() * cells, 0.0)?;
    progress.expect(scene.len() as u64);
    out.par_chunks_mut(cells).enumerate().try_for_each(|(i, out)| {
        let (emitter, triangle, patch) = (Emitter::new(scene, &tree, i), scene.triangle(i), i as u32);
        let sobol: Sobol<4> = Sobol::new(hash(seed ^ hash(STREAM ^ hash(i as u64))));
        for first in (0..rays).step_by(TOGETHER as usize) {
            let ray = |k: u32| {
                let [s, t, u, v] = sobol.point(k);
                emitter.ray(point_in_triangle(&triangle, u, v), cosine_direction(s, t))
            };
            let rays_now: Vec<_> = (first..rays.min(first.saturating_add(TOGETHER))).map(ray).collect();
            let segment = |ray: &crate::visibility::Ray| Segment {
                start: ray.origin,
                end: tree.outside(ray.origin, ray.direction),
                exclude: [patch, NO_PATCH],
            };
            let segments: Vec<Segment> = rays_now.iter().map(segment).collect();
            for (ray, blocked) in rays_now.iter().zip(tree.blocked_between(&segments)) {
                if !blocked && let Some((cell, _)) = sky.seen(ray.direction) {
                    out[cell] += std::f64::consts::PI / f64::from(rays);
                }
            }
            progress.advance(0)?;
        }
        progress.advance(1)
    })?;
    Ok(out)
}
