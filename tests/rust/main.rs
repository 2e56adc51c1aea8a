//! Tests of the Rust core, one file a module. Three kinds of proof: closed forms with their source, agreement between
//! independent methods, and physics on random scenes.

#![allow(missing_docs)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test that panics has failed")]

mod accuracy;
mod assembly;
mod bodies;
mod common;
mod direct;
mod final_gather;
mod form_factor;
mod form_factor_estimators;
mod fuzz;
mod fuzz_case;
mod geometry;
mod hierarchy;
mod instant;
mod kept;
mod rays;
mod relight;
mod render;
mod scene;
mod shadow;
mod solve;
mod specular;
mod visibility;
