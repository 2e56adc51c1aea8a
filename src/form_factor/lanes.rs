//! Pairs of polygons brought into lanes, and the kernels run on them.
//!
//! Whole triangles come straight from their patches, cut polygons from an arena of corners; one generic function a kernel
//! serves both, compiled for every set of instructions. No closure of these functions may use their vectors: it would not
//! have the instructions, and be called for every one of them.

use super::select::CONTOUR;
use super::{Accuracy, Kernel, Patch, Polygons, area_quadrature, contour, point_to_polygon};
use crate::geometry::Vec3;
use crate::geometry::polygon::MAX_CORNERS;
use crate::geometry::quadrature::TriangleRule;
use crate::simd::double::{Double, LANES, Vectors};
use crate::simd::{Machine, for_every_machine};

/// Corners of a triangle that has been cut once.
pub(super) const FEW: usize = 4;
/// Corners of the largest polygon, cut once.
pub(super) const MANY: usize = MAX_CORNERS + 1;

/// Two patches that lie wholly in front of each other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Whole {
    pub(super) slot: u32,
    pub(super) small: u32,
    pub(super) large: u32,
    /// Whether the smaller one is of the second list.
    pub(super) swapped: bool,
}

/// A pair of polygons in front of each other, in coordinates relative to a corner of one of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cut {
    pub(super) slot: u32,
    /// The corners of the smaller and then of the larger polygon, in the arena.
    pub(super) first: u32,
    pub(super) counts: [u32; 2],
    pub(super) normals: [Vec3; 2],
}

/// A contour integral in the making.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contour {
    /// Which pair: whole ones first, then the cut ones.
    pub(super) pair: u32,
    pub(super) is_whole: bool,
    /// The power of two that the polygons were scaled by.
    pub(super) scale: f64,
    /// 2 pi G of the scaled polygons, and the rounding error that G may have, m^2.
    pub(super) sum: f64,
    pub(super) rounding: f64,
}

impl Cut {
    /// The polygons may have many corners.
    pub(super) fn is_large(&self) -> usize {
        usize::from(self.counts[0].max(self.counts[1]) > FEW as u32)
    }
}

impl Contour {
    pub(super) fn slot(&self, whole: &[Vec<Whole>; Kernel::ALL.len()], cut: &[Cut]) -> u32 {
        if self.is_whole { whole[CONTOUR][self.pair as usize].slot } else { cut[self.pair as usize].slot }
    }
}

impl Whole {
    /// The smaller and the larger patch.
    #[inline(always)]
    pub(super) fn patches<'a>(&self, a: &'a [Patch], b: &'a [Patch]) -> [&'a Patch; 2] {
        let (first, second) = if self.swapped { (b, a) } else { (a, b) };
        [&first[self.small as usize], &second[self.large as usize]]
    }
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
pub(super) struct WholePairs<'a> {
    pub(super) a: &'a [Patch],
    pub(super) b: &'a [Patch],
    pub(super) pairs: &'a [Whole],
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
pub(super) struct CutPairs<'a> {
    pub(super) corners: &'a [Vec3],
    pub(super) cut: &'a [Cut],
    pub(super) bucket: &'a [u32],
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
pub(super) struct Look {
    /// A bit for each pair that may face each other.
    pub(super) facing: u32,
    /// A bit for each pair that lies wholly in front of each other's planes.
    pub(super) whole: u32,
    /// The kernels of those.
    pub(super) kernels: [usize; LANES],
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
            for_every_machine! { pub(super) fn $rule(pairs: $pairs, kernel: Kernel, out: &mut [f64]) -> () = $rule_kernel }
            for_every_machine! {
                pub(super) fn $contour(
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
for_every_machine! { pub(super) fn special_edges(special: &[contour::Special], sums: &mut [f64]) -> () = special_kernel }
for_every_machine! {
    pub(super) fn classify(a: &[Patch], b: &[Patch], pairs: &[[u32; 2]], accuracy: &Accuracy) -> Look = classify_kernel
}
