//! Area-area quadrature: G = sum over p in a, q in b of w_p w_q K(p, q).
//!
//! K(p, q) = cos_a cos_b / (pi r^2) (the kernel without visibility), points and weights by
//! [`TriangleRule`] on a fan of triangles. Some multiplications and half a
//! division a point pair; no transcendental functions, no cancellation.
//! Valid for pairs more than about two diameters apart: the relative error falls like q^(d + 1), q the size over the
//! distance, d the degree of the rule. Useless for touching pairs.

use super::Polygons;
use crate::geometry::Vec3;
use crate::geometry::quadrature::{TrianglePoint, TriangleRule};
use crate::simd::double::{Double, Vectors};

/// The kernel K of two points with their unit normals, 1/m^2; 0 where either faces away.
#[inline]
pub fn kernel(p: Vec3, normal_p: Vec3, q: Vec3, normal_q: Vec3) -> f64 {
    let r = q - p;
    let r2 = r.length_squared();
    let numerator = normal_p.dot(r).max(0.0) * (-normal_q.dot(r)).max(0.0);
    numerator / (std::f64::consts::PI * r2 * r2)
}

/// The exchange G of eight pairs of polygons that lie in front of each other, m^2.
#[inline(always)]
pub(super) fn exchange<D: Double>(small: &Polygons<D>, large: &Polygons<D>, rule: TriangleRule) -> D {
    // Loops of a fixed length, unrolled.
    match rule {
        TriangleRule::P3 => by_points::<D, 3>(small, large, rule.points()),
        TriangleRule::P6 => by_points::<D, 6>(small, large, rule.points()),
        TriangleRule::P7 => by_points::<D, 7>(small, large, rule.points()),
        TriangleRule::P12 => by_points::<D, 12>(small, large, rule.points()),
        TriangleRule::P16 => by_points::<D, 16>(small, large, rule.points()),
    }
}

#[inline(always)]
fn by_points<D: Double, const N: usize>(small: &Polygons<D>, large: &Polygons<D>, rule: &[TrianglePoint]) -> D {
    let zero = Vectors::splat(Vec3::ZERO);
    let (mut ps, mut qs) = ([zero; N], [zero; N]);
    let mut sum = D::splat(0.0);
    for s in 2..small.corners.len() {
        let area_s = place(small.corners, s, rule, &mut ps);
        for l in 2..large.corners.len() {
            let area_l = place(large.corners, l, rule, &mut qs);
            let mut part = D::splat(0.0);
            for (p, TrianglePoint { weight, .. }) in ps.iter().zip(rule) {
                part = gathered(*p, small.normal, &qs, large.normal, rule).mul_add(D::splat(*weight), part);
            }
            sum = (part * area_s).mul_add(area_l, sum);
        }
    }
    sum * D::splat(std::f64::consts::FRAC_1_PI)
}

/// pi times the sum over the points q of the weighted kernel. Two fractions share a division.
#[inline(always)]
fn gathered<D: Double, const N: usize>(
    p: Vectors<D>,
    normal_p: Vectors<D>,
    qs: &[Vectors<D>; N],
    normal_q: Vectors<D>,
    rule: &[TrianglePoint],
) -> D {
    let mut sum = D::splat(0.0);
    let mut k = 0;
    while k < N {
        let (above, below) = fraction(p, normal_p, qs[k], normal_q, rule[k].weight);
        if k + 1 == N {
            return sum + above / below;
        }
        let (above_2, below_2) = fraction(p, normal_p, qs[k + 1], normal_q, rule[k + 1].weight);
        sum = sum + above.mul_add(below_2, above_2 * below) / (below * below_2);
        k += 2;
    }
    sum
}

/// Numerator and denominator of weight x pi K(p, q).
#[inline(always)]
fn fraction<D: Double>(
    p: Vectors<D>,
    normal_p: Vectors<D>,
    q: Vectors<D>,
    normal_q: Vectors<D>,
    weight: f64,
) -> (D, D) {
    let zero = D::splat(0.0);
    let r = q - p;
    let r2 = r.dot(r);
    let cosines = normal_p.dot(r).max(zero) * (-normal_q.dot(r)).max(zero);
    (cosines * D::splat(weight), r2 * r2)
}

/// The areas of eight polygons.
#[inline(always)]
pub(super) fn area<D: Double>(corners: &[Vectors<D>]) -> D {
    let mut sum = D::splat(0.0);
    for k in 2..corners.len() {
        let normal = (corners[k - 1] - corners[0]).cross(corners[k] - corners[0]);
        sum = sum + normal.dot(normal).sqrt();
    }
    D::splat(0.5) * sum
}

/// The points of the rule on triangle 0, k - 1, k of the fan; returns its area.
#[inline(always)]
fn place<D: Double, const N: usize>(
    corners: &[Vectors<D>],
    k: usize,
    rule: &[TrianglePoint],
    out: &mut [Vectors<D>; N],
) -> D {
    let [first, u, v] = [corners[0], corners[k - 1] - corners[0], corners[k] - corners[0]];
    for (out, TrianglePoint { barycentric, .. }) in out.iter_mut().zip(rule) {
        *out = v.mul_add(D::splat(barycentric[2]), u.mul_add(D::splat(barycentric[1]), first));
    }
    let normal = u.cross(v);
    D::splat(0.5) * normal.dot(normal).sqrt()
}
