//! Many pairs at once: classified eight at a time, sorted by kernel, computed eight at a time.
//!
//! 1. Facing, by centres, radii and planes, in lanes: pairs that face away are done.
//! 2. The pairs close to a plane are looked at corner by corner; what straddles the other's plane is cut at it.
//! 3. [`Accuracy`] names the kernel of each pair by its two ratios; every kernel runs over its own pairs in lanes.
//! 4. Contour integrals whose rounding exceeds the tolerance fall back to what loses less.
//!
//! A pair's result depends on nothing but the pair, whatever else is in the batch; and (a, b) gives the bits of (b, a).

use super::lanes::{
    Contour, Cut, CutPairs, Whole, WholePairs, classify, contours_of_few, contours_of_many, contours_of_whole,
    rule_on_few, rule_on_many, rule_on_whole, special_edges,
};
use super::pieces::{Pair, pieces};
use super::select::{CONTOUR, DENSEST_POINT, Kernel, densest_point_error, ratios};
use super::{Accuracy, Patch, Shape, contour};
use crate::error::{Error, Result};
use crate::geometry::Vec3;
use crate::geometry::polygon::{Plane, Side, area_vector, clip_to_front, side_of};
use crate::simd::Instructions;
use crate::simd::double::LANES;

/// Pairs classified in one go: enough to fill the lanes of every kernel, few enough to stay in the cache.
const BLOCK: usize = 512;

/// Memory reused from block to block.
pub struct Batch {
    instructions: Instructions,
    /// Whole pairs by kernel.
    whole: [Vec<Whole>; Kernel::ALL.len()],
    corners: Vec<Vec3>,
    cut: Vec<Cut>,
    /// Cut pairs by kernel: those of few corners, then those of many.
    buckets: [[Vec<u32>; Kernel::ALL.len()]; 2],
    contours: Vec<Contour>,
    special: Vec<contour::Special>,
}

impl Default for Batch {
    fn default() -> Batch {
        Batch::new()
    }
}

impl Batch {
    /// With the best instructions of this processor.
    pub fn new() -> Batch {
        Batch::with_instructions(Instructions::best())
    }

    /// With other instructions than the best; what this processor does not have is not used.
    pub fn with_instructions(instructions: Instructions) -> Batch {
        let known = Instructions::available().contains(&instructions);
        Batch {
            instructions: if known { instructions } else { Instructions::Portable },
            whole: Default::default(),
            corners: Vec::new(),
            cut: Vec::new(),
            buckets: Default::default(),
            contours: Vec::new(),
            special: Vec::new(),
        }
    }

    /// out_k = G of patch i of `a` and patch j of `b` for pair k = (i, j), unoccluded, m^2.
    ///
    /// # Errors
    /// [`Error::Invalid`] when `out` has not one place a pair.
    pub fn exchange_pairs(
        &mut self,
        a: &[Patch],
        b: &[Patch],
        pairs: &[[u32; 2]],
        accuracy: &Accuracy,
        out: &mut [f64],
    ) -> Result<()> {
        if pairs.len() != out.len() {
            return Err(Error::Invalid(format!("{} pairs need as many places, not {}", pairs.len(), out.len())));
        }
        for (pairs, out) in pairs.chunks(BLOCK).zip(out.chunks_mut(BLOCK)) {
            self.clear();
            out.fill(0.0);
            for (group, chunk) in pairs.chunks(LANES).enumerate() {
                let look = classify(self.instructions, a, b, chunk, accuracy);
                for (lane, &[i, j]) in chunk.iter().enumerate() {
                    if look.facing >> lane & 1 == 0 {
                        continue;
                    }
                    let slot = (group * LANES + lane) as u32;
                    let (first, second) = (&a[i as usize], &b[j as usize]);
                    let sides = if look.whole >> lane & 1 != 0 {
                        [Side::Front; 2]
                    } else {
                        [side_of(&first.corners, &second.plane()), side_of(&second.corners, &first.plane())]
                    };
                    match sides {
                        [Side::Front, Side::Front] => {
                            let in_order = first.area < second.area
                                || (first.area == second.area && comes_first(&first.corners, &second.corners));
                            let [small, large] = if in_order { [i, j] } else { [j, i] };
                            self.whole[look.kernels[lane]].push(Whole { slot, small, large, swapped: !in_order });
                        }
                        [Side::Behind, _] | [_, Side::Behind] => {}
                        _ => self.add(&first.shape(), &second.shape(), accuracy, slot),
                    }
                }
            }
            self.run(a, b, accuracy, out);
        }
        Ok(())
    }

    /// G of two polygons, m^2.
    pub fn exchange(&mut self, a: &Shape, b: &Shape, accuracy: &Accuracy) -> f64 {
        let mut out = [0.0];
        self.clear();
        self.add(a, b, accuracy, 0);
        self.run(&[], &[], accuracy, &mut out);
        out[0]
    }

    fn clear(&mut self) {
        self.whole.iter_mut().for_each(Vec::clear);
        self.corners.clear();
        self.cut.clear();
        self.buckets.iter_mut().flatten().for_each(Vec::clear);
        self.contours.clear();
        self.special.clear();
    }

    /// Puts a pair into the bucket of its kernel, cut to what lies in front of the other's plane.
    fn add(&mut self, a: &Shape, b: &Shape, accuracy: &Accuracy, slot: u32) {
        let in_order = a.area < b.area || (a.area == b.area && comes_first(a.corners, b.corners));
        let (small, large) = if in_order { (a, b) } else { (b, a) };
        // Coordinates relative to the smaller polygon: it is the one whose own digits are at stake.
        let origin = small.corners[0];
        let first = self.corners.len();
        self.corners.extend(small.corners.iter().map(|v| *v - origin));
        self.corners.extend(large.corners.iter().map(|v| *v - origin));
        let (s, l) = self.corners[first..].split_at(small.corners.len());
        let s = Shape { corners: s, centre: small.centre - origin, ..*small };
        let l = Shape { corners: l, centre: large.centre - origin, ..*large };
        let normals = [s.normal, l.normal];
        let (mut cut_s, mut cut_l) = (Vec::new(), Vec::new());
        let (s, l) = match [side_of(s.corners, &plane(&l)), side_of(l.corners, &plane(&s))] {
            [Side::Front, Side::Front] => (s, l),
            [Side::Behind, _] | [_, Side::Behind] => {
                self.corners.truncate(first);
                return;
            }
            _ => {
                clip_to_front(s.corners, &plane(&l), &mut cut_s);
                clip_to_front(l.corners, &plane(&s), &mut cut_l);
                self.corners.truncate(first);
                let (Some(s), Some(l)) = (part(&cut_s, normals[0]), part(&cut_l, normals[1])) else { return };
                let (s, l) = if s.area <= l.area { (s, l) } else { (l, s) };
                self.corners.extend(s.corners.iter().chain(l.corners));
                (s, l)
            }
        };
        let [q_area, q_point] = ratios(&s, &l);
        let counts = [s.corners.len() as u32, l.corners.len() as u32];
        let cut = Cut { slot, first: first as u32, counts, normals: [s.normal, l.normal] };
        self.buckets[cut.is_large()][accuracy.choice(q_area, q_point)].push(self.cut.len() as u32);
        self.cut.push(cut);
    }

    /// Computes what is in the buckets.
    fn run(&mut self, a: &[Patch], b: &[Patch], accuracy: &Accuracy, out: &mut [f64]) {
        for (kernel, pairs) in Kernel::ALL.into_iter().zip(&self.whole).filter(|(_, pairs)| !pairs.is_empty()) {
            let work = WholePairs { a, b, pairs };
            if kernel == Kernel::Contour {
                contours_of_whole(self.instructions, work, accuracy, &mut self.contours, &mut self.special);
            } else {
                rule_on_whole(self.instructions, work, kernel, out);
            }
        }
        for (large, buckets) in self.buckets.iter().enumerate() {
            for (kernel, bucket) in Kernel::ALL.into_iter().zip(buckets).filter(|(_, bucket)| !bucket.is_empty()) {
                let work = CutPairs { corners: &self.corners, cut: &self.cut, bucket };
                match (kernel, large) {
                    (Kernel::Contour, 0) => {
                        contours_of_few(self.instructions, work, accuracy, &mut self.contours, &mut self.special);
                    }
                    (Kernel::Contour, _) => {
                        contours_of_many(self.instructions, work, accuracy, &mut self.contours, &mut self.special);
                    }
                    (_, 0) => rule_on_few(self.instructions, work, kernel, out),
                    _ => rule_on_many(self.instructions, work, kernel, out),
                }
            }
        }
        if !self.contours.is_empty() {
            self.finish_contours(a, b, accuracy, out);
        }
    }

    /// Adds the special edges, and computes in another way what rounding has spoilt.
    fn finish_contours(&mut self, a: &[Patch], b: &[Patch], accuracy: &Accuracy, out: &mut [f64]) {
        let mut sums: Vec<f64> = self.contours.iter().map(|c| c.sum).collect();
        special_edges(self.instructions, &self.special, &mut sums);
        for (c, sum) in self.contours.iter().zip(sums) {
            let g = (sum / (std::f64::consts::TAU * c.scale * c.scale)).max(0.0);
            let rounding = 2.0 * f64::EPSILON * g + c.rounding;
            let kept = accuracy.is_forced() || rounding <= accuracy.tolerance() * g;
            out[c.slot(&self.whole, &self.cut) as usize] =
                if kept { g } else { self.spoilt(c, g, rounding, a, b, accuracy) };
        }
    }

    /// The exchange of a pair of which the contour integral gave `g`, with an error of `rounding`: by pieces; where that
    /// takes too many, by the densest point rule if that is known to lose less.
    #[cold]
    fn spoilt(&self, c: &Contour, g: f64, rounding: f64, a: &[Patch], b: &[Patch], accuracy: &Accuracy) -> f64 {
        let pair: Pair = if c.is_whole {
            let pair = self.whole[CONTOUR][c.pair as usize].patches(a, b);
            let origin = pair[0].corners[0];
            pair.map(|patch| (patch.corners.map(|v| v - origin).to_vec(), patch.normal))
        } else {
            let Cut { first, counts: [s, l], normals, .. } = self.cut[c.pair as usize];
            let corners = &self.corners[first as usize..][..(s + l) as usize];
            [(corners[..s as usize].to_vec(), normals[0]), (corners[s as usize..].to_vec(), normals[1])]
        };
        // What is already lost in `g` matters little for a bound.
        let allowed = 0.1 * accuracy.tolerance() * g.max(rounding);
        let q_point = {
            let [s, l] = pair.each_ref().map(|(corners, normal)| part(corners, *normal));
            s.zip(l).map_or(f64::INFINITY, |(s, l)| ratios(&s, &l)[1])
        };
        let mut batch = Batch::with_instructions(self.instructions);
        let (pairs, accuracy) = match pieces(pair.clone(), accuracy, allowed) {
            Some(pairs) => (pairs, accuracy.forced()),
            None if rounding <= densest_point_error(q_point) * g => return g,
            None => (vec![pair], Accuracy::only(DENSEST_POINT)),
        };
        let mut parts = vec![0.0; pairs.len()];
        for (k, pair) in pairs.iter().enumerate() {
            let [s, l] = pair.each_ref().map(|(corners, normal)| part(corners, *normal));
            if let Some((s, l)) = s.zip(l) {
                batch.add(&s, &l, &accuracy, k as u32);
            }
        }
        batch.run(&[], &[], &accuracy, &mut parts);
        parts.iter().sum()
    }
}

/// A total order of polygons of the same area, so that (a, b) and (b, a) run the same instructions.
#[inline]
fn comes_first(a: &[Vec3], b: &[Vec3]) -> bool {
    a.iter().map(Vec3::to_array).le(b.iter().map(Vec3::to_array))
}

#[inline]
fn plane(shape: &Shape) -> Plane {
    Plane { normal: shape.normal, point: shape.corners[0] }
}

/// The part of a polygon that has been cut out; none when it has no area. `normal` is the whole one's, which knows better.
fn part(cut: &[Vec3], normal: Vec3) -> Option<Shape<'_>> {
    if cut.len() < 3 {
        return None;
    }
    let area = area_vector(cut).length();
    (area > 0.0).then(|| Shape::with_normal(cut, normal, area))
}
