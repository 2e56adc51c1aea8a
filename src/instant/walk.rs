//! Virtual point lights by a quasi-random walk with fractional absorption (Keller 1997, section 3).
//!
//! K particles start from the emitters, evenly in power; of these floor(q^j K) take part in bounce j, q being the mean
//! reflectance. A particle at y_j stands for a light of flux, per band,
//!
//!   Phi = Phi_emitted(y_0) rho(y_1) ... rho(y_j) / floor(q^j K)
//!
//! All lights are about equally strong since both the product and the number fall by q. Every bounce is estimated
//! without bias from its own number of particles; what comes after the last, about q^(j + 1) of all, is left out.

use rayon::prelude::*;

use super::halton::Halton;
use crate::direct::lamp::Point;
use crate::error::{Error, Result};
use crate::form_factor::emitter::Emitter;
use crate::geometry::sampling::{cosine_direction, point_in_triangle};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::{Bvh, Ray};

/// Virtual point lights, in the order of their bounces.
#[derive(Debug, Clone)]
pub struct Lights {
    /// Where they are.
    pub points: Vec<Point>,
    /// Phi, W, one row of bands a light.
    pub flux: Vec<f64>,
    /// How often the light has been reflected.
    pub bounce: Vec<u32>,
    /// K, the particles that started.
    pub particles: usize,
    /// The share of all light that further bounces would have: exact in a closed room of one reflectance, elsewhere as far as the
    /// particles of the walk tell.
    pub left_out: f64,
}

/// Particles that are sent on together.
const TOGETHER: usize = 1024;
/// Bytes that a light takes beside its bands, twice over: here and at the caller.
const BYTES: u64 = 256;

/// At most `count` lights, as nearly as the walk allows.
///
/// # Errors
/// [`Error::Invalid`] for no lights, a scene that emits nothing, or one with a patch twice; [`Error::Memory`];
/// [`Error::Interrupted`].
pub fn virtual_lights(
    scene: &Scene,
    tree: &Bvh,
    count: usize,
    seed: u64,
    memory: u64,
    progress: &Progress,
) -> Result<Lights> {
    scene.require_diffuse("instant radiosity")?;
    scene.require_distinct("instant radiosity")?;
    if count == 0 || u32::try_from(count).is_err() {
        return Err(Error::Invalid(format!("the number of lights, {count}, is outside 1 .. {}", u32::MAX)));
    }
    let bands = scene.bands();
    let mean = mean_reflectance(scene);
    // A white room would keep its particles for ever: no walk is longer, on the average, than there are others.
    let q = mean.min(1.0 - 1.0 / (count as f64).sqrt());
    let needed = (count as f64 / (1.0 - q)) * (BYTES + 16 * bands as u64) as f64;
    if needed > memory as f64 {
        return Err(Error::Memory {
            what: format!("{count} virtual lights in {bands} bands"),
            needed: needed as u64,
            available: memory,
            remedy: "choose fewer lights".to_string(),
        });
    }
    let bounces = walk(scene, tree, q, count, seed, progress)?;
    // More particles never make fewer lights.
    let lights_of = |particles: usize| -> usize {
        let alive = |(j, bounce): (usize, &Bounce)| {
            let number = surviving(q, j, particles) as u32;
            bounce.particles.partition_point(|&i| i < number)
        };
        bounces.iter().enumerate().map(alive).sum()
    };
    let (mut particles, mut too_many) = (1, count + 1);
    while too_many - particles > 1 {
        let middle = particles + (too_many - particles) / 2;
        if lights_of(middle) <= count { particles = middle } else { too_many = middle }
    }
    let mut lights = Lights { points: Vec::new(), flux: Vec::new(), bounce: Vec::new(), particles, left_out: 0.0 };
    for (j, bounce) in bounces.iter().enumerate() {
        let number = surviving(q, j, particles);
        if number == 0 {
            break;
        }
        let alive = bounce.particles.partition_point(|&i| i < number as u32);
        lights.points.extend(&bounce.points[..alive]);
        lights.flux.extend(bounce.power[..alive * bands].iter().map(|power| power / number as f64));
        lights.bounce.resize(lights.points.len(), j as u32);
    }
    // What the walk of all particles, of which lights need fewer, carries on from the last bounce with lights; where even that
    // walk has ended, as much less as is absorbed in the mean.
    let after = lights.bounce.last().map_or(0, |&j| j as usize + 1);
    let known = after.min(bounces.len() - 1);
    // An empty sum would be -0.
    let carried =
        bounces[known].power.iter().fold(0.0, |sum, power| sum + power) / surviving(q, known, count).max(1) as f64;
    let sent: f64 = bounces[0].power[..bands].iter().sum();
    lights.left_out = carried / sent * mean.powi((after - known) as i32);
    Ok(lights)
}

/// The mean of the reflectance over areas and bands.
fn mean_reflectance(scene: &Scene) -> f64 {
    let rows = scene.reflectance().chunks_exact(scene.bands());
    let reflected: f64 = rows.zip(scene.areas()).map(|(rho, area)| area * rho.iter().sum::<f64>()).sum();
    reflected / (scene.bands() as f64 * scene.areas().iter().sum::<f64>())
}

/// How many of `particles` take part in bounce `j`.
fn surviving(q: f64, j: usize, particles: usize) -> usize {
    (q.powf(j as f64) * particles as f64) as usize
}

/// The particles that are reflected for the j-th time.
#[derive(Default)]
struct Bounce {
    /// Their numbers, in order.
    particles: Vec<u32>,
    points: Vec<Point>,
    /// What all of them would carry if all were like this one, W, one row of bands a particle.
    power: Vec<f64>,
}

/// The walks of as many particles as there may be.
fn walk(scene: &Scene, tree: &Bvh, q: f64, particles: usize, seed: u64, progress: &Progress) -> Result<Vec<Bounce>> {
    let mut halton = Halton::new(seed);
    halton.extend(2);
    let mut bounces = vec![start(scene, &halton, particles)?];
    progress.expect(1);
    loop {
        let last = &bounces[bounces.len() - 1];
        let number = surviving(q, bounces.len(), particles);
        let alive = last.particles.partition_point(|&i| i < number as u32);
        if alive == 0 {
            progress.advance(1)?;
            return Ok(bounces);
        }
        let dimension = 2 * bounces.len();
        halton.extend(dimension + 2);
        let parts: Result<Vec<Bounce>> = (0..alive.div_ceil(TOGETHER))
            .into_par_iter()
            .map(|part| {
                progress.advance(0)?;
                Ok(step(scene, tree, &halton, dimension, last, part * TOGETHER..alive.min((part + 1) * TOGETHER)))
            })
            .collect();
        let mut next = Bounce::default();
        for part in parts? {
            next.particles.extend(part.particles);
            next.points.extend(part.points);
            next.power.extend(part.power);
        }
        bounces.push(next);
    }
}

/// The particles as they leave the emitters: of equal power in all bands together.
fn start(scene: &Scene, halton: &Halton, particles: usize) -> Result<Bounce> {
    let bands = scene.bands();
    let total = |row: &[f64]| row.iter().sum::<f64>();
    let mut ends = Vec::new();
    let mut power = 0.0;
    for (i, row) in scene.emission().chunks_exact(bands).enumerate() {
        if total(row) > 0.0 {
            power += scene.areas()[i] * total(row);
            ends.push((power, i));
        }
    }
    if ends.is_empty() {
        return Err(Error::Invalid("the scene emits nothing: its pictures are black".to_string()));
    }
    let mut out = Bounce::default();
    for particle in 0..particles as u32 {
        let (u, v) = (halton.coordinate(0, particle), halton.coordinate(1, particle));
        let at = ends.partition_point(|&(end, _)| end <= u * power).min(ends.len() - 1);
        let before = if at == 0 { 0.0 } else { ends[at - 1].0 };
        let (end, i) = ends[at];
        // What of u chose the patch is used up; the rest chooses the place.
        let rest = ((u * power - before) / (end - before)).clamp(0.0, 1.0);
        let x = point_in_triangle(&scene.triangle(i), rest, v);
        out.particles.push(particle);
        out.points.push(Point { x, normal: scene.normals()[i], patch: i as u32 });
        let row = &scene.emission()[i * bands..][..bands];
        out.power.extend(row.iter().map(|e| power * (e / total(row))));
    }
    Ok(out)
}

/// Sends a part of the particles on; those that meet no front, or a black one, end.
fn step(
    scene: &Scene,
    tree: &Bvh,
    halton: &Halton,
    dimension: usize,
    from: &Bounce,
    part: std::ops::Range<usize>,
) -> Bounce {
    let bands = scene.bands();
    let ray = |k: usize| {
        let (point, i) = (&from.points[k], from.particles[k]);
        let [s, t] = [0, 1].map(|d| halton.coordinate(dimension + d, i));
        Emitter::new(scene, tree, point.patch as usize).ray(point.x, cosine_direction(s, t))
    };
    let rays: Vec<Ray> = part.clone().map(ray).collect();
    let mut out = Bounce::default();
    for (k, (ray, hit)) in part.zip(rays.iter().zip(tree.closest(&rays))) {
        let Some(hit) = hit else { continue };
        let rho = &scene.reflectance()[hit.patch as usize * bands..][..bands];
        let reflected = rho.iter().zip(&from.power[k * bands..][..bands]).map(|(rho, power)| rho * power);
        let point = Point::of_hit(scene, &hit);
        if point.normal.dot(ray.direction) < 0.0 && reflected.clone().any(|power| power > 0.0) {
            out.particles.push(from.particles[k]);
            out.points.push(point);
            out.power.extend(reflected);
        }
    }
    out
}
