//! Flat geometry: polygons, quadrature over triangles, quasi-random points, subdivision of meshes.
//!
//! Nothing here knows about light. Everything is f64.

pub mod polygon;
pub mod quadrature;
pub mod sampling;
pub mod subdivision;

/// A point or a vector in space, f64.
pub type Vec3 = glam::DVec3;
/// The three corners of a triangle, counter-clockwise seen from the front.
pub type Triangle = [Vec3; 3];
