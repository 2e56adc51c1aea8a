//! Final gather: the light that arrives at every pixel, in place of what a patch has on the average (Reichert 1992; Lischinski,
//! Tampieri & Greenberg 1993).
//!
//!   L = (E + rho (H_direct + H_indirect)) / pi
//!
//! H_direct is what lamps, and lights that are no patches ([`crate::direct::lights`]), send there. A tile of the image knows from
//! earlier segments how much c_l of each lamp is seen; a point asks one lamp more, with probability p_l, at a random place z with weight w ([`crate::direct::lamp`]):
//!
//!   H_direct ~ sum over l of c_l E_l F_l  +  E_l w / p_l (V - c_l),    mean over V:  sum over l of E_l integral of V K
//!
//! F_l is the closed form: without bias whatever c is, and without noise where all of a tile sees a lamp, or nothing does. Pixels
//! where the second term counts, and those around them, get more samples. H_indirect is gathered by rays that carry
//! what the solution says of where they end, at few points ([`super::irradiance_cache`]). So the patches show only in light that
//! has been reflected twice.
//!
//! Where a ray of the camera meets a mirror or glass, all this is done where it ends ([`super::sight`]). Of caustics a point has what
//! its patch has, interpolated between corners ([`crate::direct::caustics`]).
//!
//! The picture is the mean of two halves that share no more than what the tiles know, each refined pass by pass along its own quasi-random
//! sequences and on grids moved by chance: half of their difference is the standard error.

use std::f64::consts::PI;
use std::ops::Range;

use rayon::prelude::*;

use super::irradiance_cache::{Gatherer, IrradianceCache, is_same_surface};
use super::sight::{Sight, around, check_size};
use super::{Camera, Corners};
use crate::direct::lamp::Point;
use crate::direct::lamps::Asked;
use crate::direct::{Caustics, Lamps, Lights, SCRAMBLES, Surroundings};
use crate::error::{Error, Result};
use crate::geometry::sampling::{Sobol, hash};
use crate::memory::filled;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::{Bvh, NO_PATCH, Ray};

/// What to make, and how well.
#[derive(Debug, Clone, Copy)]
pub struct GatherOptions {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Standard error to reach, relative, RMS over the pixels in which no emitter is seen; in (0, 1).
    pub tolerance: f64,
    /// Seed of the quasi-random points.
    pub seed: u64,
    /// Bytes that may be used.
    pub memory: u64,
}

/// A picture.
#[derive(Debug, Clone)]
pub struct Gathered {
    /// Radiance, W/(m^2 sr), height x width x bands, row 0 on top.
    pub pixels: Vec<f64>,
    /// Estimate of its relative error from sampling, the worst band.
    pub error_estimate: f64,
    /// Passes over the image.
    pub passes: usize,
}

/// Samples of a pixel in one pass of one half, and of one whose samples disagree.
const SAMPLES: u32 = 2;
const SAMPLES_AT_EDGES: u32 = 16;
/// Size of a cell of the irradiance cache over the mean distance of what is seen, in the first pass; it falls with the square root of
/// their number, as sampling errors do, down to a part of it: where all cells are the smallest, rays are spread too thin.
const DETAIL: f64 = 0.6;
const FINEST: f64 = 4.0;
/// Rays from all samples of a pixel together where the cache has no point.
const RAYS_ALONE: usize = 16;
/// Pixels that are worked on together.
const TOGETHER: usize = 256;
const HALVES: usize = 2;
/// Pixels each way of a tile that learns which lamps are seen.
const TILE: usize = 16;
/// The first look is at one pixel in so many each way.
const GLANCE: usize = 2;
/// Interest in lamps that a tile sees all of, or nothing, where 1/2 is the most: a sliver of a shadow must not escape for ever.
const WATCH: f64 = 0.1;
/// Samples of a pixel disagree when visibility not known beforehand makes more than this part of its light.
const UNCERTAIN: f64 = 0.05;
/// Rays of caustics that every pass adds, of each scramble and for every patch.
const CAUSTIC_RAYS: u64 = 32;
/// Passes after which nothing more is to be hoped for.
const MOST_PASSES: usize = 1 << 14;

/// Gathers light for a picture, pass by pass: `observe(pixels, error estimate)` after each.
///
/// `irradiance` is H of the solution, n x b, under these `lights`; `tree` must hold all patches of the scene.
///
/// # Errors
/// [`Error::Invalid`] for options out of range, or a camera that sees nothing or only backs; [`Error::Memory`];
/// [`Error::Interrupted`], and those of `observe`.
#[expect(clippy::too_many_arguments, reason = "what is shown, from where, how well, and who is told")]
pub fn gather(
    scene: &Scene,
    tree: &Bvh,
    lights: &Lights,
    irradiance: &[f64],
    camera: &Camera,
    options: &GatherOptions,
    observe: &mut dyn FnMut(&[f64], f64) -> Result<()>,
    progress: &Progress,
) -> Result<Gathered> {
    let GatherOptions { width, height, tolerance, seed, memory } = *options;
    if !(tolerance > 0.0 && tolerance < 1.0) {
        return Err(Error::Invalid(format!("tolerance {tolerance} is outside (0, 1)")));
    }
    let bands = scene.bands();
    // Two sums, a pass, the picture, and copies of it for the caller; and the cache, whose grid goes a cell beyond the image.
    let padded = |size: usize| size.saturating_add(2 * TILE).div_ceil(size.max(1)) as u64;
    check_size([width, height, bands], 64 + 128 * padded(width).saturating_mul(padded(height)), memory)?;
    let lamps = Lamps::of_scene(scene)?;
    let blockers = Bvh::of_blockers(scene);
    let sight = Sight::new(scene);
    let surroundings = Surroundings { scene, lamps: &lamps, lights, tree, blockers: &blockers };
    let gatherer = Gatherer { surroundings, irradiance, sight: &sight };
    let mut view = View {
        gatherer,
        camera,
        width,
        height,
        seed,
        caustics: Caustics::of_scene(scene, &lamps),
        corners: Corners::new(scene),
        seen: vec![0.0; width.div_ceil(TILE) * height.div_ceil(TILE) * lamps.lamps.len() * 2],
        disagree: filled(width * height, false)?,
    };
    let mut sums = [filled(width * height * bands, 0.0)?, filled(width * height * bands, 0.0)?];
    let mut emits = filled(width * height, false)?;
    view.glance(progress)?;
    let mut passes = 0;
    loop {
        view.add_caustics(passes, progress)?;
        for (half, sums) in sums.iter_mut().enumerate() {
            view.add(half, passes, sums, &mut emits, progress)?;
        }
        sight.check(camera)?;
        passes += 1;
        let each = 1.0 / (HALVES * passes) as f64;
        let pixels: Vec<f64> = sums[0].iter().zip(&sums[1]).map(|(a, b)| each * (a + b)).collect();
        let error_estimate = spread(&sums, &emits, bands);
        observe(&pixels, error_estimate)?;
        if error_estimate <= tolerance || passes == MOST_PASSES {
            return Ok(Gathered { pixels, error_estimate, passes });
        }
    }
}

/// Half of the difference between the halves over their mean, RMS over the pixels in which no emitter is seen (over all, where all
/// show one), the worst band; infinite where that is no number.
fn spread(sums: &[Vec<f64>; HALVES], emits: &[bool], bands: usize) -> f64 {
    let all_emit = emits.iter().all(|emits| *emits);
    let relative = |band: usize| {
        let of_half = |half: usize| {
            let values = sums[half].iter().skip(band).step_by(bands).zip(emits);
            values.filter(move |(_, emits)| all_emit || !**emits).map(|(value, _)| *value)
        };
        // In units of the largest, squares neither overflow nor vanish.
        let unit = of_half(0).chain(of_half(1)).fold(0.0f64, |peak, x| peak.max(x.abs()));
        if unit == 0.0 {
            return 0.0;
        }
        let (mut difference, mut sum) = (0.0, 0.0);
        for (a, b) in of_half(0).zip(of_half(1)) {
            difference += (a / unit - b / unit).powi(2);
            sum += (a / unit + b / unit).powi(2);
        }
        let relative = (difference / sum).sqrt();
        if relative.is_nan() { f64::INFINITY } else { relative }
    };
    (0..bands).map(relative).fold(0.0, f64::max)
}

/// What is looked at.
struct View<'a> {
    gatherer: Gatherer<'a>,
    camera: &'a Camera,
    width: usize,
    height: usize,
    seed: u64,
    caustics: Option<Caustics>,
    corners: Corners,
    /// Of every tile and lamp: the weights of segments that have seen it, and of all.
    seen: Vec<f64>,
    /// Pixels whose samples have disagreed so far. What a pass finds counts from the next on: a pixel that kept the samples which
    /// agree, and took others in place of those which do not, would favour what is seen most.
    disagree: Vec<bool>,
}

/// What is known of indirect light in one pass of one half.
struct Indirect {
    cache: IrradianceCache,
    /// Irradiance of caustics at the corners of patches, n x 3 x b; empty where there are none.
    caustics: Vec<f64>,
}

/// What samples have found of one pixel beside its radiance.
#[derive(Debug, Clone, Copy, Default)]
struct Found {
    /// Whether an emitter is seen.
    emits: bool,
    /// Whether they met different surfaces, or saw different parts of the lamps.
    disagree: bool,
}

impl View<'_> {
    fn tile(&self, pixel: usize) -> usize {
        pixel / self.width / TILE * self.width.div_ceil(TILE) + pixel % self.width / TILE
    }

    /// How much of lamp l a tile sees, as far as is known.
    fn known(&self, tile: usize, l: usize) -> f64 {
        let at = 2 * (tile * self.gatherer.surroundings.lamps.lamps.len() + l);
        if self.seen[at + 1] > 0.0 { self.seen[at] / self.seen[at + 1] } else { 1.0 }
    }

    /// Takes in what a pass has found.
    fn learn(&mut self, seen: &[f64], found: &[Found]) {
        self.seen.iter_mut().zip(seen).for_each(|(sum, more)| *sum += more);
        self.disagree.iter_mut().zip(found).for_each(|(disagree, found)| *disagree |= found.disagree);
    }

    /// Looks first of all which lamps the tiles see, and where samples disagree.
    fn glance(&mut self, progress: &Progress) -> Result<()> {
        let mut pixels = filled(self.disagree.len() * self.gatherer.surroundings.scene.bands(), 0.0)?;
        let mut found = filled(self.disagree.len(), Found::default())?;
        let stream = hash(self.seed ^ hash(2 * HALVES as u64));
        let width = self.width;
        let is_wanted = |pixel: usize| (pixel / width).is_multiple_of(GLANCE) && (pixel % width).is_multiple_of(GLANCE);
        let seen = self.look_at(None, is_wanted, 0..SAMPLES, stream, &mut pixels, &mut found, progress)?;
        self.learn(&seen, &found);
        Ok(())
    }

    /// Follows more rays from the lamps.
    fn add_caustics(&mut self, passes: usize, progress: &Progress) -> Result<()> {
        let surroundings = self.gatherer.surroundings;
        let Some(caustics) = &mut self.caustics else { return Ok(()) };
        let wanted = CAUSTIC_RAYS.saturating_mul((passes as u64 + 1) * surroundings.scene.len() as u64);
        let wanted = u32::try_from(wanted).unwrap_or(u32::MAX);
        caustics.sample(&surroundings, wanted, self.seed, progress)
    }

    /// Caustics at the corners of patches as one half of the scrambles has them.
    fn caustics_of(&self, half: usize) -> Vec<f64> {
        let Some(caustics) = &self.caustics else { return Vec::new() };
        let scene = self.gatherer.surroundings.scene;
        let mut irradiance = vec![0.0; scene.emission().len()];
        let own = SCRAMBLES / HALVES;
        for (i, out) in irradiance.chunks_exact_mut(scene.bands()).enumerate() {
            (half * own..(half + 1) * own).for_each(|s| caustics.add_of_scramble(i, s, out));
            out.iter_mut().for_each(|out| *out /= own as f64);
        }
        self.corners.irradiance(scene, &irradiance)
    }

    /// Adds one pass of one half.
    fn add(
        &mut self,
        half: usize,
        pass: usize,
        sums: &mut [f64],
        emits: &mut [bool],
        progress: &Progress,
    ) -> Result<()> {
        progress.expect(self.height as u64);
        let seed = hash(self.seed ^ hash((pass * HALVES + half) as u64));
        let detail = DETAIL / ((pass + 1) as f64).sqrt().min(FINEST);
        let size = [self.width, self.height];
        let cache = IrradianceCache::new(&self.gatherer, self.camera, size, detail, seed, progress)?;
        let indirect = Indirect { cache, caustics: self.caustics_of(half) };
        let (mut pixels, mut found) = (filled(sums.len(), 0.0)?, filled(emits.len(), Found::default())?);
        let numbers = |count: u32| pass as u32 * count..(pass as u32 + 1) * count;
        let stream = |k: usize| hash(self.seed ^ hash((2 * half + k) as u64));
        let uneven = around(&self.disagree, self.width);
        let (few, many) = (numbers(SAMPLES), numbers(SAMPLES_AT_EDGES));
        let seen = self.look_at(Some(&indirect), |k| !uneven[k], few, stream(0), &mut pixels, &mut found, progress)?;
        let seen_there =
            self.look_at(Some(&indirect), |k| uneven[k], many, stream(1), &mut pixels, &mut found, progress)?;
        self.learn(&seen, &found);
        self.learn(&seen_there, &[]);
        sums.iter_mut().zip(&pixels).for_each(|(sum, value)| *sum += value);
        emits.iter_mut().zip(&found).for_each(|(emits, found)| *emits |= found.emits);
        progress.advance(self.height as u64)
    }

    /// Replaces the radiance of the wanted pixels by that of samples number `numbers`; returns what the tiles have seen.
    /// Without `indirect` only direct light counts.
    #[expect(clippy::too_many_arguments, reason = "of one caller")]
    fn look_at(
        &self,
        indirect: Option<&Indirect>,
        wanted: impl Fn(usize) -> bool + Sync,
        numbers: Range<u32>,
        stream: u64,
        pixels: &mut [f64],
        found: &mut [Found],
        progress: &Progress,
    ) -> Result<Vec<f64>> {
        let (width, bands) = (self.width, self.gatherer.surroundings.scene.bands());
        let per_row = self.seen.len() / self.height.div_ceil(TILE);
        let of_tiles = |(band, (rows, found)): (usize, (&mut [f64], &mut [Found]))| -> Result<Vec<f64>> {
            progress.advance(0)?;
            let first = band * TILE * width;
            let wanted: Vec<usize> = (first..first + found.len()).filter(|&pixel| wanted(pixel)).collect();
            let mut seen = vec![0.0; per_row];
            for part in wanted.chunks(TOGETHER) {
                let (radiance, of_pixels) =
                    self.look(indirect, part, numbers.clone(), stream, band * per_row, &mut seen);
                for ((&pixel, radiance), own) in part.iter().zip(radiance.chunks_exact(bands)).zip(of_pixels) {
                    let at = pixel - first;
                    rows[at * bands..][..bands].copy_from_slice(radiance);
                    found[at] = Found { emits: found[at].emits || own.emits, ..own };
                }
            }
            Ok(seen)
        };
        let tiles = pixels.par_chunks_mut(TILE * width * bands).zip(found.par_chunks_mut(TILE * width)).enumerate();
        let seen: Result<Vec<Vec<f64>>> = tiles.map(of_tiles).collect();
        Ok(seen?.concat())
    }

    /// The radiance of some pixels by samples number `numbers` of each, and what else they found. What segments see is
    /// added to `seen`, the part of [`View::seen`] from `offset` on.
    fn look(
        &self,
        indirect: Option<&Indirect>,
        pixels: &[usize],
        numbers: Range<u32>,
        stream: u64,
        offset: usize,
        seen: &mut [f64],
    ) -> (Vec<f64>, Vec<Found>) {
        let Gatherer { surroundings, sight, .. } = self.gatherer;
        let Surroundings { scene, lamps, lights, tree, blockers } = surroundings;
        let (bands, each) = (scene.bands(), numbers.len());
        // Rays through the pixels, and what they meet.
        let sample = |&pixel: &usize| {
            let sobol: Sobol<4> = Sobol::new(stream ^ hash(pixel as u64));
            numbers.clone().map(move |k| sobol.point(k))
        };
        let samples: Vec<[f64; 4]> = pixels.iter().flat_map(sample).collect();
        let place = |k: usize| {
            let pixel = pixels[k / each];
            [(pixel % self.width) as f64 + samples[k][0], (pixel / self.width) as f64 + samples[k][1]]
        };
        let ray = |k: usize| {
            let [x, y] = place(k);
            let direction = self.camera.direction(x, y, self.width, self.height);
            Ray { origin: self.camera.origin(), direction, exclude: NO_PATCH }
        };
        let rays: Vec<Ray> = (0..samples.len()).map(ray).collect();
        let shown = sight.look(tree, &rays);
        let of: Vec<usize> = shown.iter().map(|shown| shown.ray).collect();
        let points: Vec<Point> = shown.iter().map(|shown| shown.point).collect();
        let (mut found, mut met) = (vec![Found::default(); pixels.len()], vec![0; pixels.len()]);
        for (m, k) in of.iter().enumerate() {
            met[k / each] += usize::from(m == 0 || of[m - 1] != *k);
        }
        for (found, met) in found.iter_mut().zip(met) {
            found.disagree = met > 0 && met < each;
        }
        if points.is_empty() {
            return (vec![0.0; pixels.len() * bands], found);
        }
        for (m, point) in points.iter().enumerate().skip(1) {
            let is_same = of[m] / each != of[m - 1] / each || is_same_surface(&points[m - 1], point);
            found[of[m] / each].disagree |= !is_same;
        }
        let factors = lamps.form_factors(&points);
        let count = lamps.lamps.len();
        let tile = |m: usize| self.tile(pixels[of[m] / each]);
        // E_l w / p_l (V - c_l), one a point.
        let mut corrections: Vec<Option<(usize, f64)>> = vec![None; points.len()];
        let free = lamps.is_free(blockers);
        if !free {
            let interest = |m: usize, l: usize| {
                let c = self.known(tile(m), l);
                (c * (1.0 - c)).sqrt() + WATCH
            };
            let (asked, segments) = lamps.ask(&points, &factors, interest, |m| [samples[of[m]][2], samples[of[m]][3]]);
            let hidden = lamps.hidden(blockers, |k| asked[k].lamp, &segments);
            for (Asked { point, lamp, weight }, blocked) in asked.into_iter().zip(hidden) {
                let visible = if blocked { 0.0 } else { 1.0 };
                let at = 2 * (tile(point) * count + lamp) - offset;
                seen[at] += visible * weight;
                seen[at + 1] += weight;
                corrections[point] = Some((lamp, weight * (visible - self.known(tile(point), lamp))));
            }
        }
        // What is no lamp is asked with the same numbers: its light is added up.
        let mut straight = vec![0.0; points.len() * bands];
        lights.light(&points, tree, |m| [samples[of[m]][2], samples[of[m]][3]], &mut straight);
        let mut radiance = vec![0.0; pixels.len() * bands];
        for (m, point) in points.iter().enumerate() {
            let (pixel, i) = (of[m] / each, point.patch as usize * bands);
            let arriving = &mut straight[m * bands..][..bands];
            for (l, lamp) in lamps.lamps.iter().enumerate() {
                let f = factors[l * points.len() + m];
                if f > 0.0 {
                    let f = f * if free { 1.0 } else { self.known(tile(m), l) };
                    arriving.iter_mut().zip(&lamp.emission).for_each(|(h, e)| *h += f * e);
                }
            }
            if let Some((l, correction)) = corrections[m] {
                for (h, e) in arriving.iter_mut().zip(&lamps.lamps[l].emission) {
                    found[pixel].disagree |= (correction * e).abs() > UNCERTAIN * h.abs();
                    *h += correction * e;
                }
            }
            if let Some(Indirect { caustics, .. }) = indirect
                && !caustics.is_empty()
            {
                let [v, w] = shown[m].barycentric;
                for (b, out) in arriving.iter_mut().enumerate() {
                    let corner = |c: usize| caustics[(3 * point.patch as usize + c) * bands + b];
                    *out += (1.0 - v - w) * corner(0) + v * corner(1) + w * corner(2);
                }
            }
            // The cache knows the place that a ray shows most of; the other one of glass is gathered at by itself.
            let is_first = m == 0 || of[m - 1] != of[m];
            if let Some(Indirect { cache, .. }) = indirect
                && !(is_first && cache.add(place(of[m]), point, arriving))
            {
                let number = u64::from(numbers.start) + (of[m] % each) as u64;
                let seed = hash(stream ^ hash((pixels[pixel] as u64) << 32 | number));
                self.gatherer.gather(&[*point], (RAYS_ALONE / each).max(1), &[seed], arriving);
            }
            for (b, out) in radiance[pixel * bands..][..bands].iter_mut().enumerate() {
                let e = scene.emission()[i + b];
                found[pixel].emits |= e > 0.0;
                *out += shown[m].part * (e + scene.reflectance()[i + b] * arriving[b]) / (PI * each as f64);
            }
        }
        (radiance, found)
    }
}
