//! The dense operator: the exchange G_ij = A_i F_ij of every pair, in f64, stored once.
//!
//! G = (unoccluded exchange by [`crate::form_factor::exchange`]) x (visible fraction by [`super::hidden`]). Pairs that face away
//! cost nothing, pairs with an empty shaft between them neither shadows nor rays, a convex scene no tree. Row i of the triangle holds G_i0 .. G_i,i-1; G_ii is 0 because patches are flat.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use super::hidden::{Blockers, Candidate, settle};
use super::matrix::add_scaled;
use super::{FormFactors, Numbers};
use crate::error::{Error, Result};
use crate::form_factor::{Accuracy, Batch, Patch};
use crate::geometry::sampling::hash;
use crate::memory::{self, filled};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::bodies::Bodies;
use crate::visibility::shaft::Shaft;

/// What to compute, and within what.
#[derive(Debug, Clone, Copy)]
pub struct DenseOptions {
    /// Bound on sum over j of |dF_ij|, for every row i; in [1e-10, 1).
    pub tolerance: f64,
    /// Seed of the quasi-random segments.
    pub seed: u64,
    /// Bytes that may be used.
    pub memory: u64,
}

/// The sampling error that is left in one pair.
#[derive(Debug, Clone, Copy)]
pub struct Uncertain {
    /// One patch.
    pub i: u32,
    /// The other, with the lower number.
    pub j: u32,
    /// Standard error of G_ij, m^2.
    pub standard_error: f64,
}

/// All of a dense operator that its scene does not tell.
#[derive(Debug, Clone)]
pub struct KeptDense {
    /// G_i0 .. G_i,i-1 of every row i, m^2.
    pub exchange: Numbers,
    /// Pairs whose visibility was sampled.
    pub uncertain: Vec<Uncertain>,
    /// Bound on the relative error of the kernels.
    pub kernel_error: f64,
    /// Estimate of the largest row error.
    pub error_estimate: f64,
    /// Segments cast.
    pub segments: u64,
}

/// Dense symmetric form factors of a scene.
#[derive(Debug, Clone)]
pub struct Dense {
    areas: Vec<f64>,
    kept: KeptDense,
}

/// Share of the row tolerance that goes to the unoccluded kernels: a small one, because they are cheap and their error,
/// unlike that of sampling, may have the same sign everywhere.
const KERNEL_SHARE: f64 = 0.02;
/// Fixed number of partial sums in a product, whatever the number of threads: the same bits every time.
const PARTS: usize = 32;

/// Memory for what is found on the way.
struct Room {
    limit: u64,
    used: AtomicU64,
}

impl Room {
    /// Takes room for some more candidates; false when there is none left.
    fn take(&self, candidates: usize) -> bool {
        // In its row and among all, and what may be left of it.
        let bytes = (candidates * (2 * size_of::<Candidate>() + size_of::<Uncertain>())) as u64;
        self.used.fetch_add(bytes, Ordering::Relaxed) + bytes <= self.limit
    }
}

/// First entry of row i in the packed triangle.
#[inline]
fn row_start(i: usize) -> usize {
    i * i.saturating_sub(1) / 2
}

impl Dense {
    /// Bytes that the operator of `n` patches holds at least.
    pub fn forecast(n: usize) -> u64 {
        let n = n as u64;
        4 * n * n.saturating_sub(1) + 8 * n
    }

    /// Computes the form factors of every pair.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a tolerance out of range or a patch that is there twice, [`Error::Memory`] before anything is
    /// allocated, [`Error::Interrupted`].
    pub fn new(scene: &Scene, options: DenseOptions, progress: &Progress) -> Result<Dense> {
        scene.require_diffuse("a matrix of form factors")?;
        scene.require_distinct("a matrix of form factors")?;
        Accuracy::new(options.tolerance)?;
        let accuracy = Accuracy::new((KERNEL_SHARE * options.tolerance).max(Accuracy::TIGHTEST))?;
        let n = scene.len();
        let fits = |needed: u64| {
            if needed <= options.memory {
                return Ok(());
            }
            Err(Error::Memory {
                what: format!("the dense exchange of {n} patches"),
                needed,
                available: options.memory,
                remedy: "use fewer patches (a larger max_edge)".to_string(),
            })
        };
        fits(Dense::forecast(n))?;
        let blockers = Blockers::of_scene(scene);
        let mut exchange = filled(row_start(n), 0.0)?;
        // How many pairs need their visibility sampled is known only as they are found.
        let room = Room { limit: options.memory - Dense::forecast(n), used: AtomicU64::new(0) };
        let patches: Vec<Patch> = (0..n).map(|i| Patch::new(scene.triangle(i))).collect();
        let mut candidates = unoccluded(&patches, accuracy, &blockers.bodies, &mut exchange, &room, progress)?;
        fits(Dense::forecast(n) + room.used.into_inner())?;
        let budget = (options.tolerance - accuracy.tolerance()).max(0.5 * options.tolerance);
        let (segments, visibility_error) =
            settle(&patches, scene.areas(), &blockers, &mut candidates, budget, options.seed, progress)?;
        let mut uncertain = Vec::new();
        for c in &candidates {
            let g = &mut exchange[row_start(c.i as usize) + c.j as usize];
            if c.error > 0.0 && *g > 0.0 {
                uncertain.push(Uncertain { i: c.i, j: c.j, standard_error: c.error * *g });
            }
            *g *= c.visible;
        }
        uncertain.shrink_to_fit();
        let kernel_error = accuracy.tolerance();
        let error_estimate = kernel_error + visibility_error;
        let kept = KeptDense { exchange: Numbers::of(exchange), uncertain, kernel_error, error_estimate, segments };
        Ok(Dense { areas: scene.areas().to_vec(), kept })
    }

    /// The operator of a scene from what was kept of it. The exchange is taken as it is, and not looked at.
    ///
    /// # Errors
    /// [`Error::Invalid`] for what cannot be of this scene, or of any.
    pub fn from_kept(scene: &Scene, kept: KeptDense) -> Result<Dense> {
        scene.require_diffuse("a matrix of form factors")?;
        let n = scene.len();
        let KeptDense { exchange, uncertain, kernel_error, error_estimate, .. } = &kept;
        if exchange.len() != row_start(n) {
            let (found, wanted) = (exchange.len(), row_start(n));
            return Err(Error::Invalid(format!("the exchange of {n} patches has {wanted} entries, not {found}")));
        }
        if let Some(k) = uncertain.iter().position(|u| !(u.j < u.i && (u.i as usize) < n && is_error(u.standard_error)))
        {
            let Uncertain { i, j, standard_error } = uncertain[k];
            return Err(Error::Invalid(format!(
                "uncertain pair {k}, of the patches {i} and {j} with the standard error {standard_error}, is none of {n} \
                 patches"
            )));
        }
        if ![*kernel_error, *error_estimate].into_iter().all(is_error) {
            return Err(Error::Invalid(format!(
                "the errors {kernel_error} of the kernels and {error_estimate} of the rows are not both numbers from 0"
            )));
        }
        Ok(Dense { areas: scene.areas().to_vec(), kept })
    }

    /// All that the scene does not tell.
    pub fn kept(&self) -> &KeptDense {
        &self.kept
    }

    /// Estimate of the largest row error max_i sum_j |dF_ij|: the kernels' bound plus the error
    /// that is estimated of every visible fraction.
    pub fn error_estimate(&self) -> f64 {
        self.kept.error_estimate
    }

    /// Segments cast.
    pub fn segments(&self) -> u64 {
        self.kept.segments
    }

    /// G_i0 .. G_i,i-1.
    fn lower(&self, i: usize) -> &[f64] {
        &self.kept.exchange[row_start(i)..][..i]
    }

    /// G_ji for j = i + 1, i + 2, ...
    fn upper(&self, i: usize) -> impl Iterator<Item = f64> + '_ {
        let exchange = self.exchange();
        (i + 1..self.areas.len()).map(move |j| exchange[row_start(j) + i])
    }

    /// All G_ij of patch i with their j, in the order of j.
    fn partners(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.lower(i).iter().copied().enumerate().chain((i + 1..).zip(self.upper(i)))
    }

    /// The packed triangle of G: the i entries G_i0 .. G_i,i-1 of every row i, m^2.
    pub fn exchange(&self) -> &[f64] {
        &self.kept.exchange
    }

    /// The same operator with another exchange, whose rows are off by no more than `error_estimate`.
    pub(super) fn with_exchange(&self, exchange: Vec<f64>, error_estimate: f64) -> Dense {
        let exchange = Numbers::of(exchange);
        Dense { areas: self.areas.clone(), kept: KeptDense { exchange, error_estimate, ..self.kept.clone() } }
    }
}

impl FormFactors for Dense {
    fn len(&self) -> usize {
        self.areas.len()
    }

    fn areas(&self) -> Option<&[f64]> {
        Some(&self.areas)
    }

    fn gather(&self, i: usize, x: &[f64], out: &mut [f64]) {
        let bands = out.len();
        out.fill(0.0);
        for ((_, g), x) in self.partners(i).zip(others(x, i, bands)) {
            add_scaled(g, x, out);
        }
        out.iter_mut().for_each(|out| *out /= self.areas[i]);
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        let bands = amount.len();
        for (j, g) in self.partners(i) {
            add_scaled(g / self.areas[j], amount, &mut out[j * bands..][..bands]);
        }
    }

    /// Every G_ij is read once and used for both patches: half the memory traffic of two triangles.
    fn apply(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        let n = self.areas.len();
        let parts: Vec<Vec<f64>> = (0..PARTS)
            .into_par_iter()
            .map(|part| {
                let mut sums = vec![0.0; n * bands];
                // Rows of a triangle grow: boundaries at n sqrt(k / PARTS) give every part the same number of pairs.
                let bound = |k: usize| (n as f64 * (k as f64 / PARTS as f64).sqrt()).round() as usize;
                for i in bound(part)..bound(part + 1) {
                    let (before, from) = sums.split_at_mut(i * bands);
                    let (sum_i, x_i) = (&mut from[..bands], &x[i * bands..][..bands]);
                    for (j, &g) in self.lower(i).iter().enumerate() {
                        if g != 0.0 {
                            add_scaled(g, &x[j * bands..][..bands], sum_i);
                            add_scaled(g, x_i, &mut before[j * bands..][..bands]);
                        }
                    }
                }
                sums
            })
            .collect();
        for (k, out) in out.iter_mut().enumerate() {
            *out = parts.iter().map(|sums| sums[k]).sum::<f64>() / self.areas[k / bands];
        }
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        out[i] = 0.0;
        self.partners(i).for_each(|(j, g)| out[j] = g / self.areas[i]);
    }

    fn kernel_error(&self) -> f64 {
        self.kept.kernel_error
    }

    fn standard_error(&self, x: &[f64], bands: usize) -> Option<Vec<f64>> {
        if self.kept.uncertain.is_empty() {
            return None;
        }
        // In units of the largest, squares neither overflow nor vanish.
        let peak = x.iter().fold(f64::MIN_POSITIVE, |peak, x| x.abs().max(peak));
        let mut variance = vec![0.0; self.areas.len() * bands];
        for u in &self.kept.uncertain {
            let (i, j) = (u.i as usize, u.j as usize);
            for b in 0..bands {
                variance[i * bands + b] += (u.standard_error / self.areas[i] * (x[j * bands + b] / peak)).powi(2);
                variance[j * bands + b] += (u.standard_error / self.areas[j] * (x[i * bands + b] / peak)).powi(2);
            }
        }
        Some(variance.iter().map(|v| peak * v.sqrt()).collect())
    }

    fn sampling_error(&self, x: &[f64], bands: usize, draw: u64) -> Option<Vec<f64>> {
        if self.kept.uncertain.is_empty() {
            return None;
        }
        let mut out = vec![0.0; self.areas.len() * bands];
        for (k, u) in self.kept.uncertain.iter().enumerate() {
            // A random sign has the variance 1, which is all that a sum of many needs.
            let sign = if hash(draw ^ hash(k as u64)) & 1 == 0 { 1.0 } else { -1.0 };
            let (i, j) = (u.i as usize, u.j as usize);
            for b in 0..bands {
                out[i * bands + b] += sign * u.standard_error / self.areas[i] * x[j * bands + b];
                out[j * bands + b] += sign * u.standard_error / self.areas[j] * x[i * bands + b];
            }
        }
        Some(out)
    }

    fn nbytes(&self) -> usize {
        size_of_val(self.exchange()) + size_of_val(self.areas.as_slice()) + size_of_val(self.kept.uncertain.as_slice())
    }
}

/// Whether this can be an error.
pub(super) fn is_error(value: f64) -> bool {
    (0.0..f64::INFINITY).contains(&value)
}

/// The rows of `x` of every patch but i.
fn others(x: &[f64], i: usize, bands: usize) -> impl Iterator<Item = &[f64]> {
    x[..i * bands].chunks_exact(bands).chain(x[(i + 1) * bands..].chunks_exact(bands))
}

/// Fills `packed` with the unoccluded exchange, and returns the pairs that something may stand between.
fn unoccluded(
    patches: &[Patch],
    accuracy: Accuracy,
    bodies: &Bodies,
    packed: &mut [f64],
    room: &Room,
    progress: &Progress,
) -> Result<Vec<Candidate>> {
    let n = patches.len();
    progress.expect(packed.len() as u64);
    let mut rows = Vec::with_capacity(n);
    let mut rest = packed;
    for i in 0..n {
        let (row, tail) = rest.split_at_mut(i);
        rows.push((i, row));
        rest = tail;
    }
    // The longest rows first, so that the threads finish together.
    let found: Result<Vec<Vec<Candidate>>> = rows
        .into_par_iter()
        .rev()
        .map_init(Batch::new, |batch, (i, row)| {
            let pairs: Vec<[u32; 2]> = (0..i as u32).map(|j| [i as u32, j]).collect();
            batch.exchange_pairs(patches, patches, &pairs, &accuracy, row)?;
            let mut candidates = Vec::new();
            if !bodies.is_empty() {
                for (j, &exchange) in row.iter().enumerate().filter(|(_, g)| **g > 0.0) {
                    let shaft = Shaft::new(&patches[i].corners, &patches[j].corners);
                    let (i, j) = (i as u32, j as u32);
                    if bodies.may_meet(&shaft, [i, j]) {
                        candidates.push(Candidate::new(i, j, exchange));
                    }
                }
            }
            progress.advance(i as u64)?;
            // Without room the count goes on, so that the error can tell what is needed.
            if !room.take(candidates.len()) {
                candidates = Vec::new();
            }
            Ok(candidates)
        })
        .collect();
    let found = found?;
    let mut all = memory::room(found.iter().map(Vec::len).sum())?;
    found.into_iter().for_each(|candidates| all.extend(candidates));
    Ok(all)
}
