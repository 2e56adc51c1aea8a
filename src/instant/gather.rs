//! The picture of virtual point lights: what each sends to every pixel, bounded, and what the bound cuts, by short
//! paths.
//!
//! A pixel has [`SAMPLES`] places s, and every place gets the light of one part of the lights, M_s, so that a light
//! counts once and edges are smooth. A path x_0 (seen), x_1, ... of throughput T_0 = 1 / pi, T_(d+1) = T_d rho(x_d)
//! adds, at each of its points,
//!
//!   T_d ( E / SAMPLES + rho sum over k in M_(s+d) of Phi_k / pi min(G, c) V )
//!
//! From x_d it goes on along a ray of density cos / pi with probability max(0, 1 - c / G) (Kollig & Keller 2004,
//! there a weight): so the mean of all is the light that an unbounded G gives, whatever c is, and a path ends where
//! it meets nothing nearer than 1 / sqrt(c).
//!
//! Lights on an emitter stand close together, so that theirs is a bound of its own, c_E >= c ([`bounds`]): where a
//! path has met an emitter after x_0, E counts by max(0, 1 - c_E / G) / (1 - c / G). Paths would seldom meet a small
//! lamp, and then too much of it.

use std::f64::consts::{FRAC_1_PI, PI};

use rayon::prelude::*;

use super::walk::Lights;
use crate::direct::lamp::Point;
use crate::error::{Error, Result};
use crate::form_factor::emitter::Emitter;
use crate::geometry::sampling::{Random, Sobol, cosine_direction, hash};
use crate::memory::filled;
use crate::progress::Progress;
use crate::render::Camera;
use crate::render::sight::{Sight, check_size};
use crate::scene::Scene;
use crate::visibility::{Bvh, NO_PATCH, Ray, Segment};

/// Places in a pixel.
pub const SAMPLES: usize = 16;
/// Pixels each way of a block, whose segments to a light go about the same way, and blocks each way of a tile.
const BLOCK: usize = 8;
const BLOCKS: usize = 4;
const TILE: usize = BLOCK * BLOCKS;
/// Paths of more bounces are ended at random: a tiny bound would send them on until nothing is left to carry.
const DEEP: usize = 32;
/// Products of cosines below are rounding: both points lie in one plane.
const GRAZING: f64 = 1e-20;

/// What to make.
#[derive(Debug, Clone, Copy)]
pub struct InstantOptions {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// c, 1/m^2: the largest geometry term of a light.
    pub bound: f64,
    /// Whether what the bound cuts is found by paths.
    pub compensate: bool,
    /// Whether what the lights send straight to the pixels is added; not when that comes from shadow maps.
    pub lit: bool,
    /// Seed of the places in the pixels, and of the paths.
    pub seed: u64,
    /// Bytes that may be used.
    pub memory: u64,
}

/// A picture.
#[derive(Debug, Clone)]
pub struct Picture {
    /// Radiance, W/(m^2 sr), height x width x bands, row 0 on top.
    pub pixels: Vec<f64>,
    /// The share of the reflected light that the bound has cut and paths have found, all bands together.
    pub compensated: f64,
    /// The bound of every light, 1/m^2.
    pub bounds: Vec<f64>,
}

/// The bound c, 1/m^2, that pictures of a scene of area A take: BOUND / A. Paths then go on nearer than 0.22 sqrt(A)
/// to something.
///
/// A larger one leaves brighter spots around the lights, a smaller one more grain of paths, and more of them. Measured on
/// the Cornell box (benches/instant.py): pixels averaged over 4 x 4 are the better the smaller the bound is, down to a
/// fourth of this one, but single ones look grainy; for any number of lights.
pub fn default_bound(scene: &Scene) -> f64 {
    BOUND / scene.areas().iter().sum::<f64>()
}

const BOUND: f64 = 20.0;
/// The largest part of the emission E of a lamp that one of the lights on it gives as irradiance.
const BRIGHTEST: f64 = 0.25;

/// The bound of every light: c, but for those on emitters.
///
/// These have a power Phi each, so that one of them stands for an area Phi / E; with c_E = BRIGHTEST pi E / Phi it
/// gives a point no more than BRIGHTEST E.
pub fn bounds(scene: &Scene, lights: &Lights, bound: f64) -> Vec<f64> {
    let power = lights.flux[..scene.bands().min(lights.flux.len())].iter().sum();
    let of_light = |(point, &bounce): (&Point, &u32)| {
        if bounce == 0 { emitter_bound(scene, point.patch, power, bound) } else { bound }
    };
    lights.points.iter().zip(&lights.bounce).map(of_light).collect()
}

/// c_E of a patch whose lights have this power each, all bands together.
fn emitter_bound(scene: &Scene, patch: u32, power: f64, bound: f64) -> f64 {
    let emission = &scene.emission()[patch as usize * scene.bands()..][..scene.bands()];
    bound.max(BRIGHTEST * PI * emission.iter().sum::<f64>() / power)
}

/// For every light the place in the pixels that it shines on. Particles that follow each other are spread evenly, so
/// those of one bounce are dealt in runs; every bounce begins at another place.
pub fn sample_of(bounce: &[u32]) -> Vec<usize> {
    let runs = bounce.chunk_by(|a, b| a == b);
    runs.flat_map(|run| (0..run.len()).map(move |k| (k * SAMPLES / run.len() + run[0] as usize) % SAMPLES)).collect()
}

/// What is seen at one place of every pixel: what a G-buffer holds.
///
/// # Errors
/// Those of [`gather()`].
pub fn places(
    scene: &Scene,
    tree: &Bvh,
    camera: &Camera,
    sample: usize,
    options: &InstantOptions,
    progress: &Progress,
) -> Result<Vec<Option<Point>>> {
    let InstantOptions { width, height, seed, memory, .. } = *options;
    check_size([width, height, 1], 2 * size_of::<Option<Point>>() as u64, memory)?;
    let view = View { scene, tree, camera, width, height, seed, sight: Sight::new(scene) };
    let mut out = filled(width * height, None)?;
    progress.expect(height as u64);
    out.par_chunks_mut(width).enumerate().try_for_each(|(y, row)| {
        let pixels: Vec<usize> = (y * width..(y + 1) * width).collect();
        view.look(&pixels, sample).into_iter().for_each(|walker| row[walker.pixel] = Some(walker.point));
        progress.advance(1)
    })?;
    Ok(out)
}

/// The picture of `lights` in their scene, whose `tree` must hold all patches. The same bits for any number of threads.
///
/// # Errors [`Error::Invalid`] for lights of another scene, an empty picture, a bound that is not positive, or a
/// camera that sees nothing or only backs; [`Error::Memory`]; [`Error::Interrupted`].
pub fn gather(
    scene: &Scene,
    tree: &Bvh,
    lights: &Lights,
    camera: &Camera,
    options: &InstantOptions,
    progress: &Progress,
) -> Result<Picture> {
    scene.require_diffuse("instant radiosity")?;
    let InstantOptions { width, height, bound, seed, memory, .. } = *options;
    let bands = scene.bands();
    if !(bound > 0.0) {
        return Err(Error::Invalid(format!("the bound {bound} of the geometry term is not positive")));
    }
    let count = lights.points.len();
    let is_of_scene = lights.points.iter().all(|point| (point.patch as usize) < scene.len());
    if !is_of_scene || lights.flux.len() != count * bands || lights.bounce.len() != count {
        return Err(Error::Invalid("these lights are not of this scene".to_string()));
    }
    // The picture, its tiles, and the copy for the caller.
    check_size([width, height, bands], 32, memory)?;
    let blockers = Bvh::of_blockers(scene);
    let mut parts = vec![Vec::new(); SAMPLES];
    sample_of(&lights.bounce).into_iter().enumerate().for_each(|(k, sample)| parts[sample].push(k));
    let view = View { scene, tree, camera, width, height, seed, sight: Sight::new(scene) };
    let bounds = bounds(scene, lights, bound);
    let power = lights.flux[..bands.min(lights.flux.len())].iter().sum();
    let shown = Shown { view: &view, blockers: &blockers, lights, parts: &parts, bounds: &bounds, power, options };
    let tiles: Vec<[usize; 2]> =
        (0..height).step_by(TILE).flat_map(|y| (0..width).step_by(TILE).map(move |x| [x, y])).collect();
    progress.expect(tiles.len() as u64);
    let done: Result<Vec<Tile>> = tiles
        .par_iter()
        .map(|&corner| {
            let tile = shown.tile(corner, progress)?;
            progress.advance(1)?;
            Ok(tile)
        })
        .collect();
    let done = done?;
    view.sight.check(camera)?;
    let mut picture = Picture { pixels: filled(width * height * bands, 0.0)?, compensated: 0.0, bounds };
    let (mut straight, mut by_paths) = (0.0, 0.0);
    for tile in done {
        straight += tile.straight;
        by_paths += tile.by_paths;
        for (&pixel, radiance) in tile.pixels.iter().zip(tile.radiance.chunks_exact(bands)) {
            picture.pixels[pixel * bands..][..bands].copy_from_slice(radiance);
        }
    }
    if by_paths > 0.0 {
        picture.compensated = by_paths / (straight + by_paths);
    }
    Ok(picture)
}

/// What is looked at.
struct View<'a> {
    scene: &'a Scene,
    tree: &'a Bvh,
    camera: &'a Camera,
    width: usize,
    height: usize,
    seed: u64,
    sight: Sight<'a>,
}

/// The end of a path so far.
#[derive(Clone, Copy)]
struct Walker {
    /// Which of the pixels that are worked on together it adds to.
    pixel: usize,
    point: Point,
    /// How much of the emission there counts.
    glow: f64,
}

impl View<'_> {
    /// The numbers of a place: where it is in the pixel, and where the path goes from what is seen there.
    fn numbers(&self, pixel: usize, sample: usize) -> [f64; 5] {
        Sobol::new(hash(self.seed ^ hash(pixel as u64))).point(sample as u32)
    }

    /// The fronts seen at one place of each of the pixels.
    fn look(&self, pixels: &[usize], sample: usize) -> Vec<Walker> {
        let ray = |&pixel: &usize| {
            let [u, v, ..] = self.numbers(pixel, sample);
            let [x, y] = [(pixel % self.width) as f64 + u, (pixel / self.width) as f64 + v];
            let direction = self.camera.direction(x, y, self.width, self.height);
            Ray { origin: self.camera.origin(), direction, exclude: NO_PATCH }
        };
        let rays: Vec<Ray> = pixels.iter().map(ray).collect();
        let hits = rays.iter().zip(self.tree.closest(&rays)).enumerate();
        let front = |(pixel, (ray, hit)): (usize, (&Ray, Option<_>))| {
            let hit = hit.filter(|hit| self.sight.is_front(hit, ray.direction))?;
            Some(Walker { pixel, point: Point::of_hit(self.scene, &hit), glow: 1.0 })
        };
        hits.filter_map(front).collect()
    }
}

/// A part of the picture.
struct Tile {
    /// Its pixels, and their radiance.
    pixels: Vec<usize>,
    radiance: Vec<f64>,
    /// Reflected light summed up over pixels and bands: straight from the lights, and by paths.
    straight: f64,
    by_paths: f64,
}

/// What makes the picture.
struct Shown<'a> {
    view: &'a View<'a>,
    blockers: &'a Bvh,
    lights: &'a Lights,
    /// The lights of each place.
    parts: &'a [Vec<usize>],
    bounds: &'a [f64],
    /// Of each light on an emitter, all bands together, W.
    power: f64,
    options: &'a InstantOptions,
}

impl Shown<'_> {
    /// The tile whose upper left pixel this is.
    fn tile(&self, [left, top]: [usize; 2], progress: &Progress) -> Result<Tile> {
        let (view, scene) = (self.view, self.view.scene);
        let bands = scene.bands();
        // Block by block, so that neighbours in the list are neighbours in the picture.
        let at = |k: usize| {
            let (block, k) = (k / (BLOCK * BLOCK), k % (BLOCK * BLOCK));
            [left + block % BLOCKS * BLOCK + k % BLOCK, top + block / BLOCKS * BLOCK + k / BLOCK]
        };
        let inside = (0..TILE * TILE).map(at).filter(|&[x, y]| x < view.width && y < view.height);
        let pixels: Vec<usize> = inside.map(|[x, y]| y * view.width + x).collect();
        let mut tile = Tile { radiance: vec![0.0; pixels.len() * bands], pixels, straight: 0.0, by_paths: 0.0 };
        for sample in 0..SAMPLES {
            let mut walkers = view.look(&tile.pixels, sample);
            let mut throughput = vec![FRAC_1_PI; tile.pixels.len() * bands];
            for depth in 0.. {
                progress.advance(0)?;
                walkers.sort_by_key(|walker| walker.point.patch);
                let irradiance = if depth > 0 || self.options.lit {
                    self.irradiance(&walkers, &self.parts[(sample + depth) % SAMPLES])
                } else {
                    vec![0.0; walkers.len() * bands]
                };
                for (walker, irradiance) in walkers.iter().zip(irradiance.chunks_exact(bands)) {
                    let patch = walker.point.patch as usize * bands;
                    let (emission, rho) = (&scene.emission()[patch..], &scene.reflectance()[patch..]);
                    for b in 0..bands {
                        let carried = &mut throughput[walker.pixel * bands + b];
                        let (shone, reflected) =
                            (*carried * walker.glow * emission[b] / SAMPLES as f64, *carried * rho[b] * irradiance[b]);
                        *carried *= rho[b];
                        tile.radiance[walker.pixel * bands + b] += shone + reflected;
                        if depth == 0 { tile.straight += reflected } else { tile.by_paths += shone + reflected }
                    }
                }
                if depth >= DEEP {
                    let lives = |walker: &Walker| self.survives(walker, &mut throughput, &tile.pixels, sample, depth);
                    walkers.retain(lives);
                }
                if self.options.compensate {
                    walkers = self.go_on(&walkers, &throughput, &tile.pixels, sample, depth);
                }
                if !self.options.compensate || walkers.is_empty() {
                    break;
                }
            }
        }
        Ok(tile)
    }

    /// Russian roulette: a path goes on as often as its patch reflects, and carries the more for it.
    fn survives(&self, walker: &Walker, throughput: &mut [f64], pixels: &[usize], sample: usize, depth: usize) -> bool {
        let (scene, bands) = (self.view.scene, self.view.scene.bands());
        let rho = &scene.reflectance()[walker.point.patch as usize * bands..][..bands];
        let odds = rho.iter().copied().fold(0.0, f64::max);
        let pixel = hash(pixels[walker.pixel] as u64 ^ hash(DEEP as u64));
        let mut random = Random::new(hash(self.view.seed ^ hash(pixel ^ (depth * SAMPLES + sample) as u64)));
        throughput[walker.pixel * bands..][..bands].iter_mut().for_each(|carried| *carried /= odds);
        random.uniform() < odds
    }

    /// Where the paths that the bound has cut light from go next.
    fn go_on(
        &self,
        walkers: &[Walker],
        throughput: &[f64],
        pixels: &[usize],
        sample: usize,
        depth: usize,
    ) -> Vec<Walker> {
        let (view, scene) = (self.view, self.view.scene);
        let bands = scene.bands();
        let carries =
            |walker: &&Walker| throughput[walker.pixel * bands..][..bands].iter().any(|carried| *carried > 0.0);
        let send = |walker: &Walker| {
            let pixel = pixels[walker.pixel];
            let [s, t, chance] = if depth == 0 {
                let [_, _, s, t, chance] = view.numbers(pixel, sample);
                [s, t, chance]
            } else {
                let mut random =
                    Random::new(hash(view.seed ^ hash(hash(pixel as u64) ^ (depth * SAMPLES + sample) as u64)));
                [(); 3].map(|()| random.uniform())
            };
            let emitter = Emitter::new(scene, view.tree, walker.point.patch as usize);
            (walker.pixel, chance, emitter.ray(walker.point.x, cosine_direction(s, t)))
        };
        let sent: Vec<(usize, f64, Ray)> = walkers.iter().filter(carries).map(send).collect();
        let rays: Vec<Ray> = sent.iter().map(|(.., ray)| *ray).collect();
        let goes_on = |((pixel, chance, ray), hit): (&(usize, f64, Ray), Option<_>)| {
            let point = Point::of_hit(scene, &hit?);
            let way = point.x - ray.origin;
            let start = scene.normals()[ray.exclude as usize];
            // Cosines times distances.
            let (here, there) = (start.dot(way), -point.normal.dot(way));
            let r2 = way.length_squared();
            let inverse = r2 * r2 / (here * there);
            let chances = 1.0 - self.options.bound * inverse;
            let glow = 1.0 - emitter_bound(scene, point.patch, self.power, self.options.bound) * inverse;
            let goes_on = there > 0.0 && *chance < chances;
            goes_on.then_some(Walker { pixel: *pixel, point, glow: (glow / chances).max(0.0) })
        };
        sent.iter().zip(view.tree.closest(&rays)).filter_map(goes_on).collect()
    }

    /// What a part of the lights sends to each point, bounded, one row of bands a point; the points in the order of
    /// their patches.
    fn irradiance(&self, walkers: &[Walker], part: &[usize]) -> Vec<f64> {
        let bands = self.view.scene.bands();
        let mut out = vec![0.0; walkers.len() * bands];
        let (mut segments, mut seen) = (Vec::new(), Vec::new());
        for &k in part {
            let light = &self.lights.points[k];
            let flux = &self.lights.flux[k * bands..][..bands];
            let mut first = 0;
            for group in walkers.chunk_by(|a, b| a.point.patch == b.point.patch) {
                let group_at = first;
                first += group.len();
                segments.clear();
                seen.clear();
                for (at, walker) in group.iter().enumerate() {
                    let point = &walker.point;
                    let way = light.x - point.x;
                    let (here, there) = (point.normal.dot(way), -light.normal.dot(way));
                    let r2 = way.length_squared();
                    if here > 0.0 && there > 0.0 && here * there > GRAZING * r2 {
                        seen.push((group_at + at, (here * there / (r2 * r2)).min(self.bounds[k])));
                        segments.push(Segment { start: point.x, end: light.x, exclude: [point.patch, light.patch] });
                    }
                }
                let blocked = self.blockers.blocked_between(&segments);
                for (&(at, geometry), _) in seen.iter().zip(blocked).filter(|(_, blocked)| !blocked) {
                    for (out, flux) in out[at * bands..][..bands].iter_mut().zip(flux) {
                        *out += FRAC_1_PI * geometry * flux;
                    }
                }
            }
        }
        out
    }
}
