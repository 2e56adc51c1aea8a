//! Pairs of patches between which something may stand: how much of each is visible, to a row tolerance.
//!
//! Shadows of convex bodies are exact from a point and need no rays ([`crate::form_factor::shadow`]); where too many bodies
//! stand between, or a patch reaches into one, segments are cast ([`crate::form_factor::occluded`]). The first round asks for
//! any accuracy; [`plan`] then spends the work where it brings a row inside its budget for the least.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use crate::error::Result;
use crate::form_factor::Patch;
use crate::form_factor::occluded::{End, VisibleFraction, visible_fraction};
use crate::form_factor::shadow::{SHOWN, Shadows, Visible};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::Bvh;
use crate::visibility::bodies::Bodies;
use crate::visibility::shaft::Shaft;

/// Segments of the pilot round, which tells how many are needed.
const PILOT: u32 = 16;
/// The error of quasi-random visibility falls like segments^-RATE (measured 0.6 to 0.7; random would be 0.5).
const RATE: f64 = 0.6;
/// A pair gets no more segments than this: beyond, a finer mesh is the better answer.
const MOST_SEGMENTS: u32 = 1 << 16;
/// Rounds after the pilot. Each plans from what the last one measured; two nearly always suffice.
const MOST_ROUNDS: usize = 4;
/// With more bodies in a shaft, rays are cheaper than shadows.
const MOST_BODIES: usize = 8;

/// A pair between whose patches something may stand.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Candidate {
    pub(crate) i: u32,
    pub(crate) j: u32,
    /// The exchange if nothing stood between, m^2.
    pub(crate) exchange: f64,
    /// Visible fraction, and its error: an estimate, or the expectation that segments leave which all agree.
    pub(crate) visible: f64,
    pub(crate) error: f64,
    /// The error to be reached in the next round; infinite at first, when any will do, and 0 when there is nothing to do.
    pub(super) wanted: f64,
    /// Segments that have been cast; 0 when the estimate comes from shadows.
    pub(super) segments: u32,
    /// Whether more work would not make the error less.
    pub(super) spent: bool,
}

impl Candidate {
    /// Of which nothing is known yet.
    pub(crate) fn new(i: u32, j: u32, exchange: f64) -> Candidate {
        Candidate { i, j, exchange, visible: 1.0, error: 1.0, wanted: f64::INFINITY, segments: 0, spent: false }
    }
}

/// What blocks: as bodies, for shadows, and as patches, for segments.
pub struct Blockers {
    /// Convex bodies.
    pub bodies: Bodies,
    /// Patches.
    pub tree: Bvh,
}

impl Blockers {
    /// What blocks in a scene.
    pub fn of_scene(scene: &Scene) -> Blockers {
        Blockers { bodies: Bodies::of_scene(scene), tree: Bvh::of_blockers(scene) }
    }
}

/// Finds what is visible of every candidate, to a `budget` for the error of every row; returns the segments cast, and the largest
/// error of a row that is left.
pub(crate) fn settle(
    patches: &[Patch],
    areas: &[f64],
    blockers: &Blockers,
    candidates: &mut [Candidate],
    budget: f64,
    seed: u64,
    progress: &Progress,
) -> Result<(u64, f64)> {
    let (mut segments, mut round) = (0, 0);
    loop {
        segments += sample(patches, blockers, candidates, seed, progress)?;
        if round == MOST_ROUNDS || !plan(candidates, areas, budget) {
            let worst = row_errors(areas, candidates).into_iter().fold(0.0, f64::max);
            return Ok((segments, worst));
        }
        round += 1;
    }
}

/// Brings the error of every candidate to what is wanted, as far as that can be; returns how many segments were cast.
fn sample(
    patches: &[Patch],
    blockers: &Blockers,
    candidates: &mut [Candidate],
    seed: u64,
    progress: &Progress,
) -> Result<u64> {
    progress.expect(candidates.iter().filter(|c| c.wanted > 0.0).count() as u64);
    let cast = AtomicU64::new(0);
    candidates.par_chunks_mut(8).try_for_each_init(Shadows::default, |shadows, chunk| {
        let mut done = 0;
        for c in chunk.iter_mut().filter(|c| c.wanted > 0.0) {
            cast.fetch_add(improve(c, shadows, patches, blockers, seed), Ordering::Relaxed);
            done += 1;
        }
        progress.advance(done)
    })?;
    Ok(cast.into_inner())
}

/// Brings the error of one candidate to what is wanted, as far as that can be; returns how many segments were cast.
pub(super) fn improve(
    c: &mut Candidate,
    shadows: &mut Shadows,
    patches: &[Patch],
    blockers: &Blockers,
    seed: u64,
) -> u64 {
    let [a, b] = [c.i, c.j].map(|k| &patches[k as usize]);
    let by_shadows = if c.segments > 0 { None } else { visible_by_shadows(shadows, blockers, c, a, b) };
    let mut cast = 0;
    if let Some(Visible { fraction, error }) = by_shadows {
        // Shadows go on until they have what is wanted, or can no more.
        (c.visible, c.error, c.spent) = (fraction, error, error > c.wanted);
    } else {
        // Shadows that gave up tell nothing of what segments would leave.
        let (known, error) = if c.segments == 0 { (PILOT, unmet(f64::from(PILOT))) } else { (c.segments, c.error) };
        let needed = f64::from(known) * (error / c.wanted).powf(1.0 / RATE);
        let segments = needed.clamp(f64::from(PILOT), f64::from(MOST_SEGMENTS)).ceil() as u32;
        let end = |k: u32, p: &Patch| End { patch: k, triangle: p.corners, normal: p.normal };
        let v = visible_fraction(&blockers.tree, &end(c.i, a), &end(c.j, b), segments, seed);
        let error = error_to_count_with(&v)
            + unshown(&v, segments, c.exchange / (a.area * b.area)) * v.value.max(1.0 - v.value);
        // Shadows may have known better before they gave up.
        if c.segments > 0 || error <= c.error {
            (c.visible, c.error) = (v.value, error);
        }
        (c.segments, c.spent) = (segments, segments == MOST_SEGMENTS);
        cast = u64::from(segments);
    }
    c.wanted = 0.0;
    cast
}

/// What is to be expected of the part that none of m segments met, 1 / (m + 2) (Laplace's rule of succession).
fn unmet(m: f64) -> f64 {
    1.0 / (m + 2.0)
}

/// Segments that all agree leave what none of them met: a thin bar is missed by few segments. Where they do not agree, four
/// replicates know their spread only to 40 %, and pairs whose spread looks small by chance would get no more segments: so
/// half of the variance is what m segments leave in a cluttered shaft, measured as half the variance of random ones,
/// V (1 - V) / 2 m.
fn error_to_count_with(v: &VisibleFraction) -> f64 {
    if v.value == 0.0 || v.value == 1.0 {
        return unmet(v.effective);
    }
    let usual = 0.5 * v.value * (1.0 - v.value) / v.effective.max(1.0);
    (0.5 * (v.standard_error * v.standard_error + usual)).sqrt()
}

/// The share of the exchange, whose mean K is `kernel`, that m segments do not show, where that is more than a tenth above what is to be
/// expected of random ones, (1 / effective - 1 / m)^(1/2): it passes next to where the patches come near to each other, and
/// nothing is known of it.
fn unshown(v: &VisibleFraction, segments: u32, kernel: f64) -> f64 {
    let usual = (1.0 / v.effective - 1.0 / f64::from(segments)).max(0.0).sqrt();
    (1.0 - v.kernel / kernel - usual - SHOWN).max(0.0)
}

/// The visible fraction from shadows, where few bodies can stand between and the patches are outside of all.
fn visible_by_shadows(
    shadows: &mut Shadows,
    blockers: &Blockers,
    c: &Candidate,
    a: &Patch,
    b: &Patch,
) -> Option<Visible> {
    let bodies = &blockers.bodies;
    if bodies.entangled(c.i) || bodies.entangled(c.j) {
        return None;
    }
    // In a town half of all pairs are hidden by one house, which takes the fewest steps to see.
    if bodies.hide(&a.corners, &b.corners) {
        return Some(Visible { fraction: 0.0, error: 0.0 });
    }
    let between = bodies.in_shaft(&Shaft::new(&a.corners, &b.corners), [c.i, c.j], MOST_BODIES)?;
    shadows.visible(a, b, &between, c.exchange, c.wanted)
}

/// For every row the sum over its candidates of the error of F_ij.
fn row_errors(areas: &[f64], candidates: &[Candidate]) -> Vec<f64> {
    let mut errors = vec![0.0; areas.len()];
    for c in candidates {
        let (i, j) = (c.i as usize, c.j as usize);
        let error = c.exchange * c.error;
        errors[i] += error / areas[i];
        errors[j] += error / areas[j];
    }
    errors
}

/// Sets what is wanted in the next round; false when no row is over the budget, or nothing more may be spent.
///
/// The work of a pair grows when its error falls, whatever its size: the cheapest way to bring a row inside its budget is
/// one limit for all errors in it, so high that the errors under it and the limit for all others add up to the budget.
fn plan(candidates: &mut [Candidate], areas: &[f64], budget: f64) -> bool {
    // A little less than allowed: one more round would cost as much again.
    const MARGIN: f64 = 0.85;
    /// Each pass raises the limits towards the fixed point.
    const PASSES: usize = 8;
    let both = |c: &Candidate| {
        let (i, j) = (c.i as usize, c.j as usize);
        [(i, c.exchange * c.error / areas[i]), (j, c.exchange * c.error / areas[j])]
    };
    let mut limits = vec![0.0; areas.len()];
    for _ in 0..=PASSES {
        let (mut under, mut over) = (vec![0.0; areas.len()], vec![0.0; areas.len()]);
        for (row, error) in candidates.iter().flat_map(both) {
            if error <= limits[row] { under[row] += error } else { over[row] += 1.0 }
        }
        for (row, limit) in limits.iter_mut().enumerate() {
            *limit = if over[row] == 0.0 { f64::INFINITY } else { (MARGIN * budget - under[row]) / over[row] };
        }
    }
    let errors = row_errors(areas, candidates);
    let mut more = false;
    for c in candidates {
        let wanted = [c.i as usize, c.j as usize]
            .into_iter()
            .filter(|&row| errors[row] > budget)
            .map(|row| limits[row] * areas[row] / c.exchange)
            .fold(f64::INFINITY, f64::min);
        c.wanted = if c.error > wanted && !c.spent { wanted } else { 0.0 };
        more |= c.wanted > 0.0;
    }
    more
}
