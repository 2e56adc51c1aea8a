//! Which kernel for which pair: the cheapest one whose error is known to be inside the tolerance.
//!
//! Two ratios decide. q_area = (R_a + R_b) / |c_a - c_b| for area quadrature; q_point = R_small / (distance from the smaller
//! polygon's centre to the larger one, from below) for point-to-polygon. A kernel is taken when its ratio is under the
//! threshold that kept 99.9 % of some thousand mixed pairs inside the tolerance with a safety of 4; pairs that no ratio
//! admits go to the contour integral.

use super::{Shape, area_quadrature, contour, point_to_polygon};
use crate::error::{Error, Result};
use crate::geometry::Vec3;
use crate::geometry::polygon::{Plane, area_vector, clip_to_front};
use crate::geometry::quadrature::TriangleRule;

/// Largest ratios for a tolerance: area quadrature with 3 and 6 points, point-to-polygon with 7, 12 and 16 points.
#[derive(Debug, Clone, Copy)]
struct Thresholds {
    tolerance: f64,
    area: [(TriangleRule, f64); 2],
    point: [(TriangleRule, f64); 3],
}

const fn row(tolerance: f64, a3: f64, a6: f64, l7: f64, l12: f64, l16: f64) -> Thresholds {
    use TriangleRule::{P3, P6, P7, P12, P16};
    Thresholds { tolerance, area: [(P3, a3), (P6, a6)], point: [(P7, l7), (P12, l12), (P16, l16)] }
}

/// Measured against triangle pairs with form factors known to 300 bits (tests/data/README.md).
const TABLE: [Thresholds; 5] = [
    row(1e-2, 0.242, 0.518, 0.549, 0.817, 1.44),
    row(1e-3, 0.106, 0.435, 0.423, 0.761, 0.817),
    row(1e-4, 0.043, 0.241, 0.239, 0.505, 0.720),
    row(1e-6, 0.012, 0.103, 0.079, 0.239, 0.366),
    row(1e-8, 0.002, 0.032, 0.039, 0.126, 0.209),
];

/// A relative tolerance for the form factor of one unoccluded pair.
#[derive(Debug, Clone, Copy)]
pub struct Accuracy {
    thresholds: Thresholds,
}

impl Accuracy {
    /// The tightest tolerance that can be asked for.
    pub const TIGHTEST: f64 = 1e-8;

    /// # Errors
    /// [`Error::Invalid`] when `tolerance` is outside [1e-8, 1).
    pub fn new(tolerance: f64) -> Result<Accuracy> {
        if !(Self::TIGHTEST..1.0).contains(&tolerance) {
            return Err(Error::Invalid(format!("tolerance {tolerance} is outside [{:e}, 1)", Self::TIGHTEST)));
        }
        // The loosest row that is at least as tight as asked; tolerances above 1e-2 are served by the first row. The
        // last row always qualifies.
        let thresholds = TABLE.into_iter().find(|row| row.tolerance <= tolerance).unwrap_or(TABLE[TABLE.len() - 1]);
        Ok(Accuracy { thresholds })
    }

    /// The relative error that is kept, at most what was asked. 99.9 % of all kinds of pairs are inside it and the rest
    /// within a small multiple, save for slivers of aspect above 1e3 or gaps below 1e-4 of the size at 1e-6 and tighter,
    /// where rounding alone can cost more.
    pub fn tolerance(&self) -> f64 {
        self.thresholds.tolerance
    }
}

/// The relative error that the 16-point rule is known to keep at a ratio q_point; infinite beyond the table.
fn densest_point_error(q_point: f64) -> f64 {
    let known = TABLE
        .iter()
        .rev()
        .find(|row| row.point.iter().any(|&(rule, limit)| rule == TriangleRule::P16 && q_point < limit));
    known.map_or(f64::INFINITY, |row| row.tolerance)
}

/// Memory reused from pair to pair.
#[derive(Debug, Default)]
pub struct Scratch {
    corners: [Vec<Vec3>; 2],
    clipped: [Vec<Vec3>; 2],
}

/// The unoccluded exchange G_ab = A_a F_ab = A_b F_ba of two polygons, m^2, whatever their position.
///
/// Exactly symmetric in its arguments. What lies behind the other polygon's plane is cut off first; 0 for pairs that
/// face away or share a plane.
pub fn exchange(a: &Shape, b: &Shape, accuracy: Accuracy, scratch: &mut Scratch) -> f64 {
    let (small, large) = if is_smaller(a, b) { (a, b) } else { (b, a) };
    // Coordinates relative to the smaller polygon: it is the one whose own digits are at stake.
    let origin = small.corners[0];
    let [corners_s, corners_l] = &mut scratch.corners;
    let [clipped_s, clipped_l] = &mut scratch.clipped;
    let s = local(small, origin, corners_s);
    let l = local(large, origin, corners_l);
    let Some(s_front) = in_front_of(&s, &l, clipped_s) else { return 0.0 };
    let Some(l_front) = in_front_of(&l, &s, clipped_l) else { return 0.0 };
    if s_front.area <= l_front.area {
        exchange_in_front(&s_front, &l_front, accuracy)
    } else {
        exchange_in_front(&l_front, &s_front, accuracy)
    }
}

/// A total order of polygons, so that (a, b) and (b, a) run the same instructions.
fn is_smaller(a: &Shape, b: &Shape) -> bool {
    let by_corners = || a.corners.iter().map(Vec3::to_array).le(b.corners.iter().map(Vec3::to_array));
    a.area < b.area || (a.area == b.area && by_corners())
}

fn local<'a>(shape: &Shape, origin: Vec3, corners: &'a mut Vec<Vec3>) -> Shape<'a> {
    corners.clear();
    corners.extend(shape.corners.iter().map(|v| *v - origin));
    Shape { corners, centre: shape.centre - origin, ..*shape }
}

/// The part of `a` before the plane of `b`.
fn in_front_of<'a>(a: &Shape<'a>, b: &Shape, clipped: &'a mut Vec<Vec3>) -> Option<Shape<'a>> {
    let plane = Plane { normal: b.normal, point: b.corners[0] };
    // The common case first: the whole polygon lies clearly in front, or clearly behind.
    let distance = plane.distance(a.centre);
    if distance > 2.0 * a.radius {
        return Some(*a);
    }
    if distance < -2.0 * a.radius {
        return None;
    }
    clip_to_front(a.corners, &plane, clipped);
    if clipped.len() < 3 {
        return None;
    }
    let area = area_vector(clipped).length();
    (area > 0.0).then(|| Shape::with_normal(clipped, a.normal, area))
}

fn exchange_in_front(small: &Shape, large: &Shape, accuracy: Accuracy) -> f64 {
    let Thresholds { area, point, .. } = &accuracy.thresholds;
    let distance = small.centre.distance(large.centre);
    let q_area = (small.radius + large.radius) / distance;
    for &(rule, limit) in area {
        if q_area < limit {
            return area_quadrature::exchange(small, large, rule);
        }
    }
    let to_plane = large.normal.dot(small.centre - large.corners[0]).abs();
    let q_point = small.radius / to_plane.max(distance - large.radius).max(f64::MIN_POSITIVE);
    for &(rule, limit) in point {
        if q_point < limit {
            return point_to_polygon::exchange(small, large, rule);
        }
    }
    let g = contour::exchange(small, large);
    // Where cancellation has eaten the tolerance, the densest point rule is taken if it is known to lose less.
    let rounding = contour::rounding(small, large, g);
    if rounding <= accuracy.tolerance() * g || rounding <= densest_point_error(q_point) * g {
        g
    } else {
        point_to_polygon::exchange(small, large, TriangleRule::P16)
    }
}
