//! The operator that quasi-random rays make, and the linear field that they show of what it gathers.
//!
//!   (F B)(x) ~ B(y) at the point y that a cosine-distributed ray from x meets first
//!
//! With m rays from points x_k of patch i that arrive on patches j_k, the mean of H = F B on the patch and its linear part are
//!
//!   H_i = 1/m sum over k of B_jk,    H_ic = H_i + 12/m sum over k of (l_c(x_k) - mean l_c) B_jk
//!
//! where l_c, c = 0, 1, 2, are the barycentric coordinates and H_ic the values at the corners of the linear function
//! that is nearest to H in the mean square: 12 inverts their covariances 1/18 and -1/36 on a triangle. In between
//! H(x) = sum over c of l_c(x) H_jc (linear finite elements, Zatz 1993, "Galerkin radiosity"). Equations are solved for the
//! means alone; the linear part is read off the last bounce, which is where a patch is most uneven. Taking off the mean
//! of l_c makes a constant B give H without a linear part, however few the rays: a furnace is solved exactly.
//!
//! Rays are Owen-scrambled Sobol points in the four dimensions of origin and direction ([`crate::geometry::sampling`]), each
//! patch with a scramble of its own, so that the rows are independent. One ray takes 8 bytes, half of them only until the
//! field is known: origins are kept in 16 bits, since all this is only where a solve starts from ([`crate::accuracy`]).

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

/// The operator for radiosity that is constant on every patch.
#[derive(Debug, Clone)]
pub struct Rays {
    /// Of each patch.
    count: usize,
    /// Where each ray of each patch arrives.
    arrivals: Vec<u32>,
    areas: Vec<f64>,
}

impl Rays {
    /// Whether every ray has arrived somewhere.
    pub fn is_closed(&self) -> bool {
        !self.arrivals.contains(&NO_PATCH)
    }

    /// The operator of the first (0) or the second (1) half of the rays of every patch.
    pub fn half(&self, which: usize) -> Rays {
        let count = self.count / 2;
        let part = |row: &[u32]| row[which * count..][..count].to_vec();
        Rays {
            count,
            arrivals: self.arrivals.chunks_exact(self.count).flat_map(part).collect(),
            areas: self.areas.clone(),
        }
    }

    fn row_of(&self, i: usize) -> &[u32] {
        &self.arrivals[i * self.count..][..self.count]
    }

    /// Calls `visit(j)` for every ray of patch i that arrives; each counts for 1 / m.
    fn for_each_arrival(&self, i: usize, visit: impl FnMut(usize)) {
        self.row_of(i).iter().filter(|j| **j != NO_PATCH).map(|j| *j as usize).for_each(visit);
    }

    fn share(&self) -> f64 {
        1.0 / self.count as f64
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
        self.for_each_arrival(i, |j| add_scaled(1.0, &x[j * bands..][..bands], out));
        let share = self.share();
        out.iter_mut().for_each(|out| *out *= share);
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        for (k, out) in out.chunks_exact_mut(amount.len()).enumerate() {
            let hits = self.row_of(k).iter().filter(|j| **j as usize == i).count();
            add_scaled(hits as f64 * self.share(), amount, out);
        }
    }

    fn apply(&self, x: &[f64], bands: usize, out: &mut [f64]) {
        let rows = out.par_chunks_mut(bands).with_min_len(64).enumerate();
        rows.for_each(|(i, out)| self.gather(i, x, out));
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        out.fill(0.0);
        self.for_each_arrival(i, |j| out[j] += self.share());
    }

    fn nbytes(&self) -> usize {
        size_of_val(self.arrivals.as_slice()) + size_of_val(self.areas.as_slice())
    }
}

/// Rays of which is also known where on their patches they started.
#[derive(Debug, Clone)]
pub struct Trips {
    order: Order,
    rays: Rays,
    origins: Vec<Place>,
}

/// Bytes of one trip.
pub const BYTES_OF_TRIP: u64 = (size_of::<u32>() + size_of::<Place>()) as u64;

impl Trips {
    /// `count` rays from each of the patches with these `areas`, all of which are still lost.
    pub fn new(order: Order, count: usize, areas: &[f64]) -> Trips {
        let arrivals = vec![NO_PATCH; count * areas.len()];
        let origins = vec![[0; 2]; arrivals.len()];
        Trips { order, rays: Rays { count, arrivals, areas: areas.to_vec() }, origins }
    }

    /// Patch after patch, where its rays are to be recorded.
    pub fn rows(&mut self) -> impl IndexedParallelIterator<Item = Row<'_>> {
        let (order, count) = (self.order, self.rays.count);
        let rows = self.rays.arrivals.par_chunks_mut(count).zip(self.origins.par_chunks_mut(count));
        rows.map(move |(arrivals, origins)| Row { order, arrivals, origins })
    }

    /// The operator.
    pub fn rays(&self) -> &Rays {
        &self.rays
    }

    /// The operator, without the places.
    pub fn into_rays(self) -> Rays {
        self.rays
    }

    /// Adds F B to a field of the same order, from a radiosity B that is constant on every patch, n x b.
    pub fn add_gathered(&self, radiosity: &[f64], field: &mut Field) {
        let bands = field.bands;
        let rows = field.values.par_chunks_mut(self.order.coefficients() * bands).enumerate();
        rows.for_each(|(i, out)| {
            let arrivals = self.rays.row_of(i);
            let value = |k: usize, row: &mut [f64]| {
                if arrivals[k] != NO_PATCH {
                    add_scaled(1.0, &radiosity[arrivals[k] as usize * bands..][..bands], row);
                }
            };
            add_projected(self.order, &self.origins[i * arrivals.len()..][..arrivals.len()], bands, value, out);
        });
    }
}

/// The rays of one patch.
pub struct Row<'a> {
    order: Order,
    arrivals: &'a mut [u32],
    origins: &'a mut [Place],
}

impl Row<'_> {
    /// Records where ray k started.
    pub fn start(&mut self, k: usize, barycentric: [f64; 2]) {
        self.origins[k] = packed(barycentric);
    }

    /// Records the patch where ray k arrived.
    pub fn arrive(&mut self, k: usize, patch: u32) {
        self.arrivals[k] = patch;
    }

    /// Adds to the coefficients `out` those of the function on the patch whose value at the start of ray k is what `value(k)`
    /// adds to `bands` times 0.
    pub fn add_projected(&self, bands: usize, value: impl Fn(usize, &mut [f64]), out: &mut [f64]) {
        add_projected(self.order, self.origins, bands, value, out);
    }
}

fn add_projected(order: Order, origins: &[Place], bands: usize, value: impl Fn(usize, &mut [f64]), out: &mut [f64]) {
    let share = 1.0 / origins.len() as f64;
    // Sums of l_c and of l_c times the value, and the mean.
    let (mut centre, mut moments) = ([0.0; 3], vec![0.0; 3 * bands]);
    let (mut row, mut mean) = (vec![0.0; bands], vec![0.0; bands]);
    for (k, origin) in origins.iter().enumerate() {
        row.fill(0.0);
        value(k, &mut row);
        add_scaled(share, &row, &mut mean);
        if order == Order::Linear {
            let l = weights(*origin);
            for c in 0..3 {
                centre[c] += share * l[c];
                add_scaled(share * l[c], &row, &mut moments[c * bands..][..bands]);
            }
        }
    }
    for c in 0..order.coefficients() {
        for b in 0..bands {
            out[c * bands + b] += mean[b] + 12.0 * (moments[c * bands + b] - centre[c] * mean[b]);
        }
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
    /// The function with these coefficients: for every patch, its corners one after the other, or its mean.
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
