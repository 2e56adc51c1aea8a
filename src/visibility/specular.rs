//! Rays followed over mirrors and through glass to the diffuse patch where they end.
//!
//! This is what makes the *extended* form factor of a patch (Sillion & Puech, "A general two-pass method integrating specular and
//! diffuse reflection", SIGGRAPH 1989): the part of its light that reaches another one straight or by way of any number of
//! mirrors and refractions. Diffuse patches exchange light as ever, with F_ij extended.
//!
//! A mirror sends d on as d - 2 (d n) n. Glass of index n splits light in two, by Fresnel's equations for unpolarised light:
//!
//!   R = (r_s^2 + r_p^2) / 2,  r_s = (c - n c') / (c + n c'),  r_p = (n c - c') / (n c + c'),  n sin' = sin
//!
//! A ray does not split: it goes either way with the probability of that part, and ends at a mirror with the probability that the
//! mirror absorbs it, so that whatever arrives counts in full (Kajiya 1986). Chance is a hash of the direction and of the number of
//! turns before: the same ray always goes the same way, and one that comes back to where it was does not go round for ever.
//!
//! Limits. Glass is clear, and a closed body with nothing diffuse in it: radiance is n^2 times as high within, which cancels only
//! where light leaves again. A ray that is still under way after [`MOST`] turns is taken to be absorbed.

use super::{Bvh, Hit, Ray};
use crate::geometry::Vec3;
use crate::geometry::sampling::hash;
use crate::scene::{Material, Scene};

/// Turns that a ray takes at most.
const MOST: u32 = 1024;

/// A diffuse patch that a ray has met from its front.
#[derive(Debug, Clone, Copy)]
pub struct Arrival {
    /// The patch; its `t` is the length of the last part of the way.
    pub hit: Hit,
    /// Length of the way, in lengths of the ray's first direction.
    pub distance: f64,
}

/// Where a ray ends.
#[derive(Debug, Clone, Copy)]
pub enum End {
    /// On the front of a diffuse patch.
    Arrived(Arrival),
    /// In a mirror.
    Absorbed,
    /// Nowhere, or on the back of a patch.
    Lost,
}

impl End {
    /// Where it arrived, if it did.
    pub fn arrival(self) -> Option<Arrival> {
        match self {
            End::Arrived(arrival) => Some(arrival),
            End::Absorbed | End::Lost => None,
        }
    }
}

/// A way on from a patch that is not diffuse, and the part of the light that takes it.
#[derive(Debug, Clone, Copy)]
pub struct Branch {
    /// The ray that goes on.
    pub ray: Ray,
    /// The part.
    pub part: f64,
}

/// Follows rays until they end. `tree` must hold all patches of the scene.
pub fn follow(scene: &Scene, tree: &Bvh, rays: &[Ray]) -> Vec<End> {
    follow_past_mirrors(scene, tree, rays, |_, _| {})
}

/// The same; `at_mirror` hears the number of the ray and the patch whenever one falls on a mirror.
pub fn follow_past_mirrors(scene: &Scene, tree: &Bvh, rays: &[Ray], mut at_mirror: impl FnMut(usize, u32)) -> Vec<End> {
    let mut ends = vec![End::Lost; rays.len()];
    let mut under_way: Vec<(usize, Ray, f64)> = rays.iter().enumerate().map(|(k, ray)| (k, *ray, 0.0)).collect();
    let mut turns = 0;
    while !under_way.is_empty() {
        let next: Vec<Ray> = under_way.iter().map(|(_, ray, ..)| *ray).collect();
        let hits = tree.closest(&next);
        let mut on = Vec::new();
        for ((k, ray, distance), hit) in under_way.into_iter().zip(hits) {
            let Some(hit) = hit else { continue };
            let distance = distance + hit.t;
            let is_front = scene.normals()[hit.patch as usize].dot(ray.direction) < 0.0;
            match scene.material(hit.patch as usize) {
                Material::Diffuse | Material::Mirror(_) if !is_front => {}
                Material::Diffuse => {
                    ends[k] = End::Arrived(Arrival { hit, distance });
                }
                material => {
                    if matches!(material, Material::Mirror(_)) {
                        at_mirror(k, hit.patch);
                    }
                    match chosen(scene, &ray, &hit, turns) {
                        Some(ray) if turns < MOST => on.push((k, ray, distance)),
                        _ => ends[k] = End::Absorbed,
                    }
                }
            }
        }
        under_way = on;
        turns += 1;
    }
    ends
}

/// The ways on for a ray that has met a patch that is not diffuse, on a side from which it goes on: one of a mirror, two of glass.
pub fn branches(scene: &Scene, ray: &Ray, hit: &Hit) -> [Option<Branch>; 2] {
    let patch = hit.patch as usize;
    let d = ray.direction;
    let [a, b, c] = scene.triangle(patch);
    let [v, w] = hit.barycentric;
    let origin = a + v * (b - a) + w * (c - a);
    let normal = scene.normals()[patch];
    // Against the ray.
    let normal = if normal.dot(d) < 0.0 { normal } else { -normal };
    let on = |direction: Vec3, part: f64| {
        (part > 0.0).then_some(Branch { ray: Ray { origin, direction, exclude: hit.patch }, part })
    };
    let mirrored = d - 2.0 * d.dot(normal) * normal;
    match scene.material(patch) {
        Material::Diffuse => [None, None],
        Material::Mirror(reflected) => [on(mirrored, reflected), None],
        Material::Glass(ior) => {
            // Of what is behind the surface over what is before it.
            let n = if scene.normals()[patch].dot(d) < 0.0 { ior } else { 1.0 / ior };
            let size = d.length();
            let cosine = (-normal.dot(d) / size).min(1.0);
            let squared = 1.0 - (1.0 - cosine * cosine) / (n * n);
            if squared <= 0.0 {
                return [on(mirrored, 1.0), None];
            }
            let refracted_cosine = squared.sqrt();
            let r_s = (cosine - n * refracted_cosine) / (cosine + n * refracted_cosine);
            let r_p = (n * cosine - refracted_cosine) / (n * cosine + refracted_cosine);
            let reflected = 0.5 * (r_s * r_s + r_p * r_p);
            let refracted = (1.0 / n) * (d + size * cosine * normal) - size * refracted_cosine * normal;
            [on(refracted, 1.0 - reflected), on(mirrored, reflected)]
        }
    }
}

/// One of the ways on after so many `turns`, by chance; none where the light is absorbed.
pub fn chosen(scene: &Scene, ray: &Ray, hit: &Hit, turns: u32) -> Option<Ray> {
    let [x, y, z] = ray.direction.to_array().map(f64::to_bits);
    // 53 bits: uniform in [0, 1).
    let mut left = (hash(x ^ hash(y ^ hash(z ^ (u64::from(turns) << 32 | u64::from(hit.patch))))) >> 11) as f64
        / (1u64 << 53) as f64;
    for branch in branches(scene, ray, hit).into_iter().flatten() {
        if left < branch.part {
            return Some(branch.ray);
        }
        left -= branch.part;
    }
    None
}
