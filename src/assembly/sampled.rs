//! The sampled operator: every row of F estimated for itself by rays, stored sparsely.
//!
//! The rows come from [`crate::form_factor::monte_carlo`] or [`crate::form_factor::hemicube`]. F_ij and F_ji are
//! separate estimates, so that reciprocity holds within their errors only; [`super::balance::reciprocity_error`] shows
//! how well. Row sums of a closed scene are 1 to rounding, because every ray arrives somewhere: they say nothing about
//! the error.
//!
//! The error of F x. Monte Carlo counts are multinomial, and with the mean f_i = sum over j of F_ij x_j
//!
//!   variance of (F x)_i = (sum over j of F_ij x_j^2 - f_i^2) / m_i
//!
//! The errors e_ij of a hemicube's entries are those of its comparisons, taken for independent:
//!
//!   variance of (F x)_i = sum over j of e_ij^2 x_j^2

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use super::FormFactors;
use super::dense::is_error;
use super::matrix::SparseMatrix;
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
    /// The error of every entry, in the order of the matrix.
    Entries(Vec<f64>),
}

/// All of a sampled operator that its scene does not tell.
#[derive(Debug, Clone)]
pub struct KeptSampled {
    /// The rows.
    pub matrix: SparseMatrix,
    /// Their errors.
    pub uncertainty: Uncertainty,
    /// Estimate of the largest row error.
    pub error_estimate: f64,
    /// Rays cast.
    pub rays: u64,
}

/// Form factors of a scene, each row sampled for itself.
#[derive(Debug, Clone)]
pub struct Sampled {
    areas: Vec<f64>,
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

/// Bytes of an entry while the matrix is built: in its row, in the rows and in the columns of the matrix.
const BYTES_OF_ENTRY: u64 = 3 * (size_of::<u32>() + size_of::<f64>()) as u64;

impl Sampled {
    /// Bytes that the operator of `n` patches holds at least; how many entries there are is known only as they are
    /// found.
    pub fn forecast(n: usize) -> u64 {
        (n * (2 * size_of::<usize>() + size_of::<f64>() + size_of::<Row>())) as u64
    }

    /// Estimates every row.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a tolerance out of range, [`Error::Memory`] as soon as the rows no longer fit,
    /// [`Error::Interrupted`].
    pub fn new(scene: &Scene, estimator: Estimator, options: SampledOptions, progress: &Progress) -> Result<Sampled> {
        scene.require_diffuse("a matrix of form factors")?;
        // The same range as that of the kernels, which keep to steps of it; rays can be as many as asked for.
        Accuracy::new(options.tolerance)?;
        let tolerance = options.tolerance;
        let n = scene.len();
        let least = Sampled::forecast(n);
        let fits = |needed: u64| {
            if needed <= options.memory {
                return Ok(());
            }
            Err(Error::Memory {
                what: format!("the sampled form factors of {n} patches"),
                needed,
                available: options.memory,
                remedy: "use fewer patches (a larger max_edge) or a looser tolerance".to_string(),
            })
        };
        fits(least)?;
        let tree = Bvh::of_scene(scene);
        let hemicubes = Hemicubes::default();
        let (found, finished) = (AtomicU64::new(0), AtomicU64::new(0));
        progress.expect(n as u64);
        let rows: Result<Vec<Row>> = (0..n)
            .into_par_iter()
            .map_init(
                || Tally::new(n),
                |tally, i| {
                    let emitter = Emitter::new(scene, &tree, i);
                    let row = match estimator {
                        Estimator::MonteCarlo => {
                            monte_carlo::row(&emitter, tolerance, options.seed, tally, progress)?.into()
                        }
                        Estimator::Hemicube => {
                            hemicubes.row(&emitter, tolerance, options.seed, tally, progress)?.into()
                        }
                    };
                    let Row { index, error, .. } = &row;
                    let bytes = BYTES_OF_ENTRY * index.len() as u64 + 2 * size_of_val(error.as_slice()) as u64;
                    let bytes = bytes + found.fetch_add(bytes, Ordering::Relaxed);
                    let rows = 1 + finished.fetch_add(1, Ordering::Relaxed);
                    if least + bytes > options.memory {
                        // The rows that are still to come need as much as those before.
                        fits(least + (bytes as f64 * n as f64 / rows as f64) as u64)?;
                        fits(least + bytes)?;
                    }
                    progress.advance(1)?;
                    Ok(row)
                },
            )
            .collect();
        Sampled::from_rows(scene, estimator, rows?)
    }

    fn from_rows(scene: &Scene, estimator: Estimator, rows: Vec<Row>) -> Result<Sampled> {
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
        let matrix = SparseMatrix::new(start, index, value)?;
        let kept = KeptSampled { matrix, uncertainty, error_estimate, rays: total };
        Ok(Sampled { areas: scene.areas().to_vec(), kept })
    }

    /// The operator of a scene from what was kept of it.
    ///
    /// # Errors
    /// [`Error::Invalid`] for what cannot be of this scene, or of any.
    pub fn from_kept(scene: &Scene, kept: KeptSampled) -> Result<Sampled> {
        scene.require_diffuse("a matrix of form factors")?;
        let n = scene.len();
        if kept.matrix.len() != n {
            return Err(Error::Invalid(format!("{} rows are not those of {n} patches", kept.matrix.len())));
        }
        let is_sound = match &kept.uncertainty {
            Uncertainty::Rays(rays) => rays.len() == n && rays.iter().all(|&rays| rays > 0),
            Uncertainty::Entries(errors) => {
                errors.len() == kept.matrix.rows().1.len() && errors.iter().all(|&error| is_error(error))
            }
        };
        if !is_sound || !is_error(kept.error_estimate) {
            return Err(Error::Invalid("the errors of the rows are not those of this matrix".to_string()));
        }
        Ok(Sampled { areas: scene.areas().to_vec(), kept })
    }

    /// All that the scene does not tell.
    pub fn kept(&self) -> &KeptSampled {
        &self.kept
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

    /// Calls `visit(i, j, F_ij, e_ij, number of the entry)` for every entry, with the standard error e_ij.
    fn for_each_entry(&self, mut visit: impl FnMut(usize, usize, f64, f64, usize)) {
        for i in 0..self.len() {
            let (first, entries) = self.kept.matrix.entries(i);
            for (k, (j, f)) in entries.enumerate() {
                let error = match &self.kept.uncertainty {
                    Uncertainty::Rays(rays) => (f / f64::from(rays[i])).sqrt(),
                    Uncertainty::Entries(errors) => errors[first + k],
                };
                visit(i, j, f, error, first + k);
            }
        }
    }

    fn counts(&self) -> bool {
        matches!(self.kept.uncertainty, Uncertainty::Rays(_))
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

impl FormFactors for Sampled {
    fn len(&self) -> usize {
        self.areas.len()
    }

    fn areas(&self) -> Option<&[f64]> {
        Some(&self.areas)
    }

    fn gather(&self, i: usize, x: &[f64], out: &mut [f64]) {
        self.kept.matrix.gather(i, x, out);
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        self.kept.matrix.shoot(i, amount, out);
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        self.kept.matrix.row(i, out);
    }

    fn standard_error(&self, x: &[f64], bands: usize) -> Option<Vec<f64>> {
        // In units of the largest, squares neither overflow nor vanish.
        let peak = x.iter().fold(f64::MIN_POSITIVE, |peak, x| x.abs().max(peak));
        let mut mean = vec![0.0; x.len()];
        if self.counts() {
            self.apply(x, bands, &mut mean);
        }
        let mut variance = vec![0.0; x.len()];
        // Around the mean, with what nobody receives as one more class of x = 0: the sum of squares less that of the
        // mean would leave the rounding of both.
        self.for_each_entry(|i, j, _, error, _| {
            for b in 0..bands {
                variance[i * bands + b] += (error * ((x[j * bands + b] - mean[i * bands + b]) / peak)).powi(2);
            }
        });
        if let Uncertainty::Rays(rays) = &self.kept.uncertainty {
            for (k, (variance, sum)) in
                variance.iter_mut().zip(self.nobody().iter().flat_map(|s| vec![*s; bands])).enumerate()
            {
                *variance += sum / f64::from(rays[k / bands]) * (mean[k] / peak).powi(2);
            }
        }
        Some(variance.iter().map(|v| peak * v.sqrt()).collect())
    }

    /// Monte Carlo: dF_ij = s_ij - F_ij sum over k of s_ik, with s_ik = +- sqrt(F_ik / m) and rays that nobody receives
    /// as one more class, has the covariance (F_ij [i = j] - F_ij F_ik) / m of multinomial counts.
    fn sampling_error(&self, x: &[f64], bands: usize, draw: u64) -> Option<Vec<f64>> {
        let seed = hash(draw);
        // A random sign has the variance 1, which is all that a sum of many needs.
        let sign = |k: u64| if hash(seed ^ hash(k)) & 1 == 0 { 1.0 } else { -1.0 };
        let mut mean = vec![0.0; x.len()];
        if self.counts() {
            self.apply(x, bands, &mut mean);
        }
        let mut out = vec![0.0; x.len()];
        self.for_each_entry(|i, j, _, error, number| {
            let signed = sign(number as u64) * error;
            for b in 0..bands {
                out[i * bands + b] += signed * (x[j * bands + b] - mean[i * bands + b]);
            }
        });
        if let Uncertainty::Rays(rays) = &self.kept.uncertainty {
            for (i, nobody) in self.nobody().into_iter().enumerate() {
                let signed = sign(!(i as u64)) * (nobody / f64::from(rays[i])).sqrt();
                for b in 0..bands {
                    out[i * bands + b] -= signed * mean[i * bands + b];
                }
            }
        }
        Some(out)
    }

    fn nbytes(&self) -> usize {
        let uncertainty = match &self.kept.uncertainty {
            Uncertainty::Rays(rays) => size_of_val(rays.as_slice()),
            Uncertainty::Entries(errors) => size_of_val(errors.as_slice()),
        };
        self.kept.matrix.nbytes() + size_of_val(self.areas.as_slice()) + uncertainty
    }
}

impl Sampled {
    /// The fraction of each patch's rays that nobody receives.
    fn nobody(&self) -> Vec<f64> {
        self.row_sums().iter().map(|sum| (1.0 - sum).max(0.0)).collect()
    }
}
