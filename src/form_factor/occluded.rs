//! The visible fraction of a pair of patches, by quasi-random segments.
//!
//!   V_ab = sum over s of K(p_s, q_s) V(p_s, q_s)  /  sum over s of K(p_s, q_s)
//!
//! with p_s, q_s Owen-scrambled Sobol points on the two patches. Weighting by the kernel K makes V the ratio of the occluded
//! to the unoccluded exchange, so the exact unoccluded G carries the shape of the pair and the segments only what is blocked.

use super::area_quadrature::kernel;
use crate::geometry::sampling::{Sobol, hash, point_in_triangle};
use crate::geometry::{Triangle, Vec3};
use crate::visibility::{Bvh, Segment};

/// Independent scrambles of the same sequence; their spread is the standard error. Few, because each runs a shorter
/// sequence: four cost about a fifth in accuracy, eight a third.
pub const REPLICATES: u32 = 4;

/// Segments that are cast together.
const BUNDLE: usize = 64;

/// An estimated visible fraction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VisibleFraction {
    /// V, in [0, 1].
    pub value: f64,
    /// Its standard error, from the spread of the replicates. 0 when all segments agree: a pair of which a fraction v is
    /// hidden goes unnoticed by m segments with probability (1 - v)^m, which the spread cannot show: whoever
    /// needs a bound must add 1 / (m + 2) with the effective m, the share to be expected of what none of m segments met.
    pub standard_error: f64,
    /// As many segments of equal weight would tell as much: (sum w)^2 / sum w^2 (Kish 1965). Where patches touch, few segments
    /// next to the common edge carry most of the weight.
    pub effective: f64,
    /// Mean of K over the segments, 1/m^2: times both areas, how much of the exchange they show. Where patches come near to each other
    /// in a small part of them, that part may be missed.
    pub kernel: f64,
}

/// A patch as this estimate needs it.
#[derive(Debug, Clone, Copy)]
pub struct End {
    /// Number of the patch.
    pub patch: u32,
    /// Its corners.
    pub triangle: Triangle,
    /// Its unit normal.
    pub normal: Vec3,
}

/// The visible fraction between two patches by `segments` (rounded up to a multiple of [`REPLICATES`]) segments.
pub fn visible_fraction(blockers: &Bvh, a: &End, b: &End, segments: u32, seed: u64) -> VisibleFraction {
    let exclude = [a.patch, b.patch];
    let each = segments.div_ceil(REPLICATES);
    let mut replicates = [(0.0, 0.0); REPLICATES as usize];
    let (mut first_weight, mut all_squares) = (0.0, 0.0);
    let (mut weights, mut bundle) = (Vec::with_capacity(BUNDLE), Vec::with_capacity(BUNDLE));
    let first = hash(seed ^ hash(u64::from(a.patch) << 32 | u64::from(b.patch)));
    let sobol: [Sobol<4>; REPLICATES as usize] = std::array::from_fn(|r| Sobol::new(first.wrapping_add(r as u64)));
    for k in 0..REPLICATES * each {
        let r = (k / each) as usize;
        let [u, v, s, t] = sobol[r].point(k % each);
        let start = point_in_triangle(&a.triangle, u, v);
        let end = point_in_triangle(&b.triangle, s, t);
        let weight = kernel(start, a.normal, end, b.normal);
        if weight > 0.0 {
            // In units of the first, squares neither overflow nor vanish.
            first_weight = if first_weight > 0.0 { first_weight } else { weight };
            let weight = weight / first_weight;
            all_squares += weight * weight;
            weights.push((r, weight));
            bundle.push(Segment { start, end, exclude });
        }
        if bundle.len() == BUNDLE || k + 1 == REPLICATES * each {
            let blocked = blockers.blocked_between(&bundle);
            for (&(r, weight), blocked) in weights.iter().zip(blocked) {
                let (seen, all) = &mut replicates[r];
                *all += weight;
                if !blocked {
                    *seen += weight;
                }
            }
            weights.clear();
            bundle.clear();
        }
    }
    let (seen, all) = replicates.iter().fold((0.0, 0.0), |(s, a), (seen, all)| (s + seen, a + all));
    if all == 0.0 {
        // No sampled point of one patch lies before the other: nothing was learnt, and the exchange is next to nothing.
        return VisibleFraction { value: 0.5, standard_error: 0.5, effective: 0.0, kernel: 0.0 };
    }
    let value = seen / all;
    let n = f64::from(REPLICATES);
    let squares: f64 = replicates.iter().map(|(seen, all)| (seen - value * all) * (seen - value * all)).sum();
    VisibleFraction {
        value,
        standard_error: (n / (n - 1.0) * squares).sqrt() / all,
        effective: all * all / all_squares,
        kernel: all * first_weight / f64::from(REPLICATES * each),
    }
}
