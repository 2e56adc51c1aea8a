//! Lambert's closed form from a point to a polygon, integrated over the smaller polygon.
//!
//!   F_{x->P} = 1/(2 pi)  sum over edges k of  angle_k  n . (r_k x r_{k+1}) / |r_k x r_{k+1}|
//!
//! with r_k the corners seen from x and angle_k the angle between r_k and r_{k+1} (Lambert 1760; Hottel & Sarofim 1967,
//! eq. 2-16; Baum, Rushmeier & Winget 1989, eq. 9). Exact for the point, whatever the size of P, so the quadrature error
//! depends on the ratio of the *smaller* polygon to the distance. The polygon must lie in front of the point's horizon
//! and the point in front of the polygon. Not valid where the point lies on the polygon's border: touching pairs converge
//! slowly.

use super::Shape;
use crate::geometry::Vec3;
use crate::geometry::quadrature::TriangleRule;

/// The form factor from a point with a unit normal to a polygon in front of it.
pub fn form_factor(x: Vec3, normal: Vec3, polygon: &[Vec3]) -> f64 {
    let mut sum = 0.0;
    let mut r0 = polygon[polygon.len() - 1] - x;
    for &corner in polygon {
        let r1 = corner - x;
        let cross = r0.cross(r1);
        let sine = cross.length();
        // An edge in line with the point turns through no area: its term is 0, and 0/0 must not be asked.
        if sine > 0.0 {
            sum += sine.atan2(r0.dot(r1)) * normal.dot(cross) / sine;
        }
        r0 = r1;
    }
    // Corners that run counter-clockwise before x's eyes turn about an axis that points back at x: hence the sign.
    -sum / std::f64::consts::TAU
}

/// The exchange G of two polygons that lie in front of each other, m^2, by points of `small`.
pub fn exchange(small: &Shape, large: &Shape, rule: TriangleRule) -> f64 {
    let mut sum = 0.0;
    rule.for_each_in_polygon(small.corners, |x, weight| {
        sum += weight * form_factor(x, small.normal, large.corners);
    });
    sum.max(0.0)
}
