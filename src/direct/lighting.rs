//! The light of suns, points, spots and skies averaged over patches.
//!
//!   H0_i = 1/A_i  integral over patch i of H0(x) dA,    by [`SCRAMBLES`] independent scrambles, whose spread is the standard error
//!
//! A sun lights a flat patch evenly: its cosine is exact, and only the visible part is sampled. So it is with a point: a patch
//! seen under the solid angle omega receives
//!
//!   H0_i = I omega / A_i  x  mean over directions to the patch of (part of the cone) x V
//!
//! because cos dA / r^2 is d omega (omega by Van Oosterom & Strackee 1983). A point that nothing hides makes no noise, however near;
//! and none a point or a sun that is hidden. Where the edge of a spot's beam crosses a patch, its cone takes directions as well as the
//! patch does, and both count by the balance heuristic (Veach & Guibas 1995): either may be a small part of the other.

use std::f64::consts::FRAC_PI_2;

use rayon::prelude::*;

use super::lamp::{Point, point_in_spherical_triangle};
use super::lights::{Cone, Light, Lights, Question, angle_between, is_before};
use super::{SCRAMBLES, Surroundings};
use crate::error::Result;
use crate::geometry::polygon::{Plane, centre};
use crate::geometry::sampling::{Sobol, hash, point_in_triangle};
use crate::geometry::{Triangle, Vec3};
use crate::progress::Progress;
use crate::visibility::{NO_PATCH, Segment};

/// Of random numbers, apart from those of lamps and caustics.
const STREAM: u64 = u64::MAX - 1;
/// Patches smaller than this, in distances of a point, take even points of their area: 1 / r^2 and the cosine vary by as much,
/// and rounding would be as large in directions of so small a solid angle.
const SMALL: f64 = 1e-4;
/// Of the samples, on patches where nothing has varied so far: a sliver of a shadow escapes a few.
const WATCH: f64 = 0.25;
/// Samples that are taken together.
const TOGETHER: u32 = 1024;
/// All patches together take no fewer: where these are few, what hides a small part of one counts.
const LEAST: usize = 1 << 16;

/// What the segments from a patch to a light have met.
const OPEN: u8 = 1;
const BLOCKED: u8 = 2;
const UNEVEN: u8 = OPEN | BLOCKED;

/// The light of the lights on every patch, by scramble.
#[derive(Debug, Clone)]
pub struct Lighting {
    bands: usize,
    /// n x scrambles x b.
    sums: Vec<f64>,
    /// Samples of each scramble so far, a patch.
    samples: Vec<u32>,
    /// n x lights.
    met: Vec<u8>,
    /// Segments cast.
    pub segments: u64,
}

/// How a patch is seen from a point.
struct Seen {
    position: Vec3,
    triangle: Triangle,
    plane: Plane,
    /// The solid angle, sr.
    omega: f64,
    /// omega / A.
    factor: f64,
    /// Unit vectors to the corners; none where the patch is too small for them.
    corners: Option<Triangle>,
}

impl Seen {
    fn new(position: Vec3, triangle: Triangle, plane: Plane, area: f64) -> Seen {
        let [a, b, c] = triangle.map(|corner| corner - position);
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        // Units of the patch's distance, so that no product vanishes.
        let [p, q, r] = [a / la, b / lb, c / lc];
        let volume = p.dot(((b - a) / lb).cross((c - a) / lc)).abs();
        let omega = 2.0 * volume.atan2(1.0 + p.dot(q) + q.dot(r) + r.dot(p));
        let middle = centre(&triangle);
        let radius = triangle.iter().map(|corner| corner.distance(middle)).fold(0.0, f64::max);
        let corners = (radius > SMALL * middle.distance(position)).then_some([p, q, r]);
        Seen { position, triangle, plane, omega, factor: omega / area, corners }
    }

    /// The point of the patch that belongs to (u, v) in the unit square.
    fn point(&self, u: f64, v: f64) -> Vec3 {
        let towards = |corners| self.towards(point_in_spherical_triangle(corners, u, v));
        // An edge seen at grazing incidence can throw the direction past the plane.
        self.corners.as_ref().and_then(towards).unwrap_or_else(|| point_in_triangle(&self.triangle, u, v))
    }

    /// Where a unit vector from the position meets the plane.
    fn towards(&self, along: Vec3) -> Option<Vec3> {
        let down = along.dot(self.plane.normal);
        (down < 0.0).then(|| self.position - self.plane.distance(self.position) / down * along)
    }

    /// A unit vector from the position if it meets the patch.
    fn holds(&self, along: Vec3) -> Option<Vec3> {
        let [p, q, r] = self.corners?;
        let sides = [p.cross(q), q.cross(r), r.cross(p)].map(|side| side.dot(along));
        let is_within = sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0);
        (is_within && p.dot(along) + q.dot(along) + r.dot(along) > 0.0).then_some(along)
    }
}

/// How a patch lies in the cone of a spot.
enum Beam<'a> {
    /// All of it in the full beam.
    Within,
    /// Nowhere.
    Beside,
    /// In part, or unevenly: with the solid angles of the patch and of the cone.
    Across { cone: &'a Cone, omega: f64, size: f64 },
}

impl<'a> Beam<'a> {
    fn new(cone: &'a Cone, seen: &Seen) -> Beam<'a> {
        let Some(corners) = &seen.corners else {
            // So small a patch is one direction.
            let part = cone.part((centre(&seen.triangle) - seen.position).normalize_or_zero());
            let is_even = part == 1.0 && cone.beam > SMALL;
            return if is_even { Beam::Within } else { Beam::of_cone(cone, seen) };
        };
        // Cones below a right angle are convex.
        let angles = corners.map(|corner| cone.angle(corner));
        let is_within = cone.beam < FRAC_PI_2 && angles.iter().all(|angle| *angle <= cone.beam);
        // All directions to the patch lie around its middle, none further from it than a corner.
        let middle = corners.iter().copied().sum::<Vec3>().normalize_or_zero();
        let radius = corners.iter().map(|corner| angle_between(middle, *corner)).fold(0.0, f64::max);
        let is_beside = radius < FRAC_PI_2 && cone.angle(middle) > cone.cutoff + radius;
        match (is_within, is_beside) {
            (true, _) => Beam::Within,
            (_, true) => Beam::Beside,
            _ => Beam::of_cone(cone, seen),
        }
    }

    fn of_cone(cone: &'a Cone, seen: &Seen) -> Beam<'a> {
        Beam::Across { cone, omega: seen.omega, size: cone.size() }
    }
}

impl Lighting {
    /// Without any light yet.
    pub fn new(patches: usize, bands: usize, lights: &Lights) -> Lighting {
        Lighting {
            bands,
            sums: vec![0.0; patches * SCRAMBLES * bands],
            samples: vec![0; patches],
            met: vec![0; patches * lights.len()],
            segments: 0,
        }
    }

    /// Brings the samples of every scramble up to `wanted(i)` for patch i, or a part of it where nothing varies.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`].
    pub fn sample(
        &mut self,
        surroundings: &Surroundings,
        wanted: impl Fn(usize) -> u32 + Sync,
        seed: u64,
        progress: &Progress,
    ) -> Result<()> {
        let (bands, lights) = (self.bands, surroundings.lights.len());
        let least = LEAST.div_ceil(self.samples.len().max(1) * SCRAMBLES) as u32;
        progress.expect(self.samples.len() as u64);
        let rows = self.sums.par_chunks_mut(SCRAMBLES * bands).zip(&mut self.samples).enumerate();
        let cast: Result<Vec<u64>> = rows
            .zip(self.met.par_chunks_mut(lights.max(1)))
            .map(|((i, (sums, samples)), met)| {
                progress.advance(0)?;
                let is_even = *samples > 0 && met.iter().all(|met| *met != UNEVEN);
                let target = if is_even { (WATCH * f64::from(wanted(i))).ceil() as u32 } else { wanted(i) };
                let target = target.max(least);
                let mut cast = 0;
                while *samples < target {
                    let next = target.min(*samples + TOGETHER);
                    for s in 0..SCRAMBLES {
                        let stream = hash(seed ^ hash(STREAM ^ hash(i as u64))).wrapping_add(s as u64);
                        let own = &mut sums[s * bands..][..bands];
                        cast += add(surroundings, i, &Sobol::new(stream), *samples..next, own, met);
                    }
                    *samples = next;
                    progress.advance(0)?;
                }
                progress.advance(1)?;
                Ok(cast)
            })
            .collect();
        self.segments += cast?.iter().sum::<u64>();
        Ok(())
    }

    /// Samples of all scrambles on patches where they vary, over all lights: those whose number [`Lighting::sample`] raises.
    pub fn uneven(&self, lights: &Lights) -> u64 {
        let of = |(met, samples): (&[u8], &u32)| {
            let is_uneven = met.contains(&UNEVEN);
            if is_uneven { met.len() as u64 * SCRAMBLES as u64 * u64::from(*samples) } else { 0 }
        };
        self.met.chunks_exact(lights.len().max(1)).zip(&self.samples).map(of).sum()
    }

    /// out_b += H0 of patch i by scramble `s`, or by all.
    pub fn add(&self, i: usize, s: Option<usize>, out: &mut [f64]) {
        let own = &self.sums[i * SCRAMBLES * self.bands..][..SCRAMBLES * self.bands];
        let chosen = s.map_or(0..SCRAMBLES, |s| s..s + 1);
        let share = 1.0 / (chosen.len() as f64 * f64::from(self.samples[i].max(1)));
        for s in chosen {
            out.iter_mut().zip(&own[s * self.bands..]).for_each(|(out, sum)| *out += share * sum);
        }
    }

    /// Samples of each scramble of patch i so far.
    pub fn samples(&self, i: usize) -> u32 {
        self.samples[i]
    }

    /// Bytes that it takes.
    pub fn nbytes(&self) -> u64 {
        (size_of_val(self.sums.as_slice()) + size_of_val(self.samples.as_slice()) + size_of_val(self.met.as_slice()))
            as u64
    }
}

/// Adds the samples `numbers` of patch i to `sums`, and to `met` what they have met. Returns the segments cast.
fn add(
    surroundings: &Surroundings,
    i: usize,
    sobol: &Sobol<4>,
    numbers: std::ops::Range<u32>,
    sums: &mut [f64],
    met: &mut [u8],
) -> u64 {
    let Surroundings { scene, lights, tree, .. } = *surroundings;
    let (triangle, normal, patch) = (scene.triangle(i), scene.normals()[i], i as u32);
    let mut cast = 0;
    for (l, (light, met)) in lights.lights.iter().zip(met).enumerate() {
        let seen = match light {
            Light::Point { position, .. } => {
                if !is_before(&Point { x: triangle[0], normal, patch }, *position) {
                    continue;
                }
                Some(Seen::new(*position, triangle, scene.plane(i), scene.areas()[i]))
            }
            Light::Sun { towards, .. } if normal.dot(*towards) <= 0.0 => continue,
            _ => None,
        };
        let (mut questions, mut segments): (Vec<Question>, Vec<Segment>) = (Vec::new(), Vec::new());
        let mut ask = |x: Vec3, question: Question| {
            questions.push(question);
            segments.push(Segment { start: x, end: question.end, exclude: [patch, NO_PATCH] });
        };
        let beam = match (light, &seen) {
            (Light::Point { cone: Some(cone), .. }, Some(seen)) => Some(Beam::new(cone, seen)),
            _ => None,
        };
        for k in numbers.clone() {
            let [a, b, u, v] = sobol.point(k);
            match (light, &seen, &beam) {
                (_, Some(seen), Some(Beam::Across { cone, omega, size })) => {
                    // The patch's own directions, and the cone's.
                    let of_patch = (seen.point(u, v) - seen.position).normalize_or_zero();
                    for along in [Some(of_patch), seen.holds(cone.direction(a, b))].into_iter().flatten() {
                        let factor = cone.part(along) * seen.factor / (1.0 + omega / size);
                        if let Some(x) = seen.towards(along).filter(|_| factor > 0.0) {
                            ask(x, Question { end: seen.position, cell: 0, factor });
                        }
                    }
                }
                (_, Some(_), Some(Beam::Beside)) => {}
                (_, Some(seen), _) => {
                    ask(seen.point(u, v), Question { end: seen.position, cell: 0, factor: seen.factor });
                }
                _ => {
                    let x = point_in_triangle(&triangle, u, v);
                    match lights.question(l, tree, &Point { x, normal, patch }, [a, b]) {
                        Some(question) => ask(x, question),
                        None => *met |= BLOCKED,
                    }
                }
            }
        }
        let hidden = tree.blocked_between(&segments);
        let is_even = match light {
            Light::Sun { .. } | Light::Point { .. } => !matches!(beam, Some(Beam::Across { .. })),
            Light::Sky(sky) => sky.is_constant(),
        };
        let mut open = questions.iter().zip(hidden).filter_map(|(question, blocked)| {
            *met |= if blocked { BLOCKED } else { OPEN };
            (!blocked).then_some(question)
        });
        if is_even {
            // All alike: one product rounds less than a sum.
            if let Some(Question { cell, factor, .. }) = open.next() {
                lights.add(l, *cell, (1 + open.count()) as f64 * factor, sums);
            }
        } else {
            open.for_each(|question| lights.add(l, question.cell, question.factor, sums));
        }
        if !is_even && (beam.is_some() || *met & OPEN != 0) {
            *met |= UNEVEN;
        }
        cast += segments.len() as u64;
    }
    cast
}
