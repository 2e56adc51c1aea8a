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
use super::sight::{Sight, around, check_size};
use crate::error::Result;
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
/// Rays through every pixel, and through those where the radiance of two rays differs by more than this part.
const RAYS: u32 = 2;
const RAYS_AT_EDGES: u32 = 16;
const EVEN: f64 = 0.05;
/// Pixels whose rays are cast together.
const TOGETHER: usize = 128;

/// Radiance, W/(m^2 sr), height x width x bands, row 0 on top; the mean over each pixel. Backs and empty space are black.
///
/// `irradiance` is H, n x b. `bvh` must hold all patches of the scene.
///
/// # Errors
/// [`crate::Error::Invalid`] when the image has no pixels, or the camera sees nothing or only backs; [`crate::Error::Memory`] when the
/// image needs more than `memory` bytes; [`crate::Error::Interrupted`].
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
    let radiance = |hit: &Hit, b: usize| {
        let k = hit.patch as usize * bands + b;
        let value = match shading {
            Shading::Flat => radiosity[k],
            Shading::Smooth => {
                let [v, w] = hit.barycentric;
                let corner = |c: usize| corners[(3 * hit.patch as usize + c) * bands + b];
                let h = (1.0 - v - w) * corner(0) + v * corner(1) + w * corner(2);
                scene.emission()[k] + scene.reflectance()[k] * h
            }
        };
        value / std::f64::consts::PI
    };
    let mut pixels = vec![0.0; width * height * bands];
    progress.expect(height as u64);
    // The sum of rays number `numbers` through these pixels, and whether they differ.
    let cast = |wanted: &[usize], numbers: Range<u32>, sums: &mut [f64]| -> Vec<bool> {
        let through = |&pixel: &usize| {
            let sobol = Sobol::new(hash(pixel as u64));
            numbers.clone().map(move |k| {
                let [u, v] = sobol.point(k);
                let [x, y] = [pixel % width, pixel / width].map(|x| x as f64);
                let direction = camera.direction(x + u, y + v, width, height);
                Ray { origin: camera.origin(), direction, exclude: NO_PATCH }
            })
        };
        let rays: Vec<Ray> = wanted.iter().flat_map(through).collect();
        let hits = bvh.closest(&rays);
        let each = numbers.len();
        let of_pixel = |(pixel, sums): (usize, &mut [f64])| {
            let own = pixel * each..(pixel + 1) * each;
            let fronts: Vec<Option<Hit>> =
                own.map(|k| hits[k].filter(|hit| sight.is_front(hit, rays[k].direction))).collect();
            let range = |b: usize| {
                let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
                for value in fronts.iter().map(|hit| hit.as_ref().map_or(0.0, |hit| radiance(hit, b))) {
                    sums[b] += value;
                    (low, high) = (low.min(value), high.max(value));
                }
                high - low > EVEN * high.abs().max(low.abs())
            };
            // Every band has to be summed.
            (0..bands).map(range).fold(false, |any, differs| any | differs)
        };
        sums.chunks_exact_mut(bands).enumerate().map(of_pixel).collect()
    };
    let mut differs = vec![false; width * height];
    let rows = pixels.par_chunks_mut(width * bands).zip(differs.par_chunks_mut(width)).enumerate();
    rows.try_for_each(|(y, (row, differs))| {
        for (part, (sums, differs)) in row.chunks_mut(TOGETHER * bands).zip(differs.chunks_mut(TOGETHER)).enumerate() {
            let first = y * width + part * TOGETHER;
            let all: Vec<usize> = (first..first + differs.len()).collect();
            differs.copy_from_slice(&cast(&all, 0..RAYS, sums));
        }
        row.iter_mut().for_each(|sum| *sum /= f64::from(RAYS));
        progress.advance(0)
    })?;
    let uneven = around(&differs, width);
    pixels.par_chunks_mut(width * bands).enumerate().try_for_each(|(y, row)| {
        let wanted: Vec<usize> = (y * width..(y + 1) * width).filter(|pixel| uneven[*pixel]).collect();
        for wanted in wanted.chunks(TOGETHER) {
            let mut more = vec![0.0; wanted.len() * bands];
            cast(wanted, RAYS..RAYS_AT_EDGES, &mut more);
            for (&pixel, more) in wanted.iter().zip(more.chunks_exact(bands)) {
                for (value, more) in row[(pixel - y * width) * bands..][..bands].iter_mut().zip(more) {
                    *value = (*value * f64::from(RAYS) + more) / f64::from(RAYS_AT_EDGES);
                }
            }
        }
        progress.advance(1)
    })?;
    sight.check(camera)?;
    Ok(pixels)
}

/// The irradiance at the three corners of every patch, n x 3 x b.
pub fn corner_irradiance(scene: &Scene, irradiance: &[f64]) -> Vec<f64> {
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
