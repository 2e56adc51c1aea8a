//! Bounding volume hierarchy over the patches of a scene, built by the obvhs crate.
//!
//! Coordinates are moved and scaled in f64 to a box of size 2 around the origin before anything is rounded to f32, so
//! that a scene in micrometres far from the origin is traversed exactly like one in metres around it. Only the boxes
//! are f32, padded by more than their rounding; triangles are intersected in f64.

use std::time::Duration;

use glam::Vec3A;
use obvhs::aabb::Aabb;
use obvhs::bvh2::{Bvh2, builder::build_bvh2};
use obvhs::ray::{Ray, RayHit};
use obvhs::{BvhBuildParams, ploc::PlocSearchDistance, ploc::SortPrecision};

use super::intersect::ShearedRay;
use crate::geometry::{Triangle, Vec3};
use crate::scene::Scene;

/// The patch number that says "none".
pub const NO_PATCH: u32 = u32::MAX;

/// The first thing that a ray meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// The patch; of two patches that share one triangle, the one that faces the ray.
    pub patch: u32,
    /// Distance along the ray, in units of the length of its direction.
    pub t: f64,
    /// Barycentric coordinates of the patch's corners 1 and 2.
    pub barycentric: [f64; 2],
}

/// Rounding of box corners and rays to f32, in a box of size 2: 1 ulp is 1.2e-7, and a slab test makes a few of them.
const PADDING: f32 = 1e-6;

/// The part of a segment at each end that counts as its own surface. Source and target are excluded by number; this
/// excludes what shares a plane with them and is hit at a distance that only rounding makes positive.
const OWN_SURFACE: f64 = 1e-9;

/// obvhs' own tree quality presets differ by a factor of four in ray throughput; full reinsertion is the best of them.
const BUILD: BvhBuildParams = BvhBuildParams {
    pre_split: false,
    ploc_search_distance: PlocSearchDistance::Medium,
    search_depth_threshold: 1,
    reinsertion_batch_ratio: 1.0,
    post_collapse_reinsertion_batch_ratio_multiplier: 1.0,
    sort_precision: SortPrecision::U64,
    max_prims_per_leaf: 8,
    collapse_traversal_cost: 3.0,
};

/// A tree over some or all patches of a scene.
pub struct Bvh {
    pub(super) tree: Bvh2,
    /// In leaf order: the normalised corners of each patch, and its number in the scene.
    pub(super) triangles: Vec<Triangle>,
    pub(super) patches: Vec<u32>,
    centre: Vec3,
    scale: f64,
}

impl Bvh {
    /// A tree over every patch: for rays that ask what they hit.
    pub fn of_scene(scene: &Scene) -> Bvh {
        Bvh::new(scene, (0..scene.len() as u32).collect())
    }

    /// A tree over the patches that can stand between two others: for visibility.
    ///
    /// A patch with no other patch behind it, or none before it, lies on the convex hull of the scene and blocks
    /// nothing. A convex scene has no blockers at all, and the tree is empty.
    pub fn of_blockers(scene: &Scene) -> Bvh {
        Bvh::new(scene, blockers(scene))
    }

    fn new(scene: &Scene, patches: Vec<u32>) -> Bvh {
        let (low, high) = bounds(scene.vertices());
        let centre = 0.5 * (low + high);
        let half = 0.5 * (high - low).max_element();
        let scale = if half > 0.0 { 1.0 / half } else { 1.0 };
        let normalised = |i: u32| scene.triangle(i as usize).map(|v| (v - centre) * scale);
        let boxes: Vec<Aabb> = patches
            .iter()
            .map(|&i| {
                let corners = normalised(i).map(|v| Vec3A::from(v.as_vec3()));
                let mut bounds = Aabb::from_points(&corners);
                bounds.min -= Vec3A::splat(PADDING);
                bounds.max += Vec3A::splat(PADDING);
                bounds
            })
            .collect();
        let tree = if boxes.is_empty() { Bvh2::default() } else { build_bvh2(&boxes, BUILD, &mut Duration::default()) };
        let patches: Vec<u32> = tree.primitive_indices.iter().map(|&k| patches[k as usize]).collect();
        let triangles = patches.iter().map(|&i| normalised(i)).collect();
        Bvh { tree, triangles, patches, centre, scale }
    }

    /// Number of patches in the tree.
    pub fn len(&self) -> usize {
        self.patches.len()
    }

    /// Whether nothing can be hit.
    pub fn is_empty(&self) -> bool {
        self.patches.is_empty()
    }

    /// A point of the scene in the tree's own coordinates.
    #[inline]
    pub(super) fn normalise(&self, x: Vec3) -> Vec3 {
        (x - self.centre) * self.scale
    }

    /// The first patch that the ray from `origin` along `direction` meets at t > 0.
    ///
    /// `direction` must be finite and not zero. `scene` must be the one that the tree was built from.
    pub fn closest(&self, scene: &Scene, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let length = direction.length();
        let unit = direction / length;
        let origin = self.normalise(origin);
        // The f32 traversal starts where the ray comes nearest to the box, so that a distant origin loses no digits.
        let start = (-origin.dot(unit) - 4.0).max(0.0);
        let moved = origin + start * unit;
        let sheared = ShearedRay::new(moved, unit);
        let ray = Ray::new(moved.as_vec3().into(), unit.as_vec3().into(), 0.0, f32::INFINITY);
        let mut best: Option<(f64, u32, [f64; 2])> = None;
        let visit = |k: usize, tmax: f32| -> f32 {
            let Some((t, barycentric)) = sheared.hit(&self.triangles[k]) else { return tmax };
            let t = t + start;
            let patch = self.patches[k];
            // Equal distances, as on a shared edge, go to the lower number: the answer must not depend on the tree.
            let nearer = best.is_none_or(|(s, p, _)| t < s || (t == s && patch < p));
            if t > 0.0 && nearer {
                best = Some((t, patch, barycentric));
                return ((t - start) as f32).next_up();
            }
            tmax
        };
        self.traverse(ray, visit);
        let (t, patch, barycentric) = best?;
        let (patch, barycentric) = facing_twin(scene, patch, barycentric, unit);
        Some(Hit { patch, t: t / (self.scale * length), barycentric })
    }

    /// Whether a patch other than the two excluded ones meets the open segment from `p` to `q`.
    #[inline]
    pub fn blocked(&self, p: Vec3, q: Vec3, exclude: [u32; 2]) -> bool {
        if self.is_empty() {
            return false;
        }
        let (p, q) = (self.normalise(p), self.normalise(q));
        let segment = q - p;
        let length = segment.length();
        // 1e-15 is the rounding of coordinates of size 1: a segment shorter than that has no inside.
        let end = OWN_SURFACE + 1e-15 / length;
        if !(end < 0.5) {
            return false;
        }
        let sheared = ShearedRay::new(p, segment);
        let ray = Ray::new(p.as_vec3().into(), segment.as_vec3().into(), 0.0, 1.0);
        !self.tree.ray_traverse_miss(ray, |_, k| {
            if exclude.contains(&self.patches[k]) {
                return f32::INFINITY;
            }
            match sheared.hit(&self.triangles[k]) {
                Some((t, _)) if t > end && t < 1.0 - end => 0.0,
                _ => f32::INFINITY,
            }
        })
    }

    /// Walks the tree; `visit(k, tmax)` tests triangle k in leaf order and returns the new end of the ray.
    fn traverse(&self, ray: Ray, mut visit: impl FnMut(usize, f32) -> f32) {
        let mut stack = obvhs::faststack::HeapStack::new_with_capacity(self.tree.max_depth.max(1));
        let mut hit = RayHit::none();
        self.tree.ray_traverse_dynamic(&mut stack, ray, &mut hit, |node, ray, _| {
            for k in node.first_index..node.first_index + node.prim_count {
                ray.tmax = visit(k as usize, ray.tmax);
            }
            true
        });
    }
}

/// Smallest and largest coordinates.
fn bounds(vertices: &[Vec3]) -> (Vec3, Vec3) {
    vertices.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)))
}

/// The patches that have both something before them and something behind them.
fn blockers(scene: &Scene) -> Vec<u32> {
    let used: Vec<Vec3> = {
        let mut is_used = vec![false; scene.vertices().len()];
        scene.faces().iter().flatten().for_each(|&v| is_used[v as usize] = true);
        scene.vertices().iter().zip(is_used).filter_map(|(v, used)| used.then_some(*v)).collect()
    };
    let (low, high) = bounds(&used);
    // What lies off a plane by less than the rounding of its coordinates lies in it.
    let tolerance = 64.0 * f64::EPSILON * (high - low).max_element().max(low.abs().max(high.abs()).max_element());
    (0..scene.len() as u32)
        .filter(|&i| {
            let plane = scene.plane(i as usize);
            let (mut before, mut behind) = (false, false);
            used.iter().any(|&v| {
                let d = plane.distance(v);
                before |= d > tolerance;
                behind |= d < -tolerance;
                before && behind
            })
        })
        .collect()
}

/// Of a triangle that is there twice, once for each side, the patch that faces the ray.
///
/// [`crate::scene::Sides::Both`] lays the twin of patch i at i + n/2, corners 1 and 2 exchanged.
fn facing_twin(scene: &Scene, patch: u32, barycentric: [f64; 2], direction: Vec3) -> (u32, [f64; 2]) {
    let half = scene.len() as u32 / 2;
    if scene.normals()[patch as usize].dot(direction) < 0.0 || patch >= half {
        return (patch, barycentric);
    }
    let [a, b, c] = scene.faces()[patch as usize];
    if scene.faces()[(patch + half) as usize] == [a, c, b] {
        return (patch + half, [barycentric[1], barycentric[0]]);
    }
    (patch, barycentric)
}
