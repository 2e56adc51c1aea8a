//! What rays bring to the patches that they leave, sampled scramble by scramble and added up.
//!
//! Nothing is kept of a ray but its share in a sum: memory does not grow with their number. Every patch has
//! [`SCRAMBLES`] independent scrambles of one quasi-random sequence, and a sum for each.

use rayon::prelude::*;

use crate::assembly::rays::{Field, Row, Sample};
use crate::assembly::{Order, Trips};
use crate::direct::lamp::Point;
use crate::direct::patches::Direct;
use crate::direct::{Lamps, Lights, SCRAMBLES, Surroundings};
use crate::error::Result;
use crate::form_factor::emitter::Emitter;
use crate::geometry::sampling::{barycentric, cosine_direction, point_in_triangle};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::specular::{self, End, follow};
use crate::visibility::{Bvh, Ray};

/// Segments that every scramble first sends from a patch towards the lamps.
pub(super) const FIRST_SEGMENTS: u32 = 8;
/// Patches that are worked on together, and rays.
const PATCHES: usize = 8;
const BUNDLE: usize = 1024;

/// Sums of what rays have brought, for every patch, scramble and band.
#[derive(Debug, Clone)]
pub(super) struct Tally {
    bands: usize,
    sums: Vec<f64>,
    /// Rays of each scramble so far, a patch.
    rays: Vec<u32>,
    /// Of all its rays, those that leave the scene.
    pub(super) lost: Vec<u32>,
    /// Segments cast for them.
    pub(super) segments: u64,
}

impl Tally {
    pub(super) fn new(patches: usize, bands: usize) -> Tally {
        Tally {
            bands,
            sums: vec![0.0; patches * SCRAMBLES * bands],
            rays: vec![0; patches],
            lost: vec![0; patches],
            segments: 0,
        }
    }

    /// The means by scramble `s`, n x b.
    pub(super) fn means(&self, s: usize) -> Vec<f64> {
        let rows = self.sums.chunks_exact(SCRAMBLES * self.bands).zip(&self.rays);
        rows.flat_map(|(sums, m)| sums[s * self.bands..][..self.bands].iter().map(|sum| sum / f64::from(*m))).collect()
    }

    /// Rays cast from patch i, all scrambles together.
    pub(super) fn rays(&self, i: usize) -> u64 {
        SCRAMBLES as u64 * u64::from(self.rays[i])
    }

    /// All rays cast.
    pub(super) fn total(&self) -> u64 {
        (0..self.rays.len()).map(|i| self.rays(i)).sum()
    }
}

/// Where a ray has arrived.
struct Arrival {
    /// Which of the rays.
    ray: usize,
    point: Point,
    barycentric: [f64; 2],
}

/// Where rays have ended.
struct Arrivals {
    /// Those that arrived.
    arrived: Vec<Arrival>,
    /// Numbers of those that left the scene.
    lost: Vec<usize>,
}

/// What light starts from and what it meets.
pub(super) struct Ground<'a> {
    tree: Bvh,
    blockers: Bvh,
    pub(super) lamps: Lamps,
    lights: &'a Lights,
}

impl Ground<'_> {
    pub(super) fn new<'a>(scene: &Scene, lights: &'a Lights) -> Result<Ground<'a>> {
        let (tree, blockers, lamps) = (Bvh::of_scene(scene), Bvh::of_blockers(scene), Lamps::of_scene(scene)?);
        Ok(Ground { tree, blockers, lamps, lights })
    }

    fn of<'a>(&'a self, scene: &'a Scene) -> Surroundings<'a> {
        let Ground { tree, blockers, lamps, lights } = self;
        Surroundings { scene, lamps, lights, tree, blockers }
    }
}

/// Light on its way through a scene.
pub(super) struct Transport<'a> {
    scene: &'a Scene,
    ground: &'a Ground<'a>,
    /// What comes straight from the lamps.
    pub(super) direct: Direct<'a>,
    seed: u64,
}

/// Streams of random numbers that have nothing in common.
const BASE: usize = 0;
const PROBE: usize = SCRAMBLES;
const PILOT: usize = 2 * SCRAMBLES;

/// Dimensions of a sample: 0 and 1 the direction (it matters most, and they are the most even ones), 2 and 3 the origin, 4 and 5
/// the next ray of the probe, and from here on the point of a lamp. The base asks a lamp where its ray arrives, the probe where
/// the next one does.
const LAMP: usize = 4;
const NEXT_LAMP: usize = 6;

impl<'a> Transport<'a> {
    /// With form factors of the lamps to the relative error `kernels`.
    pub(super) fn new(
        scene: &'a Scene,
        ground: &'a Ground<'a>,
        kernels: f64,
        seed: u64,
        progress: &Progress,
    ) -> Result<Transport<'a>> {
        let direct = Direct::new(ground.of(scene), kernels, seed, FIRST_SEGMENTS, progress)?;
        Ok(Transport { scene, ground, direct, seed })
    }

    fn bands(&self) -> usize {
        self.scene.bands()
    }

    /// The points where the rays from patches meet the front of others first.
    fn first_arrivals(&self, samples: &[Sample]) -> Arrivals {
        let ray = |sample: &Sample| {
            let [s, t, u, v, ..] = sample.numbers;
            let i = sample.patch as usize;
            let origin = point_in_triangle(&self.scene.triangle(i), u, v);
            Emitter::new(self.scene, &self.ground.tree, i).ray(origin, cosine_direction(s, t))
        };
        self.arrivals((0..samples.len()).collect(), samples.iter().map(ray).collect())
    }

    /// The same for rays from where others have arrived.
    fn next_arrivals(&self, samples: &[Sample], from: &[Arrival]) -> Arrivals {
        let ray = |arrival: &Arrival| {
            let [.., s, t, _, _] = samples[arrival.ray].numbers;
            let emitter = Emitter::new(self.scene, &self.ground.tree, arrival.point.patch as usize);
            emitter.ray(arrival.point.x, cosine_direction(s, t))
        };
        self.arrivals(from.iter().map(|arrival| arrival.ray).collect(), from.iter().map(ray).collect())
    }

    fn arrivals(&self, numbers: Vec<usize>, rays: Vec<Ray>) -> Arrivals {
        let ends = follow(self.scene, &self.ground.tree, &rays);
        let mut arrivals = Arrivals { arrived: Vec::with_capacity(rays.len()), lost: Vec::new() };
        for (ray, end) in numbers.into_iter().zip(ends) {
            match end {
                End::Arrived(specular::Arrival { hit, .. }) => {
                    let point = Point::of_hit(self.scene, &hit);
                    arrivals.arrived.push(Arrival { ray, point, barycentric: hit.barycentric });
                }
                End::Absorbed => {}
                End::Lost => arrivals.lost.push(ray),
            }
        }
        arrivals
    }

    /// out_kb = what leaves the point of arrival k towards where the ray came from, of light that has come straight from the
    /// lamps and lights, and of emitters that no lamp stands for: rho H_direct + E. Returns the segments cast.
    fn first_light(&self, samples: &[Sample], arrivals: &[Arrival], lamp: usize, out: &mut [f64]) -> usize {
        let bands = self.bands();
        let points: Vec<Point> = arrivals.iter().map(|arrival| arrival.point).collect();
        let numbers = |k: usize| {
            let all = &samples[arrivals[k].ray].numbers;
            [all[lamp], all[lamp + 1]]
        };
        let in_view = |i: u32, l: usize| self.direct.in_view(i, l);
        let mut cast = self.ground.lamps.light(&points, &self.ground.blockers, numbers, in_view, out);
        // The same numbers serve both: their light is added up.
        cast += self.ground.lights.light(&points, &self.ground.tree, numbers, out);
        for (arrival, out) in arrivals.iter().zip(out.chunks_exact_mut(bands)) {
            let j = arrival.point.patch as usize;
            // The base and the probe, scramble by scramble, so that the spread of these knows that of caustics.
            let scramble = samples[arrival.ray].scramble as usize;
            self.direct.add_caustics(j, (scramble < PILOT).then_some(scramble % SCRAMBLES), out);
            out.iter_mut().zip(&self.scene.reflectance()[j * bands..]).for_each(|(out, rho)| *out *= rho);
            self.ground.lamps.add_glow(j, out);
        }
        cast
    }

    /// out_kb += rho times the field at the points of arrival.
    fn reflect(&self, arrivals: &[Arrival], field: &Field, out: &mut [f64]) {
        let bands = self.bands();
        for (arrival, out) in arrivals.iter().zip(out.chunks_exact_mut(bands)) {
            let j = arrival.point.patch;
            field.add(j, arrival.barycentric, &self.scene.reflectance()[j as usize * bands..][..bands], out);
        }
    }

    /// Rays that a solve starts from, `count` from each patch, and the first light that they bring, T0 D. The third is the
    /// number of segments cast.
    pub(super) fn pilot(&self, order: Order, count: usize, progress: &Progress) -> Result<(Trips, Field, u64)> {
        let bands = self.bands();
        progress.expect((self.scene.len() * count) as u64);
        let mut trips = Trips::new(order, count, self.scene.areas());
        let mut source = vec![0.0; self.scene.emission().len() * order.coefficients()];
        let row = |(i, (mut row, source)): (usize, (Row, &mut [f64]))| {
            progress.advance(count as u64)?;
            let samples: Vec<Sample> = Sample::rays(self.seed, i as u32, PILOT, 0..count as u32).collect();
            let arrivals = self.first_arrivals(&samples).arrived;
            for (k, Sample { numbers: [_, _, u, v, ..], .. }) in samples.iter().enumerate() {
                row.start(k, barycentric(*u, *v));
            }
            let mut light = vec![0.0; arrivals.len() * bands];
            let cast = self.first_light(&samples, &arrivals, LAMP, &mut light);
            let mut values = vec![0.0; count * bands];
            for (arrival, light) in arrivals.iter().zip(light.chunks_exact(bands)) {
                row.arrive(arrival.ray, arrival.point.patch);
                values[arrival.ray * bands..][..bands].copy_from_slice(light);
            }
            let value = |k: usize, row: &mut [f64]| row.copy_from_slice(&values[k * bands..][..bands]);
            row.add_projected(bands, value, source);
            Ok(cast as u64)
        };
        let sources = source.par_chunks_mut(order.coefficients() * bands);
        let segments: Result<Vec<u64>> = trips.rows().zip(sources).enumerate().map(row).collect();
        Ok((trips, Field::new(order, bands, source), segments?.iter().sum()))
    }

    /// Adds to the base tally the rays that it lacks of `wanted(i)` a scramble: what they bring of first light and of `field`.
    pub(super) fn gather(
        &self,
        tally: &mut Tally,
        field: Option<&Field>,
        wanted: impl Fn(usize) -> u32 + Sync,
        progress: &Progress,
    ) -> Result<()> {
        self.add(tally, BASE, wanted, progress, |samples, out, is_lost| {
            let Arrivals { arrived: arrivals, lost } = self.first_arrivals(samples);
            lost.into_iter().for_each(|ray| is_lost[ray] = true);
            let mut light = vec![0.0; arrivals.len() * self.bands()];
            let cast = self.first_light(samples, &arrivals, LAMP, &mut light);
            if let Some(field) = field {
                self.reflect(&arrivals, field, &mut light);
            }
            for (arrival, light) in arrivals.iter().zip(light.chunks_exact(self.bands())) {
                out[arrival.ray * self.bands()..][..self.bands()].copy_from_slice(light);
            }
            cast
        })
    }

    /// The same for the probe: rho (g - u - r) at the points of arrival, where g is what one more ray brings there, u is the
    /// field, and r(s) its residual on patches by scramble s.
    pub(super) fn probe(
        &self,
        tally: &mut Tally,
        field: &Field,
        residuals: &[Vec<f64>],
        wanted: impl Fn(usize) -> u32 + Sync,
        progress: &Progress,
    ) -> Result<()> {
        let bands = self.bands();
        self.add(tally, PROBE, wanted, progress, |samples, out, is_lost| {
            let Arrivals { arrived: arrivals, lost } = self.first_arrivals(samples);
            lost.into_iter().for_each(|ray| is_lost[ray] = true);
            let mut known = vec![0.0; arrivals.len() * bands];
            self.reflect(&arrivals, field, &mut known);
            let further = self.next_arrivals(samples, &arrivals).arrived;
            let mut light = vec![0.0; further.len() * bands];
            let cast = self.first_light(samples, &further, NEXT_LAMP, &mut light);
            self.reflect(&further, field, &mut light);
            let mut at = vec![usize::MAX; samples.len()];
            for (k, arrival) in arrivals.iter().enumerate() {
                at[arrival.ray] = arrival.point.patch as usize;
                let j = arrival.point.patch as usize * bands;
                let residual = &residuals[samples[arrival.ray].scramble as usize - PROBE];
                for b in 0..bands {
                    out[arrival.ray * bands + b] =
                        -known[k * bands + b] - self.scene.reflectance()[j + b] * residual[j + b];
                }
            }
            for (arrival, light) in further.iter().zip(light.chunks_exact(bands)) {
                let j = at[arrival.ray] * bands;
                for b in 0..bands {
                    out[arrival.ray * bands + b] += self.scene.reflectance()[j + b] * light[b];
                }
            }
            cast
        })
    }

    /// Casts the rays that the tally lacks and adds what `bring` says of each: (samples, their values, whether they are lost).
    fn add(
        &self,
        tally: &mut Tally,
        stream: usize,
        wanted: impl Fn(usize) -> u32 + Sync,
        progress: &Progress,
        bring: impl Fn(&[Sample], &mut [f64], &mut [bool]) -> usize + Sync,
    ) -> Result<()> {
        let bands = self.bands();
        let n = tally.rays.len();
        let more = |i: usize, have: u32| u64::from(wanted(i).saturating_sub(have)) * SCRAMBLES as u64;
        progress.expect((0..n).map(|i| more(i, tally.rays[i])).sum());
        let groups = tally
            .sums
            .par_chunks_mut(PATCHES * SCRAMBLES * bands)
            .zip(tally.rays.par_chunks_mut(PATCHES))
            .zip(tally.lost.par_chunks_mut(PATCHES));
        let cast: Result<Vec<u64>> = groups
            .enumerate()
            .map(|(group, ((sums, rays), lost))| {
                let first = group * PATCHES;
                let ranges: Vec<_> =
                    rays.iter().enumerate().map(|(p, have)| *have..wanted(first + p).max(*have)).collect();
                let of_scramble =
                    |p: usize, s: usize| Sample::rays(self.seed, (first + p) as u32, stream + s, ranges[p].clone());
                let mut all = (0..ranges.len()).flat_map(|p| (0..SCRAMBLES).flat_map(move |s| of_scramble(p, s)));
                let mut cast = 0;
                loop {
                    let samples: Vec<Sample> = all.by_ref().take(BUNDLE).collect();
                    if samples.is_empty() {
                        break;
                    }
                    let (mut values, mut is_lost) = (vec![0.0; samples.len() * bands], vec![false; samples.len()]);
                    cast += bring(&samples, &mut values, &mut is_lost) as u64;
                    for ((sample, value), is_lost) in samples.iter().zip(values.chunks_exact(bands)).zip(is_lost) {
                        let (p, s) = (sample.patch as usize - first, sample.scramble as usize - stream);
                        let sums = &mut sums[(p * SCRAMBLES + s) * bands..][..bands];
                        sums.iter_mut().zip(value).for_each(|(sum, value)| *sum += value);
                        lost[p] += u32::from(is_lost);
                    }
                    progress.advance(samples.len() as u64)?;
                }
                rays.iter_mut().zip(&ranges).for_each(|(have, range)| *have = range.end);
                Ok(cast)
            })
            .collect();
        tally.segments += cast?.iter().sum::<u64>();
        Ok(())
    }
}
