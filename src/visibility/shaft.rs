//! A proof that nothing stands between two patches: an empty shaft.
//!
//! Every segment between patches i and j runs inside the convex hull of the two (the shaft; Haines & Wallace 1991). The
//! hull lies inside (a) its own bounding box, (b) the half spaces before plane i and before plane j, where light leaves
//! and arrives, and (c) the capsule around the line between the centres whose radius is that of the larger patch. A
//! blocker outside any of the three blocks nothing. The test is conservative: it may fail to prove, never prove wrongly.

use super::bvh::Bvh;
use super::wide::{LEAF, Pack, WIDTH};
use crate::geometry::polygon::{Plane, area_vector, centre};
use crate::geometry::{Triangle, Vec3};

/// A bounding volume of everything between two patches, in the tree's own coordinates.
struct Shaft {
    low: Vec3,
    high: Vec3,
    planes: [Plane; 2],
    start: Vec3,
    axis: Vec3,
    axis_squared: f64,
    radius: f64,
    /// Room for rounding. What stands out of a patch's plane by less lies in the plane.
    slack: f64,
}

impl Shaft {
    fn new(a: &Triangle, b: &Triangle) -> Shaft {
        let corners = [a[0], a[1], a[2], b[0], b[1], b[2]];
        let (start, end) = (centre(a), centre(b));
        let low = corners.iter().fold(Vec3::INFINITY, |m, v| m.min(*v));
        let high = corners.iter().fold(Vec3::NEG_INFINITY, |m, v| m.max(*v));
        // Distances inside the shaft carry a few ulp of its size, coordinates a few ulp of the box of size 2.
        let slack = 1e-13 * (high - low).max_element() + 1e-15;
        let radius_of = |t: &Triangle, c: Vec3| t.iter().map(|v| v.distance(c)).fold(0.0, f64::max);
        Shaft {
            low: low - slack,
            high: high + slack,
            planes: [a, b].map(|t| Plane { normal: area_vector(t).normalize_or_zero(), point: t[0] }),
            start,
            axis: end - start,
            axis_squared: (end - start).length_squared(),
            radius: radius_of(a, start).max(radius_of(b, end)) + slack,
            slack,
        }
    }

    /// Whether a convex body with these extremes may reach into the shaft; the body lies within `radius` of `centre`
    /// and reaches `reach(normal)` to the front of a plane through `centre`.
    #[inline]
    fn may_meet(&self, low: Vec3, high: Vec3, centre: Vec3, radius: f64, reach: impl Fn(Vec3) -> f64) -> bool {
        if low.cmpgt(self.high).any() || high.cmplt(self.low).any() {
            return false;
        }
        if self.planes.iter().any(|p| p.distance(centre) + reach(p.normal) <= self.slack) {
            return false;
        }
        let to = centre - self.start;
        let t = if self.axis_squared > 0.0 { (to.dot(self.axis) / self.axis_squared).clamp(0.0, 1.0) } else { 0.0 };
        (to - t * self.axis).length_squared() <= (self.radius + radius) * (self.radius + radius)
    }
}

impl Bvh {
    /// Whether provably no patch of the tree can block a segment from triangle `a` to triangle `b`.
    pub fn shaft_is_empty(&self, a: &Triangle, b: &Triangle, exclude: [u32; 2]) -> bool {
        if self.is_empty() {
            return true;
        }
        let shaft = Shaft::new(&a.map(|v| self.normalise(v)), &b.map(|v| self.normalise(v)));
        let exclude = exclude.map(|patch| self.place(patch));
        let mut stack = vec![0u32];
        while let Some(index) = stack.pop() {
            let node = &self.wide.nodes[index as usize];
            for lane in 0..WIDTH {
                let corner = |row: usize| {
                    let at = |axis: usize| f64::from(node.bounds[2 * axis + row][lane]);
                    Vec3::new(at(0), at(1), at(2))
                };
                let (low, high) = (corner(0), corner(1));
                let half = 0.5 * (high - low);
                if !shaft.may_meet(low, high, low + half, half.length(), |n| half.dot(n.abs())) {
                    continue;
                }
                let child = node.children[lane];
                if child & LEAF == 0 {
                    stack.push(child);
                } else if self.leaf_may_meet(&shaft, &self.wide.packs[(child & !LEAF) as usize], exclude) {
                    return false;
                }
            }
        }
        true
    }

    fn leaf_may_meet(&self, shaft: &Shaft, pack: &Pack, exclude: [u32; 2]) -> bool {
        let first = pack.first as usize;
        (first..first + pack.lanes.count_ones() as usize).any(|k| {
            let triangle = &self.triangles[k];
            let middle = centre(triangle);
            let low = triangle.iter().fold(Vec3::INFINITY, |m, v| m.min(*v));
            let high = triangle.iter().fold(Vec3::NEG_INFINITY, |m, v| m.max(*v));
            let radius = triangle.iter().map(|v| v.distance(middle)).fold(0.0, f64::max);
            let reach = |n: Vec3| triangle.iter().map(|v| n.dot(*v - middle)).fold(f64::NEG_INFINITY, f64::max);
            !exclude.contains(&(k as u32)) && shaft.may_meet(low, high, middle, radius, reach)
        })
    }
}
