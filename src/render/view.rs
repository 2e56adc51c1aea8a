//! The image of a solution: a ray through the pixels, and the radiance L = B / pi of the patch it meets.
//!
//! Flat shading shows B as it was solved, one value a patch. Smooth shading interpolates between the corners (Gouraud 1971;
//! Cohen & Greenberg 1985, section 7), but of the *irradiance*: L = (E + rho H) / pi with E and rho of the patch itself. So
//! neither a lamp nor a paint leaks over its border, only the light that arrives is smoothed. A corner's irradiance is the
//! area-weighted mean over the patches around it that lie within [`CREASE`] of the same orientation.

use std::collections::HashMap;
use std::ops::Range;

use rayon::prelude::*;

use super::Camera;
use super::sight::{Sight, check_size};
use crate::error::Result;
use crate::geometry::Vec3;
use crate::geometry::sampling::{Sobol, hash};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::{Bvh, Hit, NO_PATCH, Ray};

/// How a patch's radiosity is spread over it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shading {
    /// Constant.
    Flat,
    /// Irradiance interpolated between the corners.
    Smooth,
}

/// Which picture to make.
#[derive(Debug, Clone, Copy)]
pub struct Image {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Flat or smooth.
    pub shading: Shading,
}

/// Cosine of the largest angle between patches that are shaded as one surface: 40 degrees keeps boxes sharp and coarse
/// spheres round.
const CREASE: f64 = 0.766;
/// Rays through every pixel, and through pixels in which these meet different patches.
const RAYS: u32 = 8;
const RAYS_AT_EDGES: u32 = 32;
/// Pixels whose rays are cast together.
const TOGETHER: usize = 128;

/// Radiance, W/(m^2 sr), height x width x bands, row 0 on top; the mean over each pixel. Backs and empty space are black.
///
/// `irradiance` is H, n x b. `bvh` must hold all patches of the scene.
///
/// # Errors
/// [`Error::Invalid`] when the image has no pixels, or the camera sees nothing or only backs; [`Error::Memory`] when the
/// image needs more than `memory` bytes; [`Error::Interrupted`].
#[expect(clippy::too_many_arguments, reason = "a picture has this many ingredients")]
pub fn render(
    scene: &Scene,
    bvh: &Bvh,
    radiosity: &[f64],
    irradiance: &[f64],
    camera: &Camera,
    image: Image,
    memory: u64,
    progress: &Progress,
) -> Result<Vec<f64>> {
    let (Image { width, height, shading }, bands) = (image, scene.bands());
    // The image, and the copy that the caller makes of it.
    check_size([width, height, bands], 16, memory)?;
    let corners = match shading {
        Shading::Flat => Vec::new(),
        Shading::Smooth => corner_irradiance(scene, irradiance),
    };
    let sight = Sight::new(scene);
    let add_radiance = |hit: &Hit, direction: Vec3, out: &mut [f64]| {
        let i = hit.patch as usize;
        if !sight.is_front(hit, direction) {
            return;
        }
        for (b, out) in out.iter_mut().enumerate() {
            let k = i * bands + b;
            let value = match shading {
                Shading::Flat => radiosity[k],
                Shading::Smooth => {
                    let [v, w] = hit.barycentric;
                    let corner = |c: usize| corners[(3 * i + c) * bands + b];
                    let h = (1.0 - v - w) * corner(0) + v * corner(1) + w * corner(2);
                    scene.emission()[k] + scene.reflectance()[k] * h
                }
            };
            *out += value / std::f64::consts::PI;
        }
    };
    let mut pixels = vec![0.0; width * height * bands];
    progress.expect(height as u64);
    pixels.par_chunks_mut(width * bands).enumerate().try_for_each(|(y, row)| {
        for (part, pixels) in row.chunks_mut(TOGETHER * bands).enumerate() {
            let all: Vec<usize> = (0..pixels.len() / bands).collect();
            // Adds rays number `numbers` through these columns of the part; tells which of them meet different patches.
            let mut cast = |columns: &[usize], numbers: Range<u32>| -> Vec<bool> {
                let mut rays = Vec::with_capacity(columns.len() * numbers.len());
                for &column in columns {
                    let x = part * TOGETHER + column;
                    let sobol = Sobol::new(hash((y * width + x) as u64));
                    rays.extend(numbers.clone().map(|k| {
                        let [u, v] = sobol.point(k);
                        let direction = camera.direction(x as f64 + u, y as f64 + v, width, height);
                        Ray { origin: camera.origin(), direction, exclude: NO_PATCH }
                    }));
                }
                let hits = bvh.closest(&rays);
                let (rays, hits) = (rays.chunks_exact(numbers.len()), hits.chunks_exact(numbers.len()));
                let pixel_of = |column: usize| column * bands..(column + 1) * bands;
                columns
                    .iter()
                    .zip(rays.zip(hits))
                    .map(|(&column, (rays, hits))| {
                        let met = rays.iter().zip(hits).filter_map(|(ray, hit)| Some((ray, hit.as_ref()?)));
                        met.for_each(|(ray, hit)| add_radiance(hit, ray.direction, &mut pixels[pixel_of(column)]));
                        let patch = |hit: &Option<Hit>| hit.map(|hit| hit.patch);
                        hits.iter().any(|hit| patch(hit) != patch(&hits[0]))
                    })
                    .collect()
            };
            let at_edge = cast(&all, 0..RAYS);
            let edges: Vec<usize> = all.into_iter().filter(|&column| at_edge[column]).collect();
            cast(&edges, RAYS..RAYS_AT_EDGES);
            for (pixel, at_edge) in pixels.chunks_exact_mut(bands).zip(at_edge) {
                let rays = if at_edge { RAYS_AT_EDGES } else { RAYS };
                pixel.iter_mut().for_each(|value| *value /= f64::from(rays));
            }
        }
        progress.advance(1)
    })?;
    sight.check(camera)?;
    Ok(pixels)
}

/// The irradiance at the three corners of every patch, n x 3 x b.
fn corner_irradiance(scene: &Scene, irradiance: &[f64]) -> Vec<f64> {
    let bands = scene.bands();
    // Corners are the same when they are at the same place, whatever their index.
    let mut around: HashMap<[u64; 3], Vec<u32>> = HashMap::new();
    let key = |v: u32| scene.vertices()[v as usize].to_array().map(|x| (x + 0.0).to_bits());
    for (i, face) in scene.faces().iter().enumerate() {
        face.iter().for_each(|&v| around.entry(key(v)).or_default().push(i as u32));
    }
    let mut out = vec![0.0; scene.len() * 3 * bands];
    out.par_chunks_mut(3 * bands).enumerate().for_each(|(i, out)| {
        for (c, out) in out.chunks_exact_mut(bands).enumerate() {
            let mut area = 0.0;
            for &j in &around[&key(scene.faces()[i][c])] {
                let j = j as usize;
                if scene.normals()[i].dot(scene.normals()[j]) >= CREASE {
                    area += scene.areas()[j];
                    for (out, h) in out.iter_mut().zip(&irradiance[j * bands..][..bands]) {
                        *out += scene.areas()[j] * h;
                    }
                }
            }
            out.iter_mut().for_each(|out| *out /= area);
        }
    });
    out
}
