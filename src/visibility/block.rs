//! A block of rays made ready for traversal, field by field: plain loops that the compiler turns into vector code.
//!
//! Each direction is divided by the size of its largest component, the main axis z. So the distance along the ray is that
//! along z, in boxes and in triangles alike, and the shear that makes the ray the z axis (Woop, Benthin & Wald 2013,
//! section 3) is the direction itself.

use super::intersect::{ACROSS, Line};
use crate::geometry::Vec3;

/// Rays in a block. Half as many wait for each other more, twice as many leave the first-level cache.
pub(super) const BLOCK: usize = 32;

/// A little more than the normalised box, in which all arithmetic in f32 happens.
pub(super) const HALF: f64 = 1.001;
/// No way through the box is longer along its main axis.
const LONGEST: f64 = 2.01;
/// Shorter directions may have no inverse.
const TINY: f64 = 1e-300;
/// 1 / d must stay finite: beyond 2^60 a box is as good as infinitely far.
const LEAST: f32 = 8.7e-19;

type Doubles = [f64; BLOCK];
type Singles = [f32; BLOCK];
type Numbers = [u32; BLOCK];

/// Rays in f64, for what is decided, and their part inside the normalised box in f32, for the way there.
#[repr(C, align(64))]
pub(super) struct Block {
    origin: [Doubles; 3],
    /// As given; once prepared, with a main component of +-1.
    direction: [Doubles; 3],
    /// In units of the direction as given; once prepared, along the main axis.
    length: Doubles,
    /// How far along the main axis the given start lies before `origin`, which is in the box.
    pub(super) enter: Doubles,
    /// Size of the main component of the direction as given.
    pub(super) size: Doubles,
    /// Main axis, and axes x and y of the ray's frame; right-handed along the ray.
    pub(super) axis: Numbers,
    pub(super) across: [Numbers; 2],
    /// Where the f32 part starts, the first point in the box.
    pub(super) from: [Singles; 3],
    /// 1 / direction, large where that is infinite, and -from / direction.
    pub(super) inverse: [Singles; 3],
    pub(super) offset: [Singles; 3],
    /// Row of a node's bounds in which the ray enters, for each axis; it leaves in the other of the pair.
    pub(super) near: [Numbers; 3],
    /// Along which axes it goes down, one bit each.
    pub(super) octant: Numbers,
    /// d_x / d_z, d_y / d_z, and the sign of d_z.
    pub(super) shear: [Singles; 3],
    /// Places of the triangles that it does not meet.
    pub(super) exclude: [Numbers; 2],
    /// The end of the f32 part, not nearer than it is; negative for a ray that misses the box.
    pub(super) tmax: Singles,
}

impl Block {
    pub(super) fn new() -> Block {
        Block {
            origin: [[0.0; BLOCK]; 3],
            direction: [[1.0; BLOCK]; 3],
            length: [1.0; BLOCK],
            enter: [0.0; BLOCK],
            size: [1.0; BLOCK],
            axis: [0; BLOCK],
            across: [[0; BLOCK]; 2],
            from: [[0.0; BLOCK]; 3],
            inverse: [[0.0; BLOCK]; 3],
            offset: [[0.0; BLOCK]; 3],
            near: [[0; BLOCK]; 3],
            octant: [0; BLOCK],
            shear: [[0.0; BLOCK]; 3],
            exclude: [[0; BLOCK]; 2],
            tmax: [0.0; BLOCK],
        }
    }

    /// Ray `r` has this normalised origin, this direction, and this length in units of the direction.
    #[inline(always)]
    pub(super) fn set(&mut self, r: usize, origin: Vec3, direction: Vec3, length: f64, exclude: [u32; 2]) {
        for k in 0..3 {
            self.origin[k][r] = origin[k];
            self.direction[k][r] = direction[k];
        }
        self.length[r] = length;
        [self.exclude[0][r], self.exclude[1][r]] = exclude;
    }

    /// Makes all rays ready.
    #[inline(always)]
    pub(super) fn prepare(&mut self) {
        let (mut special, mut inverse) = (false, [0.0; BLOCK]);
        for r in 0..BLOCK {
            let [x, y, z] = [self.direction[0][r].abs(), self.direction[1][r].abs(), self.direction[2][r].abs()];
            let xy = if x > y { x } else { y };
            let size = if xy > z { xy } else { z };
            self.size[r] = size;
            inverse[r] = 1.0 / size;
            self.axis[r] = if xy > z { u32::from(x <= y) } else { 2 };
            let [ox, oy, oz] = [self.origin[0][r].abs(), self.origin[1][r].abs(), self.origin[2][r].abs()];
            self.enter[r] = 0.0;
            // Also what is no number.
            let usual = (ox <= HALF) & (oy <= HALF) & (oz <= HALF) & (size >= TINY) & (x + y + z < f64::INFINITY);
            special |= !usual;
        }
        if special {
            self.lengthen(&mut inverse);
        }
        for r in 0..BLOCK {
            for k in 0..3 {
                self.direction[k][r] *= inverse[r];
                self.from[k][r] = self.origin[k][r] as f32;
            }
            self.length[r] *= self.size[r];
            self.tmax[r] = if self.length[r] < LONGEST { self.length[r] as f32 } else { LONGEST as f32 };
        }
        if special {
            self.clip();
        }
        for r in 0..BLOCK {
            // The end may have been rounded down.
            self.tmax[r] *= 1.0 + f32::EPSILON;
            self.octant[r] = 0;
            for k in 0..3 {
                let d = self.direction[k][r] as f32;
                let d = if d.abs() < LEAST { LEAST.copysign(d) } else { d };
                let down = u32::from(d < 0.0);
                self.inverse[k][r] = 1.0 / d;
                self.offset[k][r] = -self.from[k][r] * self.inverse[k][r];
                self.near[k][r] = 2 * k as u32 + down;
                self.octant[r] |= down << k;
            }
        }
        for r in 0..BLOCK {
            let [dx, dy, dz] = [self.direction[0][r] as f32, self.direction[1][r] as f32, self.direction[2][r] as f32];
            let axis = self.axis[r];
            let [x, y] = if axis == 0 {
                ACROSS[0]
            } else if axis == 1 {
                ACROSS[1]
            } else {
                ACROSS[2]
            };
            let (sx, sy, main) = if axis == 0 {
                (dy, dz, dx)
            } else if axis == 1 {
                (dz, dx, dy)
            } else {
                (dx, dy, dz)
            };
            let up = main > 0.0;
            self.across[0][r] = if up { x } else { y };
            self.across[1][r] = if up { y } else { x };
            self.shear[0][r] = if up { sx } else { -sy };
            self.shear[1][r] = if up { sy } else { -sx };
            self.shear[2][r] = if up { 1.0 } else { -1.0 };
        }
    }

    /// Directions that are too short for the inverse of their size become longer by a power of two.
    #[cold]
    fn lengthen(&mut self, inverse: &mut Doubles) {
        const FACTOR: f64 = 1.606_938_044_258_990_3e60; // 2^200
        for r in 0..BLOCK {
            if self.size[r] < TINY {
                (0..3).for_each(|k| self.direction[k][r] *= FACTOR);
                inverse[r] = 1.0 / (self.size[r] * FACTOR).max(f64::MIN_POSITIVE);
            }
        }
    }

    /// Rays that start outside the box start where they enter it; those that miss it, or go nowhere, end before they start.
    #[cold]
    fn clip(&mut self) {
        for r in 0..BLOCK {
            let start = self.origin(r);
            let direction = self.direction(r);
            let length = if self.size[r] > 0.0 { self.length[r] } else { f64::NAN };
            let (enter, rest) = through_the_box(start, direction, length).unwrap_or((0.0, -1.0));
            let from = if rest >= 0.0 { start + enter * direction } else { Vec3::ZERO };
            self.enter[r] = enter;
            self.tmax[r] = rest.min(LONGEST) as f32;
            for k in 0..3 {
                self.origin[k][r] = from[k];
                self.from[k][r] = from[k] as f32;
            }
        }
    }

    /// Ray `r` in f64, from where it enters the box; the same as [`Line::new`] of it.
    #[inline(always)]
    pub(super) fn line(&self, r: usize) -> Line {
        let [x, y, z] = [self.across[0][r] as usize, self.across[1][r] as usize, self.axis[r] as usize];
        let sign = f64::from(self.shear[2][r]);
        // SAFETY: axes are numbered 0 to 2.
        let (o, d) = unsafe {
            let o = [self.origin.get_unchecked(x)[r], self.origin.get_unchecked(y)[r], self.origin.get_unchecked(z)[r]];
            (o, [self.direction.get_unchecked(x)[r], self.direction.get_unchecked(y)[r]])
        };
        Line { axes: [x, y, z], origin: o, shear: [d[0] * sign, d[1] * sign, sign] }
    }

    /// Where ray `r` goes; once prepared, with a main component of +-1.
    pub(super) fn direction(&self, r: usize) -> Vec3 {
        Vec3::new(self.direction[0][r], self.direction[1][r], self.direction[2][r])
    }

    /// Where ray `r` starts; once prepared, within the box.
    #[inline(always)]
    pub(super) fn origin(&self, r: usize) -> Vec3 {
        Vec3::new(self.origin[0][r], self.origin[1][r], self.origin[2][r])
    }
}

/// Where a ray of `length` from `start` enters the normalised box, and how far it then goes in it; along its main axis, of
/// which `direction` has the component +-1. None when it misses the box, or is no ray.
pub(super) fn through_the_box(start: Vec3, direction: Vec3, length: f64) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (0.0f64, length);
    for k in 0..3 {
        let (p, d) = (start[k], direction[k]);
        if !p.is_finite() || !d.is_finite() || (d == 0.0 && p.abs() > HALF) {
            return None;
        }
        if d != 0.0 && start.abs().max_element() > HALF {
            let (a, b) = ((-HALF - p) / d, (HALF - p) / d);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
    }
    (leave >= enter && !length.is_nan()).then_some((enter, leave - enter))
}
