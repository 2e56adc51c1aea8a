//! Scenes from which no light escapes, and an operator that loses none of it there, and makes none anywhere.
//!
//! In a closed scene every row of F sums to 1. Links miss that by a part of their error, of one sign where they miss the same
//! near fields; and where reflectance is rho, what is missing counts up to 1 / (1 - rho) times. What a leaf should have received
//! from light that is the same everywhere, but did not, is given to it from itself:
//!
//!   F'_ii = F_ii + 1 - sum over j of F_ij
//!
//! Reciprocity is as exact as before, and light that is the same everywhere stays so: a furnace is solved exactly. In an open
//! scene nobody knows what rows sum to, but never to more than 1: what is above is taken away, or light would grow without end in
//! a white room with a small hole.

use rayon::prelude::*;

use super::links::Links;
use crate::assembly::FormFactors;
use crate::assembly::rays::Sample;
use crate::form_factor::emitter::Emitter;
use crate::geometry::sampling::{cosine_direction, point_in_triangle};
use crate::scene::Scene;
use crate::visibility::Bvh;

/// Rays from each patch that look for a way out, and from all together at least.
const RAYS: usize = 8;
const LEAST_RAYS: usize = 1 << 14;

/// Whether every ray of a sample from a scene's patches arrives at the front of another: a hole of less than about 1 / (number
/// of rays) of the walls may stay unseen.
pub fn is_closed(scene: &Scene, seed: u64) -> bool {
    let tree = Bvh::of_scene(scene);
    let count = RAYS.max(LEAST_RAYS.div_ceil(scene.len())) as u32;
    (0..scene.len()).into_par_iter().all(|i| {
        let emitter = Emitter::new(scene, &tree, i);
        let triangle = scene.triangle(i);
        let ray = |sample: Sample| {
            let [s, t, u, v, ..] = sample.numbers;
            emitter.ray(point_in_triangle(&triangle, u, v), cosine_direction(s, t))
        };
        let rays: Vec<_> = Sample::rays(seed, i as u32, 0, 0..count).map(ray).collect();
        let arrives = |(ray, hit): (&crate::visibility::Ray, Option<crate::visibility::Hit>)| {
            hit.is_some_and(|hit| scene.normals()[hit.patch as usize].dot(ray.direction) < 0.0)
        };
        rays.iter().zip(tree.closest(&rays)).all(arrives)
    })
}

/// Links of which no row sums to more than 1, and in a closed scene none to less.
pub struct Balanced<'a> {
    links: &'a Links,
    /// For every row of the links what its leaf gets from itself of light that is 1 everywhere.
    given: Vec<f64>,
    /// What is still missing then, and has left the scene.
    pub left: Vec<f64>,
}

impl<'a> Balanced<'a> {
    /// Measures what is missing.
    pub fn new(links: &'a Links, is_closed: bool) -> Balanced<'a> {
        let missing = links.missing();
        let given: Vec<f64> = if is_closed {
            missing.clone()
        } else {
            let excess = |(missing, row): (&f64, &(u32, u32))| if row.1 == 0 { missing.min(0.0) } else { 0.0 };
            missing.iter().zip(links.rows()).map(excess).collect()
        };
        let left = missing.iter().zip(&given).map(|(missing, given)| missing - given).collect();
        Balanced { links, given, left }
    }

    /// What is taken away from the leaf of row r of light that is 1 everywhere, because its row would sum to more than 1.
    pub fn taken(&self, r: usize) -> f64 {
        (-self.given[self.first(r)]).max(0.0)
    }

    /// The first row of the leaf of row r.
    fn first(&self, r: usize) -> usize {
        r - self.links.rows()[r].1 as usize
    }

    /// Adds what leaf rows `r`.. receive from themselves.
    fn add(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        for (r, given) in self.given.iter().enumerate() {
            let first = self.first(r);
            for b in 0..bands {
                out[r * bands + b] += given * x[first * bands + b];
                if r != first {
                    out[first * bands + b] += given * x[r * bands + b];
                }
            }
        }
    }
}

impl FormFactors for Balanced<'_> {
    fn len(&self) -> usize {
        self.links.len()
    }

    fn areas(&self) -> Option<&[f64]> {
        self.links.areas()
    }

    fn gather(&self, i: usize, x: &[f64], out: &mut [f64]) {
        let bands = out.len();
        let mut all = vec![0.0; x.len()];
        self.apply(x, bands, &mut all);
        out.copy_from_slice(&all[i * bands..][..bands]);
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        let bands = amount.len();
        let mut x = vec![0.0; out.len()];
        x[i * bands..][..bands].copy_from_slice(amount);
        let mut all = vec![0.0; out.len()];
        self.apply(&x, bands, &mut all);
        out.iter_mut().zip(all).for_each(|(out, h)| *out += h);
    }

    fn apply(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        self.links.apply(x, bands, out);
        self.add(x, bands, out);
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        let mut x = vec![0.0; out.len()];
        x[i] = 1.0;
        self.apply(&x, 1, out);
        let areas = self.links.areas().unwrap_or(&[]);
        out.iter_mut().zip(areas).for_each(|(f, area)| *f *= area / areas[i]);
    }

    fn nbytes(&self) -> usize {
        self.links.nbytes() + size_of_val(self.given.as_slice()) + size_of_val(self.left.as_slice())
    }
}
