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

    /// The points; the weights sum to 1.
    #[inline]
    pub fn points(self) -> &'static [TrianglePoint] {
        static POINTS_3: [TrianglePoint; 3] = expanded(P3);
        static POINTS_6: [TrianglePoint; 6] = expanded(P6);
        static POINTS_7: [TrianglePoint; 7] = expanded(P7);
        static POINTS_12: [TrianglePoint; 12] = expanded(P12);
        static POINTS_16: [TrianglePoint; 16] = expanded(P16);
        match self {
            TriangleRule::P3 => &POINTS_3,
            TriangleRule::P6 => &POINTS_6,
            TriangleRule::P7 => &POINTS_7,
            TriangleRule::P12 => &POINTS_12,
            TriangleRule::P16 => &POINTS_16,
        }
    }

    /// Calls `visit(point, area weight)` over a convex polygon, as a fan of triangles; the weights sum to its area.
    #[inline]
    pub fn for_each_in_polygon(self, corners: &[Vec3], mut visit: impl FnMut(Vec3, f64)) {
        for k in 1..corners.len().saturating_sub(1) {
            let triangle: Triangle = [corners[0], corners[k], corners[k + 1]];
            let area = 0.5 * (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]).length();
            for TrianglePoint { barycentric: b, weight } in self.points() {
                visit(b[0] * triangle[0] + b[1] * triangle[1] + b[2] * triangle[2], weight * area);
            }
        }
    }
}

/// A point of a triangle rule.
#[derive(Debug, Clone, Copy)]
pub struct TrianglePoint {
    /// Barycentric coordinates.
    pub barycentric: [f64; 3],
    /// Weight, relative to the triangle's area.
    pub weight: f64,
}

/// The points of all orbits of a rule.
const fn expanded<const N: usize>(orbits: &[Orbit]) -> [TrianglePoint; N] {
    let mut points = [TrianglePoint { barycentric: [1.0 / 3.0; 3], weight: 0.0 }; N];
    let (mut next, mut k) = (0, 0);
    while k < orbits.len() {
        let (turns, count, weight) = match orbits[k] {
            Orbit::Centroid(weight) => ([[1.0 / 3.0; 3]; 6], 1, weight),
            Orbit::Three { a, weight } => {
                let c = 1.0 - 2.0 * a;
                ([[a, a, c], [a, c, a], [c, a, a], [a; 3], [a; 3], [a; 3]], 3, weight)
            }
            Orbit::Six { a, b, weight } => {
                let c = 1.0 - a - b;
                ([[a, b, c], [a, c, b], [b, a, c], [b, c, a], [c, a, b], [c, b, a]], 6, weight)
            }
        };
        let mut turn = 0;
        while turn < count {
            points[next] = TrianglePoint { barycentric: turns[turn], weight };
            next += 1;
            turn += 1;
        }
        k += 1;
    }
    points
}

/// The highest number of points of a Gauss-Legendre rule that is tabulated.
pub const MOST_GAUSS_POINTS: usize = 20;

/// `GAUSS[n][..n]`: nodes on [-1, 1] and weights of the n-point Gauss-Legendre rule, exact to degree 2n - 1; zeros after.
pub static GAUSS: [[(f64, f64); MOST_GAUSS_POINTS]; MOST_GAUSS_POINTS + 1] = {
    let mut table = [[(0.0, 0.0); MOST_GAUSS_POINTS]; MOST_GAUSS_POINTS + 1];
    let mut n = 1;
    while n <= MOST_GAUSS_POINTS {
        let mut k = 0;
        while k < n {
            table[n][k] = gauss_node(n, k);
            k += 1;
        }
        n += 1;
    }
    table
};

/// Node k of n and its weight 2 / ((1 - x^2) P_n'(x)^2) (Abramowitz & Stegun 1964, 25.4.29), by Newton's method on the
/// Legendre polynomial from the usual first guess cos(pi (k + 3/4) / (n + 1/2)).
const fn gauss_node(n: usize, k: usize) -> (f64, f64) {
    // cos t = sin(pi/2 - t), by its series.
    let t = std::f64::consts::PI * (0.5 - (k as f64 + 0.75) / (n as f64 + 0.5));
    let (mut term, mut x, mut power) = (t, t, 1.0);
    while power < 24.0 {
        term *= -t * t / ((power + 1.0) * (power + 2.0));
        x += term;
        power += 2.0;
    }
    let (mut slope, mut step) = (1.0, 0);
    while step < 6 {
        let (mut before, mut value, mut j) = (1.0, x, 1);
        while j < n {
            let next = ((2 * j + 1) as f64 * x * value - j as f64 * before) / (j + 1) as f64;
            before = value;
            value = next;
            j += 1;
        }
        slope = n as f64 * (x * value - before) / (x * x - 1.0);
        x -= value / slope;
        step += 1;
    }
    (x, 2.0 / ((1.0 - x * x) * slope * slope))
}
