//! Area-area quadrature: G = sum over p in a, q in b of w_p w_q K(p, q).
//!
//! K(p, q) = cos_a cos_b / (pi r^2) (the kernel without visibility), points and weights by [`TriangleRule`] on a fan of
//! triangles. Four additions and a division a point pair; no transcendental functions, no cancellation.
//! Valid for pairs more than about two diameters apart; the closer, the higher the rule. Useless for touching pairs.

use super::Shape;
use crate::geometry::Vec3;
use crate::geometry::quadrature::TriangleRule;

/// The kernel K of two points with their unit normals, 1/m^2; 0 where either faces away.
#[inline]
pub fn kernel(p: Vec3, normal_p: Vec3, q: Vec3, normal_q: Vec3) -> f64 {
    let r = q - p;
    let r2 = r.length_squared();
    let numerator = normal_p.dot(r).max(0.0) * (-normal_q.dot(r)).max(0.0);
    numerator / (std::f64::consts::PI * r2 * r2)
}

/// The exchange G of two polygons that lie in front of each other, m^2.
pub fn exchange(a: &Shape, b: &Shape, rule: TriangleRule) -> f64 {
    let mut sum = 0.0;
    rule.for_each_in_polygon(a.corners, |p, weight_p| {
        let mut inner = 0.0;
        rule.for_each_in_polygon(b.corners, |q, weight_q| inner += weight_q * kernel(p, a.normal, q, b.normal));
        sum += weight_p * inner;
    });
    sum
}
