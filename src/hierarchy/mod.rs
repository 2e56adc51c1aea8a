//! Hierarchical radiosity.
pub mod closed;
pub mod functions;
pub mod links;
pub mod oracle;
pub mod light;
mod operator;
pub mod solver;
pub mod push_pull;
pub mod refine;
pub mod tree;

pub use links::Links;
pub use solver::Solver;
pub use operator::{HierarchicalOptions, Reached, form_factors};
