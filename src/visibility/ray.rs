//! What is asked, and what is answered.

use crate::geometry::Vec3;

/// The patch number that says "none".
pub const NO_PATCH: u32 = u32::MAX;

/// A ray: what does it meet first?
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Where it starts.
    pub origin: Vec3,
    /// Where it goes: finite, of any length but 0.
    pub direction: Vec3,
    /// The patch that it starts on, which it does not meet, or [`NO_PATCH`].
    pub exclude: u32,
}

/// A segment: does anything stand between its ends?
#[derive(Debug, Clone, Copy)]
pub struct Segment {
    /// One end.
    pub start: Vec3,
    /// The other.
    pub end: Vec3,
    /// The patches of the two ends, which do not block, or [`NO_PATCH`].
    pub exclude: [u32; 2],
}

/// The first thing that a ray meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// The patch; of two that share one triangle back to back, the one that faces the ray.
    pub patch: u32,
    /// Distance along the ray, in units of the length of its direction.
    pub t: f64,
    /// Barycentric coordinates of the patch's corners 1 and 2.
    pub barycentric: [f64; 2],
}
