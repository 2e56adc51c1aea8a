//! Sample points: Owen-scrambled Sobol sequences in four dimensions, pseudo-random numbers, and the map to triangles.
//!
//! Sobol 1967 with the direction numbers of Joe & Kuo 2008; nested uniform scrambling (Owen 1995) by hashing
//! (Laine & Karras 2011, constants of Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020).
//! Different seeds give independent unbiased scrambles of the same net: their spread is a standard error.

use super::{Triangle, Vec3};

/// Dimensions of the sequence: two points on two triangles.
pub const DIMENSIONS: usize = 4;

/// Primitive polynomial (degree, coefficients) and initial numbers m_k of dimensions 2 to 4 (Joe & Kuo 2008);
/// dimension 1 is van der Corput's.
const JOE_KUO: [(u32, u32, [u32; 3]); DIMENSIONS - 1] = [(1, 0, [1, 0, 0]), (2, 1, [1, 3, 0]), (3, 1, [1, 3, 1])];

/// Direction numbers, one 32-bit word per bit of the index.
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

/// An Owen-scrambled Sobol sequence in four dimensions.
#[derive(Debug, Clone, Copy)]
pub struct Sobol {
    seeds: [u32; DIMENSIONS],
}

impl Sobol {
    /// The scramble that belongs to `seed`.
    pub fn new(seed: u64) -> Sobol {
        let (first, second) = (hash(seed), hash(seed ^ 0x5bd1_e995_9e37_79b9));
        Sobol { seeds: [first as u32, (first >> 32) as u32, second as u32, (second >> 32) as u32] }
    }

    /// Point number `index`, each coordinate in (0, 1).
    #[inline]
    pub fn point(&self, index: u32) -> [f64; DIMENSIONS] {
        let mut words = [0u32; DIMENSIONS];
        let mut bits = index;
        while bits != 0 {
            let k = bits.trailing_zeros() as usize;
            for (word, direction) in words.iter_mut().zip(&DIRECTIONS) {
                *word ^= direction[k];
            }
            bits &= bits - 1;
        }
        std::array::from_fn(|d| (f64::from(owen_scramble(words[d], self.seeds[d])) + 0.5) / 4_294_967_296.0)
    }
}

/// Burley 2020, listing 2: a hash in which each bit depends on the bits above it only.
#[inline]
fn owen_scramble(word: u32, seed: u32) -> u32 {
    let mut x = word.reverse_bits().wrapping_add(seed);
    x ^= x.wrapping_mul(0x6c50_b47c);
    x ^= x.wrapping_mul(0xb82f_1e52);
    x ^= x.wrapping_mul(0xc7af_e638);
    x ^= x.wrapping_mul(0x8d22_f6e6);
    x.reverse_bits()
}

/// The direction that belongs to (s, t) in the unit square, with density cos / pi about z: a uniform point of the unit disk,
/// lifted to the hemisphere (Malley 1988).
#[inline]
pub fn cosine_direction(s: f64, t: f64) -> [f64; 3] {
    let (sine, cosine) = (std::f64::consts::TAU * t).sin_cos();
    let radius = s.sqrt();
    [radius * cosine, radius * sine, (1.0 - s).sqrt()]
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
