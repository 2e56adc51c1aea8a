//! Watertight ray/triangle intersection.
//!
//! S. Woop, C. Benthin, I. Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013. The triangle is sheared into
//! the ray's frame, where the ray is the z axis; the three edge functions are then 2-D cross products. Two triangles
//! that share an edge compute the same number for it, up to sign, so no ray slips between them. This holds as long as
//! the products are not fused, which Rust never does by itself.

use crate::geometry::{Triangle, Vec3};

/// A ray prepared for intersection: origin, and the shear that turns its direction into the z axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct ShearedRay {
    origin: Vec3,
    axes: [usize; 3],
    shear: [f64; 3],
}

impl ShearedRay {
    /// `direction` must not be zero; `t` is measured in units of it.
    pub(super) fn new(origin: Vec3, direction: Vec3) -> ShearedRay {
        let d = direction.to_array();
        let size = direction.abs();
        let z = if size.x > size.y && size.x > size.z {
            0
        } else if size.y > size.z {
            1
        } else {
            2
        };
        // Keep the handedness, so that the sign of the determinant tells the side.
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if d[z] < 0.0 {
            (x, y) = (y, x);
        }
        ShearedRay { origin, axes: [x, y, z], shear: [d[x] / d[z], d[y] / d[z], 1.0 / d[z]] }
    }

    /// The parameter t of the hit and the barycentric coordinates of corners 1 and 2, whichever side is hit.
    ///
    /// A triangle seen exactly edge-on is not hit: it has no area to the ray.
    #[inline]
    pub(super) fn hit(&self, triangle: &Triangle) -> Option<(f64, [f64; 2])> {
        let [kx, ky, kz] = self.axes;
        let [sx, sy, sz] = self.shear;
        let corner = |v: Vec3| {
            let p = (v - self.origin).to_array();
            (p[kx] - sx * p[kz], p[ky] - sy * p[kz], p[kz])
        };
        let (ax, ay, az) = corner(triangle[0]);
        let (bx, by, bz) = corner(triangle[1]);
        let (cx, cy, cz) = corner(triangle[2]);
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let determinant = u + v + w;
        if determinant == 0.0 {
            return None;
        }
        let t = sz * (u * az + v * bz + w * cz) / determinant;
        Some((t, [v / determinant, w / determinant]))
    }
}
