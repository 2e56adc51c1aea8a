//! Bounding volume hierarchy over the patches of a scene, built by the obvhs crate.
//!
//! Coordinates are moved and scaled in f64 to a box of size 2 around the origin before anything is rounded to f32, so
//! that a scene in micrometres far from the origin is traversed exactly like one in metres around it. Only the boxes
//! are f32, padded by more than their rounding; triangles are intersected in f64.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::time::Duration;

use glam::Vec3A;
use obvhs::aabb::Aabb;
use obvhs::bvh2::{Bvh2, builder::build_bvh2};
use obvhs::ray::{Ray, RayHit};
use obvhs::{BvhBuildParams, ploc::PlocSearchDistance, ploc::SortPrecision};

use super::intersect::ShearedRay;
use crate::geometry::polygon::{Plane, area_vector};
use crate::geometry::{Triangle, Vec3};
use crate::scene::Scene;

/// The patch number that says "none".
pub const NO_PATCH: u32 = u32::MAX;

/// The first thing that a ray meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// The patch; of two that share one triangle back to back, the one that faces the ray.
    pub patch: u32,
    /// Distance along the ray, in units of the length of its direction.
    pub t: f64,
    /// Barycentric coordinates of the patch's corners 1 and 2.
    pub barycentric: [f64; 2],
}

/// Rounding of box corners and rays to f32, in a box of size 2: 1 ulp is 1.2e-7, and a slab test makes a few of them.
const PADDING: f32 = 1e-6;

/// The part of a segment at each end in which it meets nothing but its own surface (of a long one: of the scene's size).
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

/// The patches that share one triangle: the one whose front is that of the stored corners, and the one whose front is the
/// other side. A one-sided patch is both. Of exact duplicates the first counts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patches {
    front: u32,
    back: u32,
}

impl Patches {
    /// Whether these are the patches of a segment's ends.
    #[inline]
    pub(super) fn any_of(self, ends: [u32; 2]) -> bool {
        ends.contains(&self.front) || ends.contains(&self.back)
    }
}

/// A tree over some or all patches of a scene.
pub struct Bvh {
    pub(super) tree: Bvh2,
    /// In leaf order: normalised corners, and the patches that have them.
    pub(super) triangles: Vec<Triangle>,
    pub(super) patches: Vec<Patches>,
    centre: Vec3,
    scale: f64,
    /// How far rounding may have moved a corner, in normalised coordinates.
    rounding: f64,
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
        let (low, high) = bounds(scene);
        let centre = 0.5 * low + 0.5 * high;
        let half = 0.5 * (high - low).max_element();
        let scale = if half > 0.0 { 1.0 / half } else { 1.0 };
        let rounding = 4.0 * f64::EPSILON * low.abs().max(high.abs()).max_element().mul_add(scale, 1.0);
        let normalised = |i: u32| scene.triangle(i as usize).map(|v| (v - centre) * scale);
        let distinct = distinct_triangles(scene, &patches);
        let boxes: Vec<Aabb> = distinct
            .iter()
            .map(|p| {
                let corners = normalised(p.front).map(|v| Vec3A::from(v.as_vec3()));
                let mut bounds = Aabb::from_points(&corners);
                bounds.min -= Vec3A::splat(PADDING);
                bounds.max += Vec3A::splat(PADDING);
                bounds
            })
            .collect();
        let tree = if boxes.is_empty() { Bvh2::default() } else { build_bvh2(&boxes, BUILD, &mut Duration::default()) };
        let patches: Vec<Patches> = tree.primitive_indices.iter().map(|&k| distinct[k as usize]).collect();
        let triangles = patches.iter().map(|p| normalised(p.front)).collect();
        Bvh { tree, triangles, patches, centre, scale, rounding }
    }

    /// Number of triangles in the tree.
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
    /// `direction` must be finite and not zero.
    pub fn closest(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        // A direction may be so long or so short that its square is no number.
        let largest = direction.abs().max_element();
        let length = (direction / largest).length();
        let unit = direction / largest / length;
        let origin = self.normalise(origin);
        // The f32 traversal starts where the ray comes nearest to the box, so that a distant origin loses no digits.
        let start = (-origin.dot(unit) - 4.0).max(0.0);
        let moved = origin + start * unit;
        let sheared = ShearedRay::new(moved, unit);
        let ray = Ray::new(moved.as_vec3().into(), unit.as_vec3().into(), 0.0, f32::INFINITY);
        let mut best: Option<(f64, u32, usize, [f64; 2])> = None;
        let visit = |k: usize, tmax: f32| -> f32 {
            let Some((t, barycentric)) = sheared.hit(&self.triangles[k]) else { return tmax };
            let t = t + start;
            let patch = self.patches[k].front;
            // Equal distances, as on a shared edge, go to the lower number: the answer must not depend on the tree.
            let nearer = best.is_none_or(|(s, p, ..)| t < s || (t == s && patch < p));
            if t > 0.0 && nearer {
                best = Some((t, patch, k, barycentric));
                return ((t - start) as f32).next_up();
            }
            tmax
        };
        self.traverse(ray, visit);
        let (t, _, k, [v, w]) = best?;
        let t = t / self.scale / length / largest;
        let Patches { front, back } = self.patches[k];
        // The twin's corners 1 and 2 are exchanged.
        let from_front = front == back || area_vector(&self.triangles[k]).dot(unit) < 0.0;
        let (patch, barycentric) = if from_front { (front, [v, w]) } else { (back, [w, v]) };
        Some(Hit { patch, t, barycentric })
    }

    /// Whether a patch other than the two excluded ones meets the open segment from `p` to `q`.
    #[inline]
    pub fn blocked(&self, p: Vec3, q: Vec3, exclude: [u32; 2]) -> bool {
        if self.is_empty() {
            return false;
        }
        let (p, q) = (self.normalise(p), self.normalise(q));
        let segment = q - p;
        let Some((enter, leave)) = inside_the_box(p, segment) else { return false };
        let own = OWN_SURFACE * (2.0 / segment.length()).min(1.0);
        let sheared = ShearedRay::new(p, segment);
        // The part inside the box alone goes to f32: ends far outside would lose its digits.
        let ray =
            Ray::new((p + enter * segment).as_vec3().into(), segment.as_vec3().into(), 0.0, (leave - enter) as f32);
        !self.tree.ray_traverse_miss(ray, |_, k| {
            if self.patches[k].any_of(exclude) {
                return f32::INFINITY;
            }
            match sheared.hit(&self.triangles[k]) {
                Some((t, _)) if t > own && t < 1.0 - own && !self.touches(k, p, q) => 0.0,
                _ => f32::INFINITY,
            }
        })
    }

    /// Whether an end of the segment lies in the plane of triangle k, as far as rounding lets one tell. Then the segment
    /// starts or ends there, and is not blocked.
    fn touches(&self, k: usize, p: Vec3, q: Vec3) -> bool {
        let plane = Plane::of(&self.triangles[k]);
        plane.distance(p).abs() <= self.rounding || plane.distance(q).abs() <= self.rounding
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

/// Smallest and largest coordinates of the patches; vertices that no patch uses do not count.
fn bounds(scene: &Scene) -> (Vec3, Vec3) {
    let corners = scene.faces().iter().flatten().map(|&v| scene.vertices()[v as usize]);
    corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

/// The part [t0, t1] of the segment p + t d, t in [0, 1], that lies in the normalised box, with some room around it.
fn inside_the_box(p: Vec3, d: Vec3) -> Option<(f64, f64)> {
    const HALF: f64 = 1.001;
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for k in 0..3 {
        let (at, along) = (p[k], d[k]);
        if along == 0.0 {
            if at.abs() > HALF {
                return None;
            }
            continue;
        }
        let (a, b) = ((-HALF - at) / along, (HALF - at) / along);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    // Also refuses a segment without length, or one that is not finite.
    (enter < leave && d != Vec3::ZERO).then_some((enter, leave))
}

/// The triangles of `patches`, each once.
fn distinct_triangles(scene: &Scene, patches: &[u32]) -> Vec<Patches> {
    // Adding 0.0 makes -0.0 and 0.0 the same position.
    let position = |v: u32| scene.vertices()[v as usize].to_array().map(|x| (x + 0.0).to_bits());
    let mut known: HashMap<[[u64; 3]; 3], usize> = HashMap::with_capacity(patches.len());
    let mut distinct: Vec<Patches> = Vec::with_capacity(patches.len());
    for &i in patches {
        let mut corners = scene.faces()[i as usize].map(position);
        corners.sort_unstable();
        match known.entry(corners) {
            Entry::Vacant(entry) => {
                entry.insert(distinct.len());
                distinct.push(Patches { front: i, back: i });
            }
            Entry::Occupied(entry) => {
                let pair = &mut distinct[*entry.get()];
                let opposite = scene.normals()[i as usize].dot(scene.normals()[pair.front as usize]) < 0.0;
                if opposite && pair.back == pair.front {
                    pair.back = i;
                }
            }
        }
    }
    distinct
}

/// The patches that have both something before them and something behind them.
fn blockers(scene: &Scene) -> Vec<u32> {
    let mut is_used = vec![false; scene.vertices().len()];
    scene.faces().iter().flatten().for_each(|&v| is_used[v as usize] = true);
    let used: Vec<Vec3> = scene.vertices().iter().zip(is_used).filter_map(|(v, used)| used.then_some(*v)).collect();
    let (low, high) = bounds(scene);
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
