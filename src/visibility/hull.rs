//! What lies on the convex hull of a scene: it blocks nothing.

use super::box_tree::BoxTree;
use crate::geometry::polygon::Plane;
use crate::scene::Scene;

/// What lies on both sides of a plane, asked of all corners of the scene's patches.
pub(super) struct Hull {
    points: BoxTree,
    tolerance: f64,
}

impl Hull {
    pub(super) fn new(scene: &Scene) -> Hull {
        let mut used: Vec<u32> = scene.faces().as_flattened().to_vec();
        used.sort_unstable();
        used.dedup();
        let at = |v: u32| scene.vertices()[v as usize];
        let points = BoxTree::new(used.into_iter().map(|v| (v, (at(v), at(v)))).collect());
        let (low, high) = points.bounds();
        let size = (high - low).max_element().max(low.abs().max(high.abs()).max_element());
        // What lies off a plane by less than the rounding of its coordinates lies in it.
        Hull { points, tolerance: 64.0 * f64::EPSILON * size }
    }

    /// Whether the scene has corners before a plane and behind it.
    pub(super) fn has_both_sides(&self, plane: &Plane) -> bool {
        self.points.sides(plane, [self.tolerance, -self.tolerance]) == (true, true)
    }
}
