//! Segments between one pair of patches, through the wide tree together.
//!
//! Up to [`MOST`] segments that go about the same way lie in a frustum: between two planes across their main axis z, and in x
//! and y between chords (the least x of straight lines is a concave function of z, so the chord between its ends is a lower
//! bound; the largest likewise). Eight boxes are tested against the frustum at once, for all segments. Only at a triangle
//! that reaches into it do the segments count one by one, sixteen in the lanes of a vector.

use super::block::HALF;
use super::bvh::Bvh;
use super::intersect::{ACROSS, main_axis};
use super::ray::Segment;
use super::sift::Edges;
use super::wide::{COORDINATE_ERROR, LEAF, Node, Pack};
use crate::geometry::Vec3;
use crate::simd::single::Lanes;
use crate::simd::{Machine, for_every_machine};

/// Segments that travel together.
const MOST: usize = 64;
const LANES: usize = 16;
const GROUPS: usize = MOST / LANES;

/// The largest slope d_x / d_z of a segment in a bundle. Directions that differ more are better off alone.
const STEEPEST: f32 = 2.0;
/// Slopes up to 2 instead of 1, and rounded four times instead of once (5e-7 x depth up to 2, where depth 2 and slope 2 do not
/// occur in one box), make the errors of sheared coordinates twice what [`COORDINATE_ERROR`] bounds. Sheared extents are up
/// to 3 instead of 2 times those of the triangles, so those of edge functions are three times as large.
const BUNDLE_COORDINATE_ERROR: f32 = 2.0 * COORDINATE_ERROR;
const BUNDLE_EDGE_ERROR: f32 = 3.0;
const SHEARED_EXTENT: f32 = 3.0;
/// What rounding may move the sides of the frustum by, in a box of size 2.
const PADDING: f32 = 8e-6;
/// In flatter frusta chords mean nothing.
const FLAT: f32 = 1e-3;

/// Sixteen numbers of a group of segments.
type Row = [f32; LANES];

/// The space that the segments pass through: z in [z0, z1], and of x and y the chords  value at z = 0, slope.
#[derive(Default)]
struct Frustum {
    z: [f32; 2],
    low: [[f32; 2]; 2],
    high: [[f32; 2]; 2],
}

impl Frustum {
    /// Which of eight boxes reach into it.
    #[inline(always)]
    fn meets<V: Lanes<8>>(&self, low: [V; 3], high: [V; 3]) -> u32 {
        let (z0, z1) = (low[2].max(V::splat(self.z[0])), high[2].min(V::splat(self.z[1])));
        let mut mask = z0.le(z1);
        for k in 0..2 {
            let (at, slope) = (V::splat(self.low[k][0]), V::splat(self.low[k][1]));
            let least = z0.mul_add(slope, at).min(z1.mul_add(slope, at));
            let (at, slope) = (V::splat(self.high[k][0]), V::splat(self.high[k][1]));
            let most = z0.mul_add(slope, at).max(z1.mul_add(slope, at));
            mask &= least.le(high[k]) & low[k].le(most);
        }
        mask
    }
}

/// Segments made ready to travel together.
#[repr(C, align(64))]
struct Bundle {
    /// Starts and ways to the ends, by axis of the scene and group.
    from: [[Row; GROUPS]; 3],
    way: [[Row; GROUPS]; 3],
    /// The bundle's axes x, y and z; z is the main one.
    axes: [usize; 3],
    /// Way along x and y by that along z, size of that along z, and its sign.
    slope: [[Row; GROUPS]; 2],
    length: [Row; GROUPS],
    sign: f32,
    frustum: Frustum,
}

impl Bundle {
    fn new() -> Bundle {
        let rows = [[0.0; LANES]; GROUPS];
        Bundle {
            from: [rows; 3],
            way: [rows; 3],
            axes: [0, 1, 2],
            slope: [rows; 2],
            length: rows,
            sign: 1.0,
            frustum: Frustum::default(),
        }
    }

    /// Makes up to [`MOST`] segments ready; false when they go too different ways, or leave the box.
    #[inline(always)]
    fn prepare<V: Lanes<LANES>>(&mut self, bvh: &Bvh, segments: &[Segment]) -> bool {
        for k in 0..segments.len().next_multiple_of(LANES) {
            // The last lanes repeat the last segment. One by one: gathering several at once is slower.
            let segment = &segments[std::hint::black_box(k).min(segments.len() - 1)];
            let start = bvh.normalise(segment.start);
            let way = (bvh.normalise(segment.end) - start).as_vec3().to_array();
            let start = start.as_vec3().to_array();
            for axis in 0..3 {
                self.from[axis][k / LANES % GROUPS][k % LANES] = start[axis];
                self.way[axis][k / LANES % GROUPS][k % LANES] = way[axis];
            }
        }
        let groups = segments.len().div_ceil(LANES).min(GROUPS);
        let mut sums = [0.0; 3];
        let mut reach = V::splat(0.0);
        for axis in 0..3 {
            let mut sum = V::splat(0.0);
            for g in 0..groups {
                let (from, way) = (V::load(&self.from[axis][g]), V::load(&self.way[axis][g]));
                sum = sum.add(way);
                reach = reach.max(from.abs()).max(from.add(way).abs());
            }
            let mut lanes = [0.0; LANES];
            sum.store(&mut lanes);
            sums[axis] = lanes.iter().sum::<f32>();
        }
        let z = main_axis(Vec3::from_array(sums.map(f64::from)));
        let [x, y] = ACROSS[z].map(|axis| axis as usize);
        self.axes = [x, y, z];
        self.sign = 1f32.copysign(sums[z]);
        // What is no number does not count here, but has neither slope nor length.
        let mut fits = reach.le(V::splat(HALF as f32 * 1.001));
        let (mut z0, mut z1) = (V::splat(f32::INFINITY), V::splat(f32::NEG_INFINITY));
        for g in 0..groups {
            let (way, from) = (V::load(&self.way[z][g]), V::load(&self.from[z][g]));
            let length = way.mul(V::splat(self.sign));
            let inverse = V::splat(1.0).div(way);
            fits &= V::splat(f32::MIN_POSITIVE).le(length);
            for (a, axis) in [x, y].into_iter().enumerate() {
                let slope = V::load(&self.way[axis][g]).mul(inverse);
                fits &= slope.abs().le(V::splat(STEEPEST));
                slope.store(&mut self.slope[a][g]);
            }
            length.mul(V::splat(1.0 + f32::EPSILON)).store(&mut self.length[g]);
            (z0, z1) = (z0.min(from).min(from.add(way)), z1.max(from).max(from.add(way)));
        }
        if fits != (1 << LANES) - 1 {
            return false;
        }
        let (z0, z1) = (least(z0), -least(V::splat(0.0).sub(z1)));
        self.frustum.z = [z0 - PADDING, z1 + PADDING];
        for (a, axis) in [x, y].into_iter().enumerate() {
            let (mut low, mut high) = ([0.0; 2], [0.0; 2]);
            for (end, at) in [z0, z1].into_iter().enumerate() {
                let (mut lowest, mut highest) = (V::splat(f32::INFINITY), V::splat(f32::NEG_INFINITY));
                for g in 0..groups {
                    let depth = V::splat(at).sub(V::load(&self.from[z][g]));
                    let place = V::load(&self.slope[a][g]).mul_add(depth, V::load(&self.from[axis][g]));
                    (lowest, highest) = (lowest.min(place), highest.max(place));
                }
                (low[end], high[end]) = (least(lowest) - PADDING, PADDING - least(V::splat(0.0).sub(highest)));
            }
            if z1 - z0 > FLAT {
                let slope = (low[1] - low[0]) / (z1 - z0);
                self.frustum.low[a] = [low[0] - slope * z0, slope];
                let slope = (high[1] - high[0]) / (z1 - z0);
                self.frustum.high[a] = [high[0] - slope * z0, slope];
            } else {
                self.frustum.low[a] = [low[0].min(low[1]), 0.0];
                self.frustum.high[a] = [high[0].max(high[1]), 0.0];
            }
        }
        true
    }

    /// The children of `node` that the bundle may meet.
    #[inline(always)]
    fn boxes<V: Lanes<8>>(&self, node: &Node) -> u32 {
        let [x, y, z] = self.axes;
        let rows = &node.bounds;
        let low = [V::load(&rows[2 * x]), V::load(&rows[2 * y]), V::load(&rows[2 * z])];
        let high = [V::load(&rows[2 * x + 1]), V::load(&rows[2 * y + 1]), V::load(&rows[2 * z + 1])];
        self.frustum.meets(low, high)
    }

    /// The triangles of `pack` that the bundle may meet.
    #[inline(always)]
    fn triangles<V: Lanes<8>>(&self, pack: &Pack) -> u32 {
        let [x, y, z] = self.axes;
        let ([lx, hx], [ly, hy], [lz, hz]) = (extremes::<V>(pack, x), extremes::<V>(pack, y), extremes::<V>(pack, z));
        self.frustum.meets([lx, ly, lz], [hx, hy, hz]) & pack.lanes
    }

    /// Of the `open` segments of group `g`, those that triangle `lane` of `pack` may block, and those that it surely does;
    /// `own` is the reach of the surfaces at their ends.
    #[inline(always)]
    fn segments<V: Lanes<LANES>>(&self, g: usize, open: u32, pack: &Pack, lane: usize, own: f32) -> (u32, u32) {
        let [x, y, z] = self.axes;
        let from = [V::load(&self.from[x][g]), V::load(&self.from[y][g]), V::load(&self.from[z][g])];
        let slope = [V::load(&self.slope[0][g]), V::load(&self.slope[1][g])];
        let corners = [
            sheared(&pack.corners[0], self.axes, lane, from, slope),
            sheared(&pack.corners[1], self.axes, lane, from, slope),
            sheared(&pack.corners[2], self.axes, lane, from, slope),
        ];
        let edges = Edges::new(corners, BUNDLE_EDGE_ERROR * pack.error);
        if edges.maybe & open == 0 {
            return (0, 0);
        }
        let length = V::load(&self.length[g]);
        let sifted = edges.sift(V::splat(self.sign), length, BUNDLE_COORDINATE_ERROR);
        let between = V::splat(own).le(sifted.low) & sifted.high.add(V::splat(own)).le(length);
        // The frustum meets the box of the pack, but does each segment? Of those that are hit, no corner is farther.
        let near = edges.within(SHEARED_EXTENT * pack.extent + 1e-6);
        (sifted.open & open, sifted.certain & between & near & open)
    }
}

/// The least of sixteen.
#[inline(always)]
fn least<V: Lanes<LANES>>(v: V) -> f32 {
    let mut lanes = [0.0; LANES];
    v.store(&mut lanes);
    let mut least = lanes[0];
    for k in 1..LANES {
        least = if lanes[k] < least { lanes[k] } else { least };
    }
    least
}

/// The least and the largest coordinates of the triangles of a pack along one axis.
#[inline(always)]
fn extremes<V: Lanes<8>>(pack: &Pack, axis: usize) -> [V; 2] {
    let [a, b, c] = [&pack.corners[0], &pack.corners[1], &pack.corners[2]];
    let (a, b, c) = (V::load(&a[axis]), V::load(&b[axis]), V::load(&c[axis]));
    [a.min(b).min(c), a.max(b).max(c)]
}

/// A corner of one triangle, in the frames of sixteen segments.
#[inline(always)]
fn sheared<V: Lanes<LANES>>(
    rows: &[[f32; 8]; 3],
    [x, y, z]: [usize; 3],
    lane: usize,
    from: [V; 3],
    slope: [V; 2],
) -> [V; 3] {
    let depth = V::splat(rows[z][lane]).sub(from[2]);
    [
        slope[0].neg_mul_add(depth, V::splat(rows[x][lane]).sub(from[0])),
        slope[1].neg_mul_add(depth, V::splat(rows[y][lane]).sub(from[1])),
        depth,
    ]
}

/// Sends `segments` through the tree; false when they are no bundle.
#[inline(always)]
fn travel<M: Machine>(
    bvh: &Bvh,
    bundle: &mut Bundle,
    segments: &[Segment],
    stack: &mut Vec<u32>,
    blocked: &mut [bool],
) -> bool {
    if !bundle.prepare::<M::Sixteen>(bvh, segments) {
        return false;
    }
    let exclude = segments[0].exclude.map(|patch| bvh.place(patch));
    // The segments that nothing was found to block yet, one bit each.
    let mut open = [0u32; GROUPS];
    for k in 0..segments.len() {
        open[k / LANES] |= 1 << (k % LANES);
    }
    stack.clear();
    stack.push(0);
    while let Some(current) = stack.pop() {
        if current & LEAF == 0 {
            let node = &bvh.wide.nodes[current as usize];
            let mut rest = bundle.boxes::<M::Eight>(node);
            while rest != 0 {
                let child = node.children[rest.trailing_zeros() as usize & 7];
                bvh.wide.prefetch(child);
                stack.push(child);
                rest &= rest - 1;
            }
            continue;
        }
        let pack = &bvh.wide.packs[(current & !LEAF) as usize];
        let mut rest = bundle.triangles::<M::Eight>(pack) & !pack.lane_of(exclude[0]) & !pack.lane_of(exclude[1]);
        while rest != 0 {
            let lane = rest.trailing_zeros() as usize & 7;
            rest &= rest - 1;
            for g in 0..GROUPS {
                if open[g] == 0 {
                    continue;
                }
                let (met, certain) = bundle.segments::<M::Sixteen>(g, open[g], pack, lane, bvh.own_reach);
                let mut unclear = met & !certain;
                open[g] &= !certain;
                while unclear != 0 {
                    let k = unclear.trailing_zeros() as usize;
                    unclear &= unclear - 1;
                    if bvh.stands_between(pack.first as usize + lane, &segments[LANES * g + k]) {
                        open[g] &= !(1 << k);
                    }
                }
            }
            if open == [0; GROUPS] {
                blocked.fill(true);
                return true;
            }
        }
    }
    for (k, blocked) in blocked.iter_mut().enumerate() {
        *blocked = open[k / LANES] >> (k % LANES) & 1 == 0;
    }
    true
}

/// The sign and the number of the main axis of a segment: those that agree in both always make a bundle.
#[inline(always)]
fn course(segment: &Segment) -> usize {
    let way = segment.end - segment.start;
    let axis = main_axis(way);
    2 * axis + usize::from(way[axis] < 0.0)
}

#[inline(always)]
fn travel_all<M: Machine>(bvh: &Bvh, segments: &[Segment], blocked: &mut [bool]) {
    let mut stack = Vec::with_capacity(7 * bvh.wide.depth + 1);
    let mut bundle = Bundle::new();
    for (segments, blocked) in segments.chunks(MOST).zip(blocked.chunks_mut(MOST)) {
        if travel::<M>(bvh, &mut bundle, segments, &mut stack, blocked) {
            continue;
        }
        let mut courses = [0; MOST];
        courses.iter_mut().zip(segments).for_each(|(c, segment)| *c = course(segment));
        let (mut part, mut numbers, mut answers) = (Vec::with_capacity(MOST), [0; MOST], [false; MOST]);
        for c in 0..6 {
            part.clear();
            for k in 0..segments.len() {
                if courses[k] == c {
                    numbers[part.len()] = k;
                    part.push(segments[k]);
                }
            }
            if part.is_empty() {
                continue;
            }
            let answers = &mut answers[..part.len()];
            if !travel::<M>(bvh, &mut bundle, &part, &mut stack, answers) {
                answers.copy_from_slice(&bvh.blocked(&part));
            }
            numbers.iter().zip(&*answers).for_each(|(&k, &answer)| blocked[k] = answer);
        }
    }
}

for_every_machine! {
    /// Whether each segment is blocked; all have the same two patches at their ends. The tree must not be empty.
    fn blocked_by(bvh: &Bvh, segments: &[Segment], blocked: &mut [bool]) -> () = travel_all
}

impl Bvh {
    /// The same as [`Bvh::blocked`], faster, for segments between one pair of patches: all must exclude the same two.
    pub fn blocked_between(&self, segments: &[Segment]) -> Vec<bool> {
        let mut blocked = vec![false; segments.len()];
        if !self.is_empty() {
            blocked_by(self.instructions, self, segments, &mut blocked);
        }
        blocked
    }
}
