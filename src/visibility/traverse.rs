//! Incoherent rays through the wide tree: each by itself, eight boxes or eight triangles in one go.
//!
//! A block of rays advances together, a step each a round. A single ray is all waiting: for memory, for the end of a chain
//! of operations, for branches that nobody can predict. Steps of many rays do not wait for each other; and lists that are
//! written without a branch sort rays into those that stand at a node, at a pack, or have to take the next from their stack.

use super::block::{BLOCK, Block};
use super::bvh::Bvh;
use super::intersect::Line;
use super::own_surface::OWN_SURFACE;
use super::ray::{Hit, Ray, Segment};
use super::sift::{Sifted, sift_pack};
use super::wide::{DONE, LEAF, Node, Pack};
use crate::simd::single::{Eight, Lanes, Places};
use crate::simd::{Machine, for_every_machine};

/// For every octant of directions and every set of lanes: the lanes of the set from the far end of the ray to the near.
static FAR_TO_NEAR: [[Places; 256]; 8] = {
    let mut table = [[[0; 8]; 256]; 8];
    let mut k = 0;
    while k < 8 * 256 {
        let (octant, set) = (k / 256, k % 256);
        let (mut place, mut step) = (0, 0);
        while step < 8 {
            let lane = (7 - step) ^ octant;
            if set >> lane & 1 != 0 {
                table[octant][set][place] = lane as u8;
                place += 1;
            }
            step += 1;
        }
        k += 1;
    }
    table
};

/// The lanes of a set in some order.
#[inline(always)]
fn lanes_of(set: u32) -> &'static Places {
    &FAR_TO_NEAR[0][set as usize & 255]
}

/// Numbers of rays in a block, each at most once: a ring.
struct List {
    rays: [u32; BLOCK],
    start: usize,
    end: usize,
}

impl List {
    const EMPTY: List = List { rays: [0; BLOCK], start: 0, end: 0 };

    /// Adds `ray` if it is `wanted`, without a branch.
    #[inline(always)]
    fn add(&mut self, ray: usize, wanted: bool) {
        self.rays[self.end % BLOCK] = ray as u32;
        self.end += usize::from(wanted);
    }

    #[inline(always)]
    fn take(&mut self) -> Option<usize> {
        if self.start == self.end {
            return None;
        }
        let ray = self.rays[self.start % BLOCK];
        self.start += 1;
        Some(ray as usize % BLOCK)
    }
}

/// Triangles that rays of a block may meet first, with lower bounds of t; all rays' one after the other, so that nothing
/// loops over the few of a single ray.
struct Candidates {
    rays: [u32; Candidates::ROOM],
    triangles: [u32; Candidates::ROOM],
    low: [f32; Candidates::ROOM],
    count: usize,
}

impl Candidates {
    const ROOM: usize = 4 * BLOCK;
    const NONE: Candidates = Candidates {
        rays: [0; Candidates::ROOM],
        triangles: [0; Candidates::ROOM],
        low: [0.0; Candidates::ROOM],
        count: 0,
    };

    /// Whether there is room for a whole pack.
    #[inline(always)]
    fn has_room(&self) -> bool {
        self.count <= Candidates::ROOM - 8
    }

    /// Adds the triangles of a pack with a bit in `open`. There must be room.
    #[inline(always)]
    fn add<V: Eight>(&mut self, r: usize, pack: &Pack, open: u32, low: V) {
        let places = lanes_of(open);
        V::splat(f32::from_bits(r as u32)).store_bits(eight(&mut self.rays, self.count));
        V::numbers(pack.first, places).store_bits(eight(&mut self.triangles, self.count));
        low.permute(places).store(eight(&mut self.low, self.count));
        self.count += open.count_ones() as usize;
    }
}

/// Eight elements from `at`.
#[inline(always)]
fn eight<T>(values: &mut [T], at: usize) -> &mut [T; 8] {
    debug_assert!(at + 8 <= values.len());
    // SAFETY: stacks have eight entries more than a ray can fill, since a tree has no cycles and lanes without a child are
    // never entered; candidates are added where there is room.
    unsafe { &mut *values.as_mut_ptr().add(at).cast() }
}

/// The first hit of every ray of a block, as far as it is known: in f64.
struct Best {
    t: [f64; BLOCK],
    triangle: [u32; BLOCK],
    barycentric: [[f64; 2]; BLOCK],
}

impl Best {
    const NONE: Best = Best { t: [f64::INFINITY; BLOCK], triangle: [0; BLOCK], barycentric: [[0.0; 2]; BLOCK] };

    /// Decides whether ray `r` meets triangle `k` before what it met so far.
    #[inline(always)]
    fn decide(&mut self, bvh: &Bvh, block: &Block, r: usize, k: u32) {
        let line: Line = block.line(r);
        let Some((t, barycentric)) = line.hit(&bvh.triangles[k as usize]) else { return };
        // Of surfaces that lie on each other, cut along whichever lines, that which faces the ray is met: as if it were
        // nearer. Equal distances, as on a shared edge, go to the lower number: the answer must not depend on the tree.
        let rank = |t: f64, k: u32| {
            let lead = if bvh.faces(k as usize, block.direction(r)) { OWN_SURFACE } else { 0.0 };
            (t - lead, bvh.patches[k as usize].front)
        };
        // Further apart the rank says what the distance says, and need not be asked for.
        let is_close = (t - self.t[r]).abs() <= OWN_SURFACE;
        let nearer = if is_close { rank(t, k) < rank(self.t[r], self.triangle[r]) } else { t < self.t[r] };
        if nearer && bvh.meets(k as usize, t + block.enter[r], block.origin(r)) {
            (self.t[r], self.triangle[r], self.barycentric[r]) = (t, k, barycentric);
        }
    }
}

/// The rays of a block on their way.
struct Wave {
    block: Block,
    /// Node or pack to visit next.
    current: [u32; BLOCK],
    tmax: [f32; BLOCK],
    /// The end of each ray's part of the stack.
    top: [u32; BLOCK],
    /// What is to be visited later, and where the ray enters it; `room` entries for each ray.
    children: Vec<u32>,
    distances: Vec<f32>,
    room: usize,
    candidates: Candidates,
    best: Best,
}

impl Wave {
    fn new(bvh: &Bvh) -> Wave {
        // A node adds at most seven to what is there; one at the bottom; eight are written whatever is added.
        let room = 7 * bvh.wide.depth + 1 + 8;
        Wave {
            block: Block::new(),
            current: [0; BLOCK],
            tmax: [0.0; BLOCK],
            top: [0; BLOCK],
            children: vec![DONE; room * BLOCK],
            distances: vec![f32::NEG_INFINITY; room * BLOCK],
            room,
            candidates: Candidates::NONE,
            best: Best::NONE,
        }
    }

    /// Makes the rays ready and puts the first `count` of them at the root.
    #[inline(always)]
    fn start(&mut self, count: usize) -> List {
        self.block.prepare();
        self.tmax = self.block.tmax;
        let mut nodes = List::EMPTY;
        for r in 0..count {
            self.top[r] = (r * self.room + 1) as u32;
            self.current[r] = 0;
            nodes.add(r, true);
        }
        nodes
    }

    /// The node at which ray `r` stands.
    #[inline(always)]
    fn node<'a>(&self, bvh: &'a Bvh, r: usize) -> &'a Node {
        // SAFETY: children are numbers of nodes, or of packs with LEAF.
        unsafe { bvh.wide.nodes.get_unchecked(self.current[r] as usize) }
    }

    /// The pack at which ray `r` stands.
    #[inline(always)]
    fn pack<'a>(&self, bvh: &'a Bvh, r: usize) -> &'a Pack {
        // SAFETY: as above.
        unsafe { bvh.wide.packs.get_unchecked((self.current[r] & !LEAF) as usize) }
    }

    /// Where ray `r` enters the boxes of the children of `node`, and those that it does meet in time.
    #[inline(always)]
    fn boxes<V: Eight>(&self, node: &Node, r: usize) -> (V, u32) {
        let block = &self.block;
        let [x, y, z] = [block.near[0][r], block.near[1][r], block.near[2][r]];
        let near = slab::<V>(node, x, block, 0, r).max(slab::<V>(node, y, block, 1, r));
        let enter = near.max(slab::<V>(node, z, block, 2, r).max(V::splat(0.0)));
        let far = slab::<V>(node, x ^ 1, block, 0, r).min(slab::<V>(node, y ^ 1, block, 1, r));
        let leave = far.min(slab::<V>(node, z ^ 1, block, 2, r).min(V::splat(self.tmax[r])));
        (enter, enter.le(leave))
    }

    /// The triangles of `pack`, for ray `r`.
    #[inline(always)]
    fn triangles<V: Eight>(&self, pack: &Pack, r: usize) -> Sifted<V> {
        let block = &self.block;
        let axes = [block.across[0][r], block.across[1][r], block.axis[r]];
        // SAFETY: axes are numbered 0 to 2.
        let from = unsafe {
            [
                block.from.get_unchecked(axes[0] as usize)[r],
                block.from.get_unchecked(axes[1] as usize)[r],
                block.from.get_unchecked(axes[2] as usize)[r],
            ]
        };
        let shear = [block.shear[0][r], block.shear[1][r]];
        let mut sifted = sift_pack::<V>(pack, axes, from, shear, block.shear[2][r], self.tmax[r]);
        let lanes = pack.lanes & !pack.lane_of(block.exclude[0][r]) & !pack.lane_of(block.exclude[1][r]);
        sifted.open &= lanes;
        sifted.certain &= lanes;
        sifted
    }

    /// Takes the top of the stack of ray `r`.
    #[inline(always)]
    fn pop(&mut self, r: usize) -> (u32, f32) {
        let top = self.top[r] as usize - 1;
        // SAFETY: a ray whose stack is empty has taken DONE and is on no list.
        let (current, distance) = unsafe { (*self.children.get_unchecked(top), *self.distances.get_unchecked(top)) };
        self.current[r] = current;
        self.top[r] = top as u32;
        (current, distance)
    }

    /// The first hits of the rays in `nodes`, as far as candidates tell.
    #[inline(always)]
    fn run_closest<M: Machine>(&mut self, bvh: &Bvh, mut nodes: List) {
        let (mut packs, mut waiting) = (List::EMPTY, List::EMPTY);
        loop {
            while let Some(r) = nodes.take() {
                let node = self.node(bvh, r);
                let (enter, mask) = self.boxes::<M::Eight>(node, r);
                let places = &FAR_TO_NEAR[self.block.octant[r] as usize & 7][mask as usize & 255];
                let top = self.top[r] as usize;
                M::Eight::load_bits(&node.children).permute(places).store_bits(eight(&mut self.children, top));
                enter.permute(places).store(eight(&mut self.distances, top));
                self.top[r] = top as u32 + mask.count_ones();
                waiting.add(r, true);
            }
            while let Some(r) = packs.take() {
                let pack = self.pack(bvh, r);
                let sifted = self.triangles::<M::Eight>(pack, r);
                if !self.candidates.has_room() {
                    self.decide(bvh);
                }
                self.candidates.add(r, pack, sifted.open, sifted.low);
                // What is surely hit, and not by the surface that the ray starts on, is where the search ends.
                let certain = sifted.certain & M::Eight::splat(bvh.own_reach).le(sifted.low);
                let end = sifted.high.least_of(certain) * (1.0 + 2.0 * f32::EPSILON);
                self.tmax[r] = if end < self.tmax[r] { end } else { self.tmax[r] };
                waiting.add(r, true);
            }
            if waiting.start == waiting.end {
                return;
            }
            while let Some(r) = waiting.take() {
                let (current, distance) = self.pop(r);
                let in_time = distance <= self.tmax[r];
                waiting.add(r, !in_time);
                nodes.add(r, (current & LEAF == 0) & in_time);
                packs.add(r, (current & LEAF != 0) & (current != DONE) & in_time);
                bvh.wide.prefetch(current);
            }
        }
    }

    /// Decides about all candidates that can still be first.
    #[inline(always)]
    fn decide(&mut self, bvh: &Bvh) {
        for c in 0..self.candidates.count {
            let r = self.candidates.rays[c] as usize % BLOCK;
            if self.candidates.low[c] <= self.tmax[r] {
                self.best.decide(bvh, &self.block, r, self.candidates.triangles[c]);
            }
        }
        self.candidates.count = 0;
    }

    /// Whether the segments in `nodes` are blocked.
    #[inline(always)]
    fn run_blocked<M: Machine>(&mut self, bvh: &Bvh, mut nodes: List, segments: &[Segment], blocked: &mut [bool]) {
        let (mut packs, mut waiting) = (List::EMPTY, List::EMPTY);
        loop {
            while let Some(r) = nodes.take() {
                let node = self.node(bvh, r);
                let (_, mask) = self.boxes::<M::Eight>(node, r);
                let top = self.top[r] as usize;
                let children = M::Eight::load_bits(&node.children).permute(lanes_of(mask));
                children.store_bits(eight(&mut self.children, top));
                self.top[r] = top as u32 + mask.count_ones();
                waiting.add(r, true);
            }
            while let Some(r) = packs.take() {
                let pack = self.pack(bvh, r);
                let sifted = self.triangles::<M::Eight>(pack, r);
                let mut is_blocked = false;
                if sifted.open != 0 {
                    let beyond = M::Eight::splat(bvh.own_reach).le(sifted.low);
                    let before = sifted.high.le(M::Eight::splat(self.tmax[r] - bvh.own_reach));
                    is_blocked = sifted.certain & beyond & before != 0;
                    let mut rest = if is_blocked { 0 } else { sifted.open };
                    while rest != 0 && !is_blocked {
                        let k = pack.first as usize + rest.trailing_zeros() as usize;
                        rest &= rest - 1;
                        is_blocked = bvh.stands_between(k, &segments[r]);
                    }
                    blocked[r] = is_blocked;
                }
                waiting.add(r, !is_blocked);
            }
            if waiting.start == waiting.end {
                return;
            }
            while let Some(r) = waiting.take() {
                let (current, _) = self.pop(r);
                nodes.add(r, current & LEAF == 0);
                packs.add(r, (current & LEAF != 0) & (current != DONE));
                bvh.wide.prefetch(current);
            }
        }
    }
}

/// Where ray `r` crosses the planes of one row of a node's bounds.
#[inline(always)]
fn slab<V: Lanes<8>>(node: &Node, row: u32, block: &Block, axis: usize, r: usize) -> V {
    // SAFETY: rows are numbered 0 to 5.
    let row = unsafe { node.bounds.get_unchecked(row as usize) };
    V::load(row).mul_add(V::splat(block.inverse[axis][r]), V::splat(block.offset[axis][r]))
}

#[inline(always)]
fn closest_of_all<M: Machine>(bvh: &Bvh, rays: &[Ray], hits: &mut [Option<Hit>]) {
    let mut wave = Wave::new(bvh);
    for (rays, hits) in rays.chunks(BLOCK).zip(hits.chunks_mut(BLOCK)) {
        for (r, ray) in rays.iter().enumerate() {
            // One by one: compilers would gather eight rays at once, which is slower.
            let r = std::hint::black_box(r) % BLOCK;
            let exclude = [bvh.place(ray.exclude); 2];
            wave.block.set(r, bvh.normalise(ray.origin), ray.direction, f64::INFINITY, exclude);
        }
        wave.best.t = [f64::INFINITY; BLOCK];
        let nodes = wave.start(rays.len());
        wave.run_closest::<M>(bvh, nodes);
        wave.decide(bvh);
        for (r, (ray, hit)) in rays.iter().zip(hits).enumerate() {
            let t = wave.best.t[r];
            if t < f64::INFINITY {
                let k = wave.best.triangle[r] as usize;
                let t = (t + wave.block.enter[r]) / wave.block.size[r];
                *hit = Some(bvh.hit(k, t, wave.best.barycentric[r], ray.direction));
            }
        }
    }
}

#[inline(always)]
fn blocked_of_all<M: Machine>(bvh: &Bvh, segments: &[Segment], blocked: &mut [bool]) {
    let mut wave = Wave::new(bvh);
    for (segments, blocked) in segments.chunks(BLOCK).zip(blocked.chunks_mut(BLOCK)) {
        for (r, segment) in segments.iter().enumerate() {
            let r = std::hint::black_box(r) % BLOCK;
            let (start, end) = (bvh.normalise(segment.start), bvh.normalise(segment.end));
            wave.block.set(r, start, end - start, 1.0, segment.exclude.map(|patch| bvh.place(patch)));
        }
        let nodes = wave.start(segments.len());
        wave.run_blocked::<M>(bvh, nodes, segments, blocked);
    }
}

for_every_machine! {
    /// The first hit of every ray. The tree must not be empty.
    fn first_hits(bvh: &Bvh, rays: &[Ray], hits: &mut [Option<Hit>]) -> () = closest_of_all
}

for_every_machine! {
    /// Whether each segment is blocked. The tree must not be empty.
    fn blocked_by(bvh: &Bvh, segments: &[Segment], blocked: &mut [bool]) -> () = blocked_of_all
}

impl Bvh {
    /// What each ray meets first, other than the surface that it starts on.
    ///
    /// Give many at once: some hundreds, and they need not have anything in common.
    pub fn closest(&self, rays: &[Ray]) -> Vec<Option<Hit>> {
        let mut hits = vec![None; rays.len()];
        if !self.is_empty() {
            first_hits(self.instructions, self, rays, &mut hits);
        }
        hits
    }

    /// Whether anything meets the open segments, other than the surfaces at their ends. Give many at once.
    pub fn blocked(&self, segments: &[Segment]) -> Vec<bool> {
        let mut blocked = vec![false; segments.len()];
        if !self.is_empty() {
            blocked_by(self.instructions, self, segments, &mut blocked);
        }
        blocked
    }
}
