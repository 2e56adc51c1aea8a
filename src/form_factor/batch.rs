//! Many pairs at once: classified eight at a time, sorted by kernel, computed eight at a time.
//!
//! 1. Facing, by centres, radii and planes, in lanes: pairs that face away are done.
//! 2. The pairs close to a plane are looked at corner by corner; what straddles the other's plane is cut at it.
//! 3. [`Accuracy`] names the kernel of each pair by its two ratios; every kernel runs over its own pairs in lanes.
//! 4. Contour integrals whose rounding exceeds the tolerance fall back to what loses less.
//!
//! A pair's result depends on nothing but the pair, whatever else is in the batch; and (a, b) gives the bits of (b, a).

use super::pieces::{Pair, pieces};
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

    /// Its plane.
    pub fn plane(&self) -> Plane {
        Plane { normal: self.normal, point: self.corners[0] }
    }

    /// Mean of the corners.
    pub fn centre(&self) -> Vec3 {
        self.centre
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

/// Two patches that lie wholly in front of each other.
#[derive(Debug, Clone, Copy)]
struct Whole {
    slot: u32,
    small: u32,
    large: u32,
    /// Whether the smaller one is of the second list.
    swapped: bool,
}

/// A pair of polygons in front of each other, in coordinates relative to the smaller.
#[derive(Debug, Clone, Copy)]
struct Cut {
    slot: u32,
    /// The corners of the smaller and then of the larger polygon, in the arena.
    first: u32,
    counts: [u32; 2],
    normals: [Vec3; 2],
}

impl Cut {
    /// The polygons may have many corners.
    fn is_large(&self) -> usize {
        usize::from(self.counts[0].max(self.counts[1]) > FEW as u32)
    }
}

/// A contour integral in the making.
#[derive(Debug, Clone, Copy)]
struct Contour {
    /// Which pair: whole ones first, then the cut ones.
    pair: u32,
    is_whole: bool,
    /// The power of two that the polygons were scaled by.
    scale: f64,
    /// 2 pi G of the scaled polygons, and the rounding error that G may have, m^2.
    sum: f64,
    rounding: f64,
}

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
    pub fn exchange_pairs(
        &mut self,
        a: &[Patch],
        b: &[Patch],
        pairs: &[[u32; 2]],
        accuracy: &Accuracy,
        out: &mut [f64],
    ) {
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
            None => (vec![pair], Accuracy::by(Kernel::Point(TriangleRule::P16))),
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

/// The place of the contour integral among the kernels.
const CONTOUR: usize = Kernel::ALL.len() - 1;

impl Contour {
    fn slot(&self, whole: &[Vec<Whole>; Kernel::ALL.len()], cut: &[Cut]) -> u32 {
        if self.is_whole { whole[CONTOUR][self.pair as usize].slot } else { cut[self.pair as usize].slot }
    }
}

impl Whole {
    /// The smaller and the larger patch.
    #[inline(always)]
    fn patches<'a>(&self, a: &'a [Patch], b: &'a [Patch]) -> [&'a Patch; 2] {
        let (first, second) = if self.swapped { (b, a) } else { (a, b) };
        [&first[self.small as usize], &second[self.large as usize]]
    }
}

/// The ratios q_area and q_point of a pair (see [`super::select`]).
pub(super) fn ratios(small: &Shape, large: &Shape) -> [f64; 2] {
    let distance = small.centre.distance(large.centre);
    let to_plane = large.normal.dot(small.centre - large.centre).abs();
    let nearest = to_plane.max(distance - large.radius).max(f64::MIN_POSITIVE);
    [(small.radius + large.radius) / distance, small.radius / nearest]
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

/// Up to eight pairs of polygons in lanes, the last one repeated, in coordinates relative to the smaller.
struct Lanes<D, const N: usize> {
    corners: [[Vectors<D>; N]; 2],
    counts: [usize; 2],
    normals: [Vectors<D>; 2],
}

impl<D: Double, const N: usize> Lanes<D, N> {
    #[inline(always)]
    fn polygons(&self) -> [Polygons<'_, D>; 2] {
        let [small, large] = &self.corners;
        [
            Polygons { corners: &small[..self.counts[0].min(N)], normal: self.normals[0] },
            Polygons { corners: &large[..self.counts[1].min(N)], normal: self.normals[1] },
        ]
    }
}

/// Pairs that can be brought into lanes.
trait Pairs<const N: usize>: Copy {
    fn len(self) -> usize;
    /// Pairs `first` .. `first + LANES`, as far as there are.
    fn load<D: Double>(self, first: usize) -> Lanes<D, N>;
    /// The number of a pair in the list that [`Contour::pair`] counts in.
    fn number(self, k: usize) -> u32;
    fn slot(self, k: usize) -> u32;
    const IS_WHOLE: bool;
}

#[derive(Clone, Copy)]
struct WholePairs<'a> {
    a: &'a [Patch],
    b: &'a [Patch],
    pairs: &'a [Whole],
}

impl Pairs<3> for WholePairs<'_> {
    const IS_WHOLE: bool = true;

    #[inline(always)]
    fn len(self) -> usize {
        self.pairs.len()
    }

    #[inline(always)]
    fn load<D: Double>(self, first: usize) -> Lanes<D, 3> {
        let pair = |lane: usize| self.pairs[(first + lane).min(self.pairs.len() - 1)].patches(self.a, self.b);
        let patches = [pair(0), pair(1), pair(2), pair(3), pair(4), pair(5), pair(6), pair(7)];
        let origin = Vectors::load(&columns(&patches, |pair| pair[0].corners[0]));
        let zero = Vectors::splat(Vec3::ZERO);
        let mut lanes = Lanes { corners: [[zero; 3]; 2], counts: [3; 2], normals: [zero; 2] };
        for which in 0..2 {
            lanes.normals[which] = Vectors::load(&columns(&patches, |pair| pair[which].normal));
            for k in 0..3 {
                let corners = columns(&patches, |pair| pair[which].corners[k]);
                lanes.corners[which][k] = Vectors::load(&corners) - origin;
            }
        }
        lanes
    }

    #[inline(always)]
    fn number(self, k: usize) -> u32 {
        k as u32
    }

    #[inline(always)]
    fn slot(self, k: usize) -> u32 {
        self.pairs[k].slot
    }
}

#[derive(Clone, Copy)]
struct CutPairs<'a> {
    corners: &'a [Vec3],
    cut: &'a [Cut],
    bucket: &'a [u32],
}

impl<const N: usize> Pairs<N> for CutPairs<'_> {
    const IS_WHOLE: bool = false;

    #[inline(always)]
    fn len(self) -> usize {
        self.bucket.len()
    }

    #[inline(always)]
    fn load<D: Double>(self, first: usize) -> Lanes<D, N> {
        let zero = Vectors::splat(Vec3::ZERO);
        let mut lanes = Lanes { corners: [[zero; N]; 2], counts: [0; 2], normals: [zero; 2] };
        for which in 0..2 {
            let mut rows = [[0.0; LANES]; 3];
            for lane in 0..LANES {
                let pair = &self.cut[self.bucket[(first + lane).min(self.bucket.len() - 1)] as usize];
                lanes.counts[which] = lanes.counts[which].max(pair.counts[which] as usize);
                put(&pair.normals[which], &mut rows, lane);
            }
            lanes.normals[which] = Vectors::load(&rows);
            for k in 0..lanes.counts[which].min(N) {
                for lane in 0..LANES {
                    let pair = &self.cut[self.bucket[(first + lane).min(self.bucket.len() - 1)] as usize];
                    let before = if which == 0 { 0 } else { pair.counts[0] };
                    let place = pair.first + before + (k as u32).min(pair.counts[which] - 1);
                    put(&self.corners[place as usize], &mut rows, lane);
                }
                lanes.corners[which][k] = Vectors::load(&rows);
            }
        }
        lanes
    }

    #[inline(always)]
    fn number(self, k: usize) -> u32 {
        self.bucket[k]
    }

    #[inline(always)]
    fn slot(self, k: usize) -> u32 {
        self.cut[self.bucket[k] as usize].slot
    }
}

/// One vector of each of eight items, as the rows x, y, z.
#[inline(always)]
fn columns<T>(items: &[T; LANES], get: impl Fn(&T) -> Vec3) -> [[f64; LANES]; 3] {
    let [a, b, c, d, e, f, g, h] = items;
    let [a, b, c, d, e, f, g, h] = [get(a), get(b), get(c), get(d), get(e), get(f), get(g), get(h)];
    [
        [a.x, b.x, c.x, d.x, e.x, f.x, g.x, h.x],
        [a.y, b.y, c.y, d.y, e.y, f.y, g.y, h.y],
        [a.z, b.z, c.z, d.z, e.z, f.z, g.z, h.z],
    ]
}

#[inline(always)]
fn put(v: &Vec3, rows: &mut [[f64; LANES]; 3], lane: usize) {
    rows[0][lane] = v.x;
    rows[1][lane] = v.y;
    rows[2][lane] = v.z;
}

#[inline(always)]
fn rule_kernel<D: Double, P: Pairs<N>, const N: usize>(pairs: P, kernel: Kernel, out: &mut [f64]) {
    let mut first = 0;
    while first < pairs.len() {
        let lanes: Lanes<D, N> = pairs.load(first);
        let [small, large] = lanes.polygons();
        let g = match kernel {
            Kernel::Area(rule) => area_quadrature::exchange(&small, &large, rule),
            Kernel::Point(rule) => point_to_polygon::exchange(&small, &large, rule.points()),
            Kernel::Contour => D::splat(0.0),
        };
        let g = g.to_array();
        for lane in 0..LANES.min(pairs.len() - first) {
            out[pairs.slot(first + lane) as usize] = g[lane];
        }
        first += LANES;
    }
}

/// The error that contour integrals may have, as a part of the tolerance and of what 3 x 3 points make of the exchange, but
/// no more than the smaller area: near pairs, where points are off by a factor.
const CONTOUR_SHARE: f64 = 0.3;

#[inline(always)]
fn contour_kernel<D: Double, P: Pairs<N>, const N: usize>(
    pairs: P,
    accuracy: &Accuracy,
    contours: &mut Vec<Contour>,
    special: &mut Vec<contour::Special>,
) {
    let mut first = 0;
    while first < pairs.len() {
        let mut lanes: Lanes<D, N> = pairs.load(first);
        // The exchange scales by the square of the unit of length: a power of two does so without rounding.
        let mut extent = D::splat(0.0);
        for which in 0..2 {
            for v in &lanes.corners[which][..lanes.counts[which].min(N)] {
                extent = extent.max(v.x.abs()).max(v.y.abs()).max(v.z.abs());
            }
        }
        let mut scales = extent.to_array();
        for scale in &mut scales {
            *scale = unit_scale(*scale);
        }
        let factor = D::load(&scales);
        for which in 0..2 {
            for v in &mut lanes.corners[which][..lanes.counts[which].min(N)] {
                *v = v.scaled(factor);
            }
        }
        let used = LANES.min(pairs.len() - first);
        let mut slots = [0; LANES];
        for lane in 0..used {
            slots[lane] = (contours.len() + lane) as u32;
        }
        let [small, large] = lanes.polygons();
        let estimate =
            area_quadrature::exchange(&small, &large, TriangleRule::P3).min(area_quadrature::area(small.corners));
        let allowed = estimate * D::splat(accuracy.tolerance() * CONTOUR_SHARE * std::f64::consts::TAU);
        let sum = contour::exchange(&small, &large, allowed, &slots[..used], special).to_array();
        let rounding = (contour::rounding(&small, &large) / (factor * factor)).to_array();
        for lane in 0..used {
            let pair = pairs.number(first + lane);
            let (scale, sum, rounding) = (scales[lane], sum[lane], rounding[lane]);
            contours.push(Contour { pair, is_whole: P::IS_WHOLE, scale, sum, rounding });
        }
        first += LANES;
    }
}

/// The power of two that brings coordinates up to `extent` near 1.
#[inline(always)]
fn unit_scale(extent: f64) -> f64 {
    // The exponent alone, negated.
    f64::from_bits((2046u64 << 52).saturating_sub(extent.to_bits() & (0x7ff << 52)).max(1 << 52))
}

#[inline(always)]
fn special_kernel<M: Machine>(special: &[contour::Special], sums: &mut [f64]) {
    contour::add_special::<M::Double>(special, sums);
}

/// What the centres, radii and planes of up to eight pairs tell.
struct Look {
    /// A bit for each pair that may face each other.
    facing: u32,
    /// A bit for each pair that lies wholly in front of each other's planes.
    whole: u32,
    /// The kernels of those.
    kernels: [usize; LANES],
}

#[inline(always)]
fn classify_kernel<M: Machine>(a: &[Patch], b: &[Patch], pairs: &[[u32; 2]], accuracy: &Accuracy) -> Look {
    let pair = |lane: usize| {
        let [i, j] = pairs[lane.min(pairs.len() - 1)];
        [&a[i as usize], &b[j as usize]]
    };
    let patches = [pair(0), pair(1), pair(2), pair(3), pair(4), pair(5), pair(6), pair(7)];
    // Radii and areas together: no closure of this kernel may use its vectors, for it would not have the instructions.
    let sizes = columns(&patches, |pair| Vec3::new(pair[0].radius, pair[0].area, 0.0));
    let (radius_a, area_a) = (M::Double::load(&sizes[0]), M::Double::load(&sizes[1]));
    let sizes = columns(&patches, |pair| Vec3::new(pair[1].radius, pair[1].area, 0.0));
    let (radius_b, area_b) = (M::Double::load(&sizes[0]), M::Double::load(&sizes[1]));
    let between: Vectors<M::Double> = Vectors::load(&columns(&patches, |pair| pair[1].centre - pair[0].centre));
    let before_a = Vectors::load(&columns(&patches, |pair| pair[0].normal)).dot(between);
    let before_b = -Vectors::load(&columns(&patches, |pair| pair[1].normal)).dot(between);
    // A little more than the radius leaves room for rounding.
    let more = M::Double::splat(1.01);
    let (reach_a, reach_b) = (more * radius_a, more * radius_b);
    let facing = (-reach_b).lt(before_a) & (-reach_a).lt(before_b);
    let whole = reach_b.lt(before_a) & reach_a.lt(before_b);
    let distance = between.dot(between).sqrt();
    let tiny = M::Double::splat(f64::MIN_POSITIVE);
    let q_area = (radius_a + radius_b) / distance.max(tiny);
    let q_point_a = radius_a / before_b.abs().max(distance - radius_b).max(tiny);
    let q_point_b = radius_b / before_a.abs().max(distance - radius_a).max(tiny);
    // Of equal areas either may be the smaller.
    let q_point = M::Double::select(area_a.lt(area_b), q_point_a, q_point_a.max(q_point_b));
    let q_point = M::Double::select(area_b.lt(area_a), q_point_b, q_point);
    let choice = accuracy.choices(q_area, q_point).to_array();
    let mut kernels = [0; LANES];
    for lane in 0..LANES {
        kernels[lane] = choice[lane] as usize;
    }
    Look { facing: M::Double::bits(facing), whole: M::Double::bits(whole), kernels }
}

/// The kernels for each kind of pairs.
macro_rules! kernels {
    ($($rule:ident, $contour:ident: $pairs:ty, $n:expr;)*) => {
        $(
            #[inline(always)]
            fn $rule<M: Machine>(pairs: $pairs, kernel: Kernel, out: &mut [f64]) {
                rule_kernel::<M::Double, $pairs, { $n }>(pairs, kernel, out);
            }

            #[inline(always)]
            fn $contour<M: Machine>(
                pairs: $pairs,
                accuracy: &Accuracy,
                contours: &mut Vec<Contour>,
                special: &mut Vec<contour::Special>,
            ) {
                contour_kernel::<M::Double, $pairs, { $n }>(pairs, accuracy, contours, special);
            }
        )*
    };
}

kernels! {
    rule_whole, contour_whole: WholePairs, 3;
    rule_few, contour_few: CutPairs, FEW;
    rule_many, contour_many: CutPairs, MANY;
}

/// [`for_every_machine!`] for each of them.
macro_rules! dispatch {
    ($($rule:ident = $rule_kernel:ident, $contour:ident = $contour_kernel:ident: $pairs:ty;)*) => {
        $(
            for_every_machine! { fn $rule(pairs: $pairs, kernel: Kernel, out: &mut [f64]) -> () = $rule_kernel }
            for_every_machine! {
                fn $contour(
                    pairs: $pairs,
                    accuracy: &Accuracy,
                    contours: &mut Vec<Contour>,
                    special: &mut Vec<contour::Special>,
                ) -> () = $contour_kernel
            }
        )*
    };
}

dispatch! {
    rule_on_whole = rule_whole, contours_of_whole = contour_whole: WholePairs;
    rule_on_few = rule_few, contours_of_few = contour_few: CutPairs;
    rule_on_many = rule_many, contours_of_many = contour_many: CutPairs;
}
for_every_machine! { fn special_edges(special: &[contour::Special], sums: &mut [f64]) -> () = special_kernel }
for_every_machine! {
    fn classify(a: &[Patch], b: &[Patch], pairs: &[[u32; 2]], accuracy: &Accuracy) -> Look = classify_kernel
}
