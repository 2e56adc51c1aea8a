//! What may stand between two patches: the bodies that reach into their shaft.
//!
//! Every segment between patches i and j runs inside the convex hull of the two (the shaft; Haines & Wallace 1991). The
//! hull lies inside (a) its own bounding box, (b) the half spaces before plane i and before plane j, where light leaves
//! and arrives, and (c) the capsule around the line between the centres whose radius is that of the larger patch: quick
//! tests. What they leave is decided by looking for a plane between the hull and the body (Chung & Wang 1996, "Quick collision
//! detection of polytopes in virtual environments"): a direction in which no corner of one reaches the other. When none is
//! found, the body counts: the test may fail to prove, never prove wrongly.

use super::body::Body;
use crate::geometry::polygon::{Plane, area_vector, centre};
use crate::geometry::{Triangle, Vec3};

/// Steps towards a plane between hull and body: most that are apart are known to be after a few.
const STEPS: usize = 6;

/// Corners that the two ends may have together: two boxes.
const MOST_CORNERS: usize = 16;

/// A bounding volume of everything between two patches, or two sets of patches.
pub struct Shaft {
    corners: [Vec3; MOST_CORNERS],
    count: usize,
    low: Vec3,
    high: Vec3,
    /// Of those ends that are flat.
    planes: [Option<Plane>; 2],
    start: Vec3,
    axis: Vec3,
    axis_squared: f64,
    radius: f64,
    /// Room for rounding. What stands out of a patch's plane by less lies in the plane.
    pub(super) slack: f64,
}

impl Shaft {
    /// Between two triangles.
    pub fn new(a: &Triangle, b: &Triangle) -> Shaft {
        let plane = |t: &Triangle| Some(Plane { normal: area_vector(t).normalize_or_zero(), point: t[0] });
        Shaft::between(a, b, [plane(a), plane(b)])
    }

    /// Between all that lies in the convex hulls of some points, 8 at most each; with the planes of what is flat.
    pub fn between(a: &[Vec3], b: &[Vec3], planes: [Option<Plane>; 2]) -> Shaft {
        let (mut corners, count) = ([Vec3::ZERO; MOST_CORNERS], a.len() + b.len());
        corners[..a.len()].copy_from_slice(a);
        corners[a.len()..count].copy_from_slice(b);
        let (start, end) = (centre(a), centre(b));
        let low = corners[..count].iter().fold(Vec3::INFINITY, |m, v| m.min(*v));
        let high = corners[..count].iter().fold(Vec3::NEG_INFINITY, |m, v| m.max(*v));
        // Distances inside the shaft carry a few ulp of its size and of the coordinates.
        let slack = 1e-12 * (high - low).max_element() + 16.0 * f64::EPSILON * low.abs().max(high.abs()).max_element();
        let radius_of = |t: &[Vec3], c: Vec3| t.iter().map(|v| v.distance(c)).fold(0.0, f64::max);
        Shaft {
            corners,
            count,
            low: low - slack,
            high: high + slack,
            planes,
            start,
            axis: end - start,
            axis_squared: (end - start).length_squared(),
            radius: radius_of(a, start).max(radius_of(b, end)) + slack,
            slack,
        }
    }

    fn corners(&self) -> &[Vec3] {
        &self.corners[..self.count]
    }

    /// Whether something in a box may reach into the shaft.
    #[inline]
    pub(super) fn may_meet_box(&self, low: Vec3, high: Vec3) -> bool {
        if low.cmpgt(self.high).any() || high.cmplt(self.low).any() {
            return false;
        }
        let half = 0.5 * (high - low);
        let centre = low + half;
        if self.planes.iter().flatten().any(|p| p.distance(centre) + half.dot(p.normal.abs()) <= self.slack) {
            return false;
        }
        let to = centre - self.start;
        let t = if self.axis_squared > 0.0 { (to.dot(self.axis) / self.axis_squared).clamp(0.0, 1.0) } else { 0.0 };
        let reach = self.radius + half.length();
        (to - t * self.axis).length_squared() <= reach * reach
    }

    /// Whether a body may reach into the shaft, by quick tests.
    pub fn may_hold(&self, body: &Body) -> bool {
        if !self.may_meet_box(body.low, body.high) {
            return false;
        }
        if self.planes.iter().flatten().any(|plane| body.corners.iter().all(|x| plane.distance(*x) <= self.slack)) {
            return false;
        }
        if body.faces.iter().any(|face| self.corners().iter().all(|x| face.distance(*x) >= -self.slack)) {
            return false;
        }
        true
    }

    /// The same, by looking for a plane between the two, unless the body stands between the centres.
    pub fn holds(&self, body: &Body) -> bool {
        self.may_hold(body)
            && (body.cuts(self.start, self.start + self.axis, self.slack)
                || !are_apart(self.corners(), &body.corners, self.slack, STEPS))
    }
}

/// Whether a plane between two sets of points has been found in so many steps, no more than `slack` inside either.
pub fn are_apart(a: &[Vec3], b: &[Vec3], slack: f64, steps: usize) -> bool {
    let mut direction = (centre(b) - centre(a)).normalize_or(Vec3::X);
    for _ in 0..steps {
        let gap = furthest(b, -direction) - furthest(a, direction);
        if direction.dot(gap) >= -slack {
            return true;
        }
        let Some(gap) = gap.try_normalize() else { return false };
        direction = (direction - 2.0 * direction.dot(gap) * gap).normalize_or(Vec3::X);
    }
    false
}

/// The point that lies furthest in a direction.
fn furthest(points: &[Vec3], direction: Vec3) -> Vec3 {
    let mut best = points[0];
    for &point in &points[1..] {
        if direction.dot(point) > direction.dot(best) {
            best = point;
        }
    }
    best
}
