//! What may stand between two patches: the bodies that reach into their shaft.
//!
//! Every segment between patches i and j runs inside the convex hull of the two (the shaft; Haines & Wallace 1991). The
//! hull lies inside (a) its own bounding box, (b) the half spaces before plane i and before plane j, where light leaves
//! and arrives, (c) the capsule around the line between the centres whose radius is that of the larger patch, and (d) the
//! half spaces of its own walls, the planes through an edge of one patch and a corner of the other that have all six corners
//! on one side. A body outside any of them blocks nothing, nor does one that has all six corners in front of one of its
//! faces. The test is conservative: it may fail to prove, never prove wrongly.

use std::cell::OnceCell;

use super::bodies::Body;
use crate::geometry::polygon::{Plane, area_vector, centre};
use crate::geometry::{Triangle, Vec3};

/// A bounding volume of everything between two patches.
pub struct Shaft {
    corners: [Vec3; 6],
    low: Vec3,
    high: Vec3,
    planes: [Plane; 2],
    start: Vec3,
    axis: Vec3,
    axis_squared: f64,
    radius: f64,
    /// Room for rounding. What stands out of a patch's plane by less lies in the plane.
    slack: f64,
    /// The walls of the hull, their normals inward; known once they have been asked for.
    walls: OnceCell<Vec<Plane>>,
}

impl Shaft {
    /// Between two triangles.
    pub fn new(a: &Triangle, b: &Triangle) -> Shaft {
        let corners = [a[0], a[1], a[2], b[0], b[1], b[2]];
        let (start, end) = (centre(a), centre(b));
        let low = corners.iter().fold(Vec3::INFINITY, |m, v| m.min(*v));
        let high = corners.iter().fold(Vec3::NEG_INFINITY, |m, v| m.max(*v));
        // Distances inside the shaft carry a few ulp of its size and of the coordinates.
        let slack = 1e-12 * (high - low).max_element() + 16.0 * f64::EPSILON * low.abs().max(high.abs()).max_element();
        let radius_of = |t: &Triangle, c: Vec3| t.iter().map(|v| v.distance(c)).fold(0.0, f64::max);
        Shaft {
            corners,
            low: low - slack,
            high: high + slack,
            planes: [a, b].map(|t| Plane { normal: area_vector(t).normalize_or_zero(), point: t[0] }),
            start,
            axis: end - start,
            axis_squared: (end - start).length_squared(),
            radius: radius_of(a, start).max(radius_of(b, end)) + slack,
            slack,
            walls: OnceCell::new(),
        }
    }

    /// Whether something in a box may reach into the shaft.
    #[inline]
    pub(super) fn may_meet_box(&self, low: Vec3, high: Vec3) -> bool {
        if low.cmpgt(self.high).any() || high.cmplt(self.low).any() {
            return false;
        }
        let half = 0.5 * (high - low);
        let centre = low + half;
        if self.planes.iter().any(|p| p.distance(centre) + half.dot(p.normal.abs()) <= self.slack) {
            return false;
        }
        let to = centre - self.start;
        let t = if self.axis_squared > 0.0 { (to.dot(self.axis) / self.axis_squared).clamp(0.0, 1.0) } else { 0.0 };
        let reach = self.radius + half.length();
        (to - t * self.axis).length_squared() <= reach * reach
    }

    /// Whether a body may reach into the shaft.
    pub fn may_hold(&self, body: &Body) -> bool {
        if !self.may_meet_box(body.low, body.high) {
            return false;
        }
        let outside = |plane: &Plane| {
            let out = |x: Vec3| plane.distance(x) <= self.slack;
            body.edges.iter().all(|edge| out(edge.start) && out(edge.end))
        };
        if self.planes.iter().any(outside) {
            return false;
        }
        if body.faces.iter().any(|face| self.corners.iter().all(|x| face.distance(*x) >= -self.slack)) {
            return false;
        }
        !self.walls.get_or_init(|| walls(&self.corners, self.slack)).iter().any(outside)
    }
}

/// The planes through an edge of one triangle and a corner of the other that have all six corners on one side.
fn walls(corners: &[Vec3; 6], slack: f64) -> Vec<Plane> {
    let mut walls = Vec::with_capacity(8);
    for (p, q) in [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3)] {
        for r in if p < 3 { 3..6 } else { 0..3 } {
            let point = corners[p];
            let normal = (corners[q] - point).cross(corners[r] - point).normalize_or_zero();
            let (mut least, mut most) = (0.0f64, 0.0f64);
            for x in corners {
                let d = normal.dot(*x - point);
                (least, most) = (least.min(d), most.max(d));
            }
            if least >= -slack && most > slack {
                walls.push(Plane { normal, point });
            } else if most <= slack && least < -slack {
                walls.push(Plane { normal: -normal, point });
            }
        }
    }
    walls
}
