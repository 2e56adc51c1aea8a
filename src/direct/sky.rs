//! A sky: radiance that comes in from all directions, far away.
//!
//!   constant   L(w) = L                            from everywhere, from below the horizon too
//!   overcast   L(w) = L_z (1 + 2 sin gamma) / 3    gamma: height above the horizon; nothing below (Moon & Spencer 1942; CIE)
//!   table      L(w) = L_rc                         rows of polar angle from the zenith down, columns of azimuth
//!
//! Under an even sky directions are best drawn with density cos / pi, from which nothing but the shadows is uneven. A table may
//! hold a sun: there half of the directions are drawn by its radiance, a cell with probability p_c in proportion to its
//! brightness times its solid angle and evenly in it, and each counts for
//!
//!   cos / (1/2 cos / pi + 1/2 p_c / omega_c)
//!
//! whichever half it is from (the balance heuristic of Veach & Guibas 1995, of one sample).

use std::f64::consts::{PI, TAU};

use crate::geometry::Vec3;
use crate::geometry::sampling::cosine_direction;

/// Where the light of a sky comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Distribution {
    /// Everywhere alike.
    Constant,
    /// The standard overcast sky: three times as bright in the zenith as at the horizon, dark below.
    Overcast,
    /// Cells of equal polar angle, from the zenith (row 0) to the nadir, and of equal azimuth, from north (column 0) by east.
    Table {
        /// Number of rows.
        rows: usize,
        /// Number of columns.
        columns: usize,
    },
}

/// A sky over a scene.
#[derive(Debug, Clone)]
pub struct Sky {
    distribution: Distribution,
    /// East, north and up: unit vectors, each across the others.
    frame: [Vec3; 3],
    /// L of every cell, one a band, W/(m^2 sr); one cell where there is no table.
    pub(super) radiance: Vec<f64>,
    /// p_c summed up; empty where there is no table.
    cumulated: Vec<f64>,
}

/// A direction from which a sky may be seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Look {
    pub(super) towards: Vec3,
    pub(super) cell: usize,
    /// What the radiance of the cell is to be multiplied by: shape of the sky x cosine / density.
    pub(super) factor: f64,
}

impl Sky {
    /// A sky of `bands` bands with the zenith at `up`, a unit vector, and the azimuth counted from `north`, which is not along
    /// it. The radiance holds a row for every cell.
    pub fn new(distribution: Distribution, up: Vec3, north: Vec3, radiance: Vec<f64>, bands: usize) -> Sky {
        let north = (north - north.dot(up) * up).normalize_or_zero();
        let mut cumulated = Vec::new();
        if let Distribution::Table { rows, columns } = distribution {
            // Bands of any size count alike.
            let peak = |b: usize| radiance.iter().skip(b).step_by(bands).fold(0.0f64, |peak, x| peak.max(*x));
            let peaks: Vec<f64> = (0..bands).map(peak).collect();
            let bright = |cell: &[f64]| -> f64 {
                cell.iter().zip(&peaks).filter(|(_, peak)| **peak > 0.0).map(|(x, peak)| x / peak).sum()
            };
            let mut sum = 0.0;
            for (cell, row) in radiance.chunks_exact(bands).zip((0..rows * columns).map(|c| c / columns)) {
                sum += bright(cell) * (parallel(row, rows) - parallel(row + 1, rows));
                cumulated.push(sum);
            }
            cumulated.iter_mut().filter(|_| sum > 0.0).for_each(|part| *part /= sum);
        }
        Sky { distribution, frame: [north.cross(up), north, up], radiance, cumulated }
    }

    /// Whether directions of density cos / pi all bring the same.
    pub(super) fn is_constant(&self) -> bool {
        self.distribution == Distribution::Constant
    }

    /// The cell that lies in a direction, and its radiance there in units of that of the cell; none where it is dark.
    pub(super) fn seen(&self, towards: Vec3) -> Option<(usize, f64)> {
        let [east, north, up] = self.frame.map(|axis| axis.dot(towards));
        match self.distribution {
            Distribution::Constant => Some((0, 1.0)),
            Distribution::Overcast => (up > 0.0).then_some((0, (1.0 + 2.0 * up) / 3.0)),
            Distribution::Table { rows, columns } => {
                let polar = up.clamp(-1.0, 1.0).acos() / PI;
                let azimuth = east.atan2(north).rem_euclid(TAU) / TAU;
                let row = ((polar * rows as f64) as usize).min(rows - 1);
                let column = ((azimuth * columns as f64) as usize).min(columns - 1);
                Some((row * columns + column, 1.0))
            }
        }
    }

    /// The direction from a surface of this normal that belongs to (u, v) in the unit square; none where it brings nothing.
    pub(super) fn look(&self, normal: Vec3, [u, v]: [f64; 2]) -> Option<Look> {
        let Distribution::Table { rows, columns } = self.distribution else {
            let towards = around(normal, [u, v]);
            return self.seen(towards).map(|(cell, shape)| Look { towards, cell, factor: PI * shape });
        };
        let (towards, cell) = if u < 0.5 {
            let towards = around(normal, [2.0 * u, v]);
            (towards, self.seen(towards)?.0)
        } else {
            let u = 2.0 * u - 1.0;
            let cell = self.cumulated.partition_point(|sum| *sum <= u).min(self.cumulated.len() - 1);
            let (row, column) = (cell / columns, cell % columns);
            let p = self.probability(cell);
            let inside = if p > 0.0 { ((u - self.cumulated[cell] + p) / p).clamp(0.0, 1.0) } else { 0.5 };
            let (top, bottom) = (parallel(row, rows), parallel(row + 1, rows));
            let height = top + v * (bottom - top);
            let (sine, cosine) = (TAU * (column as f64 + inside) / columns as f64).sin_cos();
            let level = (1.0 - height * height).max(0.0).sqrt();
            let [east, north, up] = self.frame;
            (level * sine * east + level * cosine * north + height * up, cell)
        };
        let cos = normal.dot(towards);
        let row = cell / columns;
        let solid_angle = TAU / columns as f64 * (parallel(row, rows) - parallel(row + 1, rows));
        let density = 0.5 * cos / PI + 0.5 * self.probability(cell) / solid_angle;
        (cos > 0.0).then(|| Look { towards, cell, factor: cos / density })
    }

    fn probability(&self, cell: usize) -> f64 {
        self.cumulated[cell] - if cell > 0 { self.cumulated[cell - 1] } else { 0.0 }
    }
}

/// The height of the upper border of a row: the cosine of its polar angle.
fn parallel(row: usize, rows: usize) -> f64 {
    (PI * row as f64 / rows as f64).cos()
}

/// A direction of density cos / pi about a normal.
fn around(normal: Vec3, [u, v]: [f64; 2]) -> Vec3 {
    let (first, second) = normal.any_orthonormal_pair();
    let [x, y, z] = cosine_direction(u, v);
    x * first + y * second + z * normal
}
