//! The dense operator: the exchange G_ij = A_i F_ij of every pair, in f64, stored once.
//!
//! G = (unoccluded exchange by [`crate::form_factor::exchange`]) x (visible fraction by [`super::hidden`]). Clusters that cannot
//! see each other are left out as a whole ([`crate::visibility::sight`]); pairs that face away cost nothing, pairs with an empty
//! shaft between them neither shadows nor rays, a convex scene no tree. Row i of the triangle holds G_i0 .. G_i,i-1, or of these
//! what is not 0 ([`super::triangle`]); G_ii is 0 because patches are flat.

use std::cmp::Reverse;
use std::ops::Range;

use rayon::prelude::*;

use super::hidden::{Blockers, Candidate, improve, settle};
use super::matrix::add_scaled;
use super::tiles;
use super::triangle::{Builder, Pattern, Row};
use super::{FormFactors, Numbers, apply_reciprocal};
use crate::error::{Error, Result};
use crate::form_factor::shadow::Shadows;
use crate::form_factor::{Accuracy, Batch, Patch};
use crate::geometry::sampling::hash;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::shaft::Shaft;
use crate::visibility::sight::{Sights, View};

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
    /// Which pairs have an entry.
    pub pattern: Pattern,
    /// Of these G_ij, m^2, row by row.
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
/// Hardly a scene has fewer pairs that see each other than one in so many: what would not fit then is refused before any work.
const FEWEST: u64 = 64;
/// Pairs between two looks at the memory: some seconds of work, and rows of 128 MiB at most on their way into the triangle.
const BLOCK: usize = 1 << 24;
/// From so many columns on a product goes tile by tile.
const MANY_COLUMNS: usize = 8;

impl Dense {
    /// Bytes that the operator of `n` patches holds at most, but for 16 a pair of which a part is hidden.
    pub fn forecast(n: usize) -> u64 {
        let n = n as u64;
        4 * n * n.saturating_sub(1) + 8 * n
    }

    /// Computes the form factors of every pair.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a tolerance out of range or a patch that is there twice, [`Error::Memory`], before any work where
    /// nothing can block and else as soon as what is not hidden no longer fits, [`Error::Interrupted`].
    pub fn new(scene: &Scene, options: DenseOptions, progress: &Progress) -> Result<Dense> {
        scene.require_diffuse("a matrix of form factors")?;
        scene.require_distinct("a matrix of form factors")?;
        Accuracy::new(options.tolerance)?;
        let accuracy = Accuracy::new((KERNEL_SHARE * options.tolerance).max(Accuracy::TIGHTEST))?;
        let n = scene.len();
        let too_much = |needed: u64| Error::Memory {
            what: format!("the dense exchange of {n} patches"),
            needed,
            available: options.memory,
            remedy: "use fewer patches (a larger max_edge)".to_string(),
        };
        let blockers = Blockers::of_scene(scene);
        let least = if blockers.bodies.is_empty() { 1 } else { FEWEST };
        if Dense::forecast(n) / least > options.memory {
            return Err(too_much(Dense::forecast(n)));
        }
        let work = Work {
            scene,
            patches: (0..n).map(|i| Patch::new(scene.triangle(i))).collect(),
            sights: Sights::new(scene, &blockers.bodies),
            blockers,
            accuracy,
            seed: options.seed,
        };
        let (mut triangle, mut candidates, mut segments) = (Builder::default(), Vec::new(), 0);
        progress.expect(pairs_of(n));
        for rows in blocks(n) {
            let done = pairs_of(rows.end);
            for found in work.rows(rows, progress)? {
                triangle.add(found.row)?;
                candidates.extend(found.candidates);
                segments += found.segments;
            }
            // How many pairs are not hidden is known only as they are found; the rows that are still to come need as much as
            // those before.
            let found = triangle.nbytes() + bytes_of_candidates(candidates.len());
            if found + 8 * n as u64 > options.memory {
                let all = found as f64 * (pairs_of(n) as f64 / done.max(1) as f64);
                return Err(too_much(all as u64 + 8 * n as u64));
            }
        }
        let (pattern, mut exchange) = triangle.finish()?;
        // The order in which the errors of a row are added up: that of the rows, the longest first.
        candidates.sort_unstable_by_key(|c: &Candidate| (Reverse(c.i), c.j));
        let budget = (options.tolerance - accuracy.tolerance()).max(0.5 * options.tolerance);
        let Work { patches, blockers, .. } = &work;
        let (more, visibility_error) =
            settle(patches, scene.areas(), blockers, &mut candidates, budget, options.seed, progress)?;
        let mut uncertain = Vec::new();
        for c in &candidates {
            let Some(place) = pattern.place(c.i as usize, c.j as usize) else { continue };
            let g = &mut exchange[place];
            if c.error > 0.0 && *g > 0.0 {
                uncertain.push(Uncertain { i: c.i, j: c.j, standard_error: c.error * *g });
            }
            *g *= c.visible;
        }
        uncertain.shrink_to_fit();
        let kernel_error = accuracy.tolerance();
        let kept = KeptDense {
            pattern,
            exchange: Numbers::of(exchange),
            uncertain,
            kernel_error,
            error_estimate: kernel_error + visibility_error,
            segments: segments + more,
        };
        Ok(Dense { areas: scene.areas().to_vec(), kept })
    }

    /// The operator of a scene from what was kept of it. The exchange is taken as it is, and not looked at.
    ///
    /// # Errors
    /// [`Error::Invalid`] for what cannot be of this scene, or of any.
    pub fn from_kept(scene: &Scene, kept: KeptDense) -> Result<Dense> {
        scene.require_diffuse("a matrix of form factors")?;
        let n = scene.len();
        let KeptDense { pattern, exchange, uncertain, kernel_error, error_estimate, .. } = &kept;
        if pattern.patches() != n {
            let found = pattern.patches();
            return Err(Error::Invalid(format!("the exchange of {found} patches is not that of {n}")));
        }
        if exchange.len() != pattern.len() {
            let (found, wanted) = (exchange.len(), pattern.len());
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

    /// Calls `visit(j, G_ij)` for all that patch i exchanges with, in the order of j.
    #[inline]
    fn partners(&self, i: usize, mut visit: impl FnMut(usize, f64)) {
        let (pattern, exchange) = self.exchange();
        pattern.partners(i, |j, place| visit(j, exchange[place]));
    }

    /// The entries of G, m^2, and their places.
    pub(super) fn exchange(&self) -> (&Pattern, &[f64]) {
        (&self.kept.pattern, &self.kept.exchange)
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
        self.partners(i, |j, g| add_scaled(g, &x[j * bands..][..bands], out));
        out.iter_mut().for_each(|out| *out /= self.areas[i]);
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        let bands = amount.len();
        self.partners(i, |j, g| add_scaled(g / self.areas[j], amount, &mut out[j * bands..][..bands]));
    }

    /// Of few columns every G_ij is read once and used for both patches: half the memory traffic of two triangles. Of many it is
    /// the arithmetic that takes the time, which is then that of products of matrices.
    fn apply(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        let n = self.areas.len();
        let (pattern, exchange) = self.exchange();
        if bands >= MANY_COLUMNS {
            let fill = |i: usize, columns: Range<usize>, row: &mut [f64]| {
                row.fill(0.0);
                let first = columns.start;
                pattern.within(i, columns, |j, place| row[j - first] = exchange[place]);
            };
            tiles::apply(n, x, bands, out, fill);
            out.iter_mut().enumerate().for_each(|(k, out)| *out /= self.areas[k / bands]);
            return;
        }
        let parts: Vec<Vec<f64>> = (0..PARTS)
            .into_par_iter()
            .map(|part| {
                let mut sums = vec![0.0; n * bands];
                // Rows of a triangle grow: boundaries at n sqrt(k / PARTS) give every part the same number of pairs.
                let bound = |k: usize| (n as f64 * (k as f64 / PARTS as f64).sqrt()).round() as usize;
                for i in bound(part)..bound(part + 1) {
                    let (before, from) = sums.split_at_mut(i * bands);
                    let (sum_i, x_i) = (&mut from[..bands], &x[i * bands..][..bands]);
                    pattern.lower(i, |j, place| {
                        let g = exchange[place];
                        if g != 0.0 {
                            add_scaled(g, &x[j * bands..][..bands], sum_i);
                            add_scaled(g, x_i, &mut before[j * bands..][..bands]);
                        }
                    });
                }
                sums
            })
            .collect();
        for (k, out) in out.iter_mut().enumerate() {
            *out = parts.iter().map(|sums| sums[k]).sum::<f64>() / self.areas[k / bands];
        }
    }

    fn apply_transposed(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        apply_reciprocal(self, &self.areas, x, bands, out);
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        out.fill(0.0);
        self.partners(i, |j, g| out[j] = g / self.areas[i]);
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
        let (pattern, exchange) = self.exchange();
        pattern.nbytes()
            + size_of_val(exchange)
            + size_of_val(self.areas.as_slice())
            + size_of_val(self.kept.uncertain.as_slice())
    }
}

/// Whether this can be an error.
pub(crate) fn is_error(value: f64) -> bool {
    (0.0..f64::INFINITY).contains(&value)
}

/// Pairs i > j of `n` patches.
fn pairs_of(n: usize) -> u64 {
    n as u64 * n.saturating_sub(1) as u64 / 2
}

/// The rows 0 .. n in blocks of about as many pairs.
fn blocks(n: usize) -> impl Iterator<Item = Range<usize>> {
    let mut first = 0;
    std::iter::from_fn(move || {
        let start = first;
        let mut pairs = 0;
        while first < n && (first == start || pairs + first <= BLOCK) {
            pairs += first;
            first += 1;
        }
        (start < first).then_some(start..first)
    })
}

/// In its row and among all, and what may be left of it.
fn bytes_of_candidates(count: usize) -> u64 {
    (count * (2 * size_of::<Candidate>() + size_of::<Uncertain>())) as u64
}

/// What the rows are computed from.
struct Work<'a> {
    scene: &'a Scene,
    patches: Vec<Patch>,
    blockers: Blockers,
    sights: Sights,
    accuracy: Accuracy,
    seed: u64,
}

/// A row of the unoccluded exchange without what is hidden, and the pairs of which a part may be.
struct Found {
    row: Row,
    candidates: Vec<Candidate>,
    segments: u64,
}

impl Work<'_> {
    /// Some rows, in their order.
    fn rows(&self, rows: Range<usize>, progress: &Progress) -> Result<Vec<Found>> {
        let rows = rows.start as u32..rows.end as u32;
        let row = |i: u32, view: &View| Ok((i, self.row(i, view, progress)?));
        let mut found = self.sights.visit(&rows, self.scene, &self.blockers.bodies, progress, &row)?;
        found.sort_unstable_by_key(|(i, _)| *i);
        Ok(found.into_iter().map(|(_, found)| found).collect())
    }

    /// The row of patch i, by what it may see.
    fn row(&self, i: u32, view: &View, progress: &Progress) -> Result<Found> {
        /// Pairs between two looks at the wish to stop.
        const PAIRS: usize = 256;
        let (patches, bodies) = (&self.patches, &self.blockers.bodies);
        let (mut batch, mut shadows) = (Batch::new(), Shadows::default());
        let pairs: Vec<[u32; 2]> = view.patches.iter().map(|&(j, _)| [i, j]).collect();
        let mut exchange = vec![0.0; pairs.len()];
        batch.exchange_pairs(patches, patches, &pairs, &self.accuracy, &mut exchange)?;
        let (mut candidates, mut segments) = (Vec::new(), 0);
        let found = pairs.iter().zip(&view.patches).zip(&mut exchange).filter(|(_, g)| **g > 0.0);
        for (k, ((&[i, j], &(_, list)), g)) in found.enumerate() {
            if k % PAIRS == 0 {
                progress.advance(0)?;
            }
            let near = view.bodies[list as usize].as_slice();
            let shaft = || Shaft::new(&patches[i as usize].corners, &patches[j as usize].corners);
            if near.is_empty() || !bodies.may_meet(near, &shaft(), [i, j]) {
                continue;
            }
            let mut c = Candidate::new(i, j, *g);
            segments += improve(&mut c, &mut shadows, patches, &self.blockers, self.seed);
            if c.error > 0.0 {
                candidates.push(c);
            } else {
                *g *= c.visible;
            }
        }
        progress.advance(u64::from(i))?;
        let columns = view.patches.iter().map(|&(j, _)| j);
        let (column, value) = columns.zip(exchange).filter(|(_, g)| *g != 0.0).unzip();
        Ok(Found { row: Row::new(i as usize, column, value), candidates, segments })
    }
}
