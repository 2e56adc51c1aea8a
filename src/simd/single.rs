//! Eight or sixteen f32 at a time: what the sieves of [`crate::visibility`] compute with.
//!
//! They only sift; what is hit is decided in f64, the same on every machine: so lanes may round differently (fused or
//! not), and the answers are still the same bits.

/// N numbers.
pub(crate) trait Lanes<const N: usize>: Copy {
    fn splat(x: f32) -> Self;
    fn load(values: &[f32; N]) -> Self;
    fn store(self, out: &mut [f32; N]);
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    /// self x factor + term, rounded once or twice.
    fn mul_add(self, factor: Self, term: Self) -> Self;
    /// self x factor - term, rounded once or twice.
    fn mul_sub(self, factor: Self, term: Self) -> Self;
    /// term - self x factor, rounded once or twice.
    fn neg_mul_add(self, factor: Self, term: Self) -> Self;
    /// The lesser; `other` where self is NaN.
    fn min(self, other: Self) -> Self;
    /// The greater; `other` where self is NaN.
    fn max(self, other: Self) -> Self;
    fn abs(self) -> Self;
    /// self with its sign changed where that of `other` is negative.
    fn flip(self, other: Self) -> Self;
    /// A bit for every lane in which self <= other.
    fn le(self, other: Self) -> u32;
}

/// Which lane comes where.
pub(crate) type Places = [u8; 8];

/// Eight numbers that can change places.
pub(crate) trait Eight: Lanes<8> {
    /// Eight u32 as they are.
    fn load_bits(values: &[u32; 8]) -> Self;
    fn store_bits(self, out: &mut [u32; 8]);
    /// The numbers `first` + places, as u32.
    fn numbers(first: u32, places: &Places) -> Self;
    /// Lane k becomes lane places[k].
    fn permute(self, places: &Places) -> Self;
    /// The least of the lanes with a bit in `mask`; infinite when there are none.
    fn least_of(self, mask: u32) -> f32;
}

impl Eight for [f32; 8] {
    #[inline(always)]
    fn load_bits(values: &[u32; 8]) -> Self {
        let mut out = [0.0; 8];
        for k in 0..8 {
            out[k] = f32::from_bits(values[k]);
        }
        out
    }
    #[inline(always)]
    fn store_bits(self, out: &mut [u32; 8]) {
        for k in 0..8 {
            out[k] = self[k].to_bits();
        }
    }
    #[inline(always)]
    fn numbers(first: u32, places: &Places) -> Self {
        let mut out = [0.0; 8];
        for k in 0..8 {
            out[k] = f32::from_bits(first + u32::from(places[k]));
        }
        out
    }
    #[inline(always)]
    fn permute(self, places: &Places) -> Self {
        let mut out = self;
        for k in 0..8 {
            out[k] = self[usize::from(places[k] & 7)];
        }
        out
    }
    #[inline(always)]
    fn least_of(self, mask: u32) -> f32 {
        let mut least = f32::INFINITY;
        for k in 0..8 {
            if mask >> k & 1 != 0 && self[k] < least {
                least = self[k];
            }
        }
        least
    }
}

#[inline(always)]
fn zip<const N: usize>(a: [f32; N], b: [f32; N], f: impl Fn(f32, f32) -> f32) -> [f32; N] {
    let mut out = a;
    for k in 0..N {
        out[k] = f(a[k], b[k]);
    }
    out
}

impl<const N: usize> Lanes<N> for [f32; N] {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        [x; N]
    }
    #[inline(always)]
    fn load(values: &[f32; N]) -> Self {
        *values
    }
    #[inline(always)]
    fn store(self, out: &mut [f32; N]) {
        *out = self;
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        zip(self, other, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        zip(self, other, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        zip(self, other, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        zip(self, other, |a, b| a / b)
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        self.mul(factor).add(term)
    }
    #[inline(always)]
    fn mul_sub(self, factor: Self, term: Self) -> Self {
        self.mul(factor).sub(term)
    }
    #[inline(always)]
    fn neg_mul_add(self, factor: Self, term: Self) -> Self {
        term.sub(self.mul(factor))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        zip(self, other, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        zip(self, other, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        zip(self, self, |a, _| a.abs())
    }
    #[inline(always)]
    fn flip(self, other: Self) -> Self {
        zip(self, other, |a, b| f32::from_bits(a.to_bits() ^ (b.to_bits() & (1 << 31))))
    }
    #[inline(always)]
    fn le(self, other: Self) -> u32 {
        let mut bits = 0;
        for k in 0..N {
            bits |= u32::from(self[k] <= other[k]) << k;
        }
        bits
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    //! SAFETY, for all of this module: its vectors are made only in kernels that [`super::for_every_machine`] enters once
    //! the processor was found to have the instructions; loads and stores go through references to arrays of their size.
    #![allow(clippy::undocumented_unsafe_blocks)]

    use std::arch::x86_64::*;

    use super::{Eight, Lanes, Places};

    impl Eight for __m256 {
        #[inline(always)]
        fn load_bits(values: &[u32; 8]) -> Self {
            unsafe { _mm256_loadu_ps(values.as_ptr().cast()) }
        }
        #[inline(always)]
        fn store_bits(self, out: &mut [u32; 8]) {
            unsafe { _mm256_storeu_ps(out.as_mut_ptr().cast(), self) }
        }
        #[inline(always)]
        fn numbers(first: u32, places: &Places) -> Self {
            unsafe {
                let places = _mm256_cvtepu8_epi32(_mm_loadl_epi64(places.as_ptr().cast()));
                _mm256_castsi256_ps(_mm256_add_epi32(_mm256_set1_epi32(first as i32), places))
            }
        }
        #[inline(always)]
        fn permute(self, places: &Places) -> Self {
            unsafe {
                let places = _mm256_cvtepu8_epi32(_mm_loadl_epi64(places.as_ptr().cast()));
                _mm256_permutevar8x32_ps(self, places)
            }
        }
        #[inline(always)]
        fn least_of(self, mask: u32) -> f32 {
            unsafe {
                // The bit of each lane moved to its sign.
                let bits = _mm256_sllv_epi32(
                    _mm256_set1_epi32(mask as i32),
                    _mm256_setr_epi32(31, 30, 29, 28, 27, 26, 25, 24),
                );
                let kept = _mm256_blendv_ps(_mm256_set1_ps(f32::INFINITY), self, _mm256_castsi256_ps(bits));
                let four = _mm_min_ps(_mm256_castps256_ps128(kept), _mm256_extractf128_ps::<1>(kept));
                let two = _mm_min_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_min_ss(two, _mm_movehdup_ps(two)))
            }
        }
    }

    /// [`Lanes`] of a register, by the names of its intrinsics.
    macro_rules! register {
        (
            $vector:ty, $n:literal, $set1:ident, $load:ident, $store:ident, $andnot:ident, $xor:ident, $and:ident,
            [$($two:ident = $of_two:ident),*], [$($three:ident = $of_three:ident),*],
            |$a:ident, $b:ident| $le:expr
        ) => {
            impl Lanes<$n> for $vector {
                #[inline(always)]
                fn splat(x: f32) -> Self {
                    unsafe { $set1(x) }
                }
                #[inline(always)]
                fn load(values: &[f32; $n]) -> Self {
                    unsafe { $load(values.as_ptr()) }
                }
                #[inline(always)]
                fn store(self, out: &mut [f32; $n]) {
                    unsafe { $store(out.as_mut_ptr(), self) }
                }
                $(
                    #[inline(always)]
                    fn $two(self, other: Self) -> Self {
                        unsafe { $of_two(self, other) }
                    }
                )*
                $(
                    #[inline(always)]
                    fn $three(self, factor: Self, term: Self) -> Self {
                        unsafe { $of_three(self, factor, term) }
                    }
                )*
                #[inline(always)]
                fn abs(self) -> Self {
                    unsafe { $andnot($set1(-0.0), self) }
                }
                #[inline(always)]
                fn flip(self, other: Self) -> Self {
                    unsafe { $xor(self, $and($set1(-0.0), other)) }
                }
                #[inline(always)]
                fn le(self, other: Self) -> u32 {
                    let ($a, $b) = (self, other);
                    unsafe { $le }
                }
            }
        };
    }

    register!(
        __m256,
        8,
        _mm256_set1_ps,
        _mm256_loadu_ps,
        _mm256_storeu_ps,
        _mm256_andnot_ps,
        _mm256_xor_ps,
        _mm256_and_ps,
        [
            add = _mm256_add_ps,
            sub = _mm256_sub_ps,
            mul = _mm256_mul_ps,
            div = _mm256_div_ps,
            min = _mm256_min_ps,
            max = _mm256_max_ps
        ],
        [mul_add = _mm256_fmadd_ps, mul_sub = _mm256_fmsub_ps, neg_mul_add = _mm256_fnmadd_ps],
        |a, b| _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(a, b)) as u32
    );

    register!(
        __m512,
        16,
        _mm512_set1_ps,
        _mm512_loadu_ps,
        _mm512_storeu_ps,
        _mm512_andnot_ps,
        _mm512_xor_ps,
        _mm512_and_ps,
        [
            add = _mm512_add_ps,
            sub = _mm512_sub_ps,
            mul = _mm512_mul_ps,
            div = _mm512_div_ps,
            min = _mm512_min_ps,
            max = _mm512_max_ps
        ],
        [mul_add = _mm512_fmadd_ps, mul_sub = _mm512_fmsub_ps, neg_mul_add = _mm512_fnmadd_ps],
        |a, b| u32::from(_mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b))
    );

    /// Sixteen lanes as twice eight.
    macro_rules! pair {
        ([$($two:ident),*], [$($three:ident),*]) => {
            impl Lanes<16> for [__m256; 2] {
                #[inline(always)]
                fn splat(x: f32) -> Self {
                    [__m256::splat(x); 2]
                }
                #[inline(always)]
                fn load(values: &[f32; 16]) -> Self {
                    unsafe { [_mm256_loadu_ps(values.as_ptr()), _mm256_loadu_ps(values.as_ptr().add(8))] }
                }
                #[inline(always)]
                fn store(self, out: &mut [f32; 16]) {
                    unsafe {
                        _mm256_storeu_ps(out.as_mut_ptr(), self[0]);
                        _mm256_storeu_ps(out.as_mut_ptr().add(8), self[1]);
                    }
                }
                $(
                    #[inline(always)]
                    fn $two(self, other: Self) -> Self {
                        [self[0].$two(other[0]), self[1].$two(other[1])]
                    }
                )*
                $(
                    #[inline(always)]
                    fn $three(self, factor: Self, term: Self) -> Self {
                        [self[0].$three(factor[0], term[0]), self[1].$three(factor[1], term[1])]
                    }
                )*
                #[inline(always)]
                fn abs(self) -> Self {
                    [self[0].abs(), self[1].abs()]
                }
                #[inline(always)]
                fn le(self, other: Self) -> u32 {
                    self[0].le(other[0]) | self[1].le(other[1]) << 8
                }
            }
        };
    }

    pair!([add, sub, mul, div, min, max, flip], [mul_add, mul_sub, neg_mul_add]);
}
