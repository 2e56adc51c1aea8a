//! What a ray does not meet: the surface that it starts on, and a segment also the one that it ends on.
//!
//! Patches that the caller names are left out by their place in the tree. A patch that is not named (a neighbour in the same
//! plane, or all of them when a user asks from a point on a mesh) is told by two rules, neither of them an absolute length:
//! it is not met within [`OWN_SURFACE`] of the end, and not at all when the end lies in its plane as far as rounding lets
//! one tell.

use super::block::through_the_box;
use super::bvh::Bvh;
use super::intersect::{Line, main_axis};
use super::ray::Segment;
use crate::geometry::Vec3;
use crate::geometry::polygon::area_vector;

/// Of a ray: relative to the scene. Of a segment: relative to its length, but not more than that.
///
/// What is nearer to each other along a ray is one surface to it, of which it meets what faces it.
pub(super) const OWN_SURFACE: f64 = 1e-9;

impl Bvh {
    /// Where the own surface surely ends, in f32: the end of a ray that hits a triangle for sure beyond this does not lie in
    /// its plane. For sure means that D, twice the sheared area, is more than half of three errors of an edge function, so
    /// that the ray meets the plane at a sine of more than 1e-6.
    pub(super) fn own_reach(rounding: f64) -> f32 {
        (1e6 * rounding).max(1e-5) as f32
    }

    /// Whether a ray from `origin` that hits triangle `k` at `t` meets it.
    #[inline(always)]
    pub(super) fn meets(&self, k: usize, t: f64, origin: Vec3) -> bool {
        t > OWN_SURFACE && !self.in_plane(k, origin)
    }

    /// Whether triangle `k` stands between the ends of `segment`.
    pub(super) fn stands_between(&self, k: usize, segment: &Segment) -> bool {
        let (start, end) = (self.normalise(segment.start), self.normalise(segment.end));
        let way = end - start;
        let size = way.abs()[main_axis(way)];
        let direction = way * (1.0 / size);
        let Some((enter, _)) = through_the_box(start, direction, size) else { return false };
        let from = start + enter * direction;
        let Some((t, _)) = Line::new(from, direction, way).hit(&self.triangles[k]) else { return false };
        let (t, own) = (t + enter, OWN_SURFACE * size.min(1.0));
        t > own && t < size - own && !self.in_plane(k, start) && !self.in_plane(k, end)
    }

    /// Whether `x` lies in the plane of triangle `k`, as far as rounding lets one tell.
    #[inline(always)]
    fn in_plane(&self, k: usize, x: Vec3) -> bool {
        let triangle = &self.triangles[k];
        let normal = area_vector(triangle);
        let distance = normal.dot(x - triangle[0]);
        distance * distance <= self.rounding * self.rounding * normal.length_squared()
    }
}
