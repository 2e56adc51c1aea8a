//! A patch that sends out rays, and who receives them: what both estimators by rays share.
//!
//!   F_ij = 1/A_i  integral over A_i  integral over the hemisphere of  [w meets the front of j first]  cos / pi dw dA_i
//!
//! This is the double integral over areas of [`crate::form_factor`] with dw = cos_j dA_j / r^2 (Cohen & Wallace 1993).
//! Occlusion needs no factor of its own: what a ray meets first is what receives it. A ray that meets the back of a
//! patch is lost: it reaches nobody, and does not leave the scene either.

use crate::geometry::{Triangle, Vec3};
use crate::scene::Scene;
use crate::visibility::{Bvh, Ray};

/// Rays that are cast together.
pub(super) const BUNDLE: usize = 1024;

/// Patch i of a scene, ready to send out rays.
#[derive(Clone, Copy)]
pub struct Emitter<'a> {
    scene: &'a Scene,
    tree: &'a Bvh,
    patch: u32,
    /// Its corners.
    pub(super) triangle: Triangle,
    normal: Vec3,
    tangents: [Vec3; 2],
}

impl<'a> Emitter<'a> {
    /// Patch `i` of a scene, whose tree is [`Bvh::of_scene`].
    pub fn new(scene: &'a Scene, tree: &'a Bvh, i: usize) -> Emitter<'a> {
        let normal = scene.normals()[i];
        let tangents = normal.any_orthonormal_pair().into();
        Emitter { scene, tree, patch: i as u32, triangle: scene.triangle(i), normal, tangents }
    }

    /// Number of the patch, as a stream of random numbers wants it.
    pub(super) fn stream(&self) -> u64 {
        u64::from(self.patch)
    }

    /// The same patch with its tangents turned about the normal.
    pub(super) fn turned(self, angle: f64) -> Emitter<'a> {
        let ([x, y], (sine, cosine)) = (self.tangents, angle.sin_cos());
        Emitter { tangents: [cosine * x + sine * y, cosine * y - sine * x], ..self }
    }

    /// The ray from `origin` to where (x, y, z) points; z is along the normal.
    #[inline]
    pub(crate) fn ray(&self, origin: Vec3, [x, y, z]: [f64; 3]) -> Ray {
        let direction = x * self.tangents[0] + y * self.tangents[1] + z * self.normal;
        Ray { origin, direction, exclude: self.patch }
    }

    /// Casts the rays and calls `receive(k, j)` for every ray k that meets the front of a patch j.
    pub(super) fn cast(&self, rays: &[Ray], mut receive: impl FnMut(usize, u32)) {
        for (k, (ray, hit)) in rays.iter().zip(self.tree.closest(rays)).enumerate() {
            if let Some(hit) = hit
                && self.scene.normals()[hit.patch as usize].dot(ray.direction) < 0.0
            {
                receive(k, hit.patch);
            }
        }
    }
}

/// What the patches receive from one: a plain vector, with a list of the entries that are not 0.
#[derive(Debug, Default)]
pub struct Tally {
    amount: Vec<f64>,
    touched: Vec<u32>,
}

impl Tally {
    /// An empty one for `n` patches.
    pub fn new(n: usize) -> Tally {
        Tally { amount: vec![0.0; n], touched: Vec::new() }
    }

    /// Adds a positive amount to patch j.
    #[inline]
    pub(super) fn add(&mut self, j: u32, amount: f64) {
        let sum = &mut self.amount[j as usize];
        if *sum == 0.0 {
            self.touched.push(j);
        }
        *sum += amount;
    }

    /// The amounts that are not 0, in no particular order.
    pub(super) fn amounts(&self) -> impl Iterator<Item = f64> + '_ {
        self.touched.iter().map(|&j| self.amount[j as usize])
    }

    /// Empties it: the patches that received something, in their order, and what.
    pub(super) fn take(&mut self) -> Vec<(u32, f64)> {
        self.touched.sort_unstable();
        let amount = &mut self.amount;
        self.touched.drain(..).map(|j| (j, std::mem::take(&mut amount[j as usize]))).collect()
    }
}
