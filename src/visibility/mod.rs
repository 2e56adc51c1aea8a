//! The question "does x see y?", and "what does a ray hit first?".
//!
//! V(x, y) = 1 when the open segment between x and y meets no patch, else 0. Patches block from both sides.
//!
//! - [`bvh`]: the tree over a scene or its blockers, and what may be asked of it
//! - [`build`]: the binary tree, by binned surface area heuristic; [`wide`]: the same with nodes of eight boxes and leaves of
//!   up to eight triangles, lane by lane
//! - [`traverse`]: rays that have nothing in common, a block at a time ([`block`]); [`bundle`]: segments between one pair of
//!   patches together
//! - [`sift`]: the f32 tests that both rely on; [`crate::simd`]: their vectors
//! - [`intersect`]: the watertight test in f64 that decides (Woop, Benthin & Wald 2013); [`own_surface`]: what a ray leaves
//!   out of account
//! - [`specular`]: rays followed over mirrors and through glass
//! - [`bodies`]: what blocks, merged ([`merge`], [`solids`]) to few convex bodies ([`body`]); [`shaft`]: which of them may stand between two patches;
//!   [`box_tree`]: where they are looked up; [`hull`]: what cannot block
//! - [`sight`]: whole clusters of patches that cannot see each other
//!
//! The conversion to f32, the normalisation of coordinates and the self-hit rule live in this folder and nowhere else.

mod block;
pub mod bodies;
pub mod body;
mod box_tree;
mod build;
mod bundle;
pub mod bvh;
mod hull;
mod intersect;
mod merge;
mod own_surface;
mod ray;
pub mod shaft;
mod sift;
pub mod sight;
mod solids;
pub mod specular;
mod traverse;
mod wide;

pub use crate::simd::Instructions;
pub use bvh::Bvh;
pub use merge::convex_polygons;
pub use ray::{Hit, NO_PATCH, Ray, Segment};
