//! With AVX2 and FMA. Left to themselves compilers take long chains of such operations apart again, where they
//! select between lanes above all.
//!
//! Code that uses these lanes must be inlined into a function that has the two features enabled; elsewhere it is
//! right, but each operation is a call.

use core::arch::x86_64::{
    __m256, _CMP_GT_OQ, _mm256_add_ps, _mm256_and_ps, _mm256_andnot_ps, _mm256_cmp_ps, _mm256_div_ps,
    _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_max_ps, _mm256_min_ps, _mm256_mul_ps, _mm256_set1_ps,
    _mm256_setzero_ps, _mm256_sqrt_ps, _mm256_storeu_ps, _mm256_sub_ps,
};
use std::ops::{Add, Mul, Sub};

use super::{LANES, Lanes};

/// Proof that the processor has AVX2 and FMA.
#[derive(Debug, Clone, Copy)]
pub struct Avx2(());

impl Avx2 {
    /// Asks the processor.
    pub fn detect() -> Option<Self> {
        (is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")).then_some(Self(()))
    }
}

/// Eight numbers; that there are any proves that there was an [`Avx2`] to make them with.
#[derive(Debug, Clone, Copy)]
pub struct Avx2Lanes(__m256);

/// Runs one instruction of AVX2 or FMA.
macro_rules! instruction {
    ($call:expr) => {
        // SAFETY: there is an `Avx2` or an `Avx2Lanes`, so that the processor has the instruction; it touches no
        // memory.
        Self(unsafe { $call })
    };
}

impl Lanes for Avx2Lanes {
    type Level = Avx2;

    #[inline(always)]
    fn all(_: Avx2, value: f32) -> Self {
        instruction!(_mm256_set1_ps(value))
    }

    #[inline(always)]
    fn load(_: Avx2, from: &[f32], at: usize) -> Self {
        let lanes = &from[at..at + LANES];
        // SAFETY: the processor has AVX2, and the slice eight numbers.
        Self(unsafe { _mm256_loadu_ps(lanes.as_ptr()) })
    }

    #[inline(always)]
    fn times_plus(self, factor: Self, summand: Self) -> Self {
        instruction!(_mm256_fmadd_ps(self.0, factor.0, summand.0))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        instruction!(_mm256_sqrt_ps(self.0))
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        instruction!(_mm256_max_ps(self.0, other.0))
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        instruction!(_mm256_min_ps(self.0, other.0))
    }

    #[inline(always)]
    fn recip(self) -> Self {
        instruction!(_mm256_div_ps(_mm256_set1_ps(1.0), self.0))
    }

    #[inline(always)]
    fn where_positive(self, condition: Self) -> Self {
        instruction!(_mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(condition.0, _mm256_setzero_ps()), self.0))
    }

    #[inline(always)]
    fn unless_positive(self, condition: Self) -> Self {
        instruction!(_mm256_andnot_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(condition.0, _mm256_setzero_ps()), self.0))
    }

    #[inline(always)]
    fn positive(self) -> Self {
        instruction!(_mm256_max_ps(self.0, _mm256_setzero_ps()))
    }

    #[inline(always)]
    fn to_array(self) -> [f32; LANES] {
        let mut lanes = [0.0; LANES];
        // SAFETY: the processor has AVX2, and the array room for eight numbers.
        unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), self.0) };
        lanes
    }
}

impl Add for Avx2Lanes {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        instruction!(_mm256_add_ps(self.0, other.0))
    }
}

impl Sub for Avx2Lanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        instruction!(_mm256_sub_ps(self.0, other.0))
    }
}

impl Mul for Avx2Lanes {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        instruction!(_mm256_mul_ps(self.0, other.0))
    }
}
