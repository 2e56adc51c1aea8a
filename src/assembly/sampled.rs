//! The sampled operator: every row of F estimated for itself by rays, stored sparsely.
//!
//! It is one [`Block`] of all rows, with its columns beside it for shooting. F_ij and F_ji are separate estimates, so that
//! reciprocity holds within their errors only; [`super::balance::reciprocity_error`] shows how well. Row sums of a closed
//! scene are 1 to rounding, because every ray arrives somewhere: they say nothing about the error, which is that of
//! [`super::block`].

use super::FormFactors;
use super::block::{self, Block, Estimator, KeptSampled, SampledOptions};
use super::matrix::Compressed;
use crate::error::Result;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::Bvh;

/// Form factors of a scene, each row sampled for itself.
#[derive(Debug, Clone)]
pub struct Sampled {
    areas: Vec<f64>,
    block: Block,
    columns: Compressed,
}

impl Sampled {
    /// Bytes that the operator of `n` patches holds at least; how many entries there are is known only as they are
    /// found.
    pub fn forecast(n: usize) -> u64 {
        block::forecast(n)
    }

    /// Estimates every row.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for a tolerance out of range, [`crate::Error::Memory`] as soon as the rows no longer fit,
    /// [`crate::Error::Interrupted`].
    pub fn new(scene: &Scene, estimator: Estimator, options: SampledOptions, progress: &Progress) -> Result<Sampled> {
        let n = scene.len();
        block::check(scene, n, &options)?;
        let block = Block::held(scene, &Bvh::of_scene(scene), estimator, options, 0..n, 2, progress)?;
        Ok(Sampled::of_block(scene, block))
    }

    fn of_block(scene: &Scene, block: Block) -> Sampled {
        let columns = block.rows().transposed();
        Sampled { areas: scene.areas().to_vec(), block, columns }
    }

    /// The operator of a scene from what was kept of it.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for what cannot be of this scene, or of any.
    pub fn from_kept(scene: &Scene, kept: KeptSampled) -> Result<Sampled> {
        Ok(Sampled::of_block(scene, Block::from_kept(scene, kept)?))
    }

    /// All that the scene does not tell.
    pub fn kept(&self) -> &KeptSampled {
        self.block.kept()
    }

    /// Estimate of the largest row error: [`Block::error_estimate`].
    pub fn error_estimate(&self) -> f64 {
        self.block.error_estimate()
    }

    /// Rays cast.
    pub fn rays(&self) -> u64 {
        self.block.rays()
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
        self.block.rows().gather(i, x, out);
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        self.columns.scatter(i, amount, out);
    }

    fn apply_transposed(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        self.columns.apply(x, bands, out);
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        self.block.row(i, out);
    }

    fn standard_error(&self, x: &[f64], bands: usize) -> Option<Vec<f64>> {
        Some(self.block.standard_error(x, bands))
    }

    fn sampling_error(&self, x: &[f64], bands: usize, draw: u64) -> Option<Vec<f64>> {
        Some(self.block.sampling_error(x, bands, draw, 0))
    }

    fn nbytes(&self) -> usize {
        self.block.nbytes() + self.columns.nbytes() + size_of_val(self.areas.as_slice())
    }
}
