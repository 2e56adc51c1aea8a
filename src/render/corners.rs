//! The irradiance at the corners of patches, from which pictures interpolate (Gouraud 1971; Cohen & Greenberg 1985, section 7).
//!
//! Of the *irradiance*, not the radiosity: so neither a lamp nor a paint leaks over its border, only the light that arrives is
//! smoothed. A corner's irradiance is the area-weighted mean over the patches around it that lie within [`CREASE`] of the
//! same orientation.

use std::collections::HashMap;

use rayon::prelude::*;

use crate::scene::{Material, Scene};

/// Cosine of the largest angle between patches that are shaded as one surface: 40 degrees keeps boxes sharp and coarse
/// spheres round.
const CREASE: f64 = 0.766;

/// Which patches share each corner of each patch.
#[derive(Debug)]
pub struct Corners {
    /// Where the patches of corner c of patch i end, at 3 i + c.
    ends: Vec<usize>,
    patches: Vec<u32>,
}

impl Corners {
    /// The corners of a scene. They are the same when they are at the same place, whatever their index.
    pub fn new(scene: &Scene) -> Corners {
        let mut around: HashMap<[u64; 3], Vec<u32>> = HashMap::new();
        let key = |v: u32| scene.vertices()[v as usize].to_array().map(|x| (x + 0.0).to_bits());
        for (i, face) in scene.faces().iter().enumerate() {
            face.iter().for_each(|&v| around.entry(key(v)).or_default().push(i as u32));
        }
        let (mut ends, mut patches) = (Vec::with_capacity(3 * scene.len()), Vec::new());
        for (i, (face, normal)) in scene.faces().iter().zip(scene.normals()).enumerate() {
            for &v in face {
                // Mirrors and glass have no light of their own to lend.
                let lends = |j: usize| j == i || scene.material(j) == Material::Diffuse;
                let is_level = |&&j: &&u32| lends(j as usize) && normal.dot(scene.normals()[j as usize]) >= CREASE;
                patches.extend(around[&key(v)].iter().filter(is_level));
                ends.push(patches.len());
            }
        }
        Corners { ends, patches }
    }

    /// The irradiance at the corners of every patch of the same scene, n x 3 x b, from H of the patches, n x b.
    pub fn irradiance(&self, scene: &Scene, irradiance: &[f64]) -> Vec<f64> {
        let bands = scene.bands();
        let mut out = vec![0.0; self.ends.len() * bands];
        out.par_chunks_mut(bands).enumerate().for_each(|(corner, out)| {
            let first = if corner == 0 { 0 } else { self.ends[corner - 1] };
            let mut area = 0.0;
            for &j in &self.patches[first..self.ends[corner]] {
                let j = j as usize;
                area += scene.areas()[j];
                for (out, h) in out.iter_mut().zip(&irradiance[j * bands..][..bands]) {
                    *out += scene.areas()[j] * h;
                }
            }
            out.iter_mut().for_each(|out| *out /= area);
        });
        out
    }
}
