//! A convex body that blocks light, by its faces and edges.

use crate::geometry::Vec3;
use crate::geometry::polygon::{Plane, Side};

/// What a body counts as smaller where it has to hide for certain, relative to its size: far above what rounds off.
const MARGIN: f64 = 1e-6;

/// A convex body: a solid, or a flat sheet as a solid of two faces.
#[derive(Debug, Clone)]
pub struct Body {
    /// Planes whose normals point out of the body. Of a sheet: the plane of its front, then the same from behind.
    pub faces: Vec<Plane>,
    /// Every edge once.
    pub edges: Vec<Edge>,
    /// Every corner once, in the order of the edges.
    pub corners: Vec<Vec3>,
    /// The smallest coordinates.
    pub low: Vec3,
    /// The largest coordinates.
    pub high: Vec3,
    /// A length that counts as none beside the body: a part of its size, or the rounding of its coordinates as they were given.
    pub slack: f64,
}

/// Where two faces of a body meet.
#[derive(Debug, Clone, Copy)]
pub struct Edge {
    /// Where the left face's border, counter-clockwise seen from outside, enters the edge.
    pub start: Vec3,
    /// Where it leaves the edge.
    pub end: Vec3,
    /// The face that has the edge from `start` to `end`.
    pub left: u32,
    /// The face that has the edge from `end` to `start`.
    pub right: u32,
}

impl Body {
    /// From what bounds it.
    pub fn new(faces: Vec<Plane>, edges: Vec<Edge>) -> Body {
        let mut corners: Vec<Vec3> = edges.iter().flat_map(|edge| [edge.start, edge.end]).collect();
        corners.sort_unstable_by(|a, b| {
            let order = |k: usize| a[k].total_cmp(&b[k]);
            order(0).then(order(1)).then(order(2))
        });
        corners.dedup();
        let (low, high) = extremes(corners.iter().copied());
        let slack = 1e-10 * (high - low).max_element() + 64.0 * f64::EPSILON * high.abs().max(low.abs()).max_element();
        Body { faces, edges, corners, low, high, slack }
    }

    /// The same in coordinates relative to `origin`.
    pub fn relative_to(&self, origin: Vec3) -> Body {
        Body {
            faces: self.faces.iter().map(|face| Plane { point: face.point - origin, ..*face }).collect(),
            edges: self
                .edges
                .iter()
                .map(|edge| Edge { start: edge.start - origin, end: edge.end - origin, ..*edge })
                .collect(),
            corners: self.corners.iter().map(|x| *x - origin).collect(),
            low: self.low - origin,
            high: self.high - origin,
            slack: self.slack,
        }
    }

    /// Whether the body has no thickness.
    pub fn is_sheet(&self) -> bool {
        let [front, back, ..] = self.faces.as_slice() else { return false };
        front.normal == -back.normal && front.point == back.point
    }

    /// Whether the body stands in the way of every segment from one of `a` to one of `b`, and therefore of all between the convex
    /// hulls of the two: asked of a body smaller by [`MARGIN`], so that none is hidden by what it touches.
    pub fn hides(&self, a: &[Vec3], b: &[Vec3]) -> bool {
        let margin = MARGIN * (self.high - self.low).max_element() + self.slack;
        a.iter().all(|x| b.iter().all(|y| self.cuts(*x, *y, margin)))
    }

    /// Whether a segment enters and leaves the body that is smaller by `margin`.
    pub(super) fn cuts(&self, x: Vec3, y: Vec3, margin: f64) -> bool {
        let (mut enters, mut leaves) = (0.0f64, 1.0f64);
        for face in &self.faces {
            let (d0, d1) = (face.distance(x) + margin, face.distance(y) + margin);
            if d0 > 0.0 && d1 > 0.0 {
                return false;
            }
            if d0 > 0.0 {
                enters = enters.max(d0 / (d0 - d1));
            } else if d1 > 0.0 {
                leaves = leaves.min(d0 / (d0 - d1));
            }
        }
        0.0 < enters && enters < leaves && leaves < 1.0
    }

    /// Where the body lies as seen from a plane that is known to `slack`.
    pub fn side_of(&self, plane: &Plane, slack: f64) -> Side {
        let slack = self.slack.max(slack);
        let (mut before, mut behind) = (false, false);
        for &corner in &self.corners {
            let d = snapped(plane, corner, slack);
            before |= d > 0.0;
            behind |= d < 0.0;
        }
        Side::of(before, behind)
    }

    /// The part in front of a plane, known to `slack`, that cuts the body: edges are cut, and each face that the plane cuts gets
    /// an edge along the cut.
    pub fn cut(&self, plane: &Plane, slack: f64) -> Body {
        let slack = self.slack.max(slack);
        let mut edges = Vec::with_capacity(self.edges.len() + 2);
        // Where the cut enters and leaves each face, and whether the face has something in front.
        let mut cuts: Vec<([Option<Vec3>; 2], bool)> = vec![([None; 2], false); self.faces.len()];
        for edge in &self.edges {
            let (d0, d1) = (snapped(plane, edge.start, slack), snapped(plane, edge.end, slack));
            let crosses = (d0 < 0.0 && d1 > 0.0) || (d0 > 0.0 && d1 < 0.0);
            let crossing = crosses.then(|| edge.start + d0 / (d0 - d1) * (edge.end - edge.start));
            for face in [edge.left, edge.right] {
                let (points, front) = &mut cuts[face as usize];
                *front |= d0 > 0.0 || d1 > 0.0;
                let on_plane = [crossing, (d0 == 0.0).then_some(edge.start), (d1 == 0.0).then_some(edge.end)];
                for point in on_plane.into_iter().flatten() {
                    // Of several corners that count as on the plane, the cut runs between the outermost.
                    match *points {
                        [None, _] => points[0] = Some(point),
                        [Some(p), None] if p != point => points[1] = Some(point),
                        [Some(p), Some(q)] => {
                            let across = p.distance_squared(q);
                            let [to_p, to_q] = [p, q].map(|x| x.distance_squared(point));
                            if to_p.max(to_q) > across {
                                points[usize::from(to_p >= to_q)] = Some(point);
                            }
                        }
                        _ => {}
                    }
                }
            }
            match crossing {
                Some(point) if d0 > 0.0 => edges.push(Edge { end: point, ..*edge }),
                Some(point) => edges.push(Edge { start: point, ..*edge }),
                None if d0 > 0.0 || d1 > 0.0 => edges.push(*edge),
                None => {}
            }
        }
        let cap = self.faces.len() as u32;
        for (k, (points, front)) in cuts.into_iter().enumerate() {
            if let ([Some(p), Some(q)], true) = (points, front) {
                // The face lies to the left of its edges, in front of the plane.
                let forward = plane.normal.dot(self.faces[k].normal.cross(q - p)) > 0.0;
                let (start, end) = if forward { (p, q) } else { (q, p) };
                edges.push(Edge { start, end, left: k as u32, right: cap });
            }
        }
        let mut faces = self.faces.clone();
        faces.push(Plane { normal: -plane.normal, point: plane.point });
        Body { slack, ..Body::new(faces, edges) }
    }
}

/// The distance of `x` before `plane`, exactly 0 when it counts as none.
fn snapped(plane: &Plane, x: Vec3, slack: f64) -> f64 {
    let d = plane.distance(x);
    if d.abs() <= slack { 0.0 } else { d }
}

/// Smallest and largest coordinates.
pub fn extremes(points: impl IntoIterator<Item = Vec3>) -> (Vec3, Vec3) {
    points.into_iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
}
