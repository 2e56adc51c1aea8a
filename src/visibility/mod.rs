//! The question "does x see y?", and "what does a ray hit first?".
//!
//! V(x, y) = 1 when the open segment between x and y meets no patch, else 0. Patches block from both sides.
//!
//! - [`bvh`]: the tree (built by obvhs) over normalised triangles, and its traversal
//! - [`intersect`]: the watertight test of a ray against a triangle (Woop, Benthin & Wald 2013)
//! - [`shaft`]: a proof that nothing can stand between two patches
//!
//! The conversion to f32, the normalisation of coordinates and the self-hit rule live in this folder and nowhere else.

pub mod bvh;
mod intersect;
mod shaft;

pub use bvh::{Bvh, Hit, NO_PATCH};
