//! The patches of a scene in a bounding volume hierarchy: what rays are asked of.
//!
//! Coordinates are moved and scaled in f64 to a box of size 2 around the origin before anything is rounded to f32, so
//! that a scene in micrometres far from the origin is traversed exactly like one in metres around it. Boxes and the
//! triangles that are sifted are f32, with bounds on what rounding does to them; what is hit is decided in f64.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use glam::Vec3A;

use super::block::HALF;
use super::build::{Bounds, binary_tree};
use super::hull::Hull;
use super::ray::Hit;
use super::wide::Wide;
use crate::geometry::polygon::area_vector;
use crate::geometry::sampling::hash;
use crate::geometry::{Triangle, Vec3};
use crate::scene::Scene;
use crate::simd::Instructions;

/// The place of a patch that is not in the tree.
const NOWHERE: u32 = u32::MAX;

/// Rounding of box corners and rays to f32, in a box of size 2: 1 ulp is 1.2e-7, and a slab test makes a few of them.
const PADDING: f32 = 1e-6;

/// The patches that share one triangle: the one whose front is that of the stored corners, and the one whose front is the
/// other side. A one-sided patch is both. Of exact duplicates the first counts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patches {
    pub(super) front: u32,
    back: u32,
}

/// A tree over some or all patches of a scene.
pub struct Bvh {
    pub(super) wide: Wide,
    /// In leaf order: normalised corners, and the patches that have them.
    pub(super) triangles: Vec<Triangle>,
    pub(super) patches: Vec<Patches>,
    /// The leaf place of every patch; none for a patch that is not in the tree.
    places: Vec<u32>,
    centre: Vec3,
    scale: f64,
    /// How far rounding may have moved a corner, in normalised coordinates.
    pub(super) rounding: f64,
    pub(super) own_reach: f32,
    pub(super) instructions: Instructions,
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
        let (distinct, numbers) = distinct_triangles(scene, &patches);
        let tree = binary_tree(distinct.iter().map(|p| {
            let corners = normalised(p.front).map(|v| Vec3A::from(v.as_vec3()));
            let padding = Vec3A::splat(PADDING);
            Bounds {
                low: corners[0].min(corners[1]).min(corners[2]) - padding,
                high: corners[0].max(corners[1]).max(corners[2]) + padding,
            }
        }));
        let (wide, order) = Wide::new(&tree, |k| normalised(distinct[k as usize].front));
        let mut place_of = vec![0; order.len()];
        order.iter().enumerate().for_each(|(place, &k)| place_of[k as usize] = place as u32);
        let mut places = vec![NOWHERE; scene.len()];
        patches.iter().zip(numbers).for_each(|(&i, k)| places[i as usize] = place_of[k as usize]);
        let patches: Vec<Patches> = order.iter().map(|&k| distinct[k as usize]).collect();
        let triangles = patches.iter().map(|p| normalised(p.front)).collect();
        Bvh {
            wide,
            triangles,
            patches,
            places,
            centre,
            scale,
            rounding,
            own_reach: Bvh::own_reach(rounding),
            instructions: Instructions::best(),
        }
    }

    /// Number of triangles in the tree.
    pub fn len(&self) -> usize {
        self.patches.len()
    }

    /// Whether nothing can be hit.
    pub fn is_empty(&self) -> bool {
        self.patches.is_empty()
    }

    /// The same tree, traversed with other instructions than the best; what this processor does not have is not used.
    pub fn with_instructions(self, instructions: Instructions) -> Bvh {
        let known = Instructions::available().contains(&instructions);
        Bvh { instructions: if known { instructions } else { Instructions::Portable }, ..self }
    }

    /// Bytes that the tree takes.
    pub fn nbytes(&self) -> usize {
        self.wide.nbytes()
            + size_of_val(self.triangles.as_slice())
            + size_of_val(self.patches.as_slice())
            + size_of_val(self.places.as_slice())
    }

    /// A point of the scene in the tree's own coordinates.
    #[inline(always)]
    pub(super) fn normalise(&self, x: Vec3) -> Vec3 {
        (x - self.centre) * self.scale
    }

    /// Where the way from `x` in the scene along the unit vector `direction` has left it.
    pub fn outside(&self, x: Vec3, direction: Vec3) -> Vec3 {
        let start = self.normalise(x);
        let leave = |k: usize| {
            let t = (HALF.copysign(direction[k]) - start[k]) / direction[k];
            if t.is_nan() { f64::INFINITY } else { t }
        };
        x + (0..3).map(leave).fold(f64::INFINITY, f64::min) / self.scale * direction
    }

    /// Where a patch lies in the order of the leaves.
    #[inline(always)]
    pub(super) fn place(&self, patch: u32) -> u32 {
        self.places.get(patch as usize).copied().unwrap_or(NOWHERE)
    }

    /// Whether triangle `k` is the front of a patch to a ray along `direction`.
    pub(super) fn faces(&self, k: usize, direction: Vec3) -> bool {
        let Patches { front, back } = self.patches[k];
        front != back || self.is_seen_from_front(k, direction)
    }

    fn is_seen_from_front(&self, k: usize, direction: Vec3) -> bool {
        area_vector(&self.triangles[k]).dot(direction) < 0.0
    }

    /// What the hit of triangle `k` at `t` tells the one who asked.
    #[inline(always)]
    pub(super) fn hit(&self, k: usize, t: f64, [v, w]: [f64; 2], direction: Vec3) -> Hit {
        let Patches { front, back } = self.patches[k];
        let t = t / self.scale;
        // The twin's corners 1 and 2 are exchanged.
        let from_front = front == back || self.is_seen_from_front(k, direction);
        let (patch, barycentric) = if from_front { (front, [v, w]) } else { (back, [w, v]) };
        Hit { patch, t, barycentric }
    }
}

/// Smallest and largest coordinates of the patches; vertices that no patch uses do not count.
pub(super) fn bounds(scene: &Scene) -> (Vec3, Vec3) {
    let corners = scene.faces().iter().flatten().map(|&v| scene.vertices()[v as usize]);
    corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

/// The triangles of `patches`, each once, and for every patch the number of its triangle.
pub(super) fn distinct_triangles(scene: &Scene, patches: &[u32]) -> (Vec<Patches>, Vec<u32>) {
    // Adding 0.0 makes -0.0 and 0.0 the same position.
    let position = |v: u32| scene.vertices()[v as usize].to_array().map(|x| (x + 0.0).to_bits());
    let corners = |i: u32| {
        let mut corners = scene.faces()[i as usize].map(position);
        corners.sort_unstable();
        corners
    };
    // By the hash of its corners; triangles that share one by chance take the next numbers.
    let mut known: HashMap<u64, u32> = HashMap::with_capacity(patches.len());
    let mut distinct: Vec<Patches> = Vec::with_capacity(patches.len());
    let mut numbers = Vec::with_capacity(patches.len());
    for &i in patches {
        let own = corners(i);
        let mut key = own.as_flattened().iter().fold(0, |key, &bits| hash(key ^ bits));
        let number = loop {
            match known.entry(key) {
                Entry::Vacant(entry) => {
                    distinct.push(Patches { front: i, back: i });
                    break *entry.insert(distinct.len() as u32 - 1);
                }
                Entry::Occupied(entry) => {
                    let pair = &mut distinct[*entry.get() as usize];
                    if corners(pair.front) == own {
                        let opposite = scene.normals()[i as usize].dot(scene.normals()[pair.front as usize]) < 0.0;
                        if opposite && pair.back == pair.front {
                            pair.back = i;
                        }
                        break *entry.get();
                    }
                    key = key.wrapping_add(1);
                }
            }
        };
        numbers.push(number);
    }
    (distinct, numbers)
}

/// The patches that have both something before them and something behind them.
fn blockers(scene: &Scene) -> Vec<u32> {
    let hull = Hull::new(scene);
    (0..scene.len() as u32).filter(|&i| hull.has_both_sides(&scene.plane(i as usize))).collect()
}
