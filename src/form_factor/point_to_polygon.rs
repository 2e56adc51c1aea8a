//! Lambert's closed form from a point to a polygon, integrated over the smaller polygon.
//!
//!   F_{x->P} = 1/(2 pi)  sum over edges k of  angle_k  n . (r_k x r_{k+1}) / |r_k x r_{k+1}|
//!
//! with r_k the corners seen from x and angle_k the angle between r_k and r_{k+1} (Lambert 1760; Hottel & Sarofim 1967,
//! eq. 2-16; Baum, Rushmeier & Winget 1989, eq. 9). Exact for the point, whatever the size of P, so the quadrature error
//! depends on the ratio q of the *smaller* polygon to the distance, like q^(d + 1) for a rule of degree d. The polygon must
//! lie in front of the point's horizon and the point in front of the polygon. Not valid where the point lies on the
//! polygon's border: touching pairs converge slowly. Far away the terms cancel: rounding grows with distance over size.

use super::Polygons;
use crate::geometry::Vec3;
use crate::geometry::quadrature::TrianglePoint;
use crate::simd::double::{Double, Plain, Vectors, angle};

/// The form factor from a point with a unit normal to a polygon in front of it.
pub fn form_factor(x: Vec3, normal: Vec3, polygon: &[Vec3]) -> f64 {
    let corners: Vec<Vectors<Plain>> = polygon.iter().map(|v| Vectors::splat(*v)).collect();
    gathered(Vectors::splat(x), Vectors::splat(normal), &corners).to_array()[0]
}

/// The exchange G of eight pairs of polygons that lie in front of each other, m^2, by points of `small`.
#[inline(always)]
pub(super) fn exchange<D: Double>(small: &Polygons<D>, large: &Polygons<D>, rule: &[TrianglePoint]) -> D {
    let mut sum = D::splat(0.0);
    for k in 2..small.corners.len() {
        let [first, u, v] =
            [small.corners[0], small.corners[k - 1] - small.corners[0], small.corners[k] - small.corners[0]];
        let mut part = D::splat(0.0);
        for TrianglePoint { barycentric, weight } in rule {
            let x = v.mul_add(D::splat(barycentric[2]), u.mul_add(D::splat(barycentric[1]), first));
            part = gathered(x, small.normal, large.corners).mul_add(D::splat(*weight), part);
        }
        let twice_area = u.cross(v);
        sum = part.mul_add(D::splat(0.5) * twice_area.dot(twice_area).sqrt(), sum);
    }
    sum.max(D::splat(0.0))
}

/// The same for eight points in front of one polygon, all of whose corners lie before every point's horizon.
#[inline(always)]
pub(crate) fn gathered<D: Double>(x: Vectors<D>, normal: Vectors<D>, corners: &[Vectors<D>]) -> D {
    let mut sum = D::splat(0.0);
    let mut r0 = corners[corners.len() - 1] - x;
    for &corner in corners {
        let r1 = corner - x;
        sum = sum + edge_term(r0, r1, normal);
        r0 = r1;
    }
    sum
}

/// angle n . (r1 x r0) / |r0 x r1| / (2 pi). Corners that run counter-clockwise before x's eyes turn about an axis that
/// points back at x: hence the order.
#[inline(always)]
pub(super) fn edge_term<D: Double>(r0: Vectors<D>, r1: Vectors<D>, normal: Vectors<D>) -> D {
    let cross = r1.cross(r0);
    let sine = cross.dot(cross).sqrt();
    // An edge in line with the point turns through no area: its term is 0, and 0/0 must not be asked.
    angle(sine, r0.dot(r1)) * normal.dot(cross) / (D::splat(std::f64::consts::TAU) * sine).max(D::splat(1e-300))
}
