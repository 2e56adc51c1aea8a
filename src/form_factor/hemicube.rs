//! One row of F by the hemicube (Cohen & Greenberg 1985): half a cube over a point of the patch, its five faces cut
//! into cells, and in each cell the patch that is seen through its middle (the item buffer).
//!
//!   F_ij = mean over the points of  sum over the cells that show the front of j of  dF
//!
//! The delta form factor dF of a cell is the fraction of what leaves the point that goes through it. On the top, at
//! height 1, and on a side, at distance 1 with the height z above the patch, its density is
//!
//!   1 / (pi (x^2 + y^2 + 1)^2),    z / (pi (y^2 + z^2 + 1)^2)
//!
//! Taken here is not the density in the middle of the cell but its integral over the cell, from the antiderivatives
//!
//!   P(x, y) = [x / sqrt(1 + x^2) atan(y / sqrt(1 + x^2)) + y / sqrt(1 + y^2) atan(x / sqrt(1 + y^2))] / (2 pi)
//!   S(y, z) = -atan(y / sqrt(1 + z^2)) / (2 pi sqrt(1 + z^2))
//!
//! (the closed forms of a point and a rectangle parallel or perpendicular to it: Howell, B-3 and B-4), so that the
//! delta form factors sum to 1 at every resolution, to rounding, and nothing has to be normalised.
//!
//! The method assumes three things, none of which holds quite (Baum, Rushmeier & Winget 1989):
//!
//! - proximity: seen from anywhere on the patch the others look the same. It fails close to corners and edges.
//! - visibility: what is hidden from the middle of the patch is hidden from all of it.
//! - aliasing: a patch covers each cell as a whole or not at all. A patch smaller than a cell may be missed.
//!
//! Both kinds of error are measured, and added: aliasing by half the resolution at other angles about the normal,
//! proximity and visibility by a quarter as many points, which are others too. The larger of the two is refined until
//! their sum is within the tolerance. Both compare with something coarser, so they mostly overstate the error of what
//! is returned. The points are quasi-random because a regular grid may deceive: on the floor under a box, four and
//! sixteen centroids can agree on the hidden part and be wrong. What no cell of any resolution has met is in neither.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::OnceLock;

use super::emitter::{BUNDLE, Emitter, Tally};
use crate::error::Result;
use crate::geometry::Vec3;
use crate::geometry::sampling::{Random, Sobol, hash, point_in_triangle};
use crate::progress::Progress;

/// Cells along an edge of the top of the coarsest hemicube.
const COARSEST: u32 = 16;
/// Number of resolutions: 16, 32, .. 1024.
const RESOLUTIONS: usize = 7;
/// Number of sets of points: 1, 4, .. 256.
const POINT_SETS: u32 = 5;
/// One evaluation of a row casts no more rays than this.
const MOST_RAYS: u64 = 1 << 22;

/// Delta form factors of every resolution, each made when it is first asked for.
#[derive(Debug, Default)]
pub struct Hemicubes([OnceLock<Hemicube>; RESOLUTIONS]);

/// The cells of a hemicube with r x r of them on its top and r x r/2 on each side.
#[derive(Debug, Clone)]
pub struct Hemicube {
    resolution: u32,
    /// Delta form factors of a quarter of the top, r/2 x r/2: the others are mirror images.
    top: Vec<f64>,
    /// Delta form factors of the right half of a side, r/2 rows of r/2 from the bottom up.
    side: Vec<f64>,
}

impl Hemicube {
    /// The hemicube of an even resolution.
    pub fn new(resolution: u32) -> Hemicube {
        let half = resolution / 2;
        let at = |k: u32| f64::from(k) / f64::from(half);
        let table = |antiderivative: fn(f64, f64) -> f64| {
            let cell = |a: u32, b: u32| {
                let [x, u, y, v] = [at(a), at(a + 1), at(b), at(b + 1)];
                antiderivative(u, v) - antiderivative(x, v) - antiderivative(u, y) + antiderivative(x, y)
            };
            (0..half).flat_map(|b| (0..half).map(move |a| (a, b))).map(|(a, b)| cell(a, b)).collect()
        };
        Hemicube { resolution, top: table(top_antiderivative), side: table(side_antiderivative) }
    }

    /// Number of cells, 3 r^2.
    fn cells(&self) -> u64 {
        cells(self.resolution)
    }

    /// Calls `visit(direction, delta form factor)` for every cell; z is along the normal. The first error ends it.
    pub fn try_for_each(&self, mut visit: impl FnMut([f64; 3], f64) -> Result<()>) -> Result<()> {
        let half = self.resolution as usize / 2;
        // The middles of the cells along an edge, and their column in the tables.
        let middle = |k: usize| (k as f64 + 0.5) / half as f64 - 1.0;
        let column = |k: usize| if k < half { half - 1 - k } else { k - half };
        for b in 0..2 * half {
            for a in 0..2 * half {
                visit([middle(a), middle(b), 1.0], self.top[column(b) * half + column(a)])?;
            }
        }
        for b in 0..half {
            let z = middle(half + b);
            for a in 0..2 * half {
                let (y, delta) = (middle(a), self.side[b * half + column(a)]);
                for direction in [[1.0, y, z], [-1.0, y, z], [y, 1.0, z], [y, -1.0, z]] {
                    visit(direction, delta)?;
                }
            }
        }
        Ok(())
    }
}

/// Number of cells of a resolution.
fn cells(resolution: u32) -> u64 {
    3 * u64::from(resolution) * u64::from(resolution)
}

/// P(x, y) of the file's head.
fn top_antiderivative(x: f64, y: f64) -> f64 {
    let (p, q) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
    (x / p * (y / p).atan() + y / q * (x / q).atan()) / (2.0 * PI)
}

/// S(y, z) of the file's head.
fn side_antiderivative(y: f64, z: f64) -> f64 {
    let q = (1.0 + z * z).sqrt();
    -(y / q).atan() / (2.0 * PI * q)
}

/// How finely a row is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Setting {
    /// Which resolution r = 16 2^k.
    pub resolution: usize,
    /// Which set of 4^k points: the centroid, and beyond it quasi-random ones.
    pub points: u32,
}

impl Setting {
    /// Rays that an evaluation casts.
    fn rays(self) -> u64 {
        cells(COARSEST << self.resolution) << (2 * self.points)
    }

    fn is_allowed(self) -> bool {
        self.resolution < RESOLUTIONS && self.points < POINT_SETS && self.rays() <= MOST_RAYS
    }
}

/// One entry of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entry {
    /// The receiving patch j.
    pub patch: u32,
    /// F_ij.
    pub value: f64,
    /// What the two comparisons say of its error.
    pub error: f64,
}

/// A row, and how far it can be trusted.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// The entries that are not 0, or may not be, in the order of their patches.
    pub entries: Vec<Entry>,
    /// Estimate of sum over j of |dF_ij|: that of aliasing plus that of proximity and visibility.
    pub error: f64,
    /// Rays cast.
    pub rays: u64,
}

impl Hemicubes {
    /// Refines a row until both errors together are within `tolerance`, or an evaluation would cast more than 2^22
    /// rays.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`].
    pub fn row(
        &self,
        emitter: &Emitter,
        tolerance: f64,
        seed: u64,
        tally: &mut Tally,
        progress: &Progress,
    ) -> Result<Row> {
        let mut rays = 0;
        let mut evaluate = |setting: Setting| {
            rays += setting.rays();
            self.evaluate(emitter, setting, seed, tally, progress)
        };
        let mut setting = Setting { resolution: 1, points: 1 };
        let (coarse, fewer) = (Setting { resolution: 0, ..setting }, Setting { points: 0, ..setting });
        let (mut coarse, mut fewer) = (evaluate(coarse)?, evaluate(fewer)?);
        let mut value = evaluate(setting)?;
        loop {
            let (aliasing, proximity) = (difference(&value, &coarse), difference(&value, &fewer));
            let error = total(&aliasing) + total(&proximity);
            let sharper = Setting { resolution: setting.resolution + 1, ..setting };
            let denser = Setting { points: setting.points + 1, ..setting };
            let sharpen = total(&aliasing) >= total(&proximity);
            if error > tolerance && sharpen && sharper.is_allowed() {
                coarse = value;
                fewer = evaluate(Setting { points: sharper.points - 1, ..sharper })?;
                value = evaluate(sharper)?;
                setting = sharper;
            } else if error > tolerance && !sharpen && denser.is_allowed() {
                fewer = value;
                coarse = evaluate(Setting { resolution: denser.resolution - 1, ..denser })?;
                value = evaluate(denser)?;
                setting = denser;
            } else {
                return Ok(Row { entries: joined(&value, &aliasing, &proximity), error, rays });
            }
        }
    }

    /// The row as one setting sees it, in the order of the patches. Each point has an angle of its own about the
    /// normal, and each resolution has others, so that their cells do not fall on the same edges.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`].
    pub fn evaluate(
        &self,
        emitter: &Emitter,
        setting: Setting,
        seed: u64,
        tally: &mut Tally,
        progress: &Progress,
    ) -> Result<Vec<(u32, f64)>> {
        let cube = self.0[setting.resolution].get_or_init(|| Hemicube::new(COARSEST << setting.resolution));
        let points = sample_points(emitter, setting.points, seed);
        let share = 1.0 / points.len() as f64;
        let mut random = Random::new(hash(seed ^ hash(emitter.stream() ^ hash(cube.cells()))));
        let (mut rays, mut deltas) = (Vec::with_capacity(BUNDLE), Vec::with_capacity(BUNDLE));
        for point in points {
            // A quarter of a turn brings the cells back to where they were.
            let turned = emitter.turned(FRAC_PI_2 * random.uniform());
            let mut flush = |rays: &mut Vec<_>, deltas: &mut Vec<f64>| {
                turned.cast(rays, |k, j| tally.add(j, share * deltas[k]));
                rays.clear();
                deltas.clear();
                progress.advance(0)
            };
            let outcome = cube.try_for_each(|direction, delta| {
                rays.push(turned.ray(point, direction));
                deltas.push(delta);
                if rays.len() == BUNDLE { flush(&mut rays, &mut deltas) } else { Ok(()) }
            });
            if let Err(stopped) = outcome.and_then(|()| flush(&mut rays, &mut deltas)) {
                tally.take();
                return Err(stopped);
            }
        }
        Ok(tally.take())
    }
}

/// The sample points of a set: the centroid, or 4^set points of a scrambled sequence. Each set has a scramble of its
/// own, so that the errors of two sets are independent, and their difference tells of both.
fn sample_points(emitter: &Emitter, set: u32, seed: u64) -> Vec<Vec3> {
    if set == 0 {
        let [a, b, c] = emitter.triangle;
        return vec![(a + b + c) / 3.0];
    }
    let sobol = Sobol::new(hash(seed ^ hash(emitter.stream() ^ hash(u64::from(set)))));
    let point = |k: u32| {
        let [u, v] = sobol.point(k);
        point_in_triangle(&emitter.triangle, u, v)
    };
    (0..1 << (2 * set)).map(point).collect()
}

/// |a_j - b_j| of two rows in the order of their patches, for every patch of either.
fn difference(a: &[(u32, f64)], b: &[(u32, f64)]) -> Vec<(u32, f64)> {
    merged(a, b, |a, b| (a - b).abs())
}

/// Both rows entry by entry, with 0 for what one of them lacks.
fn merged(a: &[(u32, f64)], b: &[(u32, f64)], join: impl Fn(f64, f64) -> f64) -> Vec<(u32, f64)> {
    let (mut a, mut b) = (a.iter().copied().peekable(), b.iter().copied().peekable());
    let mut out = Vec::new();
    loop {
        let next = match (a.peek(), b.peek()) {
            (Some(x), Some(y)) => x.0.min(y.0),
            (Some(x), None) => x.0,
            (None, Some(y)) => y.0,
            (None, None) => return out,
        };
        let x = a.next_if(|x| x.0 == next).map_or(0.0, |x| x.1);
        let y = b.next_if(|y| y.0 == next).map_or(0.0, |y| y.1);
        out.push((next, join(x, y)));
    }
}

/// Sum of a row.
fn total(row: &[(u32, f64)]) -> f64 {
    row.iter().map(|entry| entry.1).sum()
}

/// Values with both their errors. Every patch of `value` is in both differences.
fn joined(value: &[(u32, f64)], aliasing: &[(u32, f64)], proximity: &[(u32, f64)]) -> Vec<Entry> {
    let errors = merged(aliasing, proximity, |a, p| a + p);
    let mut values = value.iter().copied().peekable();
    let entries = errors.into_iter().map(|(patch, error)| {
        let value = values.next_if(|v| v.0 == patch).map_or(0.0, |v| v.1);
        Entry { patch, value, error }
    });
    entries.collect()
}
