//! Form factors of a whole scene as an operator: all that a solver may see.
//!
//! - [`operator`]: the trait [`FormFactors`]: gather, shoot, apply
//! - [`dense`]: the symmetric exchange of every pair, occluded, stored once
//! - [`matrix`]: matrices that the user brings, dense or sparse
//! - [`balance`]: row sums, remainder, reciprocity

pub mod balance;
pub mod dense;
pub mod matrix;
pub mod operator;

pub use dense::{Dense, DenseOptions};
pub use operator::FormFactors;
