//! Many pairs at once: classified eight at a time, sorted by kernel, computed eight at a time.
//!
//! 1. Facing, by centres, radii and planes, in lanes: pairs that face away are done.
//! 2. The pairs close to a plane are looked at corner by corner; what straddles the other's plane is cut at it.
//! 3. [`Accuracy`] names the kernel of each pair by its two ratios; every kernel runs over its own pairs in lanes.
//! 4. Contour integrals whose rounding exceeds the tolerance fall back to what loses less.
//!
//! A pair's result depends on nothing but the pair, whatever else is in the batch; and (a, b) gives the bits of (b, a).

use super::select::{Kernel, densest_point_error};
use super::{Accuracy, Polygons, Shape, area_quadrature, contour, point_to_polygon};
use crate::geometry::polygon::{MAX_CORNERS, Plane, Side, area_vector, clip_to_front, side_of};
use crate::geometry::quadrature::TriangleRule;
use crate::geometry::{Triangle, Vec3};
use crate::simd::double::{Double, LANES, Vectors};
use crate::simd::{Instructions, Machine, for_every_machine};

/// A triangle with what every pair asks of it.
#[derive(Debug, Clone, Copy)]
pub struct Patch {
    /// Corners, counter-clockwise seen from the front.
    pub corners: Triangle,
    /// Unit normal, front side.
    pub normal: Vec3,
    /// Area, m^2.
    pub area: f64,
    centre: Vec3,
    radius: f64,
}

impl Patch {
    /// Measures a triangle. Its area must not be zero.
    pub fn new(corners: Triangle) -> Patch {
        let Shape { normal, area, centre, radius, .. } = Shape::new(&corners);
        Patch { corners, normal, area, centre, radius }
    }

    /// The same as a polygon.
    pub fn shape(&self) -> Shape<'_> {
        Shape { corners: &self.corners, normal: self.normal, area: self.area, centre: self.centre, radius: self.radius }
    }
}

/// Pairs classified in one go: enough to fill the lanes of every kernel, few enough to stay in the cache.
const BLOCK: usize = 512;
/// Corners of a triangle that has been cut once.
const FEW: usize = 4;
/// Corners of the largest polygon, cut once.
const MANY: usize = MAX_CORNERS + 1;

/// A pair of polygons in front of each other, in coordinates relative to the smaller.
#[derive(Debug, Clone, Copy)]
struct Entry {
    slot: u32,
    /// The corners of the smaller and then of the larger polygon, in the arena.
    first: u32,
    counts: [u32; 2],
    normals: [Vec3; 2],
    distance: f64,
    q_area: f64,
    q_point: f64,
}

/// A contour integral in the making.
#[derive(Debug, Clone, Copy)]
struct Contour {
    entry: u32,
    /// The power of two that the polygons were scaled by.
    scale: f64,
    /// 2 pi G of the scaled polygons, and the rounding error that it may have.
    sum: f64,
    rounding: f64,
}

/// Memory reused from block to block.
pub struct Batch {
    instructions: Instructions,
    corners: Vec<Vec3>,
    entries: Vec<Entry>,
    /// Entries by kernel: those of few corners, then those of many.
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
            corners: Vec::new(),
            entries: Vec::new(),
            buckets: Default::default(),
            contours: Vec::new(),
            special: Vec::new(),
        }
    }

    /// out_k = G of patch i of `a` and patch j of `b` for pair k = (i, j), unoccluded, m^2.
    pub fn exchange_pairs(&mut self, a: &[Patch], b: &[Patch], pairs: &[[u32; 2]], accuracy: &Accuracy, out: &mut [f64]) {
        for (pairs, out) in pairs.chunks(BLOCK).zip(out.chunks_mut(BLOCK)) {
            self.clear();
            for (group, chunk) in pairs.chunks(LANES).enumerate() {
                let (facing, whole) = classify(self.instructions, a, b, chunk);
                for (lane, &[i, j]) in chunk.iter().enumerate() {
                    let slot = group * LANES + lane;
                    out[slot] = 0.0;
                    if facing >> lane & 1 != 0 {
                        let (a, b) = (&a[i as usize], &b[j as usize]);
                        self.add(&a.shape(), &b.shape(), whole >> lane & 1 != 0, accuracy, slot as u32);
                    }
                }
            }
            self.run(accuracy, out);
        }
    }

    /// G of two polygons, m^2.
    pub fn exchange(&mut self, a: &Shape, b: &Shape, accuracy: &Accuracy) -> f64 {
        let mut out = [0.0];
        self.clear();
        self.add(a, b, false, accuracy, 0);
        self.run(accuracy, &mut out);
        out[0]
    }

    fn clear(&mut self) {
        self.corners.clear();
        self.entries.clear();
        self.buckets.iter_mut().flatten().for_each(Vec::clear);
    }

    /// Puts a pair into the bucket of its kernel, cut to what lies in front of the other's plane unless it is `whole`.
    fn add(&mut self, a: &Shape, b: &Shape, whole: bool, accuracy: &Accuracy, slot: u32) {
        let (small, large) = if is_smaller(a, b) { (a, b) } else { (b, a) };
        // Coordinates relative to the smaller polygon: it is the one whose own digits are at stake.
        let origin = small.corners[0];
        let first = self.corners.len();
        self.corners.extend(small.corners.iter().map(|v| *v - origin));
        self.corners.extend(large.corners.iter().map(|v| *v - origin));
        let (s, l) = self.corners[first..].split_at(small.corners.len());
        let s = Shape { corners: s, centre: small.centre - origin, ..*small };
        let l = Shape { corners: l, centre: large.centre - origin, ..*large };
        let sides = if whole { [Side::Front; 2] } else { [side(&s, &l), side(&l, &s)] };
        let entry = match sides {
            [Side::Front, Side::Front] => Entry::new(&s, &l, slot, first),
            [Side::Behind, _] | [_, Side::Behind] => {
                self.corners.truncate(first);
                return;
            }
            _ => {
                let (mut cut_s, mut cut_l) = (Vec::with_capacity(MANY), Vec::with_capacity(MANY));
                clip_to_front(s.corners, &plane(&l), &mut cut_s);
                clip_to_front(l.corners, &plane(&s), &mut cut_l);
                let normals = [s.normal, l.normal];
                self.corners.truncate(first);
                let (Some(s), Some(l)) = (part(&cut_s, normals[0]), part(&cut_l, normals[1])) else { return };
                let (s, l) = if s.area <= l.area { (s, l) } else { (l, s) };
                self.corners.extend(s.corners.iter().chain(l.corners));
                Entry::new(&s, &l, slot, first)
            }
        };
        let kernel = accuracy.choice(entry.q_area, entry.q_point);
        self.buckets[entry.is_large()][kernel].push(self.entries.len() as u32);
        self.entries.push(entry);
    }

    /// Computes what is in the buckets.
    fn run(&mut self, accuracy: &Accuracy, out: &mut [f64]) {
        self.contours.clear();
        self.special.clear();
        for (large, buckets) in self.buckets.iter().enumerate() {
            for (kernel, bucket) in Kernel::ALL.into_iter().zip(buckets).filter(|(_, bucket)| !bucket.is_empty()) {
                let work = Work { corners: &self.corners, entries: &self.entries, bucket };
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
        if self.contours.is_empty() {
            return;
        }
        let mut sums: Vec<f64> = self.contours.iter().map(|c| c.sum).collect();
        special_edges(self.instructions, &self.special, &mut sums);
        let mut again: [Vec<u32>; 2] = Default::default();
        for (c, sum) in self.contours.iter().zip(sums) {
            let entry = &self.entries[c.entry as usize];
            let g = (sum / (std::f64::consts::TAU * c.scale * c.scale)).max(0.0);
            let rounding = 2.0 * f64::EPSILON * g + c.rounding;
            // Where cancellation has eaten the tolerance, the densest point rule is taken if it is known to lose less.
            let kept = accuracy.is_forced() || rounding <= accuracy.tolerance() * g;
            if kept || rounding <= densest_point_error(entry.q_point) * g {
                out[entry.slot as usize] = g;
            } else {
                again[entry.is_large()].push(c.entry);
            }
        }
        for (large, bucket) in again.iter().enumerate() {
            let work = Work { corners: &self.corners, entries: &self.entries, bucket };
            let kernel = Kernel::Point(TriangleRule::P16);
            match large {
                0 => rule_on_few(self.instructions, work, kernel, out),
                _ => rule_on_many(self.instructions, work, kernel, out),
            }
        }
    }
}

impl Entry {
    fn new(small: &Shape, large: &Shape, slot: u32, first: usize) -> Entry {
        let distance = small.centre.distance(large.centre);
        let to_plane = large.normal.dot(small.centre - large.corners[0]).abs();
        Entry {
            slot,
            first: first as u32,
            counts: [small.corners.len() as u32, large.corners.len() as u32],
            normals: [small.normal, large.normal],
            distance,
            q_area: (small.radius + large.radius) / distance,
            q_point: small.radius / to_plane.max(distance - large.radius).max(f64::MIN_POSITIVE),
        }
    }

    fn is_large(&self) -> usize {
        usize::from(self.counts[0].max(self.counts[1]) > FEW as u32)
    }
}

/// A total order of polygons, so that (a, b) and (b, a) run the same instructions.
#[inline]
fn is_smaller(a: &Shape, b: &Shape) -> bool {
    let by_corners = || a.corners.iter().map(Vec3::to_array).le(b.corners.iter().map(Vec3::to_array));
    a.area < b.area || (a.area == b.area && by_corners())
}

#[inline]
fn plane(shape: &Shape) -> Plane {
    Plane { normal: shape.normal, point: shape.corners[0] }
}

/// Where `a` lies as seen from the plane of `b`. The common cases first: the whole polygon clearly in front, or behind.
#[inline]
fn side(a: &Shape, b: &Shape) -> Side {
    let plane = plane(b);
    let distance = plane.distance(a.centre);
    if distance > 2.0 * a.radius {
        Side::Front
    } else if distance < -2.0 * a.radius {
        Side::Behind
    } else {
        side_of(a.corners, &plane)
    }
}

/// The part of a polygon that has been cut out; none when it has no area. `normal` is the whole one's, which knows better.
fn part(cut: &[Vec3], normal: Vec3) -> Option<Shape<'_>> {
    if cut.len() < 3 {
        return None;
    }
    let area = area_vector(cut).length();
    (area > 0.0).then(|| Shape::with_normal(cut, normal, area))
}

/// Some of the entries.
#[derive(Clone, Copy)]
struct Work<'a> {
    corners: &'a [Vec3],
    entries: &'a [Entry],
    bucket: &'a [u32],
}

/// Up to eight entries in lanes, the last one repeated.
struct Lanes<D, const N: usize> {
    corners: [[Vectors<D>; N]; 2],
    counts: [usize; 2],
    normals: [Vectors<D>; 2],
}

impl<D: Double, const N: usize> Lanes<D, N> {
    #[inline(always)]
    fn load(work: Work, group: &[u32], scales: &[f64; LANES]) -> Self {
        let zero = Vectors::splat(Vec3::ZERO);
        let mut lanes = Lanes { corners: [[zero; N]; 2], counts: [0; 2], normals: [zero; 2] };
        for which in 0..2 {
            let mut rows = [[0.0; LANES]; 3];
            for lane in 0..LANES {
                let entry = &work.entries[group[lane.min(group.len() - 1)] as usize];
                lanes.counts[which] = lanes.counts[which].max(entry.counts[which] as usize);
                let normal = entry.normals[which];
                (rows[0][lane], rows[1][lane], rows[2][lane]) = (normal.x, normal.y, normal.z);
            }
            lanes.normals[which] = Vectors::load(&rows);
            for k in 0..lanes.counts[which].min(N) {
                for lane in 0..LANES {
                    let entry = &work.entries[group[lane.min(group.len() - 1)] as usize];
                    let before = if which == 0 { 0 } else { entry.counts[0] };
                    let place = entry.first + before + (k as u32).min(entry.counts[which] - 1);
                    let corner = work.corners[place as usize] * scales[lane];
                    (rows[0][lane], rows[1][lane], rows[2][lane]) = (corner.x, corner.y, corner.z);
                }
                lanes.corners[which][k] = Vectors::load(&rows);
            }
        }
        lanes
    }

    #[inline(always)]
    fn polygons(&self) -> [Polygons<'_, D>; 2] {
        [0, 1].map(|k| Polygons { corners: &self.corners[k][..self.counts[k].min(N)], normal: self.normals[k] })
    }
}

#[inline(always)]
fn rule_kernel<M: Machine, const N: usize>(work: Work, kernel: Kernel, out: &mut [f64]) {
    for group in work.bucket.chunks(LANES) {
        let lanes: Lanes<M::Double, N> = Lanes::load(work, group, &[1.0; LANES]);
        let [small, large] = lanes.polygons();
        let g = match kernel {
            Kernel::Area(rule) => area_quadrature::exchange(&small, &large, rule.points()),
            Kernel::Point(rule) => point_to_polygon::exchange(&small, &large, rule.points()),
            Kernel::Contour => M::Double::splat(0.0),
        };
        for (&k, g) in group.iter().zip(g.to_array()) {
            out[work.entries[k as usize].slot as usize] = g;
        }
    }
}

/// The error that contour integrals may have, as a part of the tolerance and of what 3 x 3 points make of the exchange:
/// near pairs, where those are off by a factor.
const CONTOUR_SHARE: f64 = 0.05;

#[inline(always)]
fn contour_kernel<M: Machine, const N: usize>(
    work: Work,
    accuracy: &Accuracy,
    contours: &mut Vec<Contour>,
    special: &mut Vec<contour::Special>,
) {
    for group in work.bucket.chunks(LANES) {
        let (mut scales, mut distances, mut slots) = ([1.0; LANES], [0.0; LANES], [0; LANES]);
        for lane in 0..LANES {
            let entry = &work.entries[group[lane.min(group.len() - 1)] as usize];
            let corners = &work.corners[entry.first as usize..][..(entry.counts[0] + entry.counts[1]) as usize];
            scales[lane] = unit_scale(corners);
            distances[lane] = entry.distance * scales[lane];
            slots[lane] = (contours.len() + lane) as u32;
        }
        let lanes: Lanes<M::Double, N> = Lanes::load(work, group, &scales);
        let [small, large] = lanes.polygons();
        let estimate = area_quadrature::exchange(&small, &large, TriangleRule::P3.points());
        let allowed = estimate * M::Double::splat(accuracy.tolerance() * CONTOUR_SHARE * std::f64::consts::TAU);
        let sum = contour::exchange(&small, &large, allowed, &slots[..group.len()], special).to_array();
        let rounding = contour::rounding(&small, &large, M::Double::load(&distances)).to_array();
        for (lane, &entry) in group.iter().enumerate() {
            let scale = scales[lane];
            contours.push(Contour { entry, scale, sum: sum[lane], rounding: rounding[lane] / (scale * scale) });
        }
    }
}

/// The power of two that brings coordinates near 1: it scales without rounding.
fn unit_scale(corners: &[Vec3]) -> f64 {
    let extent = corners.iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
    // The exponent alone, negated.
    f64::from_bits((2046u64 << 52).saturating_sub(extent.to_bits() & (0x7ff << 52)).max(1 << 52))
}

#[inline(always)]
fn special_kernel<M: Machine>(special: &[contour::Special], sums: &mut [f64]) {
    contour::add_special::<M::Double>(special, sums);
}

/// Which of up to eight pairs may face each other, and which lie wholly in front of each other's planes: a bit each.
#[inline(always)]
fn classify_kernel<M: Machine>(a: &[Patch], b: &[Patch], pairs: &[[u32; 2]]) -> (u32, u32) {
    let (mut centres, mut normals) = ([[[0.0; LANES]; 3]; 2], [[[0.0; LANES]; 3]; 2]);
    let mut radii = [[0.0; LANES]; 2];
    for (lane, &[i, j]) in pairs.iter().enumerate() {
        for (which, patch) in [&a[i as usize], &b[j as usize]].into_iter().enumerate() {
            let (centre, normal) = (patch.centre.to_array(), patch.normal.to_array());
            for axis in 0..3 {
                centres[which][axis][lane] = centre[axis];
                normals[which][axis][lane] = normal[axis];
            }
            radii[which][lane] = patch.radius;
        }
    }
    let between: Vectors<M::Double> = Vectors::load(&centres[1]) - Vectors::load(&centres[0]);
    let before_a = Vectors::load(&normals[0]).dot(between);
    let before_b = -Vectors::load(&normals[1]).dot(between);
    // Twice the radius leaves room for rounding.
    let two = M::Double::splat(2.0);
    let (radius_a, radius_b) = (two * M::Double::load(&radii[0]), two * M::Double::load(&radii[1]));
    let facing = (-radius_b).lt(before_a) & (-radius_a).lt(before_b);
    let whole = radius_b.lt(before_a) & radius_a.lt(before_b);
    (M::Double::bits(facing), M::Double::bits(whole))
}

#[inline(always)]
fn rule_few<M: Machine>(work: Work, kernel: Kernel, out: &mut [f64]) {
    rule_kernel::<M, FEW>(work, kernel, out);
}

#[inline(always)]
fn rule_many<M: Machine>(work: Work, kernel: Kernel, out: &mut [f64]) {
    rule_kernel::<M, MANY>(work, kernel, out);
}

#[inline(always)]
fn contour_few<M: Machine>(
    work: Work,
    accuracy: &Accuracy,
    contours: &mut Vec<Contour>,
    special: &mut Vec<contour::Special>,
) {
    contour_kernel::<M, FEW>(work, accuracy, contours, special);
}

#[inline(always)]
fn contour_many<M: Machine>(
    work: Work,
    accuracy: &Accuracy,
    contours: &mut Vec<Contour>,
    special: &mut Vec<contour::Special>,
) {
    contour_kernel::<M, MANY>(work, accuracy, contours, special);
}

for_every_machine! { fn classify(a: &[Patch], b: &[Patch], pairs: &[[u32; 2]]) -> (u32, u32) = classify_kernel }
for_every_machine! { fn rule_on_few(work: Work, kernel: Kernel, out: &mut [f64]) -> () = rule_few }
for_every_machine! { fn rule_on_many(work: Work, kernel: Kernel, out: &mut [f64]) -> () = rule_many }
for_every_machine! {
    fn contours_of_few(
        work: Work,
        accuracy: &Accuracy,
        contours: &mut Vec<Contour>,
        special: &mut Vec<contour::Special>,
    ) -> () = contour_few
}
for_every_machine! {
    fn contours_of_many(
        work: Work,
        accuracy: &Accuracy,
        contours: &mut Vec<Contour>,
        special: &mut Vec<contour::Special>,
    ) -> () = contour_many
}
for_every_machine! { fn special_edges(special: &[contour::Special], sums: &mut [f64]) -> () = special_kernel }
