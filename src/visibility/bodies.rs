//! The patches of a scene as few convex bodies: what casts shadows, seen as a whole.
//!
//! The shadow of a convex body, seen from a point x outside it, is one convex cone; its sides are the planes through x and the
//! body's silhouette, the edges between a face that x lies before and one that it does not (Coorg & Teller 1997, "Real-time
//! occlusion culling for models with large occluders"). A box is one such cone instead of twelve shadows of triangles.
//!
//! Triangles are merged to convex polygons ([`super::merge`]), polygons to solids ([`super::solids`]). Every polygon that
//! belongs to no solid is a sheet: a solid of two faces and no thickness.

use std::collections::HashSet;

use super::body::{Body, extremes};
use super::box_tree::BoxTree;
use super::merge::Mesh;
use super::shaft::Shaft;
use super::solids::{Others, Shells};
use crate::geometry::polygon::Plane;
use crate::scene::Scene;

/// The bodies of a scene that can stand between two of its patches.
#[derive(Debug, Clone)]
pub struct Bodies {
    /// Solids and sheets, which may overlap where the patches of the scene do.
    pub bodies: Vec<Body>,
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
        let shell_of_patch = |i: u32| shells.shell_of[polygon_of[mesh.numbers[i as usize] as usize] as usize];

        let (mut bodies, mut entangled) = (Vec::new(), vec![false; scene.len()]);
        let mut sheets = HashSet::new();
        for (number, shell) in shells.shells.iter().enumerate() {
            let solid = shells.solid(shell).filter(|solid| {
                let others = Others { scene, patches: &patches, is_own: |i| shell_of_patch(i) == number as u32 };
                let can_block = solid.body.faces.iter().any(|plane| hull.has_both_sides(plane));
                let Some(inside) = others.around(solid) else { return false };
                if can_block {
                    inside.iter().for_each(|&i| entangled[i as usize] = true);
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
                if hull.has_both_sides(&polygon.plane) && sheets.insert(key) {
                    bodies.push(mesh.sheet(polygon));
                }
            }
        }
        let boxes =
            bodies.iter().enumerate().map(|(k, body): (usize, &Body)| (k as u32, (body.low, body.high))).collect();
        Bodies { bodies, entangled, tree: BoxTree::new(boxes) }
    }

    /// Whether a body may reach into a shaft, by quick tests.
    pub fn may_meet(&self, shaft: &Shaft) -> bool {
        let mut found = false;
        self.near(shaft, |k| {
            found = found || shaft.may_hold(&self.bodies[k as usize]);
            !found
        });
        found
    }

    /// The bodies that reach into a shaft, or may, in their order, up to `most`; `None` when there are more.
    pub fn in_shaft(&self, shaft: &Shaft, most: usize) -> Option<Vec<&Body>> {
        let mut found: Vec<u32> = Vec::new();
        self.near(shaft, |k| {
            if shaft.holds(&self.bodies[k as usize]) {
                found.push(k);
            }
            found.len() <= most
        });
        found.sort_unstable();
        (found.len() <= most).then(|| found.into_iter().map(|k| &self.bodies[k as usize]).collect())
    }

    /// Visits the bodies whose boxes a shaft may meet, until `visit` returns false.
    fn near(&self, shaft: &Shaft, mut visit: impl FnMut(u32) -> bool) {
        let mut goes_on = true;
        self.tree.walk(|node| {
            let opens = goes_on && shaft.may_meet_box(node.low, node.high);
            for (k, (low, high)) in self.tree.items[node.items.clone()].iter().filter(|_| opens) {
                goes_on = goes_on && (!shaft.may_meet_box(*low, *high) || visit(*k));
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

/// What lies on both sides of a plane, asked of all corners of the scene's patches.
struct Hull {
    points: BoxTree,
    tolerance: f64,
}

impl Hull {
    fn new(scene: &Scene) -> Hull {
        let mut used: Vec<u32> = scene.faces().as_flattened().to_vec();
        used.sort_unstable();
        used.dedup();
        let at = |v: u32| scene.vertices()[v as usize];
        let points = BoxTree::new(used.into_iter().map(|v| (v, (at(v), at(v)))).collect());
        let (low, high) = points.bounds();
        let size = (high - low).max_element().max(low.abs().max(high.abs()).max_element());
        Hull { points, tolerance: 64.0 * f64::EPSILON * size }
    }

    fn has_both_sides(&self, plane: &Plane) -> bool {
        self.points.sides(plane, [self.tolerance, -self.tolerance]) == (true, true)
    }
}
