//! Convex polygons joined to solids.
//!
//! Polygons joined by convex edges make shells. A shell is a solid when it is the whole border of a convex body, or lacks one
//! plane face only, like a box without a bottom that stands on a floor: a segment crosses a plane once, so one that enters
//! through the opening must leave through the shell. Fronts are outside, and no other patch looks into the solid.

use std::collections::HashMap;

use super::body::{Body, Edge};
use super::box_tree::BoxTree;
use super::merge::{MOST_AT_AN_EDGE, Mesh, NONE, Polygon};
use crate::geometry::polygon::{Plane, area_vector, clip_to_front};
use crate::geometry::{Triangle, Vec3};
use crate::scene::Scene;

/// A distance that counts as none beside a solid; also the sine of an angle that counts as none between two polygons.
const TOUCH: f64 = 1e-9;

/// A body thinner than this, relative to its size, is taken as sheets: its inside cannot be told well from its border.
const THIN: f64 = 1e-7;

/// The most faces that a solid may have. What is rounder is cheaper to ask by rays.
const MOST_FACES: usize = 4096;

/// Polygons joined by convex edges. Sides of polygons are numbered through.
pub(super) struct Shells<'a> {
    pub(super) mesh: &'a Mesh<'a>,
    pub(super) polygons: &'a [Polygon],
    /// The first side of every polygon.
    pub(super) first_side: Vec<u32>,
    /// The polygon of every side.
    pub(super) owner: Vec<u32>,
    /// The same edge as a side of another polygon, where the two meet at a convex edge and no third one makes it ambiguous.
    pub(super) across: Vec<u32>,
    pub(super) shell_of: Vec<u32>,
    pub(super) shells: Vec<Vec<u32>>,
}

/// A convex body, and what it takes to tell where patches lie on it.
pub(super) struct Solid {
    pub(super) body: Body,
    /// The corners of every face.
    pub(super) rings: Vec<Vec<Vec3>>,
    /// Whether the last face closes an opening of the shell.
    pub(super) has_cap: bool,
    pub(super) tolerance: f64,
}

impl Shells<'_> {
    pub(super) fn new<'a>(mesh: &'a Mesh<'a>, polygons: &'a [Polygon]) -> Shells<'a> {
        let (mut first_side, mut owner) = (Vec::with_capacity(polygons.len()), Vec::new());
        for (p, polygon) in polygons.iter().enumerate() {
            first_side.push(owner.len() as u32);
            owner.resize(owner.len() + polygon.ring.len(), p as u32);
        }
        let across = vec![NONE; owner.len()];
        let shell_of = vec![NONE; polygons.len()];
        let mut shells = Shells { mesh, polygons, first_side, owner, across, shell_of, shells: Vec::new() };
        shells.join();
        shells.collect();
        shells
    }

    fn start(&self, side: u32) -> u32 {
        let p = self.owner[side as usize] as usize;
        self.polygons[p].ring[(side - self.first_side[p]) as usize]
    }

    fn end(&self, side: u32) -> u32 {
        let p = self.owner[side as usize] as usize;
        let ring = &self.polygons[p].ring;
        ring[((side - self.first_side[p]) as usize + 1) % ring.len()]
    }

    /// Whether the edge between two polygons, a side of each, stands out.
    fn stands_out(&self, side: u32, other: u32) -> bool {
        let [m, n] = [side, other].map(|s| self.polygons[self.owner[s as usize] as usize].plane.normal);
        let along = self.mesh.at(self.end(side)) - self.mesh.at(self.start(side));
        self.start(side) == self.end(other) && m.cross(n).dot(along) > TOUCH * along.length()
    }

    fn join(&mut self) {
        let mut edges: Vec<[u32; 3]> = (0..self.owner.len() as u32)
            .map(|s| {
                let (a, b) = (self.start(s), self.end(s));
                [a.min(b), a.max(b), s]
            })
            .collect();
        edges.sort_unstable();
        for group in edges.chunk_by(|p, q| p[..2] == q[..2]).filter(|group| group.len() <= MOST_AT_AN_EDGE) {
            let only = |s: u32| {
                let mut fits = group.iter().map(|edge| edge[2]).filter(|&other| self.stands_out(s, other));
                fits.next().filter(|_| fits.next().is_none())
            };
            let pairs: Vec<(u32, u32)> = group
                .iter()
                .filter_map(|edge| only(edge[2]).filter(|&other| only(other) == Some(edge[2])).map(|o| (edge[2], o)))
                .collect();
            pairs.iter().for_each(|&(s, other)| self.across[s as usize] = other);
        }
    }

    fn collect(&mut self) {
        for seed in 0..self.polygons.len() as u32 {
            if self.shell_of[seed as usize] != NONE {
                continue;
            }
            let number = self.shells.len() as u32;
            self.shell_of[seed as usize] = number;
            let mut shell = vec![seed];
            let mut k = 0;
            while k < shell.len() {
                for s in self.sides(shell[k]) {
                    let other = self.across[s as usize];
                    if other == NONE {
                        continue;
                    }
                    let neighbour = self.owner[other as usize];
                    if self.shell_of[neighbour as usize] == NONE {
                        self.shell_of[neighbour as usize] = number;
                        shell.push(neighbour);
                    }
                }
                k += 1;
            }
            self.shells.push(shell);
        }
    }

    fn sides(&self, p: u32) -> std::ops::Range<u32> {
        let first = self.first_side[p as usize];
        first..first + self.polygons[p as usize].ring.len() as u32
    }

    /// The convex body that a shell is the border of, with or without one of its faces.
    pub(super) fn solid(&self, shell: &[u32]) -> Option<Solid> {
        let polygons = || shell.iter().map(|&p| &self.polygons[p as usize]);
        if !(3..=MOST_FACES).contains(&shell.len()) || polygons().any(|polygon| polygon.twinned) {
            return None;
        }
        let corners = |ring: &[u32]| ring.iter().map(|&v| self.mesh.at(v)).collect::<Vec<Vec3>>();
        let mut faces: Vec<Plane> = polygons().map(|polygon| polygon.plane).collect();
        let mut rings: Vec<Vec<Vec3>> = polygons().map(|polygon| corners(&polygon.ring)).collect();
        let face_of: HashMap<u32, u32> = shell.iter().zip(0..).map(|(&p, face)| (p, face)).collect();
        let (mut edges, mut open) = (Vec::new(), Vec::new());
        for (&p, left) in shell.iter().zip(0..) {
            for s in self.sides(p) {
                let other = self.across[s as usize];
                if other == NONE {
                    open.push((self.start(s), self.end(s), left));
                } else if s < other {
                    let (start, end) = (self.mesh.at(self.start(s)), self.mesh.at(self.end(s)));
                    let right = *face_of.get(&self.owner[other as usize])?;
                    edges.push(Edge { start, end, left, right });
                }
            }
        }
        let has_cap = !open.is_empty();
        if has_cap {
            let ring = corners(&opening(&open)?);
            let vector = area_vector(&ring);
            if !(vector.length() > 0.0) {
                return None;
            }
            for &(start, end, left) in &open {
                let (start, end) = (self.mesh.at(start), self.mesh.at(end));
                edges.push(Edge { start, end, left, right: shell.len() as u32 });
            }
            faces.push(Plane { normal: vector.normalize(), point: ring[0] });
            rings.push(ring);
        }
        let mut vertices: Vec<u32> = polygons().flat_map(|polygon| polygon.ring.iter().copied()).collect();
        vertices.sort_unstable();
        vertices.dedup();
        // Euler: what is closed like a sphere covers the border of its hull once.
        if faces.len() < 4 || vertices.len() + faces.len() != edges.len() + 2 {
            return None;
        }
        let points = BoxTree::new(vertices.iter().map(|&v| (v, (self.mesh.at(v), self.mesh.at(v)))).collect());
        let (low, high) = points.bounds();
        let size = (high - low).max_element();
        let tolerance = TOUCH * size + 16.0 * self.mesh.grain;
        let is_border = |plane: &Plane| {
            let (before, behind) = points.sides(plane, [tolerance, -(THIN * size).max(2.0 * tolerance)]);
            behind && !before
        };
        let cap = rings.last().filter(|_| has_cap);
        let is_plane = cap.is_none_or(|ring| ring.iter().all(|x| faces[shell.len()].distance(*x).abs() <= tolerance));
        (is_plane && faces.iter().all(is_border)).then_some(Solid {
            body: Body::new(faces, edges),
            rings,
            has_cap,
            tolerance,
        })
    }
}

/// The loop that the open sides of a shell make, each (start, end, face), seen from outside the body that it closes; none
/// when they make several, or pass a vertex twice.
fn opening(open: &[(u32, u32, u32)]) -> Option<Vec<u32>> {
    // Seen through the opening the sides run the other way.
    let next: HashMap<u32, u32> = open.iter().map(|&(start, end, _)| (end, start)).collect();
    let mut ring = vec![open[0].0];
    while ring.len() <= open.len() {
        let v = *next.get(&ring[ring.len() - 1])?;
        if v == ring[0] {
            break;
        }
        ring.push(v);
    }
    (next.len() == open.len() && ring.len() == open.len()).then_some(ring)
}

/// The patches around a solid that are no part of it.
pub(super) struct Others<'a, F> {
    pub(super) scene: &'a Scene,
    pub(super) patches: &'a BoxTree,
    pub(super) is_own: F,
}

impl<F: Fn(u32) -> bool> Others<'_, F> {
    /// The patches that reach into a solid; none when the solid does not stand for its shell.
    ///
    /// Patches that lie on a face and look into the solid, like the floor that a box stands on, see nothing but its inside.
    /// That may be left out of account only while they cannot see each other or out: when all of them lie on one face, and
    /// that face is the opening if there is one.
    pub(super) fn around(&self, solid: &Solid) -> Option<Vec<u32>> {
        let Solid { body, tolerance, .. } = solid;
        let cap = solid.has_cap.then(|| body.faces.len() - 1);
        let mut looked_through = cap;
        let mut inside = Vec::new();
        let mut is_sound = true;
        self.patches.meeting(body.low - *tolerance, body.high + *tolerance, |i| {
            if !is_sound || (self.is_own)(i) {
                return;
            }
            let triangle = self.scene.triangle(i as usize);
            let normal = self.scene.normals()[i as usize];
            let may_reach_in = body.faces.iter().all(|face| triangle.iter().any(|v| face.distance(*v) < -tolerance));
            if may_reach_in && reaches_in(&triangle, &body.faces, *tolerance) {
                return inside.push(i);
            }
            for (k, face) in body.faces.iter().enumerate() {
                let looks_in = normal.dot(face.normal) < -0.99;
                let lies_in = |v: &Vec3| face.distance(*v).abs() <= *tolerance;
                if looks_in && triangle.iter().all(lies_in) && overlap(&triangle, &solid.rings[k], face, *tolerance) {
                    is_sound &= looked_through.is_none_or(|other| other == k);
                    looked_through = Some(k);
                }
            }
        });
        is_sound.then_some(inside)
    }
}

/// Whether a part of a triangle lies deeper than `tolerance` beneath every one of `faces`.
fn reaches_in(triangle: &Triangle, faces: &[Plane], tolerance: f64) -> bool {
    let inner = faces.iter().map(|face| Plane { normal: -face.normal, point: face.point - tolerance * face.normal });
    remains(triangle, inner)
}

/// Whether a triangle in the plane `face` covers more of the convex polygon `ring` than its border.
fn overlap(triangle: &Triangle, ring: &[Vec3], face: &Plane, tolerance: f64) -> bool {
    let sides = (0..ring.len()).map(|k| {
        let inward = face.normal.cross(ring[(k + 1) % ring.len()] - ring[k]).normalize_or_zero();
        Plane { normal: inward, point: ring[k] + tolerance * inward }
    });
    remains(triangle, sides)
}

/// Whether anything of a triangle lies before all of `planes`.
fn remains(triangle: &Triangle, planes: impl Iterator<Item = Plane>) -> bool {
    let (mut rest, mut clipped) = (triangle.to_vec(), Vec::new());
    for plane in planes {
        clip_to_front(&rest, &plane, &mut clipped);
        std::mem::swap(&mut rest, &mut clipped);
        if rest.is_empty() {
            return false;
        }
    }
    true
}
