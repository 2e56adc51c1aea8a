//! Vectors of numbers, on whatever the processor offers.
//!
//! A kernel is written once, for any [`Machine`], and compiled three times: for AVX-512, for AVX2, and for plain arrays. The
//! processor is asked when the program runs. [`single`] has the f32 lanes of the visibility sieves, [`double`] the f64 lanes
//! of the form factor kernels.

pub(crate) mod double;
pub(crate) mod single;

use double::Double;
use single::{Eight, Lanes};

/// A set of vector instructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Instructions {
    /// None beyond what the compiler targets.
    Portable,
    /// AVX2, FMA and bit manipulation: x86-64 since 2013.
    Avx2,
    /// AVX-512 F, DQ and VL.
    Avx512,
}

impl Instructions {
    /// Every set that this processor has, the best last.
    pub fn available() -> Vec<Instructions> {
        let mut all = vec![Instructions::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            let has_avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            let has_bits = is_x86_feature_detected!("bmi1") && is_x86_feature_detected!("bmi2");
            let has_avx512 = is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512vl");
            if has_avx2 && has_bits && is_x86_feature_detected!("popcnt") {
                all.push(Instructions::Avx2);
                if has_avx512 && is_x86_feature_detected!("avx512dq") {
                    all.push(Instructions::Avx512);
                }
            }
        }
        all
    }

    /// The best set that this processor has.
    pub fn best() -> Instructions {
        Instructions::available().pop().unwrap_or(Instructions::Portable)
    }
}

/// The vectors of a set of instructions.
pub(crate) trait Machine {
    type Eight: Eight;
    type Sixteen: Lanes<16>;
    type Double: Double;
}

pub(crate) struct Portable;

impl Machine for Portable {
    type Eight = [f32; 8];
    type Sixteen = [f32; 16];
    type Double = double::Plain;
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Avx2, Avx512};

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{__m256, __m512};

    use super::Machine;
    use super::double::{Quads, Wide};

    pub(crate) struct Avx2;

    impl Machine for Avx2 {
        type Eight = __m256;
        type Sixteen = [__m256; 2];
        type Double = Quads;
    }

    pub(crate) struct Avx512;

    impl Machine for Avx512 {
        type Eight = __m256;
        type Sixteen = __m512;
        type Double = Wide;
    }
}

/// Starts to bring `bytes` from `pointer` on into the first-level cache; any pointer will do.
#[inline(always)]
pub(crate) fn prefetch(pointer: *const u8, bytes: usize) {
    #[cfg(target_arch = "x86_64")]
    for line in 0..bytes.div_ceil(64) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch reads nothing that the program could see, and faults nowhere.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(pointer.cast::<i8>().wrapping_add(64 * line)) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (pointer, bytes);
}

/// Compiles `kernel::<M>(..)` for every machine, as one function that takes the [`Instructions`] first.
macro_rules! for_every_machine {
    ($(#[$doc:meta])* $visibility:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) -> $out:ty = $kernel:ident) => {
        $(#[$doc])*
        $visibility fn $name(instructions: $crate::simd::Instructions, $($arg: $type),*) -> $out {
            use $crate::simd;
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma,bmi1,bmi2,popcnt")]
            unsafe fn avx2($($arg: $type),*) -> $out {
                $kernel::<simd::Avx2>($($arg),*)
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma,bmi1,bmi2,popcnt,avx512f,avx512dq,avx512vl")]
            unsafe fn avx512($($arg: $type),*) -> $out {
                $kernel::<simd::Avx512>($($arg),*)
            }
            match instructions {
                // SAFETY: only what `Instructions::available` has found on this processor can be asked for.
                #[cfg(target_arch = "x86_64")]
                simd::Instructions::Avx2 => unsafe { avx2($($arg),*) },
                // SAFETY: the same.
                #[cfg(target_arch = "x86_64")]
                simd::Instructions::Avx512 => unsafe { avx512($($arg),*) },
                _ => $kernel::<simd::Portable>($($arg),*),
            }
        }
    };
}
pub(crate) use for_every_machine;
