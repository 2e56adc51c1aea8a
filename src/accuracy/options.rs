//! What is asked of a solve.

use crate::assembly::Order;
use crate::direct::Lights;
use crate::error::{Error, Result};
use crate::scene::Scene;

/// What is asked for.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Error to be reached, in (0, 1).
    pub tolerance: f64,
    /// How radiosity varies over a patch.
    pub order: Order,
    /// Whether light may be followed below the patches where they are too coarse.
    pub refine: bool,
    /// Seed of all samples.
    pub seed: u64,
    /// Bytes that may be used.
    pub memory: u64,
}

impl Options {
    pub(super) fn check(&self, scene: &Scene, lights: &Lights) -> Result<()> {
        if !(self.tolerance > 0.0 && self.tolerance < 1.0) {
            return Err(Error::Invalid(format!("tolerance {} is outside (0, 1)", self.tolerance)));
        }
        if lights.is_empty() { Ok(()) } else { scene.require_diffuse("the light of suns, points and skies") }
    }
}
