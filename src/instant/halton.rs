//! The Halton sequence, scrambled: coordinate d of point i is the radical inverse of i in the d-th prime b,
//!
//!   x = sum over m of p_m(digit m of i) b^-(m+1)
//!
//! with permutations p_m(a) = (a s_m + t_m) mod b of the digits, chosen by chance from the seed and the digits before
//! (Halton 1960; Matousek 1998, linear scrambling; nested as in Owen 1995). Without, the first points in a large base
//! lie in a row; with it each point is uniform, so that means are unbiased, and the points are as even as before.

use crate::geometry::sampling::hash;

/// Digits that are smaller do not count in f64.
const LEAST: f64 = f64::EPSILON / 2.0;

/// One scramble of the sequence.
pub(super) struct Halton {
    seed: u64,
    primes: Vec<u32>,
}

impl Halton {
    pub(super) fn new(seed: u64) -> Halton {
        Halton { seed, primes: vec![2] }
    }

    /// Makes coordinates 0 to `dimensions` - 1 known.
    pub(super) fn extend(&mut self, dimensions: usize) {
        while self.primes.len() < dimensions {
            let last = self.primes[self.primes.len() - 1];
            let is_prime = |k: &u32| self.primes.iter().take_while(|&p| p * p <= *k).all(|p| !k.is_multiple_of(*p));
            self.primes.extend((last + 1..).find(is_prime));
        }
    }

    /// Coordinate `dimension`, which must be known, of point `index`, in [0, 1).
    pub(super) fn coordinate(&self, dimension: usize, index: u32) -> f64 {
        let base = u64::from(self.primes[dimension]);
        let (mut key, mut rest) = (hash(self.seed ^ hash(dimension as u64)), u64::from(index));
        let (mut sum, mut step) = (0.0, 1.0);
        while step > LEAST {
            let (digit, rows) = (rest % base, key >> 32);
            step /= base as f64;
            sum += step * ((digit * (1 + rows % (base - 1)) + (key & 0xffff_ffff)) % base) as f64;
            key = hash(key ^ hash(digit));
            rest /= base;
        }
        // Rounding may have made a 1 of it.
        f64::min(sum, 1.0 - LEAST)
    }
}
