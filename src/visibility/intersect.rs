//! Watertight ray/triangle intersection, in f64: here it is decided what a ray hits, whichever kernel asks.
//!
//! S. Woop, C. Benthin, I. Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013. The triangle is sheared into
//! the ray's frame, where the ray is the z axis; the three edge functions are then 2-D cross products. Two triangles
//! that share an edge compute the same number for it, up to sign, so no ray slips between them. This holds as long as
//! the products are not fused, which Rust never does by itself.

use crate::geometry::{Triangle, Vec3};

/// The axes x and y of a ray's frame for its main axis, right-handed along a ray that goes up that axis.
pub(super) const ACROSS: [[u32; 2]; 3] = [[1, 2], [2, 0], [0, 1]];

/// A ray as a line in its own frame. The direction counts as divided by the size of its main component, the largest: so
/// distances along the ray are those along its main axis, and the shear is the direction itself.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line {
    /// Numbers of the axes x, y and z of the frame; z is the main one. Right-handed along the ray.
    pub(super) axes: [usize; 3],
    /// In that order.
    pub(super) origin: [f64; 3],
    /// d_x / d_z, d_y / d_z, and the sign of d_z.
    pub(super) shear: [f64; 3],
}

impl Line {
    /// The line from `origin` along `direction`, which has the main component +-1 along the main axis of `way`.
    pub(super) fn new(origin: Vec3, direction: Vec3, way: Vec3) -> Line {
        let (d, o) = (direction.to_array(), origin.to_array());
        let z = main_axis(way);
        let [x, y] = ACROSS[z].map(|axis| axis as usize);
        let (x, y, sign) = if d[z] > 0.0 { (x, y, 1.0) } else { (y, x, -1.0) };
        Line { axes: [x, y, z], origin: [o[x], o[y], o[z]], shear: [d[x] * sign, d[y] * sign, sign] }
    }

    /// The distance t of the hit along the main axis and the barycentric coordinates of corners 1 and 2, whichever side is
    /// hit.
    ///
    /// A triangle seen exactly edge-on is not hit: it has no area to the ray.
    #[inline(always)]
    pub(super) fn hit(&self, triangle: &Triangle) -> Option<(f64, [f64; 2])> {
        let (ax, ay, az) = self.sheared(&triangle[0]);
        let (bx, by, bz) = self.sheared(&triangle[1]);
        let (cx, cy, cz) = self.sheared(&triangle[2]);
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        // Which sign it is depends on the side, which no branch predictor knows: compare extremes.
        if (u.min(v).min(w) < 0.0) & (u.max(v).max(w) > 0.0) {
            return None;
        }
        let determinant = u + v + w;
        if determinant == 0.0 {
            return None;
        }
        let inverse = 1.0 / determinant;
        let t = self.shear[2] * (u * az + v * bz + w * cz) * inverse;
        Some((t, [v * inverse, w * inverse]))
    }

    /// A corner in the ray's frame.
    #[inline(always)]
    fn sheared(&self, corner: &Vec3) -> (f64, f64, f64) {
        let (corner, [x, y, z]): (&[f64; 3], _) = (corner.as_ref(), self.axes);
        // SAFETY: axes are numbered 0 to 2.
        let [x, y, z] = unsafe { [*corner.get_unchecked(x), *corner.get_unchecked(y), *corner.get_unchecked(z)] };
        let depth = z - self.origin[2];
        (x - self.origin[0] - self.shear[0] * depth, y - self.origin[1] - self.shear[1] * depth, depth)
    }
}

/// The axis of the largest component; of equal ones the last.
pub(super) fn main_axis(d: Vec3) -> usize {
    let [x, y, z] = d.abs().to_array();
    let xy = if x > y { x } else { y };
    if xy > z { usize::from(x <= y) } else { 2 }
}
