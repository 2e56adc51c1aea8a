//! Which kernel for which pair: the cheapest one whose error is known to be inside the tolerance.
//!
//! Two ratios decide. q_area = (R_a + R_b) / |c_a - c_b| for area quadrature; q_point = R_small / (distance from the smaller
//! polygon's centre to the larger one, from below) for point-to-polygon. A kernel is taken when its ratio is under the
//! threshold that kept 99.9 % of some thousand mixed pairs inside the tolerance with a safety of 4; pairs that no ratio
//! admits go to the contour integral.

use super::Shape;
use crate::error::{Error, Result};
use crate::geometry::quadrature::TriangleRule;
use crate::simd::double::Double;

/// How a pair is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kernel {
    /// [`super::area_quadrature`] with the points of a rule on both.
    Area(TriangleRule),
    /// [`super::point_to_polygon`] from the points of a rule on the smaller.
    Point(TriangleRule),
    /// [`super::contour`].
    Contour,
}

impl Kernel {
    /// All kernels that may be chosen, in the order of their cost.
    pub const ALL: [Kernel; 7] = {
        use TriangleRule::{P3, P6, P7, P12, P16};
        [
            Kernel::Area(P3),
            Kernel::Area(P6),
            Kernel::Point(P7),
            Kernel::Area(P12),
            Kernel::Point(P12),
            Kernel::Point(P16),
            Kernel::Contour,
        ]
    };

    /// A short name for tables.
    pub fn name(self) -> String {
        match self {
            Kernel::Area(rule) => format!("area {rule:?}"),
            Kernel::Point(rule) => format!("point {rule:?}"),
            Kernel::Contour => "contour".to_string(),
        }
    }
}

/// The largest ratios for a tolerance, one for each of [`Kernel::ALL`] but the last.
#[derive(Debug, Clone, Copy)]
struct Thresholds {
    tolerance: f64,
    most: [f64; 6],
}

/// Measured against triangle pairs with form factors known to 300 bits (tests/data/README.md).
const TABLE: [Thresholds; 6] = [
    Thresholds { tolerance: 1e-2, most: [0.242, 0.518, 0.549, 0.623, 0.817, 1.44] },
    Thresholds { tolerance: 1e-3, most: [0.106, 0.435, 0.423, 0.518, 0.761, 0.817] },
    Thresholds { tolerance: 1e-4, most: [0.043, 0.241, 0.239, 0.505, 0.505, 0.720] },
    Thresholds { tolerance: 1e-6, most: [0.012, 0.103, 0.079, 0.284, 0.239, 0.366] },
    Thresholds { tolerance: 1e-8, most: [0.002, 0.032, 0.039, 0.106, 0.126, 0.209] },
    Thresholds { tolerance: 1e-10, most: [0.0002, 0.01, 0.012, 0.05, 0.05, 0.1] },
];

/// A relative tolerance for the form factor of one unoccluded pair.
#[derive(Debug, Clone, Copy)]
pub struct Accuracy {
    thresholds: Thresholds,
    /// The one kernel for every pair, as an index of [`Kernel::ALL`].
    only: Option<usize>,
    forced: bool,
}

impl Accuracy {
    /// The tightest tolerance that can be asked for; rounding may leave more at slivers and narrow gaps below 1e-8.
    pub const TIGHTEST: f64 = 1e-10;

    /// # Errors
    /// [`Error::Invalid`] when `tolerance` is outside [1e-10, 1).
    pub fn new(tolerance: f64) -> Result<Accuracy> {
        if !(Self::TIGHTEST..1.0).contains(&tolerance) {
            return Err(Error::Invalid(format!("tolerance {tolerance} is outside [{:e}, 1)", Self::TIGHTEST)));
        }
        // Errors are powers of the ratio: thresholds are straight lines between logarithms. Tolerances above 1e-2 are
        // served by the first row.
        let above = TABLE.iter().take_while(|row| row.tolerance >= tolerance).count();
        let (low, high) = (TABLE[above.min(TABLE.len() - 1)], TABLE[above.saturating_sub(1)]);
        if above == 0 || above == TABLE.len() {
            return Ok(Accuracy { thresholds: high, only: None, forced: false });
        }
        let part = (tolerance / low.tolerance).ln() / (high.tolerance / low.tolerance).ln();
        let between = |k: usize| low.most[k] * (high.most[k] / low.most[k]).powf(part);
        let thresholds = Thresholds { tolerance, most: std::array::from_fn(between) };
        Ok(Accuracy { thresholds, only: None, forced: false })
    }

    /// One kernel for every pair, whether it suits or not: what tables of error and cost are made of.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the kernel is none of [`Kernel::ALL`].
    pub fn by(kernel: Kernel) -> Result<Accuracy> {
        let place = Kernel::ALL.iter().position(|k| *k == kernel);
        place.map(Accuracy::only).ok_or_else(|| {
            let names = Kernel::ALL.map(Kernel::name).join(", ");
            Error::Invalid(format!("kernel {} is none of {names}", kernel.name()))
        })
    }

    /// The kernel at a place of [`Kernel::ALL`] for every pair.
    pub(super) fn only(place: usize) -> Accuracy {
        let thresholds = Thresholds { tolerance: Accuracy::TIGHTEST, most: [0.0; 6] };
        Accuracy { thresholds, only: Some(place), forced: true }
    }

    /// The same kernels, whose results are kept whatever their rounding.
    pub(super) fn forced(&self) -> Accuracy {
        Accuracy { forced: true, ..*self }
    }

    pub(super) fn is_forced(&self) -> bool {
        self.forced
    }

    /// The relative error that is kept, at most what was asked: by 99.9 % of all kinds of pairs, and by the rest within
    /// a small multiple.
    pub fn tolerance(&self) -> f64 {
        self.thresholds.tolerance
    }

    /// The cheapest kernel for a pair with these ratios, as an index of [`Kernel::ALL`].
    #[inline]
    pub(super) fn choice(&self, q_area: f64, q_point: f64) -> usize {
        let suits = |(kernel, most): (&Kernel, &f64)| match kernel {
            Kernel::Area(_) => q_area < *most,
            Kernel::Point(_) | Kernel::Contour => q_point < *most,
        };
        self.only.unwrap_or_else(|| Kernel::ALL.iter().zip(&self.thresholds.most).position(suits).unwrap_or(CONTOUR))
    }
}

impl Accuracy {
    /// [`Accuracy::choice`] of eight pairs.
    #[inline(always)]
    pub(super) fn choices<D: Double>(&self, q_area: D, q_point: D) -> D {
        if let Some(place) = self.only {
            return D::splat(place as f64);
        }
        let mut choice = D::splat(CONTOUR as f64);
        for k in (0..self.thresholds.most.len()).rev() {
            let ratio = if matches!(Kernel::ALL[k], Kernel::Area(_)) { q_area } else { q_point };
            choice = D::select(ratio.lt(D::splat(self.thresholds.most[k])), D::splat(k as f64), choice);
        }
        choice
    }
}

/// The ratios q_area and q_point of a pair.
pub(super) fn ratios(small: &Shape, large: &Shape) -> [f64; 2] {
    let distance = small.centre.distance(large.centre);
    let to_plane = large.normal.dot(small.centre - large.centre).abs();
    let nearest = to_plane.max(distance - large.radius).max(f64::MIN_POSITIVE);
    [(small.radius + large.radius) / distance, small.radius / nearest]
}

/// The place of the contour integral among the kernels.
pub(super) const CONTOUR: usize = Kernel::ALL.len() - 1;

/// The place of the point rule of the most points.
pub(super) const DENSEST_POINT: usize = CONTOUR - 1;

/// The relative error that the densest point rule is known to keep at a ratio q_point; infinite beyond the table.
pub(super) fn densest_point_error(q_point: f64) -> f64 {
    let known = TABLE.iter().rev().find(|row| q_point < row.most[DENSEST_POINT]);
    known.map_or(f64::INFINITY, |row| row.tolerance)
}
