//! Rows first to last of F, each estimated for itself by rays and stored sparsely.
//!
//! The rows come from [`crate::form_factor::monte_carlo`] or [`crate::form_factor::hemicube`]. A row depends on the scene,
//! the seed and its number alone, so that blocks may be computed anywhere, in any order, and together are the operator
//! [`super::Sampled`] bit for bit.
//!
//! The error of F x. Monte Carlo counts are multinomial, and with the mean f_i = sum over j of F_ij x_j
//!
//!   variance of (F x)_i = (sum over j of F_ij x_j^2 - f_i^2) / m_i
//!
//! The errors e_ij of a hemicube's entries are those of its comparisons, taken for independent:
//!
//!   variance of (F x)_i = sum over j of e_ij^2 x_j^2

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use super::dense::is_error;
use super::matrix::Compressed;
use crate::error::{Error, Result};
use crate::form_factor::Accuracy;
use crate::form_factor::emitter::{Emitter, Tally};
use crate::form_factor::hemicube::Hemicubes;
use crate::form_factor::monte_carlo;
use crate::geometry::sampling::hash;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::Bvh;

/// How a row is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Estimator {
    /// Cosine-distributed random rays, at most 2^20 a patch.
    MonteCarlo,
    /// Hemicubes, at most 2^22 cells an evaluation.
    Hemicube,
}

/// What to compute, and within what.
#[derive(Debug, Clone, Copy)]
pub struct SampledOptions {
    /// Bound on the expected sum over j of |dF_ij|, for every row i; in [1e-10, 1).
    pub tolerance: f64,
    /// Seed of the rays.
    pub seed: u64,
    /// Bytes that may be used.
    pub memory: u64,
}

/// What is known of the errors of the entries.
#[derive(Debug, Clone)]
pub enum Uncertainty {
    /// Rays that each row rests on.
    Rays(Vec<u32>),
    /// The error of every entry, in the order of the rows.
    Entries(Vec<f64>),
}

/// All of sampled rows that neither their scene nor their place in it tells.
#[derive(Debug, Clone)]
pub struct KeptSampled {
    /// The rows.
    pub rows: Compressed,
    /// Their errors.
    pub uncertainty: Uncertainty,
    /// Estimate of the largest row error.
    pub error_estimate: f64,
    /// Rays cast.
    pub rays: u64,
}

/// Rows of the form factors of a scene, each sampled for itself.
#[derive(Debug, Clone)]
pub struct Block {
    /// Number of the first row.
    first: usize,
    /// Number of patches n.
    patches: usize,
    kept: KeptSampled,
}

/// One row as it was found.
#[derive(Default)]
struct Row {
    index: Vec<u32>,
    value: Vec<f64>,
    /// The error of every entry; empty where the number of rays tells it.
    error: Vec<f64>,
    rays: u64,
    row_error: f64,
}

/// Bytes of an entry of a row or column.
const BYTES_OF_ENTRY: u64 = (size_of::<u32>() + size_of::<f64>()) as u64;

/// Bytes that `rows` rows hold at least; how many entries there are is known only as they are found.
pub(super) fn forecast(rows: usize) -> u64 {
    (rows * (2 * size_of::<usize>() + size_of::<f64>() + size_of::<Row>())) as u64
}

/// Refuses what cannot be done or would not fit, before any work.
pub(super) fn check(scene: &Scene, rows: usize, options: &SampledOptions) -> Result<()> {
    scene.require_diffuse("a matrix of form factors")?;
    // The same range as that of the kernels, which keep to steps of it; rays can be as many as asked for.
    Accuracy::new(options.tolerance)?;
    fits(scene, rows, options, forecast(rows))
}

fn fits(scene: &Scene, rows: usize, options: &SampledOptions, needed: u64) -> Result<()> {
    if needed <= options.memory {
        return Ok(());
    }
    let n = scene.len();
    let part = if rows == n { String::new() } else { format!("{rows} rows of ") };
    Err(Error::Memory {
        what: format!("{part}the sampled form factors of {n} patches"),
        needed,
        available: options.memory,
        remedy: "use fewer patches (a larger max_edge) or a looser tolerance".to_string(),
    })
}

impl Block {
    /// Estimates the rows of `range`, whose entries will be held `copies` times. The tree is [`Bvh::of_scene`].
    ///
    /// # Errors
    /// [`Error::Invalid`] for a tolerance out of range, rows that are not there, or a scene with mirrors or glass;
    /// [`Error::Memory`] as soon as the rows no longer fit, [`Error::Interrupted`].
    pub fn new(
        scene: &Scene,
        tree: &Bvh,
        estimator: Estimator,
        options: SampledOptions,
        range: Range<usize>,
        progress: &Progress,
    ) -> Result<Block> {
        Block::held(scene, tree, estimator, options, range, 1, progress)
    }

    /// The same where the entries will be held `copies` times by the finished operator.
    pub(super) fn held(
        scene: &Scene,
        tree: &Bvh,
        estimator: Estimator,
        options: SampledOptions,
        range: Range<usize>,
        copies: u64,
        progress: &Progress,
    ) -> Result<Block> {
        let (n, count, first) = (scene.len(), range.len(), range.start);
        if count == 0 || range.end > n {
            return Err(Error::Invalid(format!("rows {first} .. {} are not rows of {n} patches", range.end)));
        }
        check(scene, count, &options)?;
        let SampledOptions { tolerance, seed, .. } = options;
        let least = forecast(count);
        let hemicubes = Hemicubes::default();
        let (found, finished) = (AtomicU64::new(0), AtomicU64::new(0));
        progress.expect(count as u64);
        let rows: Result<Vec<Row>> = range
            .into_par_iter()
            .map_init(
                || Tally::new(n),
                |tally, i| {
                    let emitter = Emitter::new(scene, tree, i);
                    let row = match estimator {
                        Estimator::MonteCarlo => monte_carlo::row(&emitter, tolerance, seed, tally, progress)?.into(),
                        Estimator::Hemicube => hemicubes.row(&emitter, tolerance, seed, tally, progress)?.into(),
                    };
                    let Row { index, error, .. } = &row;
                    // Every entry is held in its row, too, while the block is put together.
                    let bytes =
                        (1 + copies) * BYTES_OF_ENTRY * index.len() as u64 + 2 * size_of_val(error.as_slice()) as u64;
                    let bytes = bytes + found.fetch_add(bytes, Ordering::Relaxed);
                    let rows = 1 + finished.fetch_add(1, Ordering::Relaxed);
                    if least + bytes > options.memory {
                        // The rows that are still to come need as much as those before.
                        let all = (bytes as f64 * count as f64 / rows as f64) as u64;
                        fits(scene, count, &options, least + all)?;
                        fits(scene, count, &options, least + bytes)?;
                    }
                    progress.advance(1)?;
                    Ok(row)
                },
            )
            .collect();
        Ok(Block::from_rows(first, n, estimator, rows?))
    }

    fn from_rows(first: usize, patches: usize, estimator: Estimator, rows: Vec<Row>) -> Block {
        let entries = rows.iter().map(|row| row.index.len()).sum();
        let (mut start, mut index, mut value) = (vec![0], Vec::with_capacity(entries), Vec::with_capacity(entries));
        let (mut rays, mut error, mut error_estimate) = (Vec::new(), Vec::new(), 0.0f64);
        for row in rows {
            index.extend(row.index);
            value.extend(row.value);
            start.push(index.len());
            error.extend(row.error);
            rays.push(row.rays);
            error_estimate = error_estimate.max(row.row_error);
        }
        let total = rays.iter().sum();
        let uncertainty = match estimator {
            // At most 2^20 a row.
            Estimator::MonteCarlo => Uncertainty::Rays(rays.into_iter().map(|m| m as u32).collect()),
            Estimator::Hemicube => Uncertainty::Entries(error),
        };
        let rows = Compressed { start, index, value };
        Block { first, patches, kept: KeptSampled { rows, uncertainty, error_estimate, rays: total } }
    }

    /// All rows of a scene from what was kept of them.
    ///
    /// # Errors
    /// [`Error::Invalid`] for what cannot be of this scene, or of any.
    pub(super) fn from_kept(scene: &Scene, kept: KeptSampled) -> Result<Block> {
        scene.require_diffuse("a matrix of form factors")?;
        let n = scene.len();
        let KeptSampled { rows, uncertainty, error_estimate, .. } = &kept;
        if rows.len() != n {
            return Err(Error::Invalid(format!("{} rows are not those of {n} patches", rows.len())));
        }
        let is_sound = match uncertainty {
            Uncertainty::Rays(rays) => rays.len() == n && rays.iter().all(|&rays| rays > 0),
            Uncertainty::Entries(errors) => {
                errors.len() == rows.index.len() && errors.iter().all(|&error| is_error(error))
            }
        };
        if !is_sound || !is_error(*error_estimate) {
            return Err(Error::Invalid("the errors of the rows are not those of this matrix".to_string()));
        }
        Ok(Block { first: 0, patches: n, kept })
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.kept.rows.len()
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of patches n, which is that of the columns.
    pub fn patches(&self) -> usize {
        self.patches
    }

    /// Number of entries that are not 0.
    pub fn entries(&self) -> usize {
        self.kept.rows.index.len()
    }

    /// Estimate of the largest row error max_i sum_j |dF_ij|: what is to be expected of Monte Carlo, the sum of both
    /// differences of a hemicube.
    pub fn error_estimate(&self) -> f64 {
        self.kept.error_estimate
    }

    /// Rays cast.
    pub fn rays(&self) -> u64 {
        self.kept.rays
    }

    /// Bytes held.
    pub fn nbytes(&self) -> usize {
        let uncertainty = match &self.kept.uncertainty {
            Uncertainty::Rays(rays) => size_of_val(rays.as_slice()),
            Uncertainty::Entries(errors) => size_of_val(errors.as_slice()),
        };
        self.kept.rows.nbytes() + uncertainty
    }

    /// The rows themselves.
    pub(super) fn rows(&self) -> &Compressed {
        &self.kept.rows
    }

    /// All that neither the scene nor the place of the rows tells.
    pub(super) fn kept(&self) -> &KeptSampled {
        &self.kept
    }

    /// The irradiance of the patches of these rows, out = F x, `bands` numbers a patch. Same bits for any number of
    /// threads.
    pub fn apply(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        self.kept.rows.apply(x, bands, out);
    }

    /// Row k of the block: out_j = F_ij of patch i = first + k.
    pub fn row(&self, k: usize, out: &mut [f64]) {
        out.fill(0.0);
        self.kept.rows.scatter(k, &[1.0], out);
    }

    /// Sum over j of F_ij for every row.
    pub fn row_sums(&self) -> Vec<f64> {
        let mut sums = vec![0.0; self.len()];
        self.apply(&vec![1.0; self.patches], 1, &mut sums);
        sums
    }

    /// The standard error of (F x)_ib that the sampling of F leaves.
    pub fn standard_error(&self, x: &[f64], bands: usize) -> Vec<f64> {
        // In units of the largest, squares neither overflow nor vanish.
        let peak = x.iter().fold(f64::MIN_POSITIVE, |peak, x| x.abs().max(peak));
        let mean = self.mean(x, bands);
        let mut variance = vec![0.0; mean.len()];
        // Around the mean, with what nobody receives as one more class of x = 0: the sum of squares less that of the
        // mean would leave the rounding of both.
        self.for_each_entry(|k, j, error, _| {
            for b in 0..bands {
                variance[k * bands + b] += (error * ((x[j * bands + b] - mean[k * bands + b]) / peak)).powi(2);
            }
        });
        if let Uncertainty::Rays(rays) = &self.kept.uncertainty {
            for (k, (variance, sum)) in
                variance.iter_mut().zip(self.nobody().iter().flat_map(|s| vec![*s; bands])).enumerate()
            {
                *variance += sum / f64::from(rays[k / bands]) * (mean[k] / peak).powi(2);
            }
        }
        variance.iter().map(|v| peak * v.sqrt()).collect()
    }

    /// (dF x)_ib for one realisation of the sampling error dF, number `draw`; `before` is the number of entries in all
    /// rows before these.
    ///
    /// Monte Carlo: dF_ij = s_ij - F_ij sum over k of s_ik, with s_ik = +- sqrt(F_ik / m) and rays that nobody receives
    /// as one more class, has the covariance (F_ij [i = j] - F_ij F_ik) / m of multinomial counts.
    pub fn sampling_error(&self, x: &[f64], bands: usize, draw: u64, before: u64) -> Vec<f64> {
        let seed = hash(draw);
        // A random sign has the variance 1, which is all that a sum of many needs.
        let sign = |k: u64| if hash(seed ^ hash(k)) & 1 == 0 { 1.0 } else { -1.0 };
        let mean = self.mean(x, bands);
        let mut out = vec![0.0; mean.len()];
        self.for_each_entry(|k, j, error, number| {
            let signed = sign(before + number as u64) * error;
            for b in 0..bands {
                out[k * bands + b] += signed * (x[j * bands + b] - mean[k * bands + b]);
            }
        });
        if let Uncertainty::Rays(rays) = &self.kept.uncertainty {
            for (k, nobody) in self.nobody().into_iter().enumerate() {
                let signed = sign(!((self.first + k) as u64)) * (nobody / f64::from(rays[k])).sqrt();
                for b in 0..bands {
                    out[k * bands + b] -= signed * mean[k * bands + b];
                }
            }
        }
        out
    }

    /// Calls `visit(row of the block, j, e_ij, number of the entry)` for every entry, with the standard error e_ij.
    fn for_each_entry(&self, mut visit: impl FnMut(usize, usize, f64, usize)) {
        for k in 0..self.len() {
            let first = self.kept.rows.start[k];
            for (place, (j, f)) in self.kept.rows.row(k).enumerate() {
                let error = match &self.kept.uncertainty {
                    Uncertainty::Rays(rays) => (f / f64::from(rays[k])).sqrt(),
                    Uncertainty::Entries(errors) => errors[first + place],
                };
                visit(k, j, error, first + place);
            }
        }
    }

    /// What the errors are measured from: the mean of counted rays; 0 where every entry has an error of its own.
    fn mean(&self, x: &[f64], bands: usize) -> Vec<f64> {
        let mut mean = vec![0.0; self.len() * bands];
        if matches!(self.kept.uncertainty, Uncertainty::Rays(_)) {
            self.apply(x, bands, &mut mean);
        }
        mean
    }

    /// The fraction of each patch's rays that nobody receives.
    fn nobody(&self) -> Vec<f64> {
        self.row_sums().iter().map(|sum| (1.0 - sum).max(0.0)).collect()
    }
}

impl From<monte_carlo::Hits> for Row {
    fn from(hits: monte_carlo::Hits) -> Row {
        let m = f64::from(hits.rays);
        let (index, value) = hits.counts.into_iter().map(|(j, count)| (j, count / m)).unzip();
        Row { index, value, error: Vec::new(), rays: u64::from(hits.rays), row_error: hits.error }
    }
}

impl From<crate::form_factor::hemicube::Row> for Row {
    fn from(row: crate::form_factor::hemicube::Row) -> Row {
        let mut out = Row { rays: row.rays, row_error: row.error, ..Row::default() };
        for entry in row.entries {
            out.index.push(entry.patch);
            out.value.push(entry.value);
            out.error.push(entry.error);
        }
        out
    }
}
