//! Caustics: light of the lamps by way of glass, of bent mirrors, or of more than one mirror.
//!
//! Rays that leave a diffuse patch would have to find a small lamp by way of glass: that is noise. Here rays go the other way: from a
//! lamp to a specular surface, and on until they end on a diffuse patch (Arvo, "Backward ray tracing", SIGGRAPH 1986
//! courses). From point y of specular surfaces of area A, and lamp l chosen with probability p_l,
//!
//!   power = E_l w(y, z) A / p_l    arrives where the ray ends,    H_i += power / (A_i m)
//!
//! for m rays, with the weight w of a point z of the lamp as in [`super::lamp`], and on every mirror that the ray falls on before.
//! What flat mirrors show of lamps once is known in closed form ([`super::mirrors`]): rays from lamps do not start there, those
//! from their images in other mirrors do.
//!
//! Known as patch averages only: a patch is lit evenly by them.

use std::ops::Range;

use rayon::prelude::*;

use super::lamp::{Lamp, Point};
use super::lamps::Lamps;
use super::{SCRAMBLES, Surroundings};
use crate::error::Result;
use crate::geometry::sampling::{Sobol, barycentric, hash, point_in_triangle};
use crate::progress::Progress;
use crate::scene::{Material, Scene};
use crate::visibility::specular::{End, chosen, follow_past_mirrors};
use crate::visibility::{Hit, NO_PATCH, Ray, Segment};

/// Of random numbers, apart from those of patches and lamps.
const STREAM: u64 = u64::MAX;
/// The number of the first turn for chance, one that no later turn has.
const FIRST_TURN: u32 = u32::MAX;
/// Rays that are followed together.
const TOGETHER: u32 = 1024;
/// Rays whose ends are kept until they are summed up.
const AT_ONCE: usize = 1 << 20;

/// A side of a specular patch.
#[derive(Debug, Clone, Copy)]
struct Start {
    patch: u32,
    /// 1 for the front, -1 for the back of glass.
    side: f64,
}

/// Sides of patches to start from, one by its area.
#[derive(Debug, Clone, Default)]
struct Starts {
    sides: Vec<Start>,
    /// Areas summed up.
    cumulated: Vec<f64>,
}

impl Starts {
    fn new(scene: &Scene, is_wanted: impl Fn(usize) -> bool) -> Starts {
        let mut starts = Starts::default();
        let mut sum = 0.0;
        for i in (0..scene.len()).filter(|i| is_wanted(*i)) {
            let sides: &[f64] = match scene.material(i) {
                Material::Diffuse => &[],
                Material::Mirror(_) => &[1.0],
                Material::Glass(_) => &[1.0, -1.0],
            };
            for &side in sides {
                sum += scene.areas()[i];
                starts.sides.push(Start { patch: i as u32, side });
                starts.cumulated.push(sum);
            }
        }
        starts
    }

    fn area(&self) -> f64 {
        self.cumulated.last().copied().unwrap_or(0.0)
    }

    fn choose(&self, u: f64) -> Start {
        let k = self.cumulated.partition_point(|sum| *sum <= u * self.area());
        self.sides[k.min(self.sides.len() - 1)]
    }
}

/// The light of caustics, by scramble.
#[derive(Debug, Clone)]
pub struct Caustics {
    /// Where rays from lamps start, and after that, mirror by mirror, those from the images in it: everywhere else.
    starts: Vec<Starts>,
    /// Of the lamps, their share of the rays summed up.
    cumulated: Vec<f64>,
    bands: usize,
    /// Sums of power over area, n x scrambles x b.
    sums: Vec<f64>,
    /// Rays of each scramble so far.
    pub rays: u32,
}

/// Which of the starts belong to a lamp.
fn start_of(lamp: &Lamp) -> usize {
    lamp.mirror.map_or(0, |mirror| mirror + 1)
}

/// What falls on a patch: its number, that of the lamp, and the power per unit of emission.
type Deposit = (u32, u32, f64);

impl Caustics {
    /// Without any light yet; `None` where there can be none.
    pub fn of_scene(scene: &Scene, lamps: &Lamps) -> Option<Caustics> {
        if scene.is_diffuse() {
            return None;
        }
        let is_flat_mirror = |i: usize| lamps.reflects.get(i).is_some_and(|reflects| *reflects);
        let of_images = |patches: &[u32]| {
            let mut is_own = vec![false; scene.len()];
            patches.iter().for_each(|&i| is_own[i as usize] = true);
            Starts::new(scene, |i| !is_own[i])
        };
        let mut starts = vec![Starts::new(scene, |i| !is_flat_mirror(i))];
        starts.extend(lamps.mirrors().map(of_images));
        let mut sum = 0.0;
        let cumulated: Vec<f64> = (0..lamps.lamps.len())
            .map(|l| {
                sum += lamps.power(l) * lamps.lamps[l].area() * starts[start_of(&lamps.lamps[l])].area();
                sum
            })
            .collect();
        let bands = scene.bands();
        (sum > 0.0).then(|| Caustics {
            starts,
            cumulated,
            bands,
            sums: vec![0.0; scene.len() * SCRAMBLES * bands],
            rays: 0,
        })
    }

    /// Brings the rays of every scramble up to `wanted`.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`].
    pub fn sample(&mut self, surroundings: &Surroundings, wanted: u32, seed: u64, progress: &Progress) -> Result<()> {
        let Surroundings { scene, lamps, .. } = *surroundings;
        for s in 0..SCRAMBLES {
            let sobol: Sobol<6> = Sobol::new(hash(seed ^ hash(STREAM)).wrapping_add(s as u64));
            let firsts: Vec<u32> = (self.rays..wanted).step_by(TOGETHER as usize).collect();
            for firsts in firsts.chunks(AT_ONCE / TOGETHER as usize) {
                let found: Result<Vec<Vec<Deposit>>> = firsts
                    .par_iter()
                    .map(|&first| {
                        progress.advance(0)?;
                        Ok(self.cast(surroundings, &sobol, first..wanted.min(first + TOGETHER)))
                    })
                    .collect();
                for (patch, lamp, power) in found?.into_iter().flatten() {
                    let at = (patch as usize * SCRAMBLES + s) * self.bands;
                    let area = scene.areas()[patch as usize];
                    let sums = self.sums[at..][..self.bands].iter_mut();
                    sums.zip(&lamps.lamps[lamp as usize].emission).for_each(|(sum, e)| *sum += e * power / area);
                }
            }
        }
        self.rays = self.rays.max(wanted);
        Ok(())
    }

    /// Casts the rays `numbers` of one scramble.
    fn cast(&self, surroundings: &Surroundings, sobol: &Sobol<6>, numbers: Range<u32>) -> Vec<Deposit> {
        let Surroundings { scene, lamps, tree, blockers, .. } = *surroundings;
        let whole = self.cumulated.last().copied().unwrap_or(0.0);
        let (mut started, mut segments, mut hits) = (Vec::new(), Vec::new(), Vec::new());
        for k in numbers {
            let [choice, which, u, v, a, b] = sobol.point(k);
            let l = self.cumulated.partition_point(|sum| *sum <= choice * whole).min(self.cumulated.len() - 1);
            let probability = (self.cumulated[l] - if l > 0 { self.cumulated[l - 1] } else { 0.0 }) / whole;
            let starts = &self.starts[start_of(&lamps.lamps[l])];
            if !(probability > 0.0) {
                continue;
            }
            let Start { patch, side } = starts.choose(which);
            let triangle = scene.triangle(patch as usize);
            let x = point_in_triangle(&triangle, u, v);
            let point = Point { x, normal: side * scene.normals()[patch as usize], patch };
            let lamp = &lamps.lamps[l];
            if !lamp.shines_on(x) {
                continue;
            }
            let (z, weight) = lamp.sample(&point, a, b);
            if weight > 0.0 {
                started.push((l as u32, weight * starts.area() / probability));
                segments.push(Segment { start: x, end: z, exclude: [patch, NO_PATCH] });
                hits.push(Hit { patch, t: 1.0, barycentric: barycentric(u, v) });
            }
        }
        let hidden = lamps.hidden(blockers, |k| started[k].0 as usize, &segments);
        let (mut of, mut rays) = (Vec::new(), Vec::new());
        for (k, (segment, hit)) in segments.iter().zip(&hits).enumerate() {
            let ray = Ray { origin: segment.end, direction: segment.start - segment.end, exclude: NO_PATCH };
            if !hidden[k]
                && let Some(ray) = chosen(scene, &ray, hit, FIRST_TURN)
            {
                of.push(started[k]);
                rays.push(ray);
            }
        }
        let mut deposits = Vec::new();
        let at_mirror = |k: usize, patch: u32| deposits.push((patch, of[k].0, of[k].1));
        let ends = follow_past_mirrors(scene, tree, &rays, at_mirror);
        let at_end = |(&(lamp, power), end): (&(u32, f64), End)| end.arrival().map(|at| (at.hit.patch, lamp, power));
        deposits.extend(of.iter().zip(ends).filter_map(at_end));
        deposits
    }

    /// out_b += the irradiance of patch i by scramble `s`.
    pub fn add_of_scramble(&self, i: usize, s: usize, out: &mut [f64]) {
        let own = &self.sums[(i * SCRAMBLES + s) * self.bands..][..self.bands];
        out.iter_mut().zip(own).for_each(|(out, sum)| *out += sum / f64::from(self.rays.max(1)));
    }

    /// out_b += the irradiance of patch i.
    pub fn add(&self, i: usize, out: &mut [f64]) {
        let share = 1.0 / (SCRAMBLES as f64 * f64::from(self.rays.max(1)));
        for own in self.sums[i * SCRAMBLES * self.bands..][..SCRAMBLES * self.bands].chunks_exact(self.bands) {
            out.iter_mut().zip(own).for_each(|(out, sum)| *out += share * sum);
        }
    }

    /// Bytes that it takes.
    pub fn nbytes(&self) -> u64 {
        size_of_val(self.sums.as_slice()) as u64
    }
}
