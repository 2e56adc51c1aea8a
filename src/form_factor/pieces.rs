//! Pairs that no kernel can do whole: very unequal, or slivers, where the contour integral cancels beyond the tolerance.
//!
//! The polygon that is larger is cut in two across its longest way, again and again, until every piece is far enough for
//! a rule, or of a size at which the contour integral keeps its digits: log2 of the ratio of sizes many cuts where the two
//! come close in one place.

use super::select::{CONTOUR, ratios};
use super::{Accuracy, Polygons, Shape, contour};
use crate::geometry::Vec3;
use crate::geometry::polygon::{MAX_CORNERS, Plane, area_vector, clip_to_front};
use crate::simd::double::{Double, Plain, Vectors};

/// More pieces than this are no better than a rule on the whole: two slivers side by side.
const MOST_PIECES: usize = 512;

/// Corners and normal of two polygons in front of each other.
pub(super) type Pair = [(Vec<Vec3>, Vec3); 2];

/// Cuts a pair until each piece suits a kernel; a contour integral may be off by `allowed`. `None` when that takes too many
/// pieces, or makes one of too many corners.
pub(super) fn pieces(pair: Pair, accuracy: &Accuracy, allowed: f64) -> Option<Vec<Pair>> {
    let (mut open, mut done) = (vec![pair], Vec::new());
    while let Some(pair) = open.pop() {
        let [a, b] = pair.each_ref().map(|(corners, normal)| Shape::with_normal(corners, *normal, area(corners)));
        if !(a.area > 0.0 && b.area > 0.0) {
            continue;
        }
        let (small, large) = if a.area <= b.area { (&a, &b) } else { (&b, &a) };
        let [q_area, q_point] = ratios(small, large);
        let contour = accuracy.choice(q_area, q_point) == CONTOUR;
        if !contour || rounding(small, large) <= allowed {
            done.push(pair);
            continue;
        }
        if open.len() + done.len() >= MOST_PIECES {
            return None;
        }
        let first_is_larger = a.radius >= b.radius;
        let [(first, n), (second, m)] = pair;
        let parts = halves(if first_is_larger { &first } else { &second });
        if parts.iter().any(|half| half.len() > MAX_CORNERS) {
            return None;
        }
        if first_is_larger {
            open.extend(parts.map(|half| [(half, n), (second.clone(), m)]));
        } else {
            open.extend(parts.map(|half| [(first.clone(), n), (half, m)]));
        }
    }
    Some(done)
}

fn area(corners: &[Vec3]) -> f64 {
    if corners.len() < 3 { 0.0 } else { area_vector(corners).length() }
}

/// The two parts of a polygon before and behind the middle of its longest edge.
fn halves(corners: &[Vec3]) -> [Vec<Vec3>; 2] {
    let edge = |k: usize| corners[(k + 1) % corners.len()] - corners[k];
    let longest = (0..corners.len()).fold(0, |best, k| if edge(k).length() > edge(best).length() { k } else { best });
    let point = corners[longest] + 0.5 * edge(longest);
    let normal = edge(longest).normalize();
    [normal, -normal].map(|normal| {
        let mut half = Vec::with_capacity(corners.len() + 1);
        clip_to_front(corners, &Plane { normal, point }, &mut half);
        half
    })
}

/// [`contour::rounding`] of one pair.
fn rounding(small: &Shape, large: &Shape) -> f64 {
    let corners = |s: &Shape| s.corners.iter().map(|v| Vectors::splat(*v)).collect::<Vec<Vectors<Plain>>>();
    let (s, l) = (corners(small), corners(large));
    let polygons = [(&s, small.normal), (&l, large.normal)];
    let [s, l] = polygons.map(|(corners, normal)| Polygons { corners, normal: Vectors::splat(normal) });
    contour::rounding(&s, &l).to_array()[0]
}
