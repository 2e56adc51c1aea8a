//! Form factors of a whole scene as an operator: all that a solver may see.
//!
//! - [`operator`]: the trait [`FormFactors`]: gather, shoot, apply, forwards and backwards
//! - [`dense`]: the symmetric exchange of every pair, occluded, stored once
//! - [`triangle`]: where its entries lie, all of them or those that are not 0
//! - [`block`]: some rows by Monte Carlo or hemicube, stored sparsely, each for itself
//! - [`sampled`]: all of them as an operator
//! - [`rays`]: rows by quasi-random rays, and the linear field that they show
//! - [`tiles`]: the product of a symmetric matrix with many columns
//! - [`hidden`]: how much of each pair is visible, and where work is spent
//! - [`matrix`]: matrices that the user brings, dense or sparse
//! - [`numbers`]: the numbers of the largest arrays, in whose memory they may be
//! - [`balance`]: row sums, remainder, reciprocity, and the repair of the first

pub mod balance;
mod block;
pub mod dense;
mod hidden;
pub mod matrix;
pub mod numbers;
pub mod operator;
pub mod rays;
pub mod sampled;
mod tiles;
mod triangle;

pub use block::{Block, Estimator, KeptSampled, SampledOptions, Uncertainty};
pub use dense::{Dense, DenseOptions, KeptDense, Uncertain};
pub use hidden::Blockers;
pub(crate) use hidden::{Candidate, settle};
pub use numbers::Numbers;
pub(crate) use operator::apply_reciprocal;
pub use operator::{FormFactors, Transposed};
pub use rays::{Order, Rays, Trips};
pub use sampled::Sampled;
pub use triangle::Pattern;
