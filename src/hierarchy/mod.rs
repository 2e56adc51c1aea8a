//! Hierarchical radiosity: form factors as links between elements of all sizes, and scenes solved on them.
//!
//! What is far away, or dim, need not be looked at patch by patch. Patches are gathered to clusters and cut into elements, and
//! two nodes of that tree are linked where a single link between them is good enough (Hanrahan, Salzman & Aupperle, "A
//! Rapid Hierarchical Radiosity Algorithm", SIGGRAPH 1991; clusters: Smits, Arvo & Greenberg 1994).
//!
//! - [`tree`]: clusters ([`clusters`]), patches, elements; [`node`]: one of them; [`functions`]: what radiosity is on it, linear in
//!   position and normal
//! - [`oracle`]: what two nodes exchange, how much of it is hidden, how far a link would be wrong
//! - [`refine`]: from the root down to links that a goal allows
//! - [`link`]: one of them; [`links`]: all as an operator; [`push_pull`]: up and down the tree
//! - [`operator`]: the goal of form factors, a row tolerance
//! - [`light`]: the goal of a solve, brightness x form factor x area; [`balanced`]: scenes that lose no light
//! - [`solver`]: refine, solve, refine again; [`mesh`]: the leaves, to be shown

pub mod balanced;
mod clusters;
pub mod functions;
pub mod light;
pub mod link;
pub mod links;
pub mod mesh;
pub mod node;
pub mod operator;
pub mod oracle;
pub mod push_pull;
pub mod refine;
pub mod solver;
pub mod tree;

pub use links::Links;
pub use operator::{HierarchicalOptions, Reached, form_factors, from_kept};
pub use solver::Solver;
