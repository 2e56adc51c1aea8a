//! The image of a solution: rays through the pixels, and the radiance L = B / pi of the patch that each meets.
//!
//! Flat shading shows B as it was solved, one value a patch. Smooth shading shows L = (E + rho H) / pi with E and rho of the patch
//! itself and H interpolated between its [`Corners`]. A ray through the middle of every pixel is all where its neighbours show
//! the same; at edges the mean of [`RAYS_AT_EDGES`] others takes its place.

use rayon::prelude::*;

use super::sight::{Sight, around, check_size};
use super::{Camera, Corners};
use crate::error::Result;
use crate::geometry::sampling::{Sobol, hash};
use crate::memory::filled;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::{Bvh, Hit, NO_PATCH, Ray};

/// How a patch's radiosity is spread over it.
#[derive(Debug, Clone, Copy)]
pub enum Shading<'a> {
    /// Constant: the radiosity B, n x b.
    Flat(&'a [f64]),
    /// The irradiance H, n x b, interpolated between the corners.
    Smooth(&'a Corners, &'a [f64]),
}

/// Which picture to make.
#[derive(Debug, Clone, Copy)]
pub struct Image<'a> {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Flat or smooth.
    pub shading: Shading<'a>,
}

/// Rays through a pixel whose radiance differs from that of a neighbour by more than this part.
const RAYS_AT_EDGES: u32 = 16;
const EVEN: f64 = 0.05;
/// Pixels whose rays are cast together.
const TOGETHER: usize = 128;

/// Radiance, W/(m^2 sr), height x width x bands, row 0 on top; the mean over each pixel. Backs and empty space are black.
///
/// `bvh` must hold all patches of the scene.
///
/// # Errors
/// [`crate::Error::Invalid`] when the image has no pixels, or the camera sees nothing or only backs; [`crate::Error::Memory`] when the
/// image needs more than `memory` bytes; [`crate::Error::Interrupted`].
pub fn render(
    scene: &Scene,
    bvh: &Bvh,
    camera: &Camera,
    image: Image<'_>,
    memory: u64,
    progress: &Progress,
) -> Result<Vec<f64>> {
    scene.require_diffuse("a flat or smooth picture")?;
    let (Image { width, height, shading }, bands) = (image, scene.bands());
    // The image, and the copy that the caller makes of it.
    check_size([width, height, bands], 16, memory)?;
    let corners = match shading {
        Shading::Flat(_) => Vec::new(),
        Shading::Smooth(corners, irradiance) => corners.irradiance(scene, irradiance),
    };
    let sight = Sight::new(scene);
    let radiance = |hit: &Hit, b: usize| {
        let k = hit.patch as usize * bands + b;
        let value = match shading {
            Shading::Flat(radiosity) => radiosity[k],
            Shading::Smooth(..) => {
                let [v, w] = hit.barycentric;
                let corner = |c: usize| corners[(3 * hit.patch as usize + c) * bands + b];
                let h = (1.0 - v - w) * corner(0) + v * corner(1) + w * corner(2);
                scene.emission()[k] + scene.reflectance()[k] * h
            }
        };
        value / std::f64::consts::PI
    };
    // Adds the mean over `places`, in pixels from the upper left corner, to `sums`: as many places for each pixel.
    let cast = |places: &[[f64; 2]], sums: &mut [f64]| {
        let through = |&[x, y]: &[f64; 2]| Ray {
            origin: camera.origin(),
            direction: camera.direction(x, y, width, height),
            exclude: NO_PATCH,
        };
        let rays: Vec<Ray> = places.iter().map(through).collect();
        let each = places.len() * bands / sums.len();
        for (k, (ray, hit)) in rays.iter().zip(bvh.closest(&rays)).enumerate() {
            if let Some(hit) = hit.filter(|hit| sight.is_front(hit, ray.direction)) {
                for (b, sum) in sums[k / each * bands..][..bands].iter_mut().enumerate() {
                    *sum += radiance(&hit, b) / each as f64;
                }
            }
        }
    };
    let mut pixels = filled(width * height * bands, 0.0)?;
    progress.expect(height as u64);
    pixels.par_chunks_mut(width * bands).enumerate().try_for_each(|(y, row)| {
        for (part, sums) in row.chunks_mut(TOGETHER * bands).enumerate() {
            let middle = |x: usize| [(part * TOGETHER + x) as f64 + 0.5, y as f64 + 0.5];
            let middles: Vec<[f64; 2]> = (0..sums.len() / bands).map(middle).collect();
            cast(&middles, sums);
        }
        progress.advance(0)
    })?;
    let uneven = around(&edges(&pixels, width, bands), width);
    pixels.par_chunks_mut(width * bands).enumerate().try_for_each(|(y, row)| {
        let wanted: Vec<usize> = (0..width).filter(|x| uneven[y * width + x]).collect();
        for wanted in wanted.chunks(TOGETHER / RAYS_AT_EDGES as usize) {
            let places = |&x: &usize| {
                let sobol: Sobol<2> = Sobol::new(hash((y * width + x) as u64));
                (0..RAYS_AT_EDGES).map(move |k| sobol.point(k)).map(move |[u, v]| [x as f64 + u, y as f64 + v])
            };
            let places: Vec<[f64; 2]> = wanted.iter().flat_map(places).collect();
            let mut means = vec![0.0; wanted.len() * bands];
            cast(&places, &mut means);
            for (&x, mean) in wanted.iter().zip(means.chunks_exact(bands)) {
                row[x * bands..][..bands].copy_from_slice(mean);
            }
        }
        progress.advance(1)
    })?;
    sight.check(camera)?;
    Ok(pixels)
}

/// Which pixels differ from their right or lower neighbour; a pixel alone has none to tell.
fn edges(pixels: &[f64], width: usize, bands: usize) -> Vec<bool> {
    let differ = |k: usize, other: usize| {
        let of = |k: usize| &pixels[k * bands..][..bands];
        of(k).iter().zip(of(other)).any(|(a, b)| (a - b).abs() > EVEN * a.abs().max(b.abs()))
    };
    let count = pixels.len() / bands;
    let is_edge = |k: usize| {
        count == 1 || (k % width + 1 < width && differ(k, k + 1)) || (k + width < count && differ(k, k + width))
    };
    (0..count).into_par_iter().map(is_edge).collect()
}
