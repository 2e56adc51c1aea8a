//! Hierarchical radiosity.
pub mod functions;
pub mod links;
pub mod oracle;
mod operator;
pub mod push_pull;
pub mod refine;
pub mod tree;

pub use links::Links;
pub use operator::{HierarchicalOptions, Reached, form_factors};
