//! The sieve, in f32: what may a ray hit, what does it surely hit, what does it surely miss?
//!
//! Nothing that is hit is ever dropped. Boxes are padded by more than the rounding of all that is done with them; triangles
//! carry bounds on the error of their edge functions. What is neither surely hit nor surely missed, one triangle in some
//! hundreds, is decided in f64 ([`super::intersect`]): so answers do not depend on how a machine rounds here.

use super::wide::{COORDINATE_ERROR, Pack};
use crate::simd::single::Lanes;

/// Triangles in the lanes of a ray, or rays in the lanes of a triangle.
pub(super) struct Sifted<V> {
    /// May be hit in time.
    pub(super) open: u32,
    /// Are hit, if in time.
    pub(super) certain: u32,
    /// Bounds of t.
    pub(super) low: V,
    pub(super) high: V,
}

/// Edge functions u, v, w of triangles with sheared corners a, b, c (Woop, Benthin & Wald 2013), and what they tell.
pub(super) struct Edges<V> {
    corners: [[V; 3]; 3],
    v: V,
    w: V,
    sum: V,
    error: f32,
    /// Not missed: not both signs occur beyond the error.
    pub(super) maybe: u32,
    /// Hit: one sign occurs beyond the error, provided that the error bounds that of triangles that are missed too.
    surely: u32,
}

impl<V> Edges<V> {
    #[inline(always)]
    pub(super) fn new<const N: usize>([a, b, c]: [[V; 3]; 3], error: f32) -> Edges<V>
    where
        V: Lanes<N>,
    {
        let u = c[0].mul_sub(b[1], c[1].mul(b[0]));
        let v = a[0].mul_sub(c[1], a[1].mul(c[0]));
        let w = b[0].mul_sub(a[1], b[1].mul(a[0]));
        let (plus, minus) = (V::splat(error), V::splat(-error));
        let (least, most) = (u.min(v).min(w), u.max(v).max(w));
        Edges {
            corners: [a, b, c],
            v,
            w,
            sum: u.add(v).add(w),
            error,
            maybe: minus.le(least) | most.le(plus),
            surely: plus.le(least) | most.le(minus),
        }
    }

    /// Where all corners lie within `reach` of the ray across it: only there does an error for rays that meet the triangles'
    /// box hold.
    #[inline(always)]
    pub(super) fn within<const N: usize>(&self, reach: f32) -> u32
    where
        V: Lanes<N>,
    {
        let [a, b, c] = self.corners;
        let x = a[0].abs().max(b[0].abs()).max(c[0].abs());
        let y = a[1].abs().max(b[1].abs()).max(c[1].abs());
        x.max(y).le(V::splat(reach))
    }

    /// Sifts by distance along a ray that goes along +-z by `sign`.
    ///
    /// t = z_a + (v (z_b - z_a) + w (z_c - z_a)) / D, D = u + v + w. Of triangles that are not missed v and w lie between -error
    /// and |D| + 2 error: t is off by no more than 20 error / |D| times the depth of the triangle, edge-on (|D| of the size
    /// of its own error) too, and a few times `coordinate_error`. Where D = 0 the bounds say nothing.
    #[inline(always)]
    pub(super) fn sift<const N: usize>(&self, sign: V, tmax: V, coordinate_error: f32) -> Sifted<V>
    where
        V: Lanes<N>,
    {
        let [a, b, c] = [self.corners[0][2], self.corners[1][2], self.corners[2][2]];
        let (b, c) = (b.sub(a), c.sub(a));
        let size = self.sum.abs();
        let inverse = V::splat(1.0).div(size);
        let t = a.mul_add(self.sum, self.v.mul_add(b, self.w.mul(c))).flip(self.sum).flip(sign).mul(inverse);
        let depth = V::splat(20.0 * self.error).mul(b.abs().add(c.abs()));
        let slack = depth.mul_add(inverse, V::splat(4.0 * coordinate_error));
        // Of NaN and a number, the number.
        let (low, high) = (t.sub(slack).max(V::splat(-1.0)), t.add(slack).min(V::splat(f32::MAX)));
        let in_time = V::splat(0.0).le(high) & low.le(tmax);
        Sifted { open: self.maybe & in_time, certain: self.surely & in_time, low, high }
    }
}

/// Sifts the triangles of a pack for one ray, of which `axes`, `from`, `shear` and `sign` are as in [`super::block::Block`].
#[inline(always)]
pub(super) fn sift_pack<V: Lanes<8>>(
    pack: &Pack,
    axes: [u32; 3],
    from: [f32; 3],
    shear: [f32; 2],
    sign: f32,
    tmax: f32,
) -> Sifted<V> {
    let from = [V::splat(from[0]), V::splat(from[1]), V::splat(from[2])];
    let shear = [V::splat(shear[0]), V::splat(shear[1])];
    let corners = [
        sheared(&pack.corners[0], axes, from, shear),
        sheared(&pack.corners[1], axes, from, shear),
        sheared(&pack.corners[2], axes, from, shear),
    ];
    Edges::new(corners, pack.error).sift(V::splat(sign), V::splat(tmax), COORDINATE_ERROR)
}

/// A corner of eight triangles in the ray's frame.
#[inline(always)]
fn sheared<V: Lanes<8>>(rows: &[[f32; 8]; 3], [x, y, z]: [u32; 3], from: [V; 3], shear: [V; 2]) -> [V; 3] {
    // SAFETY: axes are numbered 0 to 2.
    let [x, y, z] =
        unsafe { [rows.get_unchecked(x as usize), rows.get_unchecked(y as usize), rows.get_unchecked(z as usize)] };
    let depth = V::load(z).sub(from[2]);
    [shear[0].neg_mul_add(depth, V::load(x).sub(from[0])), shear[1].neg_mul_add(depth, V::load(y).sub(from[1])), depth]
}
