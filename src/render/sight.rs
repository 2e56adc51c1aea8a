//! What a camera sees: the first patch on each of its rays, and whether there was anything to see at all.
//!
//! Where that is a mirror or glass, what is seen there: the second pass of a two-pass picture (Wallace, Cohen & Greenberg, "A
//! two-pass solution to the rendering equation", SIGGRAPH 1987). The first surface is not left to chance: both ways on of glass
//! are followed and weighted, so that a highlight on it is no noise.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use rayon::prelude::*;

use super::Camera;
use crate::direct::lamp::Point;
use crate::error::{Error, Result};
use crate::geometry::Vec3;
use crate::scene::{Material, Scene};
use crate::visibility::specular::{branches, follow};
use crate::visibility::{Bvh, Hit, NO_PATCH, Ray};

/// A diffuse point that a ray shows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shown {
    /// The number of the ray.
    pub(super) ray: usize,
    pub(super) point: Point,
    /// Barycentric coordinates of corners 1 and 2 of its patch.
    pub(super) barycentric: [f64; 2],
    /// The part of the ray that comes from there.
    pub(super) part: f64,
}

impl Shown {
    fn new(scene: &Scene, ray: usize, hit: &Hit, part: f64) -> Shown {
        Shown { ray, point: Point::of_hit(scene, hit), barycentric: hit.barycentric, part }
    }
}

/// Whether any ray has met a front, and the lowest number of the patches whose backs were met.
pub(crate) struct Sight<'a> {
    scene: &'a Scene,
    front: AtomicBool,
    back: AtomicU32,
}

impl<'a> Sight<'a> {
    pub(crate) fn new(scene: &'a Scene) -> Sight<'a> {
        Sight { scene, front: AtomicBool::new(false), back: AtomicU32::new(NO_PATCH) }
    }

    /// Whether a ray has met the front of a patch.
    #[inline]
    pub(crate) fn is_front(&self, hit: &Hit, direction: Vec3) -> bool {
        let is_front = self.scene.normals()[hit.patch as usize].dot(direction) < 0.0;
        if is_front {
            self.front.store(true, Ordering::Relaxed);
        } else {
            self.back.fetch_min(hit.patch, Ordering::Relaxed);
        }
        is_front
    }

    /// The points that rays of the camera show, ray after ray. `tree` must hold all patches.
    pub(super) fn look(&self, tree: &Bvh, rays: &[Ray]) -> Vec<Shown> {
        let scene = self.scene;
        let (mut shown, mut on, mut branching) = (Vec::with_capacity(rays.len()), Vec::new(), Vec::new());
        for (k, (ray, hit)) in rays.iter().zip(tree.closest(rays)).enumerate() {
            let Some(hit) = hit else { continue };
            let material = scene.material(hit.patch as usize);
            if !matches!(material, Material::Glass(_)) && !self.is_front(&hit, ray.direction) {
                continue;
            }
            if material == Material::Diffuse {
                shown.push(Shown::new(scene, k, &hit, 1.0));
                continue;
            }
            self.front.store(true, Ordering::Relaxed);
            for branch in branches(scene, ray, &hit).into_iter().flatten() {
                on.push(branch.ray);
                branching.push((k, branch));
            }
        }
        if !on.is_empty() {
            let ends = follow(scene, tree, &on);
            for ((k, branch), end) in branching.iter().zip(ends) {
                if let Some(arrival) = end.arrival() {
                    shown.push(Shown::new(scene, *k, &arrival.hit, branch.part));
                }
            }
            // In the order of the rays, the largest part of each first.
            shown.sort_by(|a, b| a.ray.cmp(&b.ray).then(b.part.total_cmp(&a.part)));
        }
        shown
    }

    /// A picture without a single front is black: refuses it, and says why.
    pub(crate) fn check(&self, camera: &Camera) -> Result<()> {
        let (origin, back) = (camera.origin(), self.back.load(Ordering::Relaxed));
        if self.front.load(Ordering::Relaxed) {
            return Ok(());
        }
        Err(Error::Invalid(if back == NO_PATCH {
            let [low, high] = [Vec3::min, Vec3::max]
                .map(|pick| self.scene.vertices().iter().copied().reduce(pick).unwrap_or(Vec3::ZERO));
            format!(
                "the camera at {origin} looks at nothing: no patch is in its view; the scene reaches from {low} to {high}"
            )
        } else {
            format!(
                "the camera at {origin} sees only the backs of patches (patch {back} among them): it stands inside a wall \
                 or a solid, outside a closed room, or the patches are wound clockwise"
            )
        }))
    }
}

/// Refuses an image without pixels, and one of more than `memory` bytes at `bytes` for every pixel and band.
pub(crate) fn check_size([width, height, bands]: [usize; 3], bytes: u64, memory: u64) -> Result<()> {
    if width == 0 || height == 0 {
        return Err(Error::Invalid(format!("an image of {width} x {height} pixels is empty; both must be at least 1")));
    }
    let needed = [width, height, bands].iter().fold(bytes, |bytes, &k| bytes.saturating_mul(k as u64));
    if needed <= memory {
        return Ok(());
    }
    Err(Error::Memory {
        what: format!("an image of {width} x {height} pixels in {bands} bands"),
        needed,
        available: memory,
        remedy: "choose fewer pixels".to_string(),
    })
}

/// The marked pixels of an image with rows of `width`, and those around them: few samples of a pixel agree by chance.
pub(super) fn around(marked: &[bool], width: usize) -> Vec<bool> {
    let height = marked.len() / width;
    let near = |k: usize, size: usize| k.saturating_sub(1)..(k + 2).min(size);
    let is_near = |k: usize| {
        let (x, y) = (k % width, k / width);
        near(y, height).any(|y| near(x, width).any(|x| marked[y * width + x]))
    };
    (0..marked.len()).into_par_iter().map(is_near).collect()
}
