//! The operator that quasi-random rays make: rows sampled once, constant or linear radiosity on every patch.
//!
//!   (F B)(x) ~ B(y) at the point y that a cosine-distributed ray from x meets first
//!
//! With m rays from points x_k of patch i that arrive at points y_k, the mean of H = F B on the patch and its linear part are
//!
//!   H_i = 1/m sum over k of B(y_k),    H_ic = H_i + 12/m sum over k of (l_c(x_k) - mean l_c) B(y_k)
//!
//! where l_c, c = 0, 1, 2, are the barycentric coordinates and H_ic the values at the corners of the linear function
//! that is nearest to H in the mean square: 12 inverts their covariances 1/18 and -1/36 on a triangle. In between
//! H(y) = sum over c of l_c(y) H_jc (linear finite elements, Zatz 1993, "Galerkin radiosity"; P0 and P1 there and in
//! what follows). Taking off the mean of l_c makes a constant B give H without a linear part, however few the rays: a
//! furnace is solved exactly.
//!
//! Rays are Owen-scrambled Sobol points in the four dimensions of origin and direction ([`crate::geometry::sampling`]), each
//! patch with a scramble of its own, so that the rows are independent. One ray takes 12 bytes: barycentric coordinates are
//! kept in 16 bits, since this operator is only where a solve starts from ([`crate::accuracy`]).

use std::ops::Range;

use rayon::prelude::*;

use super::FormFactors;
use super::matrix::add_scaled;
use crate::geometry::sampling::{DIMENSIONS, Sobol, hash};
use crate::visibility::NO_PATCH;

/// How the radiosity of a patch varies over it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Not at all: P0.
    Constant,
    /// Linearly: P1.
    Linear,
}

impl Order {
    /// Numbers that say what one band is on one patch.
    pub fn coefficients(self) -> usize {
        match self {
            Order::Constant => 1,
            Order::Linear => 3,
        }
    }
}

/// One ray of a patch, by the random numbers that belong to it.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// The patch that it starts on.
    pub patch: u32,
    /// The scramble that its numbers are from.
    pub scramble: u32,
    /// In (0, 1).
    pub numbers: [f64; DIMENSIONS],
}

impl Sample {
    /// The rays `indices` of a scramble from a patch.
    pub fn rays(seed: u64, patch: u32, scramble: usize, indices: Range<u32>) -> impl Iterator<Item = Sample> {
        let sobol = Sobol::new(hash(hash(seed ^ hash(u64::from(patch))).wrapping_add(scramble as u64)));
        indices.map(move |k| Sample { patch, scramble: scramble as u32, numbers: sobol.point(k) })
    }
}

/// Barycentric coordinates of corners 1 and 2, in units of 2^-16.
type Place = [u16; 2];

fn packed(barycentric: [f64; 2]) -> Place {
    barycentric.map(|x| (x * 65_536.0) as u16)
}

fn weights(place: Place) -> [f64; 3] {
    let [v, w] = place.map(|x| (f64::from(x) + 0.5) / 65_536.0);
    [1.0 - v - w, v, w]
}

/// Where a ray started and where it arrived.
#[derive(Debug, Clone, Copy)]
struct Trip {
    patch: u32,
    from: Place,
    to: Place,
}

/// The operator. With [`Order::Linear`] its unknowns are the corner values, three a patch.
#[derive(Debug, Clone)]
pub struct Rays {
    order: Order,
    rays: usize,
    trips: Vec<Trip>,
    areas: Vec<f64>,
}

/// Bytes of one ray.
pub const BYTES_OF_RAY: u64 = size_of::<Trip>() as u64;

impl Rays {
    /// An operator of `rays` rays from each of the patches with these `areas`, all of which are still lost.
    pub fn new(order: Order, rays: usize, areas: &[f64]) -> Rays {
        let lost = Trip { patch: NO_PATCH, from: [0; 2], to: [0; 2] };
        let count = order.coefficients();
        let areas: Vec<f64> = areas.iter().flat_map(|a| std::iter::repeat_n(a / count as f64, count)).collect();
        Rays { order, rays, trips: vec![lost; rays * areas.len() / count], areas }
    }

    /// Coefficients a patch.
    pub fn coefficients(&self) -> usize {
        self.order.coefficients()
    }

    /// Patch after patch, where its rays are to be recorded.
    pub fn rows(&mut self) -> impl IndexedParallelIterator<Item = Row<'_>> {
        self.trips.par_chunks_mut(self.rays).map(Row)
    }

    /// The same rays with constant radiosity on every patch.
    pub fn into_constant(self) -> Rays {
        let count = self.order.coefficients();
        let areas = self.areas.iter().step_by(count).map(|a| a * count as f64).collect();
        Rays { order: Order::Constant, areas, ..self }
    }

    /// Whether every ray has arrived somewhere.
    pub fn is_closed(&self) -> bool {
        self.trips.iter().all(|trip| trip.patch != NO_PATCH)
    }

    /// out = the coefficients of the function on patch i whose value at the start of ray k is `value(k)`, `bands` numbers each.
    pub fn project(&self, i: usize, bands: usize, value: impl Fn(usize, &mut [f64]), out: &mut [f64]) {
        let trips = &self.trips[i * self.rays..][..self.rays];
        let share = 1.0 / self.rays as f64;
        let mut row = vec![0.0; bands];
        out.fill(0.0);
        if self.order == Order::Constant {
            for k in 0..self.rays {
                value(k, &mut row);
                add_scaled(share, &row, out);
            }
            return;
        }
        let mut centre = [0.0; 3];
        let mut mean = vec![0.0; bands];
        for (k, trip) in trips.iter().enumerate() {
            let l = weights(trip.from);
            row.fill(0.0);
            value(k, &mut row);
            for c in 0..3 {
                centre[c] += share * l[c];
                add_scaled(share * l[c], &row, &mut out[c * bands..][..bands]);
            }
            add_scaled(share, &row, &mut mean);
        }
        for c in 0..3 {
            for b in 0..bands {
                let out = &mut out[c * bands + b];
                *out = mean[b] + 12.0 * (*out - centre[c] * mean[b]);
            }
        }
    }

    /// Calls `visit(j, F_ij)` for every ray of the coefficient i; coefficients may come more than once.
    fn for_each_entry(&self, i: usize, mut visit: impl FnMut(usize, f64)) {
        let count = self.order.coefficients();
        let trips = &self.trips[i / count * self.rays..][..self.rays];
        let share = 1.0 / self.rays as f64;
        let centre = share * trips.iter().map(|trip| weights(trip.from)[i % count]).sum::<f64>();
        for trip in trips.iter().filter(|trip| trip.patch != NO_PATCH) {
            match self.order {
                Order::Constant => visit(trip.patch as usize, share),
                Order::Linear => {
                    let f = share * (1.0 + 12.0 * (weights(trip.from)[i % 3] - centre));
                    let to = weights(trip.to);
                    (0..3).for_each(|c| visit(3 * trip.patch as usize + c, f * to[c]));
                }
            }
        }
    }
}

/// The rays of one patch.
pub struct Row<'a>(&'a mut [Trip]);

impl Row<'_> {
    /// Records where ray k started and, unless nobody receives it, where it arrived.
    pub fn set(&mut self, k: usize, from: [f64; 2], arrival: Option<(u32, [f64; 2])>) {
        let (patch, to) = arrival.unwrap_or((NO_PATCH, [0.0; 2]));
        self.0[k] = Trip { patch, from: packed(from), to: packed(to) };
    }
}

impl FormFactors for Rays {
    fn len(&self) -> usize {
        self.areas.len()
    }

    fn areas(&self) -> Option<&[f64]> {
        Some(&self.areas)
    }

    fn gather(&self, i: usize, x: &[f64], out: &mut [f64]) {
        let bands = out.len();
        out.fill(0.0);
        self.for_each_entry(i, |j, f| add_scaled(f, &x[j * bands..][..bands], out));
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        for (k, out) in out.chunks_exact_mut(amount.len()).enumerate() {
            self.for_each_entry(k, |j, f| {
                if j == i {
                    add_scaled(f, amount, out);
                }
            });
        }
    }

    fn apply(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        let count = self.order.coefficients();
        let value = |trip: &Trip, row: &mut [f64]| {
            if trip.patch == NO_PATCH {
                return;
            }
            let from = &x[trip.patch as usize * count * bands..][..count * bands];
            match self.order {
                Order::Constant => add_scaled(1.0, from, row),
                Order::Linear => {
                    let to = weights(trip.to);
                    (0..3).for_each(|c| add_scaled(to[c], &from[c * bands..][..bands], row));
                }
            }
        };
        out.par_chunks_mut(count * bands).with_min_len(64).enumerate().for_each(|(i, out)| {
            let trips = &self.trips[i * self.rays..][..self.rays];
            if self.order == Order::Constant {
                out.fill(0.0);
                trips.iter().for_each(|trip| value(trip, out));
                out.iter_mut().for_each(|out| *out /= self.rays as f64);
            } else {
                self.project(i, bands, |k, row| value(&trips[k], row), out);
            }
        });
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        out.fill(0.0);
        self.for_each_entry(i, |j, f| out[j] += f);
    }

    fn nbytes(&self) -> usize {
        size_of_val(self.trips.as_slice()) + size_of_val(self.areas.as_slice())
    }
}

/// A function that is constant or linear on every patch.
#[derive(Debug, Clone)]
pub struct Field {
    order: Order,
    bands: usize,
    values: Vec<f64>,
}

impl Field {
    /// The function with these coefficients, in the order of [`Rays`].
    pub fn new(order: Order, bands: usize, values: Vec<f64>) -> Field {
        Field { order, bands, values }
    }

    /// out_b += factor_b times the value at a point of patch j.
    #[inline]
    pub fn add(&self, j: u32, [v, w]: [f64; 2], factor: &[f64], out: &mut [f64]) {
        let (count, bands) = (self.order.coefficients(), self.bands);
        let values = &self.values[j as usize * count * bands..][..count * bands];
        for b in 0..bands {
            let value = match self.order {
                Order::Constant => values[b],
                Order::Linear => (1.0 - v - w) * values[b] + v * values[bands + b] + w * values[2 * bands + b],
            };
            out[b] += factor[b] * value;
        }
    }

    /// The mean over every patch, n x b.
    pub fn means(&self) -> Vec<f64> {
        let (count, bands) = (self.order.coefficients(), self.bands);
        let mean = |patch: &[f64], b: usize| patch.iter().skip(b).step_by(bands).sum::<f64>() / count as f64;
        self.values.chunks_exact(count * bands).flat_map(|patch| (0..bands).map(move |b| mean(patch, b))).collect()
    }
}
