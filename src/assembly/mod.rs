//! Form factors of a whole scene as an operator: all that a solver may see.
//!
//! - [`operator`]: the trait [`FormFactors`]: gather, shoot, apply
//! - [`dense`]: the symmetric exchange of every pair, occluded, stored once
//! - [`sampled`]: rows by Monte Carlo or hemicube, stored sparsely
//! - [`rays`]: rows by quasi-random rays, and the linear field that they show
//! - [`hidden`]: how much of each pair is visible, and where work is spent
//! - [`matrix`]: matrices that the user brings, dense or sparse
//! - [`numbers`]: the numbers of the largest arrays, in whose memory they may be
//! - [`balance`]: row sums, remainder, reciprocity, and the repair of the first

pub mod balance;
pub mod dense;
mod hidden;
pub mod matrix;
pub mod numbers;
pub mod operator;
pub mod rays;
pub mod sampled;

pub use dense::{Dense, DenseOptions, KeptDense, Uncertain};
pub use hidden::Blockers;
pub(crate) use hidden::{Candidate, settle};
pub use numbers::Numbers;
pub use operator::FormFactors;
pub use rays::{Order, Rays, Trips};
pub use sampled::{Estimator, KeptSampled, Sampled, SampledOptions, Uncertainty};
