//! The light of the lamps averaged over patches.
//!
//!   H_i = sum over lamps l of  E_l F_il v_il,    v_il = sum over s of w_s V_s  /  sum over s of w_s
//!
//! F_il is the exact unoccluded form factor, v_il the visible fraction by segments from quasi-random points of the patch to
//! points of the lamp, weighted as in [`super::lamp`]: a lamp in full view and a lamp behind a wall make no noise. The
//! segments are [`SCRAMBLES`] independent scrambles of one sequence, whose spread is the standard error. Patches in half-shadow get
//! more of them, until the error is the one asked for. What comes from other lights is added ([`super::lighting`]).

use rayon::prelude::*;

use super::caustics::Caustics;
use super::lamp::Point;
use super::lighting::Lighting;
use super::{SCRAMBLES, Surroundings};
use crate::error::Result;
use crate::form_factor::{Accuracy, Batch, Shape};
use crate::geometry::sampling::{Sobol, hash, point_in_triangle};
use crate::progress::Progress;
use crate::visibility::{NO_PATCH, Segment};

/// Share of the segments that watch lamps on which all segments have agreed so far: a sliver of a shadow escapes a few.
const WATCH: f64 = 0.25;

/// The most rays of caustics in a scramble, and what one costs, in segments.
const MOST_CAUSTIC_RAYS: u64 = 1 << 26;
const CAUSTIC_COST: u64 = 6;

/// What the segments of one scramble from a patch to a lamp have seen.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    visible: f64,
    all: f64,
}

/// A lamp as one patch sees it.
#[derive(Debug, Clone)]
struct View {
    lamp: u32,
    /// F_il, unoccluded.
    form_factor: f64,
    /// Segments of each scramble so far, and its share of the next ones.
    segments: u32,
    share: f64,
    seen: [Seen; SCRAMBLES],
}

impl View {
    /// The visible fraction by all segments.
    fn fraction(&self) -> f64 {
        let (visible, all) = self.seen.iter().fold((0.0, 0.0), |(v, a), seen| (v + seen.visible, a + seen.all));
        // Where no sampled point of the patch lay before the lamp, what the form factor holds is next to nothing.
        if all > 0.0 { visible / all } else { 1.0 }
    }

    /// Whether it is seen in part.
    fn is_partial(&self) -> bool {
        let v = self.fraction();
        v > 0.0 && v < 1.0
    }

    /// The fraction as scramble `s` alone has it, linearised around that of all: their mean is that of all.
    fn of_scramble(&self, s: usize) -> f64 {
        let v = self.fraction();
        let all: f64 = self.seen.iter().map(|seen| seen.all).sum();
        if all > 0.0 { v + SCRAMBLES as f64 * (self.seen[s].visible - v * self.seen[s].all) / all } else { v }
    }
}

/// The direct irradiance of every patch.
pub struct Direct<'a> {
    surroundings: Surroundings<'a>,
    seed: u64,
    caustics: Option<Caustics>,
    lighting: Option<Lighting>,
    views: Vec<Vec<View>>,
    /// For each patch the lamps that it sees most of, a bit each.
    in_view: Vec<u64>,
    /// Segments cast.
    pub segments: u64,
}

impl<'a> Direct<'a> {
    /// The unoccluded form factors of every patch and lamp, to the relative `tolerance`, and the first segments: `each` for
    /// every patch and scramble.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for a tolerance out of range, [`crate::Error::Interrupted`].
    pub fn new(
        surroundings: Surroundings<'a>,
        tolerance: f64,
        seed: u64,
        each: u32,
        progress: &Progress,
    ) -> Result<Direct<'a>> {
        let Surroundings { scene, lamps, .. } = surroundings;
        let accuracy = Accuracy::new(tolerance)?;
        let shapes: Vec<Shape> = lamps.lamps.iter().map(|lamp| Shape::new(lamp.corners())).collect();
        let views: Result<Vec<Vec<View>>> = (0..scene.len())
            .into_par_iter()
            .map_init(Batch::new, |batch, i| {
                if shapes.is_empty() {
                    return Ok(Vec::new());
                }
                progress.advance(0)?;
                let triangle = scene.triangle(i);
                let own = Shape::new(&triangle);
                let views = shapes.iter().enumerate().filter_map(|(l, shape)| {
                    let form_factor = batch.exchange(&own, shape, &accuracy) / own.area;
                    let seen = [Seen::default(); SCRAMBLES];
                    (form_factor > 0.0).then_some(View { lamp: l as u32, form_factor, segments: 0, share: 0.0, seen })
                });
                let mut views: Vec<View> = views.collect();
                views.shrink_to_fit();
                let power = |view: &View| view.form_factor * lamps.power(view.lamp as usize);
                let total: f64 = views.iter().map(power).sum();
                views.iter_mut().for_each(|view| view.share = power(view) / total);
                Ok(views)
            })
            .collect();
        let in_view = vec![u64::MAX; scene.len()];
        let caustics = Caustics::of_scene(scene, lamps);
        let lights = surroundings.lights;
        let lighting = (!lights.is_empty()).then(|| Lighting::new(scene.len(), scene.bands(), lights));
        let mut direct = Direct { surroundings, seed, caustics, lighting, views: views?, in_view, segments: 0 };
        direct.sample(|_| each, progress)?;
        Ok(direct)
    }

    /// Brings the segments of every scramble up to `wanted(i)` for patch i, over all its lamps. Where a lamp seems to be in full
    /// view or hidden, a share of them goes on watching: their spread is 0, and would stay so for ever.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`].
    pub fn sample(&mut self, wanted: impl Fn(usize) -> u32 + Sync, progress: &Progress) -> Result<()> {
        if let Some(caustics) = &mut self.caustics {
            let all: u64 = (0..self.surroundings.scene.len()).map(|i| u64::from(wanted(i))).sum();
            caustics.sample(&self.surroundings, all.min(MOST_CAUSTIC_RAYS) as u32, self.seed, progress)?;
        }
        if let Some(lighting) = &mut self.lighting {
            let before = lighting.segments;
            lighting.sample(&self.surroundings, &wanted, self.seed, progress)?;
            self.segments += lighting.segments - before;
        }
        let Surroundings { scene, lamps, blockers, .. } = self.surroundings;
        if lamps.is_free(blockers) {
            return Ok(());
        }
        let seed = self.seed;
        let cast = |(i, (views, in_view)): (usize, (&mut Vec<View>, &mut u64))| -> Result<u64> {
            progress.advance(0)?;
            let (triangle, normal, patch) = (scene.triangle(i), scene.normals()[i], i as u32);
            let mut cast = 0;
            for view in views {
                let watched = if view.segments == 0 || view.is_partial() { 1.0 } else { WATCH };
                let target = (f64::from(wanted(i)) * view.share * watched).ceil() as u32;
                if target <= view.segments {
                    continue;
                }
                let lamp = &lamps.lamps[view.lamp as usize];
                let stream = hash(seed ^ hash(u64::from(patch) << 32 | u64::from(view.lamp)));
                for (s, seen) in view.seen.iter_mut().enumerate() {
                    let sobol = Sobol::new(stream.wrapping_add(s as u64));
                    let (mut weights, mut segments) = (Vec::new(), Vec::new());
                    for k in view.segments..target {
                        let [u, v, a, b] = sobol.point(k);
                        let point = Point { x: point_in_triangle(&triangle, u, v), normal, patch };
                        let (end, weight) = lamp.sample(&point, a, b);
                        if weight > 0.0 && lamp.shines_on(point.x) {
                            weights.push(weight);
                            segments.push(Segment { start: point.x, end, exclude: [patch, NO_PATCH] });
                        }
                    }
                    let hidden = lamps.hidden_between(blockers, view.lamp as usize, &segments);
                    for (weight, blocked) in weights.iter().zip(hidden) {
                        seen.all += weight;
                        seen.visible += if blocked { 0.0 } else { *weight };
                    }
                    cast += segments.len() as u64;
                }
                view.segments = target;
                let bit = 1 << view.lamp;
                *in_view = if view.fraction() >= 0.5 { *in_view | bit } else { *in_view & !bit };
            }
            Ok(cast)
        };
        let patches = self.views.par_iter_mut().zip(&mut self.in_view).enumerate();
        let cast: Result<Vec<u64>> = patches.map(cast).collect();
        self.segments += cast?.iter().sum::<u64>();
        Ok(())
    }

    /// Segments to lamps and lights in half-shadow, and rays of caustics in as many segments: those whose number
    /// [`Direct::sample`] raises.
    pub fn partial_segments(&self) -> u64 {
        let partial = self.views.iter().flatten().filter(|view| view.is_partial());
        let partial: u64 = partial.map(|view| SCRAMBLES as u64 * u64::from(view.segments)).sum();
        let lights = self.surroundings.lights;
        partial
            + self.lighting.as_ref().map_or(0, |lighting| lighting.uneven(lights))
            + self.caustics.as_ref().map_or(0, |caustics| CAUSTIC_COST * SCRAMBLES as u64 * u64::from(caustics.rays))
    }

    /// Bytes of what is known of every patch and lamp.
    pub fn nbytes(&self) -> u64 {
        let views: usize = self.views.iter().map(|views| size_of_val(views.as_slice())).sum();
        let caustics = self.caustics.as_ref().map_or(0, Caustics::nbytes);
        let lighting = self.lighting.as_ref().map_or(0, Lighting::nbytes);
        caustics + lighting + (views + size_of_val(self.views.as_slice()) + size_of_val(self.in_view.as_slice())) as u64
    }

    /// Whether patch i sees most of lamp l.
    #[inline]
    pub fn in_view(&self, i: u32, l: usize) -> bool {
        self.in_view[i as usize] >> l & 1 == 1
    }

    /// H of patch i, one a band, added to `out`.
    pub fn irradiance(&self, i: usize, out: &mut [f64]) {
        for view in &self.views[i] {
            self.add(view, view.fraction(), out);
        }
        self.add_caustics(i, None, out);
        self.add_lights(i, None, out);
    }

    /// The same as scramble `s` alone has it; the mean of all is [`Direct::irradiance`].
    pub fn irradiance_of_scramble(&self, i: usize, s: usize, out: &mut [f64]) {
        for view in &self.views[i] {
            self.add(view, view.of_scramble(s), out);
        }
        self.add_caustics(i, Some(s), out);
        self.add_lights(i, Some(s), out);
    }

    /// The part of H of patch i that comes by way of glass and bent mirrors, added to `out`: as scramble `s` alone has it, or as
    /// all have it.
    pub fn add_caustics(&self, i: usize, s: Option<usize>, out: &mut [f64]) {
        match (&self.caustics, s) {
            (None, _) => {}
            (Some(caustics), None) => caustics.add(i, out),
            (Some(caustics), Some(s)) => caustics.add_of_scramble(i, s, out),
        }
    }

    /// The part of H of patch i that comes from lights that are no patches, added to `out`: as scramble `s` alone has it, or as
    /// all have it.
    pub fn add_lights(&self, i: usize, s: Option<usize>, out: &mut [f64]) {
        if let Some(lighting) = &self.lighting {
            lighting.add(i, s, out);
        }
    }

    fn add(&self, view: &View, fraction: f64, out: &mut [f64]) {
        let emission = &self.surroundings.lamps.lamps[view.lamp as usize].emission;
        out.iter_mut().zip(emission).for_each(|(out, e)| *out += view.form_factor * fraction * e);
    }
}
