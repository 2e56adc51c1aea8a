//! The patches of a scene as few convex bodies: what casts shadows, seen as a whole.
//!
//! The shadow of a convex body, seen from a point x outside it, is one convex cone; its sides are the planes through x and the
//! body's silhouette, the edges between a face that x lies before and one that it does not (Coorg & Teller 1997, "Real-time
//! occlusion culling for models with large occluders"). A box is one such cone instead of twelve shadows of triangles.
//!
//! Triangles are merged to convex polygons ([`super::merge`]), polygons to solids ([`super::solids`]). Every polygon that
//! belongs to no solid is a sheet: a solid of two faces and no thickness.

use std::collections::HashMap;

use super::body::{Body, extremes};
use super::box_tree::BoxTree;
use super::hull::Hull;
use super::merge::{Mesh, NONE};
use super::shaft::Shaft;
use super::solids::{Others, Shells};
use crate::geometry::Vec3;
use crate::geometry::polygon::{Plane, centre};
use crate::scene::Scene;

/// The bodies of a scene that can stand between two of its patches.
#[derive(Debug, Clone)]
pub struct Bodies {
    /// Solids and sheets, which may overlap where the patches of the scene do.
    pub bodies: Vec<Body>,
    /// The body that has a patch on its border, if any: a convex body hides nothing from there.
    body_of: Vec<u32>,
    entangled: Vec<bool>,
    tree: BoxTree,
}

impl Bodies {
    /// The bodies that the patches of a scene make up. What lies on the convex hull of the scene is left out, as it is from
    /// [`Bvh::of_blockers`](super::Bvh::of_blockers).
    pub fn of_scene(scene: &Scene) -> Bodies {
        let mesh = Mesh::new(scene);
        let (polygons, polygon_of) = mesh.polygons();
        let shells = Shells::new(&mesh, &polygons);
        let hull = Hull::new(scene);
        let patches =
            BoxTree::new((0..scene.len() as u32).map(|i| (i, extremes(scene.triangle(i as usize)))).collect());
        let polygon_of_patch = |i: u32| polygon_of[mesh.numbers[i as usize] as usize] as usize;
        let shell_of_patch = |i: u32| shells.shell_of[polygon_of_patch(i)];

        let (mut bodies, mut entangled) = (Vec::new(), vec![false; scene.len()]);
        let (mut sheets, mut body_of_polygon) = (HashMap::new(), vec![NONE; polygons.len()]);
        for (number, shell) in shells.shells.iter().enumerate() {
            let solid = shells.solid(shell).filter(|solid| {
                let others = Others { scene, patches: &patches, is_own: |i| shell_of_patch(i) == number as u32 };
                let can_block = solid.body.faces.iter().any(|plane| hull.has_both_sides(plane));
                let Some(inside) = others.around(solid) else { return false };
                if can_block {
                    inside.iter().for_each(|&i| entangled[i as usize] = true);
                    shell.iter().for_each(|&p| body_of_polygon[p as usize] = bodies.len() as u32);
                    bodies.push(solid.body.clone());
                }
                true
            });
            if solid.is_some() {
                continue;
            }
            for &p in shell {
                let polygon = &polygons[p as usize];
                let mut key = polygon.ring.clone();
                key.sort_unstable();
                // Two polygons with the same corners are the two sides of one sheet.
                if hull.has_both_sides(&polygon.plane) {
                    body_of_polygon[p as usize] = *sheets.entry(key).or_insert_with(|| {
                        bodies.push(mesh.sheet(polygon));
                        bodies.len() as u32 - 1
                    });
                }
            }
        }
        let boxes =
            bodies.iter().enumerate().map(|(k, body): (usize, &Body)| (k as u32, (body.low, body.high))).collect();
        let body_of = (0..scene.len() as u32).map(|i| body_of_polygon[polygon_of_patch(i)]).collect();
        Bodies { bodies, body_of, entangled, tree: BoxTree::new(boxes) }
    }

    /// Whether one of some bodies may reach into the shaft between two patches, by quick tests.
    pub fn may_meet(&self, some: &[u32], shaft: &Shaft, patches: [u32; 2]) -> bool {
        let own = patches.map(|i| self.body_of(i));
        some.iter().any(|k| !own.contains(k) && shaft.may_hold(&self.bodies[*k as usize]))
    }

    /// Those of some bodies that may reach into a shaft: without those that have all that spans it before one of their faces, as
    /// `is_all_before` tells.
    pub fn around(&self, some: &[u32], shaft: &Shaft, is_all_before: impl Fn(&Plane) -> bool) -> Vec<u32> {
        let may_meet = |k: &u32| {
            let body = &self.bodies[*k as usize];
            shaft.may_meet_box(body.low, body.high) && !body.faces.iter().any(&is_all_before)
        };
        some.iter().copied().filter(may_meet).collect()
    }

    /// The bodies that reach into the shaft between two patches, or may, in their order, up to `most`; `None` when there are more.
    pub fn in_shaft(&self, shaft: &Shaft, patches: [u32; 2], most: usize) -> Option<Vec<&Body>> {
        let mut found: Vec<u32> = Vec::new();
        self.near(shaft, patches.map(|i| self.body_of(i)), |k| {
            if shaft.holds(&self.bodies[k as usize]) {
                found.push(k);
            }
            found.len() <= most
        });
        found.sort_unstable();
        (found.len() <= most).then(|| found.into_iter().map(|k| &self.bodies[k as usize]).collect())
    }

    /// Whether no body is known to reach into a shaft but for those that all of an end lies on, `own`, and those that have all that
    /// spans it before one of their faces, as `has_before` tells: in a bowl of facets, all.
    pub fn is_clear(&self, shaft: &Shaft, own: [u32; 2], has_before: impl Fn(&Plane) -> bool) -> bool {
        let mut clear = true;
        self.near(shaft, own, |k| {
            let body = &self.bodies[k as usize];
            clear = !shaft.may_hold(body) || body.faces.iter().any(&has_before) || !shaft.holds(body);
            clear
        });
        clear
    }

    /// The body that has a patch on its border; a number that no body has where there is none.
    pub fn body_of(&self, patch: u32) -> u32 {
        self.body_of[patch as usize]
    }

    /// Whether one solid is found that hides all in the convex hull of `b` from all in that of `a`: one of those between the centres.
    pub fn hide(&self, a: &[Vec3], b: &[Vec3]) -> bool {
        let line = Line::new(centre(a), centre(b));
        let mut hidden = false;
        self.tree.walk(|node| {
            let opens = !hidden && line.meets(node.low, node.high);
            for (k, (low, high)) in self.tree.items[node.items.clone()].iter().filter(|_| opens) {
                hidden = hidden || (line.meets(*low, *high) && self.bodies[*k as usize].hides(a, b));
            }
            opens
        });
        hidden
    }

    /// The same of some of the bodies.
    pub fn some_hides(&self, some: &[u32], a: &[Vec3], b: &[Vec3]) -> bool {
        let line = Line::new(centre(a), centre(b));
        some.iter().map(|k| &self.bodies[*k as usize]).any(|body| line.meets(body.low, body.high) && body.hides(a, b))
    }

    /// Visits the bodies whose boxes a shaft may meet, but for `own`, until `visit` returns false.
    fn near(&self, shaft: &Shaft, own: [u32; 2], mut visit: impl FnMut(u32) -> bool) {
        let mut goes_on = true;
        self.tree.walk(|node| {
            let opens = goes_on && shaft.may_meet_box(node.low, node.high);
            for (k, (low, high)) in self.tree.items[node.items.clone()].iter().filter(|_| opens) {
                goes_on = goes_on && (own.contains(k) || !shaft.may_meet_box(*low, *high) || visit(*k));
            }
            opens
        });
    }

    /// Whether nothing can block.
    pub fn is_empty(&self) -> bool {
        self.bodies.is_empty()
    }

    /// Whether a patch reaches into the inside of a solid. Its points may lie inside a body, whose shadow is then no cone.
    pub fn entangled(&self, patch: u32) -> bool {
        self.entangled[patch as usize]
    }
}

/// A segment that is tested against many boxes.
struct Line {
    start: Vec3,
    /// 1 over the components of the way.
    inverse: Vec3,
}

impl Line {
    fn new(start: Vec3, end: Vec3) -> Line {
        Line { start, inverse: (end - start).recip() }
    }

    /// Whether the segment meets a box. Where a component of its way is 0 and a face of the box lies in it, either answer may come.
    #[inline]
    fn meets(&self, low: Vec3, high: Vec3) -> bool {
        let (a, b) = ((low - self.start) * self.inverse, (high - self.start) * self.inverse);
        a.min(b).max_element().max(0.0) <= a.max(b).min_element().min(1.0)
    }
}
