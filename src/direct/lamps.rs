//! Which emitters of a scene are lamps, and their light at many points.
//!
//! Emitters in one plane with one emission are merged to convex polygons first: a lamp of a thousand patches costs no more
//! than one of two. Then the brightest are taken, as many as pay. With the lamps 1..k apart, what rays from a patch still
//! find has a second moment of about
//!
//!   sum over j > k of E_j^2 A_j / A  +  R^2,    R = rho / (1 - rho) x (power emitted) / A
//!
//! where R is the mean reflected radiosity of a closed scene (Cohen et al. 1988, "ambient"), and a ray costs 1 plus what the
//! lamps add. The k with the least product is chosen: the one square of a ceiling light, however finely it is meshed; none
//! where all walls glow and reflect half of what arrives.
//!
//! At a point x all form factors F_l are known and one lamp is asked, with probability p_l in proportion to E_l F_l, whether
//! its point z is hidden. Both
//!
//!   E_l F_l - E_l (1 - V) w / p_l    and    E_l V w / p_l
//!
//! have the mean E_l integral of V K (see [`Lamp::sample`]). The first has no noise where the lamp is in full view, the second
//! none where it is hidden: the first is used on patches that see most of the lamp.

use super::flat_parts::{flat_parts, groups};
use super::lamp::{Lamp, Point};
use super::mirrors::FlatMirror;
use crate::error::Result;
use crate::geometry::Vec3;
use crate::scene::Scene;
use crate::simd::Instructions;
use crate::visibility::{Bvh, NO_PATCH, Segment};

/// Never more lamps than this: as many as a word has bits.
const MOST: usize = u64::BITS as usize;
/// What asking a lamp costs, in rays: to choose it and a point of it, and the segment.
const SEGMENT_COST: f64 = 0.7;
/// What the form factor of one more lamp costs.
const LAMP_COST: f64 = 0.15;

/// The lamps of a scene, the brightest first, and after them their images in flat mirrors.
pub struct Lamps {
    /// The lamps.
    pub lamps: Vec<Lamp>,
    /// The mirrors in which lamps have images.
    mirrors: Vec<FlatMirror>,
    /// Whether each patch belongs to one of them; empty where there is none.
    pub(super) reflects: Vec<bool>,
    /// E of what is no lamp, n x b; empty where all emitters are lamps.
    pub glow: Vec<f64>,
    bands: usize,
    /// The units in which the bands are added up, so that none counts for its size.
    scale: Vec<f64>,
    instructions: Instructions,
}

impl Lamps {
    /// No lamps, for a scene of `bands` bands.
    pub fn none(bands: usize) -> Lamps {
        let (lamps, mirrors, reflects, glow) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Lamps { lamps, mirrors, reflects, glow, bands, scale: vec![1.0; bands], instructions: Instructions::best() }
    }

    /// Chooses the lamps of a scene.
    ///
    /// # Errors
    /// Those of [`Scene::new`] for the emitting part alone.
    pub fn of_scene(scene: &Scene) -> Result<Lamps> {
        let bands = scene.bands();
        let total: f64 = scene.areas().iter().sum();
        let mean = |values: &[f64], b: usize| {
            scene.areas().iter().enumerate().map(|(i, a)| a / total * values[i * bands + b]).sum::<f64>()
        };
        let emitted: Vec<f64> = (0..bands).map(|b| mean(scene.emission(), b)).collect();
        let scale: Vec<f64> = emitted.iter().map(|e| if *e > 0.0 { 1.0 / e } else { 0.0 }).collect();
        // In units of the mean emission of each band.
        let brightness = |emission: &[f64]| emission.iter().zip(&scale).map(|(e, s)| (e * s).powi(2)).sum::<f64>();
        let ambient = |b: usize| {
            let rho = mean(scene.reflectance(), b).min(0.999);
            if emitted[b] > 0.0 { (rho / (1.0 - rho)).powi(2) } else { 0.0 }
        };
        let reflected: f64 = (0..bands).map(ambient).sum();

        let mut found = Vec::new();
        let emits = |i: usize| {
            let emission = &scene.emission()[i * bands..][..bands];
            emission.iter().any(|e| *e > 0.0).then(|| emission.iter().map(|e| e.to_bits()).collect())
        };
        for group in groups(scene, emits) {
            let emission = &scene.emission()[group[0] as usize * bands..][..bands];
            let surface = |(ring, patches): (Vec<Vec3>, _)| Surface { lamps: Lamp::fan_of(&ring, emission), patches };
            found.extend(flat_parts(scene, &group)?.into_iter().map(surface));
        }
        let bright = |surface: &Surface| brightness(&surface.lamps[0].emission);
        let moment = |surface: &Surface| bright(surface) * surface.lamps.iter().map(Lamp::area).sum::<f64>() / total;
        found.sort_by(|a, b| bright(b).total_cmp(&bright(a)));
        let mut rest: f64 = reflected + found.iter().map(moment).sum::<f64>();
        let (mut count, mut least, mut lamps) = (0, rest, 0);
        for (k, surface) in found.iter().enumerate() {
            rest -= moment(surface);
            lamps += surface.lamps.len();
            if lamps > MOST {
                break;
            }
            let cost = (1.0 + SEGMENT_COST + LAMP_COST * lamps as f64) * rest.max(reflected);
            if cost < least {
                (count, least) = (k + 1, cost);
            }
        }
        found.truncate(count);
        let mut glow = scene.emission().to_vec();
        for &i in found.iter().flat_map(|surface| &surface.patches) {
            glow[i as usize * bands..][..bands].fill(0.0);
        }
        if glow.iter().all(|e| *e == 0.0) {
            glow = Vec::new();
        }
        let mut lamps: Vec<Lamp> = found.into_iter().flat_map(|surface| surface.lamps).collect();
        let (mut mirrors, mut reflects) = (Vec::new(), Vec::new());
        if !scene.is_diffuse() && !lamps.is_empty() {
            let real = lamps.clone();
            reflects = vec![false; scene.len()];
            for mirror in FlatMirror::of_scene(scene)? {
                let mut images: Vec<Lamp> = real.iter().flat_map(|lamp| mirror.images(lamp)).collect();
                if lamps.len() + images.len() > MOST {
                    break;
                }
                images.iter_mut().for_each(|image| image.mirror = Some(mirrors.len()));
                lamps.extend(images);
                mirror.patches.iter().for_each(|&i| reflects[i as usize] = true);
                mirrors.push(mirror);
            }
        }
        Ok(Lamps { lamps, glow, mirrors, reflects, bands, scale, instructions: Instructions::best() })
    }

    /// Emission of a lamp in all bands together, in units of the mean emissions.
    pub(super) fn power(&self, l: usize) -> f64 {
        self.lamps[l].emission.iter().zip(&self.scale).map(|(e, s)| e * s).sum()
    }

    /// out_kb = direct irradiance at point k, W/m^2: an unbiased sample with the random `numbers(k)` in the unit square.
    /// `in_view(i, l)`: whether patch i sees most of lamp l. Without blockers the answer is exact. Returns the segments cast.
    pub fn light(
        &self,
        points: &[Point],
        blockers: &Bvh,
        numbers: impl Fn(usize) -> [f64; 2],
        in_view: impl Fn(u32, usize) -> bool,
        out: &mut [f64],
    ) -> usize {
        let (count, bands) = (self.lamps.len(), self.bands);
        out.fill(0.0);
        if count == 0 || points.is_empty() {
            return 0;
        }
        let factors = self.form_factors(points);
        let free = self.is_free(blockers);
        for (l, lamp) in self.lamps.iter().enumerate() {
            for (k, point) in points.iter().enumerate() {
                let f = factors[l * points.len() + k];
                if f > 0.0 && (free || in_view(point.patch, l)) {
                    out[k * bands..][..bands].iter_mut().zip(&lamp.emission).for_each(|(out, e)| *out += f * e);
                }
            }
        }
        if free {
            return 0;
        }
        let (asked, segments) = self.ask(points, &factors, |_, _| 1.0, numbers);
        let hidden = self.hidden(blockers, |k| asked[k].lamp, &segments);
        for (Asked { point: k, lamp: l, weight }, blocked) in asked.into_iter().zip(hidden) {
            let sign = match (in_view(points[k].patch, l), blocked) {
                (true, true) => -1.0,
                (false, false) => 1.0,
                _ => continue,
            };
            let row = out[k * bands..][..bands].iter_mut();
            row.zip(&self.lamps[l].emission).for_each(|(out, e)| *out += sign * weight * e);
        }
        segments.len()
    }

    /// The mirrors in which lamps have images, each by its patches.
    pub(super) fn mirrors(&self) -> impl Iterator<Item = &[u32]> {
        self.mirrors.iter().map(|mirror| mirror.patches.as_slice())
    }

    /// Whether every point sees all of the lamps that shine on it.
    pub fn is_free(&self, blockers: &Bvh) -> bool {
        blockers.is_empty() && self.mirrors.is_empty()
    }

    /// Whether the points of lamps at the ends of segments are hidden; segment k leads to lamp `lamp(k)`.
    pub fn hidden(&self, blockers: &Bvh, lamp: impl Fn(usize) -> usize, segments: &[Segment]) -> Vec<bool> {
        if self.mirrors.is_empty() {
            return blockers.blocked(segments);
        }
        // A way over a mirror has two parts.
        let (mut parts, mut of) = (Vec::with_capacity(segments.len()), Vec::with_capacity(segments.len()));
        let mut hidden = vec![false; segments.len()];
        for (k, segment) in segments.iter().enumerate() {
            match self.lamps[lamp(k)].mirror.map(|m| self.mirrors[m].folded(segment)) {
                None => parts.push(*segment),
                Some(Some(folded)) => parts.extend(folded),
                Some(None) => hidden[k] = true,
            }
            of.resize(parts.len(), k);
        }
        for (k, blocked) in of.into_iter().zip(blockers.blocked(&parts)) {
            hidden[k] |= blocked;
        }
        hidden
    }

    /// The same for segments from one patch to one lamp.
    pub(super) fn hidden_between(&self, blockers: &Bvh, lamp: usize, segments: &[Segment]) -> Vec<bool> {
        match self.lamps[lamp].mirror {
            None => blockers.blocked_between(segments),
            Some(_) => self.hidden(blockers, |_| lamp, segments),
        }
    }

    /// out_b += what patch j emits that no lamp stands for.
    pub fn add_glow(&self, j: usize, out: &mut [f64]) {
        if !self.glow.is_empty() {
            out.iter_mut().zip(&self.glow[j * self.bands..]).for_each(|(out, e)| *out += e);
        }
    }

    /// F_l of point k at l x points + k: the form factor from there to lamp l, unoccluded.
    pub fn form_factors(&self, points: &[Point]) -> Vec<f64> {
        let mut factors = vec![0.0; self.lamps.len() * points.len()];
        for (lamp, factors) in self.lamps.iter().zip(factors.chunks_exact_mut(points.len().max(1))) {
            lamp.form_factors(self.instructions, points, factors);
        }
        factors
    }

    /// Asks one lamp a point whether it is seen, with probability p_l in proportion to E_l F_l times the `interest` in lamp l at
    /// point k: the segments to cast, and what each of them stands for. Points without light ask nothing.
    pub fn ask(
        &self,
        points: &[Point],
        factors: &[f64],
        interest: impl Fn(usize, usize) -> f64,
        numbers: impl Fn(usize) -> [f64; 2],
    ) -> (Vec<Asked>, Vec<Segment>) {
        let count = self.lamps.len();
        let powers: Vec<f64> = (0..count).map(|l| self.power(l)).collect();
        let (mut asked, mut segments) = (Vec::new(), Vec::new());
        for (k, point) in points.iter().enumerate() {
            let share = |l: usize| powers[l] * factors[l * points.len() + k] * interest(k, l);
            let total: f64 = (0..count).map(share).sum();
            if !(total > 0.0) {
                continue;
            }
            // The first number says which lamp, and what is left of it where on the lamp.
            let [u, v] = numbers(k);
            let (mut l, mut left) = (0, u * total);
            while l + 1 < count && left >= share(l) {
                left -= share(l);
                l += 1;
            }
            let (end, weight) = self.lamps[l].sample(point, (left / share(l)).min(1.0), v);
            if weight > 0.0 && share(l) > 0.0 {
                asked.push(Asked { point: k, lamp: l, weight: weight * total / share(l) });
                segments.push(Segment { start: point.x, end, exclude: [point.patch, NO_PATCH] });
            }
        }
        (asked, segments)
    }
}

/// One question: does a point see a point of a lamp?
#[derive(Debug, Clone, Copy)]
pub struct Asked {
    /// Number of the point.
    pub point: usize,
    /// Number of the lamp.
    pub lamp: usize,
    /// w / p: the mean of weight x visibility over all questions is the form factor from the point, occluded.
    pub weight: f64,
}

/// A convex surface that emits evenly.
struct Surface {
    lamps: Vec<Lamp>,
    patches: Vec<u32>,
}
