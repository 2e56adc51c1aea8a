//! Eight f64 at a time, with the two transcendental functions that form factors are made of.
//!
//! [`ln`] after fdlibm's `e_log.c` (Sun Microsystems 1993), [`angle`] after Cephes' `atan.c` (Moshier 1989): their
//! coefficients, both within 2 ulp. Lanes may round products and sums once or twice (fused or not), so results on different
//! machines agree to rounding; on one machine a lane's result depends on nothing but its own numbers.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Sub};

/// Numbers in a vector.
pub(crate) const LANES: usize = 8;

/// Eight numbers.
pub(crate) trait Double:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    type Mask: Copy + BitAnd<Output = Self::Mask> + BitOr<Output = Self::Mask>;

    fn splat(x: f64) -> Self;
    fn load(values: &[f64; LANES]) -> Self;
    fn store(self, out: &mut [f64; LANES]);
    /// self x factor + term, rounded once or twice.
    fn mul_add(self, factor: Self, term: Self) -> Self;
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    fn lt(self, other: Self) -> Self::Mask;
    /// `yes` where the mask is set, else `no`.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// A bit for every lane that is set.
    fn bits(mask: Self::Mask) -> u32;
    /// (e, m) with self = m 2^e and m in [1, 2), for positive normal numbers.
    fn split(self) -> (Self, Self);

    #[inline(always)]
    fn to_array(self) -> [f64; LANES] {
        let mut out = [0.0; LANES];
        self.store(&mut out);
        out
    }
}

/// The natural logarithm of positive normal numbers.
#[inline(always)]
pub(crate) fn ln<D: Double>(x: D) -> D {
    // log(1 + f) = f - (f^2/2 - s (f^2/2 + R)),  s = f / (2 + f),  R = s^2 (L1 + s^2 (L2 + ...)).
    const L: [f64; 7] = [
        1.479_819_860_511_658_6e-1,
        1.531_383_769_920_937_3e-1,
        1.818_357_216_161_805e-1,
        2.222_219_843_214_978_4e-1,
        2.857_142_874_366_239e-1,
        3.999_999_999_940_942e-1,
        6.666_666_666_666_735e-1,
    ];
    // ln 2 in two parts: an exponent times the first is exact.
    const LN2_HIGH: f64 = 6.931_471_803_691_238e-1;
    const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    let (exponent, mantissa) = x.split();
    let large = D::splat(std::f64::consts::SQRT_2).lt(mantissa);
    let mantissa = D::select(large, mantissa * D::splat(0.5), mantissa);
    let exponent = D::select(large, exponent + D::splat(1.0), exponent);
    let f = mantissa - D::splat(1.0);
    let s = f / (f + D::splat(2.0));
    let z = s * s;
    let half_square = D::splat(0.5) * f * f;
    let r = z * polynomial(z, &L);
    let low = exponent.mul_add(D::splat(LN2_LOW), s * (half_square + r));
    exponent.mul_add(D::splat(LN2_HIGH), f - (half_square - low))
}

/// The angle in [0, pi] whose sine is to its cosine as y to x; y must not be negative. 0 for (0, 0).
#[inline(always)]
pub(crate) fn angle<D: Double>(y: D, x: D) -> D {
    // atan t = t + t z P(z) / Q(z), z = t^2, for |t| below 0.66: all angles come there by two reflections and a turn of pi/4.
    const P: [f64; 5] = [
        -8.750_608_600_031_904e-1,
        -1.615_753_718_733_365e1,
        -7.500_855_792_314_705e1,
        -1.228_866_684_490_136_2e2,
        -6.485_021_904_942_025e1,
    ];
    const Q: [f64; 6] = [
        1.0,
        2.485_846_490_142_306_3e1,
        1.650_270_098_316_988_5e2,
        4.328_810_604_912_902_7e2,
        4.853_903_996_359_137e2,
        1.945_506_571_482_614e2,
    ];
    let zero = D::splat(0.0);
    let size = x.abs();
    let steep = size.lt(y);
    let (low, high) = (y.min(size), y.max(size));
    let turned = (D::splat(0.5) * high).lt(low);
    let above = D::select(turned, low - high, low);
    let below = D::select(turned, low + high, high).max(D::splat(f64::MIN_POSITIVE));
    let t = above / below;
    let z = t * t;
    let arc = (t * z).mul_add(polynomial(z, &P) / polynomial(z, &Q), t);
    let arc = arc + D::select(turned, D::splat(std::f64::consts::FRAC_PI_4), zero);
    let arc = D::select(steep, D::splat(std::f64::consts::FRAC_PI_2) - arc, arc);
    D::select(x.lt(zero), D::splat(std::f64::consts::PI) - arc, arc)
}

/// The polynomial with these coefficients, the highest power first (Horner).
#[inline(always)]
pub(crate) fn polynomial<D: Double, const N: usize>(x: D, coefficients: &[f64; N]) -> D {
    let mut sum = D::splat(coefficients[0]);
    for k in 1..N {
        sum = sum.mul_add(x, D::splat(coefficients[k]));
    }
    sum
}

/// Eight points or vectors.
#[derive(Clone, Copy)]
pub(crate) struct Vectors<D> {
    pub(crate) x: D,
    pub(crate) y: D,
    pub(crate) z: D,
}

impl<D: Double> Vectors<D> {
    #[inline(always)]
    pub(crate) fn splat(v: crate::geometry::Vec3) -> Self {
        Vectors { x: D::splat(v.x), y: D::splat(v.y), z: D::splat(v.z) }
    }

    #[inline(always)]
    pub(crate) fn load(rows: &[[f64; LANES]; 3]) -> Self {
        Vectors { x: D::load(&rows[0]), y: D::load(&rows[1]), z: D::load(&rows[2]) }
    }

    #[inline(always)]
    pub(crate) fn dot(self, other: Self) -> D {
        self.x.mul_add(other.x, self.y.mul_add(other.y, self.z * other.z))
    }

    /// Both products are rounded, so that the cross product of equal vectors is 0.
    #[inline(always)]
    pub(crate) fn cross(self, other: Self) -> Self {
        Vectors {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    /// self x factor + term.
    #[inline(always)]
    pub(crate) fn mul_add(self, factor: D, term: Self) -> Self {
        Vectors {
            x: self.x.mul_add(factor, term.x),
            y: self.y.mul_add(factor, term.y),
            z: self.z.mul_add(factor, term.z),
        }
    }

    #[inline(always)]
    pub(crate) fn scaled(self, factor: D) -> Self {
        Vectors { x: self.x * factor, y: self.y * factor, z: self.z * factor }
    }
}

impl<D: Double> Add for Vectors<D> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Vectors { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }
}

impl<D: Double> Sub for Vectors<D> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Vectors { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }
}

/// Eight numbers as an array.
#[derive(Clone, Copy)]
pub(crate) struct Plain([f64; LANES]);

/// A truth value a lane.
#[derive(Clone, Copy)]
pub(crate) struct Truths([bool; LANES]);

impl BitAnd for Truths {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Truths(std::array::from_fn(|k| self.0[k] & other.0[k]))
    }
}

impl BitOr for Truths {
    type Output = Self;
    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Truths(std::array::from_fn(|k| self.0[k] | other.0[k]))
    }
}

/// An operator of a vector type, by the expression that computes it.
macro_rules! operator {
    ($vector:ty, $trait:ident, $name:ident, |$a:ident, $b:ident| $result:expr) => {
        impl $trait for $vector {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                let ($a, $b) = (self.0, other.0);
                $result
            }
        }
    };
}

operator!(Plain, Add, add, |a, b| Plain(std::array::from_fn(|k| a[k] + b[k])));
operator!(Plain, Sub, sub, |a, b| Plain(std::array::from_fn(|k| a[k] - b[k])));
operator!(Plain, Mul, mul, |a, b| Plain(std::array::from_fn(|k| a[k] * b[k])));
operator!(Plain, Div, div, |a, b| Plain(std::array::from_fn(|k| a[k] / b[k])));

impl Neg for Plain {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Plain(self.0.map(|x| -x))
    }
}

impl Double for Plain {
    type Mask = Truths;

    #[inline(always)]
    fn splat(x: f64) -> Self {
        Plain([x; LANES])
    }
    #[inline(always)]
    fn load(values: &[f64; LANES]) -> Self {
        Plain(*values)
    }
    #[inline(always)]
    fn store(self, out: &mut [f64; LANES]) {
        *out = self.0;
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        self * factor + term
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Plain(self.0.map(f64::sqrt))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Plain(self.0.map(f64::abs))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Plain(std::array::from_fn(|k| if self.0[k] < other.0[k] { self.0[k] } else { other.0[k] }))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Plain(std::array::from_fn(|k| if self.0[k] > other.0[k] { self.0[k] } else { other.0[k] }))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Truths {
        Truths(std::array::from_fn(|k| self.0[k] < other.0[k]))
    }
    #[inline(always)]
    fn select(mask: Truths, yes: Self, no: Self) -> Self {
        Plain(std::array::from_fn(|k| if mask.0[k] { yes.0[k] } else { no.0[k] }))
    }
    #[inline(always)]
    fn bits(mask: Truths) -> u32 {
        (0..LANES).map(|k| u32::from(mask.0[k]) << k).sum()
    }
    #[inline(always)]
    fn split(self) -> (Self, Self) {
        const MANTISSA: u64 = (1 << 52) - 1;
        let exponent = |x: f64| (x.to_bits() >> 52) as i64 as f64 - 1023.0;
        let mantissa = |x: f64| f64::from_bits(x.to_bits() & MANTISSA | 1023 << 52);
        (Plain(self.0.map(exponent)), Plain(self.0.map(mantissa)))
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Quads, Wide};

#[cfg(target_arch = "x86_64")]
mod x86 {
    //! SAFETY, for all of this module: its vectors are made only in kernels that [`super::super::for_every_machine`] enters
    //! once the processor was found to have the instructions; loads and stores go through references to arrays of their size.
    #![allow(clippy::undocumented_unsafe_blocks)]

    use std::arch::x86_64::*;
    use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Sub};

    use super::{Double, LANES};

    /// Eight numbers in two AVX2 registers.
    #[derive(Clone, Copy)]
    pub(crate) struct Quads([__m256d; 2]);

    /// All bits of a lane that is set.
    #[derive(Clone, Copy)]
    pub(crate) struct QuadMask([__m256d; 2]);

    /// Eight numbers in an AVX-512 register.
    #[derive(Clone, Copy)]
    pub(crate) struct Wide(__m512d);

    operator!(QuadMask, BitAnd, bitand, |a, b| unsafe {
        QuadMask([_mm256_and_pd(a[0], b[0]), _mm256_and_pd(a[1], b[1])])
    });
    operator!(QuadMask, BitOr, bitor, |a, b| unsafe { QuadMask([_mm256_or_pd(a[0], b[0]), _mm256_or_pd(a[1], b[1])]) });

    macro_rules! arithmetic {
        ($($trait:ident, $name:ident, $of_four:ident, $of_eight:ident;)*) => {
            $(
                operator!(Quads, $trait, $name, |a, b| unsafe { Quads([$of_four(a[0], b[0]), $of_four(a[1], b[1])]) });
                operator!(Wide, $trait, $name, |a, b| unsafe { Wide($of_eight(a, b)) });
            )*
        };
    }

    arithmetic!(
        Add, add, _mm256_add_pd, _mm512_add_pd;
        Sub, sub, _mm256_sub_pd, _mm512_sub_pd;
        Mul, mul, _mm256_mul_pd, _mm512_mul_pd;
        Div, div, _mm256_div_pd, _mm512_div_pd;
    );

    impl Neg for Quads {
        type Output = Self;
        #[inline(always)]
        fn neg(self) -> Self {
            unsafe {
                let sign = _mm256_set1_pd(-0.0);
                Quads([_mm256_xor_pd(self.0[0], sign), _mm256_xor_pd(self.0[1], sign)])
            }
        }
    }

    impl Neg for Wide {
        type Output = Self;
        #[inline(always)]
        fn neg(self) -> Self {
            unsafe { Wide(_mm512_xor_pd(self.0, _mm512_set1_pd(-0.0))) }
        }
    }

    /// There is no conversion from 64-bit integers: the exponent is written into the mantissa of 2^52.
    #[inline(always)]
    fn split_four(x: __m256d) -> (__m256d, __m256d) {
        unsafe {
            let bits = _mm256_castpd_si256(x);
            let magic = _mm256_set1_epi64x(0x4330_0000_0000_0000);
            let exponent = _mm256_castsi256_pd(_mm256_or_si256(_mm256_srli_epi64::<52>(bits), magic));
            let exponent = _mm256_sub_pd(exponent, _mm256_set1_pd(4_503_599_627_370_496.0 + 1023.0));
            let kept = _mm256_and_si256(bits, _mm256_set1_epi64x((1 << 52) - 1));
            let mantissa = _mm256_castsi256_pd(_mm256_or_si256(kept, _mm256_set1_epi64x(1023 << 52)));
            (exponent, mantissa)
        }
    }

    impl Double for Quads {
        type Mask = QuadMask;

        #[inline(always)]
        fn splat(x: f64) -> Self {
            unsafe { Quads([_mm256_set1_pd(x); 2]) }
        }
        #[inline(always)]
        fn load(values: &[f64; LANES]) -> Self {
            unsafe { Quads([_mm256_loadu_pd(values.as_ptr()), _mm256_loadu_pd(values.as_ptr().add(4))]) }
        }
        #[inline(always)]
        fn store(self, out: &mut [f64; LANES]) {
            unsafe {
                _mm256_storeu_pd(out.as_mut_ptr(), self.0[0]);
                _mm256_storeu_pd(out.as_mut_ptr().add(4), self.0[1]);
            }
        }
        #[inline(always)]
        fn mul_add(self, factor: Self, term: Self) -> Self {
            let (a, b, c) = (self.0, factor.0, term.0);
            unsafe { Quads([_mm256_fmadd_pd(a[0], b[0], c[0]), _mm256_fmadd_pd(a[1], b[1], c[1])]) }
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            unsafe { Quads([_mm256_sqrt_pd(self.0[0]), _mm256_sqrt_pd(self.0[1])]) }
        }
        #[inline(always)]
        fn abs(self) -> Self {
            unsafe {
                let sign = _mm256_set1_pd(-0.0);
                Quads([_mm256_andnot_pd(sign, self.0[0]), _mm256_andnot_pd(sign, self.0[1])])
            }
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            unsafe { Quads([_mm256_min_pd(self.0[0], other.0[0]), _mm256_min_pd(self.0[1], other.0[1])]) }
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            unsafe { Quads([_mm256_max_pd(self.0[0], other.0[0]), _mm256_max_pd(self.0[1], other.0[1])]) }
        }
        #[inline(always)]
        fn lt(self, other: Self) -> QuadMask {
            let (a, b) = (self.0, other.0);
            unsafe { QuadMask([_mm256_cmp_pd::<_CMP_LT_OQ>(a[0], b[0]), _mm256_cmp_pd::<_CMP_LT_OQ>(a[1], b[1])]) }
        }
        #[inline(always)]
        fn select(mask: QuadMask, yes: Self, no: Self) -> Self {
            let (m, y, n) = (mask.0, yes.0, no.0);
            unsafe { Quads([_mm256_blendv_pd(n[0], y[0], m[0]), _mm256_blendv_pd(n[1], y[1], m[1])]) }
        }
        #[inline(always)]
        fn bits(mask: QuadMask) -> u32 {
            unsafe { (_mm256_movemask_pd(mask.0[0]) | _mm256_movemask_pd(mask.0[1]) << 4) as u32 }
        }
        #[inline(always)]
        fn split(self) -> (Self, Self) {
            let ((e0, m0), (e1, m1)) = (split_four(self.0[0]), split_four(self.0[1]));
            (Quads([e0, e1]), Quads([m0, m1]))
        }
    }

    impl Double for Wide {
        type Mask = u8;

        #[inline(always)]
        fn splat(x: f64) -> Self {
            unsafe { Wide(_mm512_set1_pd(x)) }
        }
        #[inline(always)]
        fn load(values: &[f64; LANES]) -> Self {
            unsafe { Wide(_mm512_loadu_pd(values.as_ptr())) }
        }
        #[inline(always)]
        fn store(self, out: &mut [f64; LANES]) {
            unsafe { _mm512_storeu_pd(out.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn mul_add(self, factor: Self, term: Self) -> Self {
            unsafe { Wide(_mm512_fmadd_pd(self.0, factor.0, term.0)) }
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            unsafe { Wide(_mm512_sqrt_pd(self.0)) }
        }
        #[inline(always)]
        fn abs(self) -> Self {
            unsafe { Wide(_mm512_andnot_pd(_mm512_set1_pd(-0.0), self.0)) }
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            unsafe { Wide(_mm512_min_pd(self.0, other.0)) }
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            unsafe { Wide(_mm512_max_pd(self.0, other.0)) }
        }
        #[inline(always)]
        fn lt(self, other: Self) -> u8 {
            unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn select(mask: u8, yes: Self, no: Self) -> Self {
            unsafe { Wide(_mm512_mask_blend_pd(mask, no.0, yes.0)) }
        }
        #[inline(always)]
        fn bits(mask: u8) -> u32 {
            u32::from(mask)
        }
        #[inline(always)]
        fn split(self) -> (Self, Self) {
            unsafe {
                let mantissa = _mm512_getmant_pd::<_MM_MANT_NORM_1_2, _MM_MANT_SIGN_ZERO>(self.0);
                (Wide(_mm512_getexp_pd(self.0)), Wide(mantissa))
            }
        }
    }
}
