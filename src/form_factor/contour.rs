//! The exchange as a double line integral: exact where polygons touch.
//!
//!   G = 1/(2 pi)  sum over edges e of a, f of b of  (e^ . f^)  integral over e integral over f of  ln r  dt ds
//!
//! (Sparrow 1963; Schroeder & Hanrahan 1993, eq. 4), e^ and f^ unit directions. The inner integral is elementary. Pairs of
//! edges that are parallel or share a corner are elementary altogether; for the rest the outer integral is 10-point
//! Gauss-Legendre on pieces that shrink towards the three places where the integrand is not smooth, so the error is near
//! rounding for any position of the edges.
//!
//! The terms have the size of the product of the perimeters and cancel down to G: for polygons d diameters apart, or
//! very unequal ones, digits are lost. See [`rounding`]; [`super::select`] keeps such pairs away.

use super::Shape;
use crate::geometry::Vec3;
use crate::geometry::quadrature::GAUSS_10;

/// An edge: start, unit direction, length.
#[derive(Clone, Copy)]
struct Edge {
    start: Vec3,
    direction: Vec3,
    length: f64,
}

impl Edge {
    fn end(&self) -> Vec3 {
        self.start + self.length * self.direction
    }
}

/// The exchange G of two polygons that lie in front of each other, m^2.
pub fn exchange(a: &Shape, b: &Shape) -> f64 {
    // The integral of ln r over closed contours does not depend on the unit of length; lengths near 1 keep ln r near 0,
    // where it costs the fewest digits. A power of two scales without rounding.
    let extent = a.corners.iter().chain(b.corners).map(|v| v.abs().max_element()).fold(0.0, f64::max);
    let scale = 2f64.powi(-(extent.log2().round() as i32));
    let mut sum = 0.0;
    for_each_edge(a.corners, scale, |e, e_end| {
        for_each_edge(b.corners, scale, |f, f_end| {
            let cosine = e.direction.dot(f.direction);
            if cosine != 0.0 {
                sum += cosine * integral_of_log(&e, e_end, &f, f_end);
            }
        });
    });
    (sum / (std::f64::consts::TAU * scale * scale)).max(0.0)
}

/// A bound on the rounding error of [`exchange`] for a result `g`, m^2: 2 eps (g + (1 + D/l) P_a P_b / 2 pi), with P the
/// perimeters, D the distance of the centres and l a third of the smaller perimeter.
pub fn rounding(a: &Shape, b: &Shape, g: f64) -> f64 {
    let perimeter = |s: &Shape| {
        let n = s.corners.len();
        (0..n).map(|k| s.corners[k].distance(s.corners[(k + 1) % n])).sum::<f64>()
    };
    let (p, q) = (perimeter(a), perimeter(b));
    let ratio = 3.0 * a.centre.distance(b.centre) / p.min(q);
    2.0 * f64::EPSILON * (g + (1.0 + ratio) * p * q / std::f64::consts::TAU)
}

fn for_each_edge(corners: &[Vec3], scale: f64, mut visit: impl FnMut(Edge, Vec3)) {
    for k in 0..corners.len() {
        let start = corners[k] * scale;
        let end = corners[(k + 1) % corners.len()] * scale;
        let length = start.distance(end);
        if length > 0.0 {
            visit(Edge { start, direction: (end - start) / length, length }, end);
        }
    }
}

/// integral over e integral over f of ln r. The exact ends are passed beside the edges so that shared corners are
/// recognised by equality.
fn integral_of_log(e: &Edge, e_end: Vec3, f: &Edge, f_end: Vec3) -> f64 {
    // Directions carry a few ulp; a smaller sine than that means parallel.
    let parallel = e.direction.cross(f.direction).length() <= 8.0 * f64::EPSILON;
    if parallel {
        // The closed form differences antiderivatives of the size of D^2 ln D: beyond a few lengths that costs more
        // digits than the quadrature of an integrand that is smooth there.
        let reach = 4.0 * e.length.max(f.length);
        if e.start.distance(f.start) <= reach {
            return parallel_edges(e, f);
        }
    } else {
        for (common, far_e) in [(e.start, e_end), (e_end, e.start)] {
            for (other, far_f) in [(f.start, f_end), (f_end, f.start)] {
                if common == other {
                    return edges_with_common_corner(common, far_e, far_f, e.length, f.length);
                }
            }
        }
    }
    graded_quadrature(e, f)
}

/// Parallel edges at distance h: the second difference of K(u), K'' = ln sqrt(u^2 + h^2), with
/// K(u) = (u^2 - h^2)/4 ln(u^2 + h^2) + h u atan(u/h) - 3/4 u^2. For e = f it is L^2 (ln L - 3/2).
fn parallel_edges(e: &Edge, f: &Edge) -> f64 {
    let offset = f.start - e.start;
    let h = offset.cross(e.direction).length();
    let antiderivative = |u: f64| {
        let r2 = u * u + h * h;
        if r2 == 0.0 {
            return 0.0;
        }
        0.25 * (u * u - h * h) * r2.ln() + h * u * u.atan2(h) - 0.75 * u * u
    };
    // f runs from c to c + f.length along e's direction, whichever way it points itself.
    let first = offset.dot(e.direction);
    let c = if e.direction.dot(f.direction) > 0.0 { first } else { first - f.length };
    antiderivative(e.length - c) - antiderivative(-c) - antiderivative(e.length - c - f.length)
        + antiderivative(-c - f.length)
}

/// Edges of lengths a and b from a common corner at an angle theta:
/// 1/4 (2ab - c(a^2 + b^2)) ln r^2 + c/4 (a^2 ln a^2 + b^2 ln b^2) + s/2 (a^2 alpha + b^2 beta) - 3/2 ab,
/// c, s = cos, sin theta; r the side between the far ends; alpha and beta the triangle's angles at the ends of a and b.
fn edges_with_common_corner(corner: Vec3, far_a: Vec3, far_b: Vec3, a: f64, b: f64) -> f64 {
    let (u, v) = ((far_a - corner) / a, (far_b - corner) / b);
    let (cosine, sine) = (u.dot(v), u.cross(v).length());
    let r2 = far_a.distance_squared(far_b);
    let alpha = (b * sine).atan2(a - b * cosine);
    let beta = (a * sine).atan2(b - a * cosine);
    0.25 * (2.0 * a * b - cosine * (a * a + b * b)) * r2.ln()
        + 0.5 * cosine * (a * a * a.ln() + b * b * b.ln())
        + 0.5 * sine * (a * a * alpha + b * b * beta)
        - 1.5 * a * b
}

/// The integral over f of ln|x - y| dy: with t along f and d the distance from its line,
/// the difference of t/2 ln(t^2 + d^2) - t + d atan(t/d).
#[inline]
fn inner(x: Vec3, f: &Edge) -> f64 {
    let to = f.start - x;
    let t0 = to.dot(f.direction);
    let t1 = t0 + f.length;
    let d2 = to.cross(f.direction).length_squared();
    let d = d2.sqrt();
    let half_t_log = |t: f64| {
        let r2 = t * t + d2;
        if r2 > 0.0 { 0.5 * t * r2.ln() } else { 0.0 }
    };
    // atan(t1/d) - atan(t0/d) in one call, which also keeps its digits when the two are close.
    let angle = (d * (t1 - t0)).atan2(d2 + t0 * t1);
    half_t_log(t1) - half_t_log(t0) - f.length + d * angle
}

/// Pieces are not cut below this part of an edge: the integrand's worst term is s ln s, whose quadrature error on a piece
/// of length x is below x^2 / 1000.
const SMALLEST_PIECE: f64 = 1.0 / (1u64 << 24) as f64;

/// Outer Gauss-Legendre quadrature on pieces no longer than their distance, in the complex plane, from the singularities
/// of the integrand. Such a piece has its nearest singularity outside the Bernstein ellipse of parameter 2 + sqrt 5, and
/// the 10-point rule an error of 4.2^-20 = 3e-13 relative to the integrand.
fn graded_quadrature(e: &Edge, f: &Edge) -> f64 {
    // ln|x(s) - y| of the two ends y of f: a pair of branch points above and below the foot of y on e.
    let end_point = |y: Vec3| {
        let to = y - e.start;
        (to.dot(e.direction), to.cross(e.direction).length())
    };
    // The distance d(s) to f's line is the root of a quadratic, with branch points where the lines come closest.
    let cross = e.direction.cross(f.direction);
    let sine2 = cross.length_squared();
    let closest = if sine2 > 0.0 {
        let to = f.start - e.start;
        (to.cross(f.direction).dot(cross) / sine2, to.dot(cross).abs() / sine2)
    } else {
        (0.0, f64::INFINITY)
    };
    let singular = [end_point(f.start), end_point(f.end()), closest];
    let mut sum = 0.0;
    let mut pieces = vec![(0.0, e.length)];
    while let Some((low, high)) = pieces.pop() {
        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
        let too_close = singular.iter().any(|&(s, height): &(f64, f64)| {
            let beside = ((s - middle).abs() - half).max(0.0);
            beside.hypot(height) < high - low
        });
        if too_close && high - low > SMALLEST_PIECE * e.length {
            pieces.extend([(low, middle), (middle, high)]);
            continue;
        }
        let mut piece = 0.0;
        for (node, weight) in GAUSS_10 {
            let at = |s: f64| inner(e.start + s * e.direction, f);
            piece += weight * (at(middle - half * node) + at(middle + half * node));
        }
        sum += half * piece;
    }
    sum
}
