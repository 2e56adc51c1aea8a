//! Sample points: Owen-scrambled Sobol sequences, pseudo-random numbers, and the maps to triangles and hemispheres.
//!
//! Sobol 1967 with the direction numbers of Joe & Kuo 2008; nested uniform scrambling (Owen 1995) by hashing
//! (Laine & Karras 2011; Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020; the hash of Vegdahl, "Building
//! a Better LK Hash", 2021).
//! Different seeds give independent unbiased scrambles of the same net: their spread is a standard error.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use super::{Triangle, Vec3};

/// Most dimensions of a sequence: two points on two triangles take four; a ray and what it does at two places, eight.
pub const DIMENSIONS: usize = 8;

/// Primitive polynomial (degree, coefficients) and initial numbers m_k of dimensions 2 to 8 (Joe & Kuo 2008);
/// dimension 1 is van der Corput's.
const JOE_KUO: [(u32, u32, [u32; 5]); DIMENSIONS - 1] = [
    (1, 0, [1, 0, 0, 0, 0]),
    (2, 1, [1, 3, 0, 0, 0]),
    (3, 1, [1, 3, 1, 0, 0]),
    (3, 2, [1, 1, 1, 0, 0]),
    (4, 1, [1, 1, 3, 3, 0]),
    (4, 4, [1, 3, 5, 13, 0]),
    (5, 2, [1, 1, 5, 5, 17]),
];

/// Direction numbers, one 32-bit word per bit of the index, the highest bit first.
const DIRECTIONS: [[u32; 32]; DIMENSIONS] = directions();

const fn directions() -> [[u32; 32]; DIMENSIONS] {
    let mut v = [[0u32; 32]; DIMENSIONS];
    let mut k = 0;
    while k < 32 {
        v[0][k] = 1 << (31 - k);
        k += 1;
    }
    let mut dimension = 1;
    while dimension < DIMENSIONS {
        let (degree, coefficients, m) = JOE_KUO[dimension - 1];
        let s = degree as usize;
        let mut k = 0;
        while k < 32 {
            if k < s {
                v[dimension][k] = m[k] << (31 - k);
            } else {
                let mut word = v[dimension][k - s] ^ (v[dimension][k - s] >> s);
                let mut j = 1;
                while j < s {
                    if (coefficients >> (s - 1 - j)) & 1 == 1 {
                        word ^= v[dimension][k - j];
                    }
                    j += 1;
                }
                v[dimension][k] = word;
            }
            k += 1;
        }
        dimension += 1;
    }
    v
}

/// The words of every value of every byte of an index, the lowest bit first: an index is the exclusive or of four of them.
static WORDS: [[[u32; DIMENSIONS]; 256]; 4] = words();

const fn words() -> [[[u32; DIMENSIONS]; 256]; 4] {
    let mut words = [[[0; DIMENSIONS]; 256]; 4];
    let mut byte = 0;
    while byte < 4 {
        let mut value = 1;
        while value < 256 {
            let bit = 31 - (value as u32).leading_zeros() as usize;
            let mut dimension = 0;
            while dimension < DIMENSIONS {
                // What the lower bits say, and the highest.
                let rest = words[byte][value ^ 1 << bit][dimension];
                words[byte][value][dimension] = rest ^ DIRECTIONS[dimension][8 * byte + bit].reverse_bits();
                dimension += 1;
            }
            value += 1;
        }
        byte += 1;
    }
    words
}

/// 2^64 over the golden ratio, odd: the step of splitmix64.
const GOLDEN_GAMMA: u64 = 0x9e37_79b9_7f4a_7c15;

/// A well mixed 64-bit hash (the finaliser of splitmix64, Steele, Lea & Flood 2014).
pub fn hash(x: u64) -> u64 {
    let mut z = x.wrapping_add(GOLDEN_GAMMA);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Pseudo-random numbers: splitmix64 (Steele, Lea & Flood 2014), for where independence matters more than evenness.
#[derive(Debug, Clone)]
pub struct Random {
    state: u64,
}

impl Random {
    /// The sequence that belongs to `seed`.
    pub fn new(seed: u64) -> Random {
        Random { state: seed }
    }

    /// The next number, uniform in [0, 1): a multiple of 2^-53.
    #[inline]
    pub fn uniform(&mut self) -> f64 {
        let bits = hash(self.state);
        self.state = self.state.wrapping_add(GOLDEN_GAMMA);
        (bits >> 11) as f64 / 9_007_199_254_740_992.0
    }
}

/// An Owen-scrambled Sobol sequence in D dimensions, at most [`DIMENSIONS`].
///
/// What belongs together takes dimensions of one sequence. Two scrambles of the same dimension would not do: their first bits
/// are equal at all points, or different at all.
#[derive(Debug, Clone, Copy)]
pub struct Sobol<const D: usize> {
    scrambles: [u32; D],
}

impl<const D: usize> Sobol<D> {
    /// The scramble that belongs to `seed`.
    #[inline]
    pub fn new(seed: u64) -> Sobol<D> {
        let seed = hash(seed);
        Sobol { scrambles: std::array::from_fn(|d| hash(seed.wrapping_add(d as u64)) as u32) }
    }

    /// Point number `index`, each coordinate in (0, 1).
    #[inline]
    pub fn point(&self, index: u32) -> [f64; D] {
        let [a, b, c, d] = index.to_le_bytes().map(usize::from);
        let [a, b, c, d] = [&WORDS[0][a], &WORDS[1][b], &WORDS[2][c], &WORDS[3][d]];
        std::array::from_fn(|k| {
            let word = a[k] ^ b[k] ^ c[k] ^ d[k];
            (f64::from(owen_scramble(word, self.scrambles[k])) + 0.5) / 4_294_967_296.0
        })
    }
}

/// Vegdahl 2021: a hash in which each bit depends on the bits below it only, of a word with the lowest bit first.
#[inline]
fn owen_scramble(word: u32, seed: u32) -> u32 {
    let mut x = word;
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x.reverse_bits()
}

/// The direction that belongs to (s, t) in the unit square, with density cos / pi about z: a uniform point of the unit disk,
/// lifted to the hemisphere (Malley 1988). The square goes to the disk in concentric rings (Shirley & Chiu 1997): what is
/// close together stays so, and an even sample stays even.
#[inline]
pub fn cosine_direction(s: f64, t: f64) -> [f64; 3] {
    let (a, b) = (2.0 * s - 1.0, 2.0 * t - 1.0);
    let (radius, angle) = if a.abs() > b.abs() {
        (a, FRAC_PI_4 * (b / a))
    } else if b == 0.0 {
        (0.0, 0.0)
    } else {
        (b, FRAC_PI_2 - FRAC_PI_4 * (a / b))
    };
    let (sine, cosine) = angle.sin_cos();
    [radius * cosine, radius * sine, (1.0 - radius * radius).sqrt()]
}

/// The barycentric coordinates of corners 1 and 2 of the point that [`point_in_triangle`] takes.
#[inline]
pub fn barycentric(u: f64, v: f64) -> [f64; 2] {
    let s = u.sqrt();
    [s * (1.0 - v), s * v]
}

/// The uniform point of a triangle that belongs to (u, v) in the unit square (Turk 1990).
#[inline]
pub fn point_in_triangle(triangle: &Triangle, u: f64, v: f64) -> Vec3 {
    let s = u.sqrt();
    triangle[0] + s * ((1.0 - v) * (triangle[1] - triangle[0]) + v * (triangle[2] - triangle[0]))
}
