//! Indirect light gathered at few points of a picture, and interpolated between them (Ward, Rubinstein & Clear, "A ray tracing
//! solution for diffuse interreflection", SIGGRAPH 1988).
//!
//! The points lie on a square grid over the image, which is cut in four where light may change: where the corners of a cell are not
//! on one surface, or are further apart than a part of the harmonic mean distance R of what they see, which bounds the gradient
//! of their irradiance (Ward 1988, section 3). Elsewhere one point serves [`SPACING`]^2 pixels.

use rayon::prelude::*;

use super::Camera;
use super::sight::Sight;
use crate::direct::Surroundings;
use crate::direct::lamp::Point;
use crate::error::Result;
use crate::form_factor::emitter::Emitter;
use crate::geometry::sampling::{Sobol, cosine_direction, hash};
use crate::progress::Progress;
use crate::visibility::specular::follow;
use crate::visibility::{NO_PATCH, Ray};

/// Pixels between the points where nothing changes.
const SPACING: usize = 8;
/// Rays from each of these; half as many from points that are half as far apart.
const RAYS: usize = 80;
/// Cosine of the largest angle between two points that are taken to lie on one surface (3 degrees), and its sine.
const SAME: f64 = 0.9986;
const BENT: f64 = 0.052;
/// Points that are gathered at together.
const TOGETHER: usize = 16;

/// What light is gathered from.
pub(super) struct Gatherer<'a> {
    pub(super) surroundings: Surroundings<'a>,
    /// H of every patch, n x b.
    pub(super) irradiance: &'a [f64],
    /// What the camera sees of them.
    pub(super) sight: &'a Sight<'a>,
}

impl Gatherer<'_> {
    /// Irradiance at a point but for what comes straight from the lamps, added up in `out` over rays that carry rho H + E of what
    /// they meet:  H = mean of B over directions of density cos / pi. Returns 1/R, the mean of 1/distance.
    pub(super) fn gather(&self, points: &[Point], rays: usize, seeds: &[u64], out: &mut [f64]) -> Vec<f64> {
        let Surroundings { scene, tree, lamps, .. } = self.surroundings;
        let bands = scene.bands();
        let from = |(point, seed): (&Point, &u64)| {
            let emitter = Emitter::new(scene, tree, point.patch as usize);
            let (sobol, origin): (Sobol<2>, _) = (Sobol::new(*seed), point.x);
            (0..rays as u32).map(move |k| {
                let [s, t] = sobol.point(k);
                emitter.ray(origin, cosine_direction(s, t))
            })
        };
        let all: Vec<Ray> = points.iter().zip(seeds).flat_map(from).collect();
        let share = 1.0 / rays as f64;
        let (mut near, mut leaving) = (vec![0.0; points.len()], vec![0.0; bands]);
        for (k, end) in follow(scene, tree, &all).into_iter().enumerate() {
            let Some(arrival) = end.arrival() else { continue };
            near[k / rays] += share / arrival.distance;
            let j = arrival.hit.patch as usize;
            let own = j * bands..(j + 1) * bands;
            let reflected = scene.reflectance()[own.clone()].iter().zip(&self.irradiance[own]).map(|(rho, h)| rho * h);
            leaving.iter_mut().zip(reflected).for_each(|(leaving, reflected)| *leaving = reflected);
            lamps.add_glow(j, &mut leaving);
            let out = out[k / rays * bands..][..bands].iter_mut();
            out.zip(&leaving).for_each(|(out, leaving)| *out += share * leaving);
        }
        near
    }
}

/// A point of the grid at which light was gathered.
#[derive(Debug, Clone, Copy)]
struct Place {
    point: Point,
    /// Harmonic mean distance of what it sees.
    radius: f64,
}

/// Points of the grid that are not known yet, and those through which nothing is seen.
const UNKNOWN: u32 = u32::MAX;
const NOTHING: u32 = u32::MAX - 1;

/// Gathered light over one image.
pub(super) struct IrradianceCache {
    bands: usize,
    /// Where the grid's first point is in the image.
    offset: [f64; 2],
    columns: usize,
    /// Number of the place at every point of the finest grid, one a pixel.
    index: Vec<u32>,
    /// Size of the cell that holds every point of the finest grid.
    size: Vec<u8>,
    places: Vec<Place>,
    irradiance: Vec<f64>,
}

impl IrradianceCache {
    /// For an image of `width` x `height` pixels, on a grid that is moved by the seed. Cells are cut when they are larger than
    /// `detail` times R.
    pub(super) fn new(
        gatherer: &Gatherer,
        camera: &Camera,
        [width, height]: [usize; 2],
        detail: f64,
        seed: u64,
        progress: &Progress,
    ) -> Result<IrradianceCache> {
        let offset = Sobol::<2>::new(seed).point(0).map(|u| u * SPACING as f64);
        let [columns, rows] = [width, height].map(|size| size.div_ceil(SPACING) * SPACING + SPACING + 1);
        let mut cache = IrradianceCache {
            bands: gatherer.surroundings.scene.bands(),
            offset,
            columns,
            index: vec![UNKNOWN; columns * rows],
            size: vec![1; columns * rows],
            places: Vec::new(),
            irradiance: Vec::new(),
        };
        let of_row = |y: usize| (0..columns - 1).step_by(SPACING).map(move |x| [x, y]);
        let mut cells: Vec<[usize; 2]> = (0..rows - 1).step_by(SPACING).flat_map(of_row).collect();
        let mut size = SPACING;
        while !cells.is_empty() {
            let rays = RAYS * size / SPACING;
            cache.fill(gatherer, camera, [width, height], &cells, size, rays, seed, progress)?;
            let mut next = Vec::new();
            for [x, y] in cells {
                if size > 1 && cache.is_uneven([x, y], size, detail) {
                    let half = size / 2;
                    next.extend([[x, y], [x + half, y], [x, y + half], [x + half, y + half]]);
                } else {
                    (y..y + size).for_each(|y| cache.size[y * columns + x..][..size].fill(size as u8));
                }
            }
            (cells, size) = (next, size / 2);
        }
        Ok(cache)
    }

    /// Gathers at the corners of cells where nobody has.
    #[expect(clippy::too_many_arguments, reason = "of one caller")]
    fn fill(
        &mut self,
        gatherer: &Gatherer,
        camera: &Camera,
        [width, height]: [usize; 2],
        cells: &[[usize; 2]],
        size: usize,
        rays: usize,
        seed: u64,
        progress: &Progress,
    ) -> Result<()> {
        let mut wanted: Vec<usize> = cells.iter().flat_map(|cell| self.corners(*cell, size)).collect();
        wanted.retain(|&at| self.index[at] == UNKNOWN);
        wanted.sort_unstable();
        wanted.dedup();
        let (columns, bands, offset) = (self.columns, self.bands, self.offset);
        let look = |at: &[usize]| {
            progress.advance(0)?;
            let ray = |&at: &usize| {
                let [x, y] = [(at % columns) as f64 - offset[0], (at / columns) as f64 - offset[1]];
                Ray { origin: camera.origin(), direction: camera.direction(x, y, width, height), exclude: NO_PATCH }
            };
            let rays_there: Vec<Ray> = at.iter().map(ray).collect();
            let mut shown = gatherer.sight.look(gatherer.surroundings.tree, &rays_there);
            shown.dedup_by_key(|shown| shown.ray);
            let (met, points): (Vec<usize>, Vec<Point>) =
                shown.iter().map(|shown| (at[shown.ray], shown.point)).unzip();
            let seeds: Vec<u64> = met.iter().map(|&at| hash(seed ^ hash(at as u64))).collect();
            let mut irradiance = vec![0.0; met.len() * bands];
            let near = gatherer.gather(&points, rays, &seeds, &mut irradiance);
            let places: Vec<Place> =
                points.into_iter().zip(near).map(|(point, near)| Place { point, radius: 1.0 / near }).collect();
            Ok((met, places, irradiance))
        };
        let found: Result<Vec<_>> = wanted.par_chunks(TOGETHER).map(look).collect();
        wanted.iter().for_each(|&at| self.index[at] = NOTHING);
        for (at, places, irradiance) in found? {
            at.iter().enumerate().for_each(|(k, &at)| self.index[at] = (self.places.len() + k) as u32);
            self.places.extend(places);
            self.irradiance.extend(irradiance);
        }
        Ok(())
    }

    fn corners(&self, [x, y]: [usize; 2], size: usize) -> [usize; 4] {
        let first = y * self.columns + x;
        let below = first + size * self.columns;
        [first, first + size, below, below + size]
    }

    fn place(&self, at: usize) -> Option<&Place> {
        self.places.get(self.index[at] as usize)
    }

    /// Whether light may change within a cell.
    fn is_uneven(&self, cell: [usize; 2], size: usize, detail: f64) -> bool {
        let corners = self.corners(cell, size).map(|at| self.place(at));
        if corners.iter().all(Option::is_none) {
            return false;
        }
        let [Some(a), Some(b), Some(c), Some(d)] = corners else { return true };
        let nearest = a.radius.min(b.radius).min(c.radius).min(d.radius);
        let extent = a.point.x.distance(d.point.x).max(b.point.x.distance(c.point.x));
        extent > detail * nearest || [b, c, d].iter().any(|other| !is_same_surface(&a.point, &other.point))
    }

    /// Adds the irradiance at a point seen at (x, y) in the image; false when no place near by lies on its surface.
    pub(super) fn add(&self, [x, y]: [f64; 2], point: &Point, out: &mut [f64]) -> bool {
        let [x, y] = [x + self.offset[0], y + self.offset[1]];
        let size = self.size[y as usize * self.columns + x as usize] as usize;
        let cell = [x, y].map(|x| x as usize / size * size);
        let [u, v] = [x - cell[0] as f64, y - cell[1] as f64].map(|part| part / size as f64);
        let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
        let mut whole = 0.0;
        let fits = self.corners(cell, size).map(|at| {
            self.place(at).filter(|place| is_same_surface(&place.point, point)).map(|_| self.index[at] as usize)
        });
        for (weight, fit) in weights.iter().zip(fits) {
            whole += if fit.is_some() { *weight } else { 0.0 };
        }
        // What is next to nothing says nothing.
        if whole < 1e-3 {
            return false;
        }
        for (weight, fit) in weights.iter().zip(fits) {
            if let Some(place) = fit {
                let row = &self.irradiance[place * self.bands..][..self.bands];
                out.iter_mut().zip(row).for_each(|(out, h)| *out += weight / whole * h);
            }
        }
        true
    }
}

/// Whether two points lie on one surface, flat or nearly so.
pub(super) fn is_same_surface(a: &Point, b: &Point) -> bool {
    a.patch == b.patch
        || a.normal.dot(b.normal) >= SAME && (b.x - a.x).dot(a.normal).abs() <= BENT * (b.x - a.x).length()
}
