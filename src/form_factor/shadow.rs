//! The part of a polygon that convex bodies hide from a point, exactly; and its mean over another polygon.
//!
//! Seen from x, a convex body hides a cone of directions, whose walls are the planes through x and its silhouette. The cone of
//! a polygon P is of the same kind. The form factor of x to what several cones have in common is Lambert's sum over the
//! border of the intersection (see [`super::point_to_polygon`]), and that border is made of the edges of each cone as far as
//! they run inside all the others: no intersection has to be built. Shadows that overlap are counted once by inclusion and
//! exclusion:
//!
//!   H(x) = sum over S of F_x(P n S) - sum over S < T of F_x(P n S n T) + ...
//!
//! H is continuous in x, with kinks where a corner of a silhouette crosses an edge of P. Its mean over the other patch is
//! taken by a triangle rule and compared with two coarser ones on the same points; where they differ most, the triangle is
//! quartered, until the differences add up to what was asked. After Nishita & Nakamae 1985 (shadow volumes of convex polyhedra) and Walton 1987 (projected
//! obstructions subtracted from the view).

use std::collections::BinaryHeap;

use super::Patch;
use super::point_to_polygon::edge_term;
use crate::geometry::polygon::{Plane, Side, area_vector, clip_with_slack};
use crate::geometry::quadrature::TrianglePoint;
use crate::geometry::{Triangle, Vec3};
use crate::simd::double::{Double, LANES, Vectors};
use crate::simd::{Instructions, Machine, for_every_machine};
use crate::visibility::body::{Body, extremes};
use crate::visibility::shaft::are_apart;

/// Points of a triangle that leave no part of it unseen: near the corners, near the middles of the edges, the centroid. A
/// shadow that does not reach the whole triangle reaches its border, since the points that see one are a convex set.
///
/// Weights for the three orbits that make a rule of degree 3, and, to compare it with, two of degree 2 from two orbits
/// each: solutions of the moment equations (one unknown a weight; the tests hold them against the moments).
pub const POINTS: [TrianglePoint; 7] = {
    const NEAR: f64 = 0.01;
    const FAR: f64 = 1.0 - 2.0 * NEAR;
    const HALF: f64 = 0.5 * (1.0 - NEAR);
    const THIRD: f64 = 1.0 / 3.0;
    const CORNER: f64 = 0.053_871_065_175_223_4;
    const MIDDLE: f64 = 0.138_786_472_993_795_87;
    [
        TrianglePoint { barycentric: [FAR, NEAR, NEAR], weight: CORNER },
        TrianglePoint { barycentric: [NEAR, FAR, NEAR], weight: CORNER },
        TrianglePoint { barycentric: [NEAR, NEAR, FAR], weight: CORNER },
        TrianglePoint { barycentric: [HALF, HALF, NEAR], weight: MIDDLE },
        TrianglePoint { barycentric: [NEAR, HALF, HALF], weight: MIDDLE },
        TrianglePoint { barycentric: [HALF, NEAR, HALF], weight: MIDDLE },
        TrianglePoint { barycentric: [THIRD; 3], weight: 0.422_027_385_492_942_16 },
    ]
};
/// Weights of the corner points, of the middle points, and of the centroid.
pub const COARSE: [[f64; 3]; 2] = [
    [0.088_567_683_423_672_37, 0.0, 0.734_296_949_728_982_9],
    [0.0, 0.354_270_733_694_689_5, -0.062_812_201_084_068_44],
];
/// Triangles that one patch may be cut into.
const MOST_CELLS: usize = 16_384;
/// Steps to prove that a body hides nothing: without a proof, more triangles have to be looked from.
const STEPS: usize = 60;
/// Intersections of shadows that are looked at from one point before rays are the better answer.
const MOST_OVERLAPS: usize = 64;
/// Edges of all bodies before rays are the better answer. Every wall is cut by every wall of the others, and a pair cannot be
/// interrupted: two bodies of 256 edges show some 80 each, and a triangle then costs about a tenth of a millisecond.
const MOST_EDGES: usize = 512;
/// The sine of an angle that counts as none: an edge so near to a plane through x lies in it.
const FLAT: f64 = 1e-11;
/// How far outside of [0, 1] rounding may put a visible fraction: the terms of a small patch far away cancel by so many digits.
const ROUNDING: f64 = 1e-6;
/// Share of the exchange that the points of a rule, or segments, may have wrong without any harm to what is visible of it. Where a
/// small patch is next to a large one, they may miss most of it: nothing is known of that.
pub const SHOWN: f64 = 0.1;
/// What may hide in a triangle of which every point sees all, or nothing: between the points near its border, or beyond.
const UNSEEN: f64 = 1e-2;

/// The error of the rule where a kink crosses a triangle, relative to the [`bend`]: the two differences of a cell may be small
/// by chance, and among some ten thousand cells some are.
const KINK: f64 = 0.1;
/// What neither differences nor bend may show: a shadow that lies between the points but for a corner of it. Of a part of the
/// triangle it is as much less as the part is smaller: the shadow's border runs through fewer of them, and reaches less deep.
const CHANCE: f64 = 4e-3;

/// The fraction of the exchange of a pair that is visible, and an estimate of its error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Visible {
    /// V, in [0, 1].
    pub fraction: f64,
    /// Estimated error of V.
    pub error: f64,
}

/// Memory reused from pair to pair.
pub struct Shadows {
    instructions: Instructions,
    cones: Vec<Cone>,
    walls: Vec<Wall>,
    faces: Vec<bool>,
    terms: Vec<Term>,
    sums: Vec<f64>,
    members: Vec<usize>,
    overlaps: usize,
}

/// A convex cone with its apex in the point that looks: some of the walls, in turn.
#[derive(Debug, Clone, Copy)]
struct Cone {
    first: usize,
    end: usize,
}

/// A wall of a cone: the triangle between the apex and an edge, which runs counter-clockwise around the cone.
#[derive(Debug, Clone, Copy)]
struct Wall {
    r0: Vec3,
    r1: Vec3,
    /// Points into the cone.
    inward: Vec3,
    /// (FLAT x its length)^2.
    flat2: f64,
    /// Squared lengths of r0 and r1.
    lengths2: [f64; 2],
}

/// A part of an edge, to be summed.
#[derive(Debug, Clone, Copy)]
struct Term {
    r0: Vec3,
    r1: Vec3,
    /// 1, or -1 for what has been counted twice.
    sign: f64,
    slot: u32,
}

/// A triangle of the patch that looks, with what its points see.
#[derive(Debug, Clone, Copy)]
struct Cell {
    triangle: Triangle,
    hidden: f64,
    all: f64,
    error: f64,
}

impl PartialEq for Cell {
    fn eq(&self, other: &Cell) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Cell {}

impl PartialOrd for Cell {
    fn partial_cmp(&self, other: &Cell) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Cell {
    fn cmp(&self, other: &Cell) -> std::cmp::Ordering {
        self.error.total_cmp(&other.error)
    }
}

impl Wall {
    /// How far a direction lies inside, up to a factor; exactly 0 when it cannot be told from 0.
    #[inline(always)]
    fn distance(&self, r: Vec3, length2: f64) -> f64 {
        let f = self.inward.dot(r);
        if f * f <= self.flat2 * length2 { 0.0 } else { f }
    }
}

impl Default for Shadows {
    fn default() -> Shadows {
        Shadows {
            instructions: Instructions::best(),
            cones: Vec::new(),
            walls: Vec::new(),
            faces: Vec::new(),
            terms: Vec::new(),
            sums: Vec::new(),
            members: Vec::new(),
            overlaps: 0,
        }
    }
}

impl Shadows {
    /// What `bodies` leave of the `exchange` of two patches, m^2, to an error of `wanted` as far as [`MOST_CELLS`] triangles
    /// allow. No point of the patches may lie inside a body. `None` when the bodies have too many edges, too many shadows
    /// overlap, the triangles do not show the exchange, or rounding is in the way.
    pub fn visible(&mut self, a: &Patch, b: &Patch, bodies: &[&Body], exchange: f64, wanted: f64) -> Option<Visible> {
        let all = Some(Visible { fraction: 1.0, error: 0.0 });
        if bodies.iter().map(|body| body.edges.len()).sum::<usize>() > MOST_EDGES {
            return None;
        }
        let [slack_a, slack_b] = slacks([a, b])?;
        // What is cut has short edges, whose directions need more digits than coordinates far from the origin have.
        let origin = a.corners[0];
        let [a, b] = [a, b].map(|patch| patch.relative_to(origin));
        let planes = [(a.plane(), slack_a), (b.plane(), slack_b)];
        let solids: Vec<Body> = bodies.iter().filter_map(|body| between(body.relative_to(origin), &planes)).collect();
        if solids.is_empty() {
            return all;
        }
        let (from, to) = if looks(&a, &b, &solids) { (&a, &b) } else { (&b, &a) };
        let (mut source, mut target) = (Vec::new(), Vec::new());
        clip_with_slack(&from.corners, &to.plane(), slack_a.max(slack_b), &mut source);
        clip_with_slack(&to.corners, &from.plane(), slack_a.max(slack_b), &mut target);
        if source.len() < 3 || target.len() < 3 {
            return all;
        }
        if solids.iter().any(|solid| self.hides_all(&source, &target, solid)) {
            return Some(Visible { fraction: 0.0, error: 0.0 });
        }
        let fan: Vec<Triangle> = (2..source.len()).map(|k| [source[0], source[k - 1], source[k]]).collect();
        let whole: f64 = fan.iter().map(area).sum();
        let mut cells: BinaryHeap<Cell> = self.look(&fan, whole, from.normal, &target, &solids)?.into();
        let mut total: f64 = cells.iter().map(|cell| cell.all).sum();
        if !(total > 0.0) {
            return all;
        }
        let mut error: f64 = cells.iter().map(|cell| cell.error).sum();
        // What is proven needs no more to be shown of it.
        let unshown = |total: f64, error: f64| {
            if error > 0.0 { ((1.0 - total / exchange).abs() - SHOWN).clamp(0.0, 1.0) } else { 0.0 }
        };
        while error / total + unshown(total, error) > wanted && cells.len() < MOST_CELLS {
            let Some(worst) = cells.pop() else { break };
            let [p, q, r] = worst.triangle;
            let [pq, qr, rp] = [0.5 * (p + q), 0.5 * (q + r), 0.5 * (r + p)];
            let quarters = [[p, pq, rp], [pq, q, qr], [rp, qr, r], [pq, qr, rp]];
            for cell in self.look(&quarters, whole, from.normal, &target, &solids)? {
                error += cell.error;
                total += cell.all;
                cells.push(cell);
            }
            error -= worst.error;
            total -= worst.all;
        }
        let cells = cells.into_vec();
        let (hidden, all) = cells.iter().fold((0.0, 0.0), |(hidden, all), c| (hidden + c.hidden, all + c.all));
        let (sum, error) = (1.0 - hidden / all, (error / total).max(0.0));
        let unshown = unshown(total, error);
        if cells.len() >= MOST_CELLS && unshown > 0.0 {
            return None;
        }
        let fraction = sum.clamp(0.0, 1.0);
        // What is outside by more than rounding has lost a part of a border.
        let outside = (sum - fraction).abs();
        (outside <= error.max(ROUNDING))
            .then(|| Visible { fraction, error: error.max(outside) + unshown * fraction.max(1.0 - fraction) })
    }

    /// Whether a body hides all of the target from all of the source. The points from which one point is hidden make a convex
    /// set, and so do the points hidden from one: what holds for the corners holds for all.
    fn hides_all(&mut self, source: &[Vec3], target: &[Vec3], solid: &Body) -> bool {
        source.iter().all(|&x| {
            self.walls.clear();
            let outside = self.push_silhouette(x, solid);
            let hides = |y: &Vec3| {
                let r = *y - x;
                self.walls.iter().all(|wall| wall.distance(r, r.length_squared()) >= 0.0)
            };
            outside && !self.walls.is_empty() && target.iter().all(hides)
        })
    }

    /// What the points of each triangle see of the target, and what is hidden.
    fn look(
        &mut self,
        triangles: &[Triangle],
        whole: f64,
        normal: Vec3,
        target: &[Vec3],
        solids: &[Body],
    ) -> Option<Vec<Cell>> {
        self.terms.clear();
        self.sums.clear();
        self.sums.resize(2 * triangles.len() * POINTS.len(), 0.0);
        // Of every triangle: whether a point saw something hidden, and whether one saw something at all.
        let mut mixed = vec![[false; 2]; triangles.len()];
        for (k, triangle) in triangles.iter().enumerate() {
            for (p, TrianglePoint { barycentric: [u, v, w], .. }) in POINTS.iter().enumerate() {
                let x = *u * triangle[0] + *v * triangle[1] + *w * triangle[2];
                let slot = 2 * (k * POINTS.len() + p) as u32;
                let [hides, shows] = self.look_from(x, target, solids, slot)?;
                mixed[k][0] |= hides;
                mixed[k][1] |= shows;
            }
        }
        sum_terms(self.instructions, &self.terms, normal, &mut self.sums);
        let mut cells = Vec::with_capacity(triangles.len());
        for (k, (&triangle, [hides, shows])) in triangles.iter().zip(mixed).enumerate() {
            let area = area(&triangle);
            let sums = &self.sums[2 * k * POINTS.len()..][..2 * POINTS.len()];
            // Sums of what is seen and of what is hidden.
            let by = |weights: [f64; 3]| {
                [0, 1].map(|which| {
                    let orbit = |points: std::ops::Range<usize>| points.map(|p| sums[2 * p + which]).sum::<f64>();
                    area * (weights[0] * orbit(0..3) + weights[1] * orbit(3..6) + weights[2] * orbit(6..7))
                })
            };
            let [all, hidden] = by([POINTS[0].weight, POINTS[3].weight, POINTS[6].weight]);
            let difference = |weights: [f64; 3]| {
                let [coarse_all, coarse] = by(weights);
                // As fractions: where the view itself changes fast, both change together.
                (hidden - if coarse_all > 0.0 { coarse * (all / coarse_all) } else { 0.0 }).abs()
            };
            let error = if hides && shows {
                let chance = CHANCE * area / whole;
                difference(COARSE[0]).max(difference(COARSE[1])).max((KINK * bend(sums)).max(chance) * all)
            } else if self.is_proven(&triangle, target, solids, hides) {
                0.0
            } else {
                UNSEEN * area / whole * all.abs()
            };
            cells.push(Cell { triangle, hidden, all, error });
        }
        Some(cells)
    }

    /// Whether it is certain that all of the target is hidden from all of a triangle, or nothing.
    fn is_proven(&mut self, triangle: &Triangle, target: &[Vec3], solids: &[Body], hidden: bool) -> bool {
        if hidden {
            return solids.iter().any(|solid| self.hides_all(triangle, target, solid));
        }
        let hull: Vec<Vec3> = triangle.iter().chain(target).copied().collect();
        solids.iter().all(|solid| are_apart(&hull, &solid.corners, solid.slack, STEPS))
    }

    /// Adds what x sees to `slot` and what is hidden of it to the next; tells whether anything is hidden, and whether
    /// anything is not.
    fn look_from(&mut self, x: Vec3, target: &[Vec3], solids: &[Body], slot: u32) -> Option<[bool; 2]> {
        self.cones.clear();
        self.walls.clear();
        for k in 0..target.len() {
            self.push_wall(target[k] - x, target[(k + 1) % target.len()] - x);
        }
        self.cones.push(Cone { first: 0, end: self.walls.len() });
        for wall in &self.walls {
            self.terms.push(Term { r0: wall.r0, r1: wall.r1, sign: 1.0, slot });
        }
        let hidden_from = self.terms.len();
        for solid in solids {
            let first = self.walls.len();
            if !self.push_silhouette(x, solid) {
                self.hide_all(slot + 1);
                return Some([true, false]);
            }
            if self.walls.len() > first {
                self.cones.push(Cone { first, end: self.walls.len() });
            }
        }
        self.overlaps = 0;
        self.members.clear();
        self.members.push(0);
        for k in 1..self.cones.len() {
            if self.overlap(k, 1.0, slot + 1)? {
                // Nothing is left to be hidden by others.
                self.terms.truncate(hidden_from);
                self.hide_all(slot + 1);
                return Some([true, false]);
            }
        }
        Some([self.terms.len() > hidden_from, true])
    }

    fn hide_all(&mut self, slot: u32) {
        for k in 0..self.cones[0].end {
            let Wall { r0, r1, .. } = self.walls[k];
            self.terms.push(Term { r0, r1, sign: 1.0, slot });
        }
    }

    fn push_wall(&mut self, r0: Vec3, r1: Vec3) {
        let inward = r1.cross(r0);
        let flat2 = FLAT * FLAT * inward.length_squared();
        self.walls.push(Wall { r0, r1, inward, flat2, lengths2: [r0.length_squared(), r1.length_squared()] });
    }

    /// Adds the walls of a body's shadow: none for a sheet seen edge on. False when x lies inside the body, or on its border
    /// and looks into it.
    fn push_silhouette(&mut self, x: Vec3, body: &Body) -> bool {
        self.faces.clear();
        self.faces.extend(body.faces.iter().map(|face| face.distance(x) > body.slack));
        if !self.faces.contains(&true) {
            return body.is_sheet();
        }
        if body.is_sheet() && !self.faces[0] && !self.faces[1] {
            return true;
        }
        for edge in &body.edges {
            match [self.faces[edge.left as usize], self.faces[edge.right as usize]] {
                [true, false] => self.push_wall(edge.start - x, edge.end - x),
                [false, true] => self.push_wall(edge.end - x, edge.start - x),
                _ => {}
            }
        }
        true
    }

    /// Adds what cone k has in common with the members, and with every further cone; tells whether it covers the first
    /// member, the target, all by itself.
    fn overlap(&mut self, k: usize, sign: f64, slot: u32) -> Option<bool> {
        self.overlaps += 1;
        if self.overlaps > MOST_OVERLAPS {
            return None;
        }
        self.members.push(k);
        let before = self.terms.len();
        let whole = self.push_border(sign, slot);
        let alone = self.members.len() == 2;
        if self.terms.len() > before && !(alone && whole) {
            for next in k + 1..self.cones.len() {
                self.overlap(next, -sign, slot)?;
            }
        }
        self.members.pop();
        Some(alone && whole)
    }

    /// Adds the border of what the members have in common: of every edge the part inside all other cones. Tells whether that
    /// is the first member as a whole.
    fn push_border(&mut self, sign: f64, slot: u32) -> bool {
        let mut whole = true;
        for (m, &member) in self.members.iter().enumerate() {
            let Cone { first, end } = self.cones[member];
            for k in first..end {
                let wall = self.walls[k];
                let (mut low, mut high) = (0.0f64, 1.0f64);
                for (o, &other) in self.members.iter().enumerate().filter(|(o, _)| *o != m) {
                    let Cone { first, end } = self.cones[other];
                    for plane in &self.walls[first..end] {
                        let f0 = plane.distance(wall.r0, wall.lengths2[0]);
                        let f1 = plane.distance(wall.r1, wall.lengths2[1]);
                        if f0 > 0.0 && f1 > 0.0 {
                            continue;
                        }
                        if f0 == 0.0 && f1 == 0.0 {
                            // The edge runs along a wall of the other cone: it is counted once if both lie on the same
                            // side of it, else there is nothing between them.
                            if m > o || wall.inward.dot(plane.inward) < 0.0 {
                                low = 1.0;
                            }
                        } else if f0 <= 0.0 && f1 <= 0.0 {
                            low = 1.0;
                        } else if f0 < f1 {
                            low = low.max(f0 / (f0 - f1));
                        } else {
                            high = high.min(f0 / (f0 - f1));
                        }
                        if low >= high {
                            break;
                        }
                    }
                    if low >= high {
                        break;
                    }
                }
                if m == 0 {
                    whole &= low == 0.0 && high == 1.0;
                }
                if low < high {
                    let way = wall.r1 - wall.r0;
                    let r0 = if low > 0.0 { wall.r0 + low * way } else { wall.r0 };
                    let r1 = if high < 1.0 { wall.r0 + high * way } else { wall.r1 };
                    self.terms.push(Term { r0, r1, sign, slot });
                }
            }
        }
        whole
    }
}

fn area(triangle: &Triangle) -> f64 {
    area_vector(triangle).length()
}

/// Whether `a` should look at `b` rather than `b` at `a`: the patch that is smaller as seen from the nearest body, since the
/// shadows change the less as the point moves.
fn looks(a: &Patch, b: &Patch, solids: &[Body]) -> bool {
    let angle = |patch: &Patch| {
        let nearest = solids
            .iter()
            .map(|body| patch.centre().clamp(body.low, body.high).distance_squared(patch.centre()))
            .fold(f64::INFINITY, f64::min);
        patch.area / nearest
    };
    // Infinite where both touch: then the first looks.
    angle(a) <= angle(b)
}

/// How far rounding may put what lies in the plane of a patch off it: of two patches as they were given, whose normals it
/// turns by the more, the thinner they are. `None` when a plane is known so badly that what it leaves out could show.
fn slacks(patches: [&Patch; 2]) -> Option<[f64; 2]> {
    /// Relative to the size of the pair. What is so near to a plane hides about as much of the view from it.
    const MOST: f64 = 1e-5;
    let (low, high) = extremes(patches.iter().flat_map(|patch| patch.corners));
    let grain = f64::EPSILON * low.abs().max(high.abs()).max_element();
    let size = (high - low).max_element();
    // Area over radius is about the height. A distance is a sum of some products of rounded numbers.
    let slacks = patches.map(|patch| 16.0 * grain * (1.0 + size * patch.radius / patch.area));
    slacks.iter().all(|slack| *slack <= MOST * size).then_some(slacks)
}

/// The part of a body in front of both planes, each known to a length, or none.
fn between(mut body: Body, planes: &[(Plane, f64); 2]) -> Option<Body> {
    for (plane, slack) in planes {
        match body.side_of(plane, *slack) {
            Side::Front => {}
            Side::Behind => return None,
            Side::Across => body = body.cut(plane, *slack),
        }
    }
    Some(body)
}

/// How far the hidden fractions at corners and middles are from a linear function, in what symmetric rules cannot see: for
/// one, the middle of an edge falls below the mean by half as much as the corner across rises above it.
fn bend(sums: &[f64]) -> f64 {
    let fraction = |p: usize| if sums[2 * p] > 0.0 { sums[2 * p + 1] / sums[2 * p] } else { 0.0 };
    let (corners, middles) = ([0, 1, 2].map(fraction), [4, 5, 3].map(fraction));
    let mean = |values: [f64; 3]| values.iter().sum::<f64>() / 3.0;
    let off = |k: usize| middles[k] - mean(middles) + 0.5 * (corners[k] - mean(corners));
    ((off(0).powi(2) + off(1).powi(2) + off(2).powi(2)) / 3.0).sqrt()
}

#[inline(always)]
fn sum_kernel<M: Machine>(terms: &[Term], normal: Vec3, sums: &mut [f64]) {
    let normal = Vectors::<M::Double>::splat(normal);
    for group in terms.chunks(LANES) {
        let (mut starts, mut ends, mut signs) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3], [0.0; LANES]);
        for (lane, term) in group.iter().enumerate() {
            (starts[0][lane], starts[1][lane], starts[2][lane]) = (term.r0.x, term.r0.y, term.r0.z);
            (ends[0][lane], ends[1][lane], ends[2][lane]) = (term.r1.x, term.r1.y, term.r1.z);
            signs[lane] = term.sign;
        }
        let term = edge_term(Vectors::load(&starts), Vectors::load(&ends), normal);
        let parts = (term * M::Double::load(&signs)).to_array();
        for (lane, term) in group.iter().enumerate() {
            sums[term.slot as usize] += parts[lane];
        }
    }
}

for_every_machine! { fn sum_terms(terms: &[Term], normal: Vec3, sums: &mut [f64]) -> () = sum_kernel }
