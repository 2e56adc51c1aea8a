//! The exchange as a double line integral: exact where polygons touch.
//!
//!   G = 1/(2 pi)  sum over edges e of a, f of b of  (e^ . f^)  integral over e integral over f of  ln r  dt ds
//!
//! (Sparrow 1963; Schroeder & Hanrahan 1993, eq. 4), e^ and f^ unit directions. The integral over the longer edge is
//! elementary. The one over the shorter is Gauss-Legendre, of n points where the integrand is analytic inside a Bernstein
//! ellipse of parameter p: the error falls like p^-2n (Trefethen 2008, theorem 4.5), so n follows from p and the tolerance.
//! Edges that are parallel and close or share a corner are elementary altogether; other edges that need more than
//! [`MOST_GAUSS_POINTS`] are bisected towards the places where the integrand is not smooth. The error is near rounding for
//! any position of the edges.
//!
//! The terms have the size of the product of the perimeters and cancel down to G: for polygons d diameters apart, or
//! very unequal ones, digits are lost. See [`rounding`]; [`super::select`] keeps such pairs away.

use super::Polygons;
use crate::geometry::Vec3;
use crate::geometry::quadrature::{GAUSS, MOST_GAUSS_POINTS};
use crate::simd::double::{Double, LANES, Vectors, angle, ln};

/// The rounding error of a result G is below 2 eps G and this, m^2: 2 eps (1 + D/l) P_a P_b / 2 pi, with P the perimeters,
/// D the distance and l a third of the smaller perimeter.
#[inline(always)]
pub(super) fn rounding<D: Double>(small: &Polygons<D>, large: &Polygons<D>) -> D {
    let (p, q) = (perimeter(small.corners), perimeter(large.corners));
    // Between first corners: about as far as the centres, and padding does not move them.
    let way = small.corners[0] - large.corners[0];
    let distance = way.dot(way).sqrt();
    let ratio = D::splat(3.0) * distance / p.min(q);
    let terms = (D::splat(1.0) + ratio) * p * q * D::splat(1.0 / std::f64::consts::TAU);
    D::splat(2.0 * f64::EPSILON) * terms
}

#[inline(always)]
fn perimeter<D: Double>(corners: &[Vectors<D>]) -> D {
    let mut sum = D::splat(0.0);
    for k in 0..corners.len() {
        let side = corners[(k + 1) % corners.len()] - corners[k];
        sum = sum + side.dot(side).sqrt();
    }
    sum
}

/// Edges, one a lane: start, unit direction, length.
#[derive(Clone, Copy)]
struct Edges<D> {
    start: Vectors<D>,
    direction: Vectors<D>,
    length: D,
}

impl<D: Double> Edges<D> {
    #[inline(always)]
    fn new(start: Vectors<D>, end: Vectors<D>) -> Self {
        let way = end - start;
        let length = way.dot(way).sqrt();
        // A padded corner makes an edge of no length: any direction will do for it.
        Edges { start, direction: way.scaled(D::splat(1.0) / length.max(D::splat(1e-300))), length }
    }

    #[inline(always)]
    fn select(mask: D::Mask, yes: Self, no: Self) -> Self {
        Edges {
            start: select(mask, yes.start, no.start),
            direction: select(mask, yes.direction, no.direction),
            length: D::select(mask, yes.length, no.length),
        }
    }
}

#[inline(always)]
fn select<D: Double>(mask: D::Mask, yes: Vectors<D>, no: Vectors<D>) -> Vectors<D> {
    Vectors { x: D::select(mask, yes.x, no.x), y: D::select(mask, yes.y, no.y), z: D::select(mask, yes.z, no.z) }
}

/// Two edges that need more than one Gauss rule, and the pair whose integral they belong to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Special {
    slot: u32,
    /// e^ . f^
    cosine: f64,
    /// The error that is allowed in the integral of ln r, divided by the lengths.
    allowed: f64,
    e: [Vec3; 2],
    f: [Vec3; 2],
}

/// 2 pi G of eight pairs of polygons that lie in front of each other, without the edges that are appended to `special`
/// for [`add_special`]. `allowed` is the error that 2 pi G may have; `slots` names the pairs; only `active` lanes count.
///
/// The integral of ln r over closed contours does not depend on the unit of length; lengths near 1 keep ln r near 0, where it
/// costs the fewest digits: the caller has scaled the polygons so.
#[inline(always)]
pub(super) fn exchange<D: Double>(
    small: &Polygons<D>,
    large: &Polygons<D>,
    allowed: D,
    slots: &[u32],
    special: &mut Vec<Special>,
) -> D {
    let zero = D::splat(0.0);
    let (ns, nl) = (small.corners.len(), large.corners.len());
    let mut sum = zero;
    // Every pair of edges may be off by as much as its lengths are of the perimeters.
    let share = allowed / (perimeter(small.corners) * perimeter(large.corners));
    let lanes = (1u32 << slots.len()) - 1;
    for i in 0..ns {
        let e = Edges::new(small.corners[i], small.corners[(i + 1) % ns]);
        for j in 0..nl {
            let f = Edges::new(large.corners[j], large.corners[(j + 1) % nl]);
            let cosine = e.direction.dot(f.direction);
            let weight = cosine.abs() * e.length * f.length;
            let active = D::bits(zero.lt(weight)) & lanes;
            if active == 0 {
                continue;
            }
            let longer = f.length.lt(e.length);
            let (outer, inner) = (Edges::select(longer, f, e), Edges::select(longer, e, f));
            let touching = common_corner(small.corners, i, large.corners, j);
            let needed = points_needed(outer, inner, zero, outer.length, share);
            // What is not a number needs care as well.
            let easy = D::bits(needed.lt(D::splat(MOST_GAUSS_POINTS as f64 + 0.5))) & !D::bits(touching);
            let hard = active & !easy;
            if hard != 0 {
                let (cosines, shares) = (cosine.to_array(), share.to_array());
                let ends = [
                    points(small.corners[i]),
                    points(small.corners[(i + 1) % ns]),
                    points(large.corners[j]),
                    points(large.corners[(j + 1) % nl]),
                ];
                for (k, &slot) in slots.iter().enumerate().filter(|(k, _)| hard >> k & 1 != 0) {
                    let [e0, e1, f0, f1] = ends.map(|points| points[k]);
                    let (e, f) = ([e0, e1], [f0, f1]);
                    let (e, f) = if f0.distance_squared(f1) < e0.distance_squared(e1) { (f, e) } else { (e, f) };
                    special.push(Special { slot, cosine: cosines[k], allowed: shares[k], e, f });
                }
            }
            let regular = active & easy;
            if regular != 0 {
                let (counts, cosines) = counted(needed.to_array(), cosine.to_array(), regular);
                sum = D::load(&cosines).mul_add(gauss(outer, inner, zero, outer.length, &counts), sum);
            }
        }
    }
    sum
}

/// Whole numbers of points, and the cosines; both 0 for lanes that do not count.
#[inline(always)]
fn counted(needed: [f64; LANES], mut cosines: [f64; LANES], lanes: u32) -> ([usize; LANES], [f64; LANES]) {
    let mut counts = [0; LANES];
    for k in 0..LANES {
        if lanes >> k & 1 != 0 {
            counts[k] = (needed[k].ceil() as usize).clamp(2, MOST_GAUSS_POINTS);
        } else {
            cosines[k] = 0.0;
        }
    }
    (counts, cosines)
}

#[inline(always)]
fn points<D: Double>(v: Vectors<D>) -> [Vec3; LANES] {
    let (x, y, z) = (v.x.to_array(), v.y.to_array(), v.z.to_array());
    let mut out = [Vec3::ZERO; LANES];
    for k in 0..LANES {
        out[k] = Vec3::new(x[k], y[k], z[k]);
    }
    out
}

/// Whether edge i of one and edge j of the other have a corner in common.
#[inline(always)]
fn common_corner<D: Double>(a: &[Vectors<D>], i: usize, b: &[Vectors<D>], j: usize) -> D::Mask {
    let tiny = D::splat(1e-300);
    let (a0, a1, b0, b1) = (a[i], a[(i + 1) % a.len()], b[j], b[(j + 1) % b.len()]);
    let mut least = distance_squared(a0, b0);
    least = least.min(distance_squared(a0, b1));
    least = least.min(distance_squared(a1, b0));
    least.min(distance_squared(a1, b1)).lt(tiny)
}

#[inline(always)]
fn distance_squared<D: Double>(a: Vectors<D>, b: Vectors<D>) -> D {
    let way = a - b;
    way.dot(way)
}

/// The Gauss points needed on the piece `low` .. `high` of edge e so that the integral over it, divided by the product of
/// the lengths, is off by no more than `error`.
///
/// The integrand has three singularities in the complex plane of s: a pair of branch points above and below the foot of
/// each end of f, and where the distance d(s) to f's line is 0. The nearest, in the sense of the ellipse with foci at
/// the ends of the piece, tells the parameter p, and (64/15) p^-2n bounds the error relative to the integrand's size.
#[inline(always)]
fn points_needed<D: Double>(e: Edges<D>, f: Edges<D>, low: D, high: D, error: D) -> D {
    let (half, one) = (D::splat(0.5), D::splat(1.0));
    let tiny = D::splat(1e-300);
    let (middle, inverse) = (half * (low + high), D::splat(2.0) / (high - low).max(tiny));
    let cross = e.direction.cross(f.direction);
    let sine2 = cross.dot(cross);
    let to = f.start - e.start;
    let lines = D::splat(1.0) / sine2.max(tiny);
    let closest = (to.cross(f.direction).dot(cross) * lines, to.dot(cross).abs() * lines);
    let end = f.direction.mul_add(f.length, to);
    let feet = [foot(to, e.direction), foot(end, e.direction)];
    let mut sum = semi_axes((feet[0].0 - middle) * inverse, feet[0].1 * inverse);
    sum = sum.min(semi_axes((feet[1].0 - middle) * inverse, feet[1].1 * inverse));
    // Parallel lines come closest at infinity.
    let skew = semi_axes((closest.0 - middle) * inverse, closest.1 * inverse);
    sum = D::select(D::splat(1e-24).lt(sine2), sum.min(skew), sum);
    let a = (half * sum).max(one);
    let p = a + a.mul_add(a, -one).max(D::splat(0.0)).sqrt();
    let digits = -ln(error.max(D::splat(1e-18)).min(half));
    half * (digits + D::splat(1.45)) / ln(p.max(D::splat(1.0 + 1e-9)))
}

/// Where a point (relative to the start of a line) comes nearest to it, and how near.
#[inline(always)]
fn foot<D: Double>(to: Vectors<D>, direction: Vectors<D>) -> (D, D) {
    let off = to.cross(direction);
    (to.dot(direction), off.dot(off).sqrt())
}

/// |z - 1| + |z + 1| for z = x + iy: twice the long semi-axis of the ellipse through z with foci at -1 and 1.
#[inline(always)]
fn semi_axes<D: Double>(x: D, y: D) -> D {
    let (left, right, y2) = (x + D::splat(1.0), x - D::splat(1.0), y * y);
    left.mul_add(left, y2).sqrt() + right.mul_add(right, y2).sqrt()
}

/// integral over the piece `low` .. `high` of e, by as many points as `counts` says, of the integral over f of ln r.
#[inline(always)]
fn gauss<D: Double>(e: Edges<D>, f: Edges<D>, low: D, high: D, counts: &[usize; LANES]) -> D {
    let mut most = 0;
    let mut same = true;
    for &count in counts {
        same &= count == 0 || most == 0 || count == most;
        most = most.max(count);
    }
    let (middle, half) = (D::splat(0.5) * (low + high), D::splat(0.5) * (high - low));
    let mut sum = D::splat(0.0);
    for k in 0..most {
        let (node, weight) = if same {
            let (node, weight) = GAUSS[most][k];
            (D::splat(node), D::splat(weight))
        } else {
            let (mut nodes, mut weights) = ([0.0; LANES], [0.0; LANES]);
            for lane in 0..LANES {
                (nodes[lane], weights[lane]) = GAUSS[counts[lane]][k];
            }
            (D::load(&nodes), D::load(&weights))
        };
        let x = e.direction.mul_add(half.mul_add(node, middle), e.start);
        sum = inner(x, f).mul_add(weight, sum);
    }
    half * sum
}

/// The integral over f of ln|x - y| dy: with t along f and d the distance from its line,
/// the difference of t/2 ln(t^2 + d^2) - t + d atan(t/d).
#[inline(always)]
fn inner<D: Double>(x: Vectors<D>, f: Edges<D>) -> D {
    let (tiny, half) = (D::splat(1e-300), D::splat(0.5));
    let to = f.start - x;
    let t0 = to.dot(f.direction);
    let t1 = t0 + f.length;
    let off = to.cross(f.direction);
    let d2 = off.dot(off);
    let d = d2.sqrt();
    // atan(t1/d) - atan(t0/d) in one call, which also keeps its digits when the two are close.
    let turn = angle(d * f.length, t0.mul_add(t1, d2));
    let logs = t1 * ln(t1.mul_add(t1, d2).max(tiny)) - t0 * ln(t0.mul_add(t0, d2).max(tiny));
    half.mul_add(logs, d.mul_add(turn, -f.length))
}

/// Adds the integrals of the special edges to 2 pi G of their pairs, in the order in which they were found.
#[inline(always)]
pub(super) fn add_special<D: Double>(special: &[Special], out: &mut [f64]) {
    let mut values = vec![0.0; special.len()];
    let mut kinds: [Vec<u32>; 3] = Default::default();
    for (k, s) in special.iter().enumerate() {
        kinds[kind(s) as usize].push(k as u32);
    }
    for group in kinds[Kind::Parallel as usize].chunks(LANES) {
        let (e, f) = load::<D>(special, group);
        keep(parallel_edges(e, f), group, &mut values);
    }
    for group in kinds[Kind::CommonCorner as usize].chunks(LANES) {
        let (e, f) = load::<D>(special, group);
        keep(edges_with_common_corner(e, f), group, &mut values);
    }
    graded_quadrature::<D>(special, &kinds[Kind::Graded as usize], &mut values);
    for (s, value) in special.iter().zip(values) {
        out[s.slot as usize] += s.cosine * value;
    }
}

#[derive(Clone, Copy)]
enum Kind {
    Parallel,
    CommonCorner,
    Graded,
}

fn kind(s: &Special) -> Kind {
    let ([e0, e1], [f0, f1]) = (s.e, s.f);
    let (e, f) = (e1 - e0, f1 - f0);
    let (a, b) = (e.length(), f.length());
    // Directions carry a few ulp; a smaller sine than that means parallel.
    if e.cross(f).length() <= 8.0 * f64::EPSILON * a * b {
        // The closed form differences antiderivatives of the size of D^2 ln D: beyond a few lengths that costs more
        // digits than the quadrature of an integrand that is smooth there.
        return if e0.distance(f0) <= 4.0 * a.max(b) { Kind::Parallel } else { Kind::Graded };
    }
    let common = e0 == f0 || e0 == f1 || e1 == f0 || e1 == f1;
    if common { Kind::CommonCorner } else { Kind::Graded }
}

/// The edges of up to eight special pairs, the last one repeated; where they have a corner in common, both start there.
#[inline(always)]
fn load<D: Double>(special: &[Special], group: &[u32]) -> (Edges<D>, Edges<D>) {
    let mut rows = [[[0.0; LANES]; 3]; 4];
    for lane in 0..LANES {
        let s = &special[group[lane.min(group.len() - 1)] as usize];
        let ([e0, e1], [f0, f1]) = (s.e, s.f);
        let ends = if e0 == f0 {
            [e0, e1, f0, f1]
        } else if e0 == f1 {
            [e0, e1, f1, f0]
        } else if e1 == f0 {
            [e1, e0, f0, f1]
        } else if e1 == f1 {
            [e1, e0, f1, f0]
        } else {
            [e0, e1, f0, f1]
        };
        for (rows, end) in rows.iter_mut().zip(ends) {
            for (row, x) in rows.iter_mut().zip(end.to_array()) {
                row[lane] = x;
            }
        }
    }
    let [e0, e1, f0, f1] =
        [Vectors::load(&rows[0]), Vectors::load(&rows[1]), Vectors::load(&rows[2]), Vectors::load(&rows[3])];
    (Edges::new(e0, e1), Edges::new(f0, f1))
}

#[inline(always)]
fn keep<D: Double>(results: D, group: &[u32], values: &mut [f64]) {
    for (&k, result) in group.iter().zip(results.to_array()) {
        values[k as usize] = result;
    }
}

/// Parallel edges at distance h: the second difference of K(u), K'' = ln sqrt(u^2 + h^2), with
/// K(u) = (u^2 - h^2)/4 ln(u^2 + h^2) + h u atan(u/h) - 3/4 u^2. For e = f it is L^2 (ln L - 3/2).
#[inline(always)]
fn parallel_edges<D: Double>(e: Edges<D>, f: Edges<D>) -> D {
    let zero = D::splat(0.0);
    let offset = f.start - e.start;
    let off = offset.cross(e.direction);
    let h = off.dot(off).sqrt();
    // f runs from c to c + f.length along e's direction, whichever way it points itself.
    let first = offset.dot(e.direction);
    let c = D::select(zero.lt(e.direction.dot(f.direction)), first, first - f.length);
    parallel_antiderivative(e.length - c, h)
        - parallel_antiderivative(-c, h)
        - parallel_antiderivative(e.length - c - f.length, h)
        + parallel_antiderivative(-c - f.length, h)
}

#[inline(always)]
fn parallel_antiderivative<D: Double>(u: D, h: D) -> D {
    let (u2, h2) = (u * u, h * h);
    let size = u.abs();
    // u atan(u/h) is even in u.
    let logarithm = D::splat(0.25) * (u2 - h2) * ln((u2 + h2).max(D::splat(1e-300)));
    logarithm + h * size * angle(size, h) - D::splat(0.75) * u2
}

/// Edges of lengths a and b from a common corner at an angle theta:
/// 1/4 (2ab - c(a^2 + b^2)) ln r^2 + c/4 (a^2 ln a^2 + b^2 ln b^2) + s/2 (a^2 alpha + b^2 beta) - 3/2 ab,
/// c, s = cos, sin theta; r the side between the far ends; alpha and beta the triangle's angles at the ends of a and b.
#[inline(always)]
fn edges_with_common_corner<D: Double>(e: Edges<D>, f: Edges<D>) -> D {
    let (a, b) = (e.length, f.length);
    let cross = e.direction.cross(f.direction);
    let (cosine, sine) = (e.direction.dot(f.direction), cross.dot(cross).sqrt());
    let across = e.direction.scaled(a) - f.direction.scaled(b);
    let r2 = across.dot(across).max(D::splat(1e-300));
    let alpha = angle(b * sine, a - b * cosine);
    let beta = angle(a * sine, b - a * cosine);
    let (a2, b2) = (a * a, b * b);
    let (quarter, half) = (D::splat(0.25), D::splat(0.5));
    quarter * (D::splat(2.0) * a * b - cosine * (a2 + b2)) * ln(r2)
        + half * cosine * (a2 * ln(a) + b2 * ln(b))
        + half * sine * (a2 * alpha + b2 * beta)
        - D::splat(1.5) * a * b
}

/// Pieces are not cut below this part of an edge: the integrand's worst term is s ln s, whose quadrature error on a piece
/// of length x is below x^2 / 1000.
const SMALLEST_PIECE: f64 = 1.0 / (1u64 << 24) as f64;

/// A part of edge e of a special pair, from `low` to `high`, in units of its length.
#[derive(Clone, Copy)]
struct Piece {
    special: u32,
    low: f64,
    high: f64,
}

/// Outer Gauss-Legendre quadrature on pieces short enough, against their distance from the singularities of the integrand,
/// for [`POINTS_A_PIECE`] points.
#[inline(always)]
fn graded_quadrature<D: Double>(special: &[Special], graded: &[u32], values: &mut [f64]) {
    let mut pieces: Vec<Piece> = graded.iter().map(|&special| Piece { special, low: 0.0, high: 1.0 }).collect();
    let mut halves = Vec::new();
    while !pieces.is_empty() {
        for group in pieces.chunks(LANES) {
            let lane_of = |lane: usize| group[lane.min(group.len() - 1)];
            let (mut numbers, mut lows, mut highs, mut allowed) =
                ([0; LANES], [0.0; LANES], [0.0; LANES], [0.0; LANES]);
            for lane in 0..LANES {
                let piece = lane_of(lane);
                numbers[lane] = piece.special;
                (lows[lane], highs[lane]) = (piece.low, piece.high);
                allowed[lane] = special[piece.special as usize].allowed;
            }
            let (e, f) = load::<D>(special, &numbers);
            let (low, high) = (D::load(&lows) * e.length, D::load(&highs) * e.length);
            let needed = points_needed(e, f, low, high, D::load(&allowed)).to_array();
            let mut counts = [0; LANES];
            for (lane, piece) in group.iter().enumerate() {
                if needed[lane] <= POINTS_A_PIECE || piece.high - piece.low <= SMALLEST_PIECE {
                    counts[lane] = (needed[lane].ceil() as usize).clamp(2, POINTS_A_PIECE as usize);
                } else {
                    let middle = 0.5 * (piece.low + piece.high);
                    halves.push(Piece { high: middle, ..*piece });
                    halves.push(Piece { low: middle, ..*piece });
                }
            }
            let results = gauss(e, f, low, high, &counts).to_array();
            for (lane, piece) in group.iter().enumerate() {
                if counts[lane] > 0 {
                    values[piece.special as usize] += results[lane];
                }
            }
        }
        pieces.clear();
        std::mem::swap(&mut pieces, &mut halves);
    }
}

/// The most points on a piece: more are better spent on two halves, since the rest of the edge then needs fewer.
const POINTS_A_PIECE: f64 = 12.0;
