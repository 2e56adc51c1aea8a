//! Triangles in one plane merged to convex polygons.
//!
//! Triangles that lie in one plane and share edges make regions. A region whose border is convex is one polygon; any other is
//! cut along edges of its triangles, of which as many are left out as convexity allows (Hertel & Mehlhorn 1983, "Fast
//! triangulation of simple polygons").
//!
//! Positions are compared exactly. What is told by measuring is told at [`FLAT`], relative to the size of what is measured, or
//! at the rounding of the coordinates where that is more.

use std::collections::HashSet;

use super::body::{Body, Edge};
use super::bvh::{bounds, distinct_triangles};
use crate::geometry::polygon::Plane;
use crate::geometry::{Triangle, Vec3};
use crate::scene::Scene;

/// A distance that counts as none within a region of triangles or along a straight border.
const FLAT: f64 = 1e-10;

/// An edge that more polygons share than this joins none of them: to pair them all would be quadratic.
pub(super) const MOST_AT_AN_EDGE: usize = 64;

/// No side, region or polygon.
pub(super) const NONE: u32 = u32::MAX;

/// The distinct triangles of a scene. Side 3 t + e of triangle t runs from its corner e to the next one.
pub(super) struct Mesh<'a> {
    pub(super) scene: &'a Scene,
    /// Corners: of the vertices at one position the first.
    pub(super) triangles: Vec<[u32; 3]>,
    /// The patch whose front is the front of the triangle.
    pub(super) patches: Vec<u32>,
    /// Whether another patch is the same triangle from behind.
    pub(super) twinned: Vec<bool>,
    /// The triangle of every patch.
    pub(super) numbers: Vec<u32>,
    /// What rounding may have moved a coordinate by.
    pub(super) grain: f64,
}

/// A planar convex polygon that stands for triangles of a scene.
pub(super) struct Polygon {
    /// Vertices of the scene, none between its neighbours on a straight line.
    pub(super) ring: Vec<u32>,
    pub(super) plane: Plane,
    /// Whether any of it is a patch from behind too.
    pub(super) twinned: bool,
}

/// A triangle's plane, and how well it is known.
struct Flat {
    plane: Plane,
    longest: f64,
    height: f64,
    grain: f64,
}

impl Flat {
    /// Whether `x` lies in the plane. The further from the triangle, the less rounding lets one tell.
    fn holds(&self, x: Vec3) -> bool {
        let reach = x.distance(self.plane.point);
        let slack = FLAT * reach.max(self.longest) + 8.0 * self.grain * (1.0 + reach / self.height);
        self.plane.distance(x).abs() <= slack
    }
}

/// The patches of a scene merged to convex polygons: their corners, counter-clockwise seen from the front, and the patches that
/// each is made of. No two patches may be each other's backs.
pub fn convex_polygons(scene: &Scene) -> Vec<(Vec<Vec3>, Vec<u32>)> {
    let mesh = Mesh::new(scene);
    let (polygons, polygon_of) = mesh.polygons();
    let mut members = vec![Vec::new(); polygons.len()];
    for (i, &t) in mesh.numbers.iter().enumerate() {
        members[polygon_of[t as usize] as usize].push(i as u32);
    }
    let corners = polygons.iter().map(|polygon| polygon.ring.iter().map(|&v| mesh.at(v)).collect());
    corners.zip(members).collect()
}

impl Mesh<'_> {
    pub(super) fn new(scene: &Scene) -> Mesh<'_> {
        let all: Vec<u32> = (0..scene.len() as u32).collect();
        let (distinct, numbers) = distinct_triangles(scene, &all);
        let patches: Vec<u32> = distinct.iter().map(|p| p.front).collect();
        let mut twinned = vec![false; patches.len()];
        for (&i, &t) in all.iter().zip(&numbers) {
            let front = scene.normals()[patches[t as usize] as usize];
            twinned[t as usize] |= scene.normals()[i as usize].dot(front) < 0.0;
        }
        let joined = scene.first_vertices();
        let triangles = patches.iter().map(|&i| scene.faces()[i as usize].map(|v| joined[v as usize])).collect();
        let (low, high) = bounds(scene);
        let grain = f64::EPSILON * low.abs().max(high.abs()).max_element();
        Mesh { scene, triangles, patches, twinned, numbers, grain }
    }

    pub(super) fn at(&self, v: u32) -> Vec3 {
        self.scene.vertices()[v as usize]
    }

    fn start(&self, side: u32) -> u32 {
        self.triangles[side as usize / 3][side as usize % 3]
    }

    fn end(&self, side: u32) -> u32 {
        self.triangles[side as usize / 3][(side as usize + 1) % 3]
    }

    fn corners(&self, t: u32) -> Triangle {
        self.triangles[t as usize].map(|v| self.at(v))
    }

    fn normal(&self, t: u32) -> Vec3 {
        self.scene.normals()[self.patches[t as usize] as usize]
    }

    fn area(&self, t: u32) -> f64 {
        self.scene.areas()[self.patches[t as usize] as usize]
    }

    fn flat(&self, t: u32) -> Flat {
        let [a, b, c] = self.corners(t);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let plane = Plane { normal: self.normal(t), point: a };
        Flat { plane, longest, height: 2.0 * self.area(t) / longest, grain: self.grain }
    }

    /// Whether two triangles that share an edge lie in one plane and face the same way. Of the two planes the one counts that
    /// is known better.
    fn lie_flat(&self, s: u32, t: u32) -> bool {
        if !(self.normal(s).dot(self.normal(t)) > 0.0) {
            return false;
        }
        let (of_s, of_t) = (self.flat(s), self.flat(t));
        let (flat, other) = if of_s.height >= of_t.height { (of_s, t) } else { (of_t, s) };
        self.corners(other).iter().all(|x| flat.holds(*x))
    }

    /// For every side of a triangle the same edge as a side of a neighbour in the same plane.
    fn flat_neighbours(&self) -> Vec<u32> {
        let count = 3 * self.triangles.len() as u32;
        let mut sides: Vec<[u32; 3]> = (0..count)
            .map(|h| {
                let (a, b) = (self.start(h), self.end(h));
                [a.min(b), a.max(b), h]
            })
            .collect();
        sides.sort_unstable();
        let mut twin = vec![NONE; count as usize];
        for group in sides.chunk_by(|p, q| p[..2] == q[..2]).filter(|group| group.len() <= MOST_AT_AN_EDGE) {
            for &[low, _, h] in group.iter().filter(|side| self.start(side[2]) == side[0]) {
                let across = group
                    .iter()
                    .map(|side| side[2])
                    .find(|&g| self.start(g) != low && twin[g as usize] == NONE && self.lie_flat(h / 3, g / 3));
                if let Some(g) = across {
                    twin[h as usize] = g;
                    twin[g as usize] = h;
                }
            }
        }
        twin
    }

    /// The triangles merged to convex polygons, and for each triangle the polygon that it went into.
    pub(super) fn polygons(&self) -> (Vec<Polygon>, Vec<u32>) {
        let count = self.triangles.len();
        let mut cut = Cutter {
            mesh: self,
            twin: self.flat_neighbours(),
            next: (0..3 * count as u32).map(|h| if h % 3 == 2 { h - 2 } else { h + 1 }).collect(),
            previous: (0..3 * count as u32).map(|h| if h % 3 == 0 { h + 2 } else { h - 1 }).collect(),
            leaving: vec![NONE; self.scene.vertices().len()],
            polygons: Vec::new(),
            polygon_of: vec![NONE; count],
        };
        // The plane of a region is that of its largest triangle.
        let mut seeds: Vec<u32> = (0..count as u32).collect();
        seeds.sort_by(|&s, &t| self.area(t).total_cmp(&self.area(s)));
        let mut region_of = vec![NONE; count];
        for seed in seeds {
            if region_of[seed as usize] != NONE {
                continue;
            }
            region_of[seed as usize] = seed;
            let flat = self.flat(seed);
            let mut region = vec![seed];
            let mut k = 0;
            while k < region.len() {
                for h in sides(region[k]) {
                    let t = cut.twin[h as usize] / 3;
                    let is_new = cut.twin[h as usize] != NONE && region_of[t as usize] == NONE;
                    if is_new && self.corners(t).iter().all(|x| flat.holds(*x)) {
                        region_of[t as usize] = seed;
                        region.push(t);
                    }
                }
                k += 1;
            }
            for h in region.iter().flat_map(|&t| sides(t)) {
                let across = cut.twin[h as usize];
                if across != NONE && region_of[across as usize / 3] != seed {
                    cut.twin[h as usize] = NONE;
                }
            }
            cut.region(&region);
        }
        (cut.polygons, cut.polygon_of)
    }

    pub(super) fn sheet(&self, polygon: &Polygon) -> Body {
        let ring = &polygon.ring;
        let edges = (0..ring.len()).map(|k| {
            let (start, end) = (self.at(ring[k]), self.at(ring[(k + 1) % ring.len()]));
            Edge { start, end, left: 0, right: 1 }
        });
        let front = polygon.plane;
        let back = Plane { normal: -front.normal, point: front.point };
        Body::new(vec![front, back], edges.collect())
    }

    /// A ring without the vertices that lie on a straight line between their neighbours.
    fn straightened(&self, ring: &[u32]) -> Vec<u32> {
        let n = ring.len();
        let origin = self.at(ring[0]);
        let distance = |k: &usize| self.at(ring[*k]).distance_squared(origin);
        // What lies furthest from another point of the border is surely a corner.
        let first = (0..n).max_by(|j, k| distance(j).total_cmp(&distance(k))).unwrap_or(0);
        let mut kept = vec![ring[first]];
        for k in 1..n {
            let (v, next) = (ring[(first + k) % n], ring[(first + k + 1) % n]);
            let (x, from, to) = (self.at(v), self.at(kept[kept.len() - 1]), self.at(next));
            let length = to.distance(from);
            let off = (x - from).cross(to - from).length();
            let is_straight = off <= (FLAT * length + 8.0 * self.grain) * length;
            if !(is_straight && (x - from).dot(to - x) > 0.0) {
                kept.push(v);
            }
        }
        kept
    }

    /// Whether a straightened ring turns left at every vertex, once around in all.
    fn is_convex(&self, ring: &[u32], normal: Vec3) -> bool {
        let n = ring.len();
        let step = |k: usize| self.at(ring[(k + 1) % n]) - self.at(ring[k % n]);
        let turns_left = (0..n).all(|k| step(k).cross(step(k + 1)).dot(normal) > 0.0);
        let turned = || (0..n).map(|k| step(k).angle_between(step(k + 1))).sum::<f64>();
        n >= 3 && turns_left && turned() < 1.5 * std::f64::consts::TAU
    }
}

/// The three sides of a triangle.
fn sides(t: u32) -> [u32; 3] {
    [3 * t, 3 * t + 1, 3 * t + 2]
}

/// Cuts regions of triangles into convex polygons: the sides of triangles as a doubly linked list around every piece.
struct Cutter<'a> {
    mesh: &'a Mesh<'a>,
    /// The same edge as a side of the neighbour; none at the border of a region.
    twin: Vec<u32>,
    next: Vec<u32>,
    previous: Vec<u32>,
    /// Scratch: the side of the border that starts at a vertex.
    leaving: Vec<u32>,
    polygons: Vec<Polygon>,
    polygon_of: Vec<u32>,
}

impl Cutter<'_> {
    /// Adds the polygons of one region; its first triangle is the largest.
    fn region(&mut self, region: &[u32]) {
        let normal = self.mesh.normal(region[0]);
        if let Some(ring) = self.border(region) {
            let ring = self.mesh.straightened(&ring);
            // A flat patchwork whose border is convex and turns once covers the inside of it once.
            if self.mesh.is_convex(&ring, normal) {
                return self.push(ring, region);
            }
        }
        self.merge(region, normal);
        // Pieces, each from the first of its sides.
        for &t in region {
            if self.polygon_of[t as usize] != NONE {
                continue;
            }
            let members = self.piece(t, region.len());
            let ring = self.ring_of(&members);
            let ring = self.mesh.straightened(&ring);
            if self.mesh.is_convex(&ring, normal) {
                self.push(ring, &members);
            } else {
                members.iter().for_each(|&t| self.push(self.mesh.triangles[t as usize].to_vec(), &[t]));
            }
        }
    }

    fn push(&mut self, ring: Vec<u32>, members: &[u32]) {
        let corners: Vec<Vec3> = ring.iter().map(|&v| self.mesh.at(v)).collect();
        let plane = if ring.len() == 3 && members.len() == 1 {
            Plane { normal: self.mesh.normal(members[0]), point: corners[0] }
        } else {
            Plane::of(&corners)
        };
        members.iter().for_each(|&t| self.polygon_of[t as usize] = self.polygons.len() as u32);
        let twinned = members.iter().any(|&t| self.mesh.twinned[t as usize]);
        self.polygons.push(Polygon { ring, plane, twinned });
    }

    /// The border of a region, when it is one loop that passes no vertex twice.
    fn border(&mut self, region: &[u32]) -> Option<Vec<u32>> {
        let open: Vec<u32> = region.iter().flat_map(|&t| sides(t)).filter(|&h| self.twin[h as usize] == NONE).collect();
        let mut is_simple = !open.is_empty();
        for &h in &open {
            let leaving = &mut self.leaving[self.mesh.start(h) as usize];
            is_simple &= *leaving == NONE;
            *leaving = h;
        }
        let mut ring = Vec::with_capacity(open.len());
        if is_simple {
            let mut h = open[0];
            while ring.len() < open.len() {
                ring.push(self.mesh.start(h));
                h = self.leaving[self.mesh.end(h) as usize];
                if h == NONE || h == open[0] {
                    break;
                }
            }
        }
        open.iter().for_each(|&h| self.leaving[self.mesh.start(h) as usize] = NONE);
        (is_simple && ring.len() == open.len()).then_some(ring)
    }

    /// Leaves out sides between triangles while the pieces that they divide are convex together.
    fn merge(&mut self, region: &[u32], normal: Vec3) {
        let mut inner = self.in_order(region, normal);
        let mut seen = HashSet::new();
        loop {
            let before = inner.len();
            seen.clear();
            for &h in &inner {
                let is_left_out = self.twin[h as usize] == NONE;
                if is_left_out || !seen.insert(h) {
                    continue;
                }
                let chain = self.chain(h);
                seen.extend(chain.iter().flat_map(|&h| [h, self.twin[h as usize]]));
                self.leave_out(&chain, normal);
            }
            inner.retain(|&h| self.twin[h as usize] != NONE);
            if inner.len() == before {
                break;
            }
        }
    }

    /// The sides between triangles of a region, the longest first: diagonals before the sides of the squares that they halve;
    /// of equal length those of one direction first, so that squares make rows before rows make blocks.
    fn in_order(&self, region: &[u32], normal: Vec3) -> Vec<u32> {
        let way = |h: u32| self.mesh.at(self.mesh.end(h)) - self.mesh.at(self.mesh.start(h));
        let open = region.iter().flat_map(|&t| sides(t)).filter(|&h| self.twin[h as usize] == NONE);
        let x = open.map(way).max_by(|v, w| v.length_squared().total_cmp(&w.length_squared())).unwrap_or(normal);
        let y = normal.cross(x);
        let mut inner: Vec<([i64; 2], u32)> = region
            .iter()
            .flat_map(|&t| sides(t))
            .filter(|&h| self.twin[h as usize] != NONE && h < self.twin[h as usize])
            .map(|h| {
                let v = way(h);
                // Classes, wide enough for rounding; the shift keeps common angles away from where the half turn closes.
                let angle = (v.dot(y).atan2(v.dot(x)) + 0.05).rem_euclid(std::f64::consts::PI);
                ([(-64.0 * v.length().log2()).round() as i64, (1e4 * angle).round() as i64], h)
            })
            .collect();
        inner.sort_unstable();
        inner.into_iter().map(|(_, h)| h).collect()
    }

    /// All sides along which the two pieces beside side `h` touch, one after the other: pieces are convex, so that they touch
    /// along one straight line.
    fn chain(&self, h: u32) -> Vec<u32> {
        let mut first = h;
        loop {
            let before = self.previous[first as usize];
            if self.twin[before as usize] == NONE
                || self.twin[before as usize] != self.next[self.twin[first as usize] as usize]
                || before == h
            {
                break;
            }
            first = before;
        }
        let mut chain = vec![first];
        loop {
            let last = chain[chain.len() - 1];
            let after = self.next[last as usize];
            if self.twin[after as usize] == NONE
                || self.twin[after as usize] != self.previous[self.twin[last as usize] as usize]
                || after == first
            {
                return chain;
            }
            chain.push(after);
        }
    }

    /// Joins the two pieces beside a chain of sides, when together they are convex at both ends of it.
    fn leave_out(&mut self, chain: &[u32], normal: Vec3) {
        let (first, last) = (chain[0] as usize, chain[chain.len() - 1] as usize);
        let (across_first, across_last) = (self.twin[first] as usize, self.twin[last] as usize);
        let starts = [self.previous[first], self.previous[across_last]];
        let ends = [self.next[across_first], self.next[last]];
        let turns_left = |(&h, &g): (&u32, &u32)| {
            let (v, w) = (self.mesh.at(self.mesh.start(h)), self.mesh.at(self.mesh.start(g)));
            let (into, out) = (w - v, self.mesh.at(self.mesh.end(g)) - w);
            let (length, other) = (into.length(), out.length());
            let slack = FLAT * length * other + 8.0 * self.mesh.grain * (length + other);
            let turn = into.cross(out).dot(normal);
            turn > slack || (turn >= -slack && into.dot(out) > 0.0)
        };
        if !starts.iter().zip(&ends).all(turns_left) {
            return;
        }
        for (&h, &g) in starts.iter().zip(&ends) {
            self.next[h as usize] = g;
            self.previous[g as usize] = h;
        }
        for &h in chain {
            // Left out: on no ring, which a missing previous side tells; the next one tells what it was the border to.
            let g = self.twin[h as usize];
            self.twin[h as usize] = NONE;
            self.twin[g as usize] = NONE;
            self.next[h as usize] = g;
            self.previous[h as usize] = NONE;
            self.next[g as usize] = h;
            self.previous[g as usize] = NONE;
        }
    }

    /// The triangles of the piece that triangle `t` belongs to.
    fn piece(&self, t: u32, most: usize) -> Vec<u32> {
        let mut members = vec![t];
        let mut known = HashSet::from([t]);
        let mut k = 0;
        while k < members.len() && members.len() <= most {
            for h in sides(members[k]).into_iter().filter(|&h| self.previous[h as usize] == NONE) {
                let neighbour = self.next[h as usize] / 3;
                if known.insert(neighbour) {
                    members.push(neighbour);
                }
            }
            k += 1;
        }
        members
    }

    /// The border of a piece.
    fn ring_of(&self, members: &[u32]) -> Vec<u32> {
        let mut on_border = members.iter().flat_map(|&t| sides(t)).filter(|&h| self.previous[h as usize] != NONE);
        let Some(first) = on_border.next() else { return self.mesh.triangles[members[0] as usize].to_vec() };
        let mut ring = vec![self.mesh.start(first)];
        let mut h = self.next[first as usize];
        while h != first && ring.len() < 3 * members.len() {
            ring.push(self.mesh.start(h));
            h = self.next[h as usize];
        }
        ring
    }
}
