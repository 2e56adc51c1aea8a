//! Quadrature rules: symmetric rules over the triangle (Dunavant 1985), Gauss-Legendre over an interval.
//!
//! integral over T of f = area(T) * sum_k w_k f(p_k), the p_k given by barycentric coordinates. A test
//! holds every table against the exact integrals of all monomials up to its degree.

use super::{Triangle, Vec3};

/// A set of points that a symmetric triangle rule gives equal weight.
#[derive(Debug, Clone, Copy)]
enum Orbit {
    /// The centroid: 1 point.
    Centroid(f64),
    /// (a, a, 1 - 2a) and its turns: 3 points.
    Three { a: f64, weight: f64 },
    /// (a, b, 1 - a - b) and its permutations: 6 points.
    Six { a: f64, b: f64, weight: f64 },
}

/// The triangle rules, by their number of points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum TriangleRule {
    /// 3 points, exact for polynomials of degree 2.
    P3,
    /// 6 points, degree 4.
    P6,
    /// 7 points, degree 5.
    P7,
    /// 12 points, degree 6.
    P12,
    /// 16 points, degree 8.
    P16,
}

// D. A. Dunavant, "High degree efficient symmetrical Gaussian quadrature rules for the triangle", Int. J. Numer. Meth.
// Engng 21 (1985) 1129-1148, appendix II; polished by Newton steps on the moment equations in 40 digits.
const P3: &[Orbit] = &[Orbit::Three { a: 1.0 / 6.0, weight: 1.0 / 3.0 }];
const P6: &[Orbit] = &[
    Orbit::Three { a: 0.445_948_490_915_964_9, weight: 0.223_381_589_678_011_47 },
    Orbit::Three { a: 0.091_576_213_509_770_74, weight: 0.109_951_743_655_321_87 },
];
const P7: &[Orbit] = &[
    Orbit::Centroid(0.225),
    Orbit::Three { a: 0.470_142_064_105_115_1, weight: 0.132_394_152_788_506_2 },
    Orbit::Three { a: 0.101_286_507_323_456_34, weight: 0.125_939_180_544_827_14 },
];
const P12: &[Orbit] = &[
    Orbit::Three { a: 0.249_286_745_170_910_43, weight: 0.116_786_275_726_379_37 },
    Orbit::Three { a: 0.063_089_014_491_502_23, weight: 0.050_844_906_370_206_82 },
    Orbit::Six { a: 0.310_352_451_033_784_4, b: 0.053_145_049_844_816_945, weight: 0.082_851_075_618_373_57 },
];
const P16: &[Orbit] = &[
    Orbit::Centroid(0.144_315_607_677_787_17),
    Orbit::Three { a: 0.459_292_588_292_723_2, weight: 0.095_091_634_267_284_62 },
    Orbit::Three { a: 0.170_569_307_751_760_2, weight: 0.103_217_370_534_718_24 },
    Orbit::Three { a: 0.050_547_228_317_030_98, weight: 0.032_458_497_623_198_08 },
    Orbit::Six { a: 0.263_112_829_634_638_1, b: 0.008_394_777_409_957_605, weight: 0.027_230_314_174_434_993 },
];

impl TriangleRule {
    /// Number of points.
    pub fn len(self) -> usize {
        match self {
            TriangleRule::P3 => 3,
            TriangleRule::P6 => 6,
            TriangleRule::P7 => 7,
            TriangleRule::P12 => 12,
            TriangleRule::P16 => 16,
        }
    }

    /// No rule is empty; here because `len` is.
    pub fn is_empty(self) -> bool {
        false
    }

    /// The highest degree of polynomials that the rule integrates exactly.
    pub fn degree(self) -> usize {
        match self {
            TriangleRule::P3 => 2,
            TriangleRule::P6 => 4,
            TriangleRule::P7 => 5,
            TriangleRule::P12 => 6,
            TriangleRule::P16 => 8,
        }
    }

    /// Calls `visit(barycentric, weight)` for every point; the weights sum to 1.
    #[inline]
    pub fn for_each(self, mut visit: impl FnMut([f64; 3], f64)) {
        let orbits = match self {
            TriangleRule::P3 => P3,
            TriangleRule::P6 => P6,
            TriangleRule::P7 => P7,
            TriangleRule::P12 => P12,
            TriangleRule::P16 => P16,
        };
        for orbit in orbits {
            match *orbit {
                Orbit::Centroid(weight) => visit([1.0 / 3.0; 3], weight),
                Orbit::Three { a, weight } => {
                    let c = 1.0 - 2.0 * a;
                    visit([a, a, c], weight);
                    visit([a, c, a], weight);
                    visit([c, a, a], weight);
                }
                Orbit::Six { a, b, weight } => {
                    let c = 1.0 - a - b;
                    for point in [[a, b, c], [a, c, b], [b, a, c], [b, c, a], [c, a, b], [c, b, a]] {
                        visit(point, weight);
                    }
                }
            }
        }
    }

    /// Calls `visit(point, area weight)` over a convex polygon, as a fan of triangles; the weights sum to its area.
    #[inline]
    pub fn for_each_in_polygon(self, corners: &[Vec3], mut visit: impl FnMut(Vec3, f64)) {
        for k in 1..corners.len().saturating_sub(1) {
            let triangle: Triangle = [corners[0], corners[k], corners[k + 1]];
            let area = 0.5 * (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]).length();
            self.for_each(|b, weight| {
                visit(b[0] * triangle[0] + b[1] * triangle[1] + b[2] * triangle[2], weight * area);
            });
        }
    }
}

/// Positive nodes and their weights of the 10-point Gauss-Legendre rule on [-1, 1], exact to degree 19.
/// (Abramowitz & Stegun 1964, table 25.4.)
pub const GAUSS_10: [(f64, f64); 5] = [
    (0.148_874_338_981_631_22, 0.295_524_224_714_752_8),
    (0.433_395_394_129_247_2, 0.269_266_719_309_995_95),
    (0.679_409_568_299_024_4, 0.219_086_362_515_982),
    (0.865_063_366_688_984_5, 0.149_451_349_150_580_4),
    (0.973_906_528_517_171_7, 0.066_671_344_308_688_14),
];
