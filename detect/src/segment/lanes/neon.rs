//! With NEON: two registers of four numbers.
//!
//! Builds for AArch64 assume NEON everywhere, so that code which uses these lanes needs no function of its own with
//! the feature enabled, as with AVX2.

use core::arch::aarch64::{
    float32x4_t, vaddq_f32, vandq_u32, vbicq_u32, vbslq_f32, vcgtq_f32, vcgtzq_f32, vcltq_f32, vdivq_f32,
    vdupq_n_f32, vfmaq_f32, vld1q_f32, vmulq_f32, vreinterpretq_f32_u32, vreinterpretq_u32_f32, vsqrtq_f32,
    vst1q_f32, vsubq_f32,
};
use std::{
    array::from_fn,
    ops::{Add, Mul, Sub},
};

use super::{LANES, Lanes};

/// Numbers of one register.
const HALF: usize = LANES / 2;

/// Proof that the processor has NEON.
#[derive(Debug, Clone, Copy)]
pub struct Neon(());

impl Neon {
    /// Asks the processor.
    pub fn detect() -> Option<Self> {
        std::arch::is_aarch64_feature_detected!("neon").then_some(Self(()))
    }
}

/// Eight numbers; that there are any proves that there was a [`Neon`] to make them with.
#[derive(Debug, Clone, Copy)]
pub struct NeonLanes([float32x4_t; 2]);

/// Runs one instruction of NEON on each half.
macro_rules! instruction {
    (|$half:ident| $call:expr) => {
        // SAFETY: there is a `Neon` or a `NeonLanes`, so that the processor has the instruction; it touches no
        // memory.
        Self(from_fn(
            #[inline(always)]
            |$half| unsafe { $call },
        ))
    };
}

impl Lanes for NeonLanes {
    type Level = Neon;

    #[inline(always)]
    fn all(_: Neon, value: f32) -> Self {
        instruction!(|_half| vdupq_n_f32(value))
    }

    #[inline(always)]
    fn load(_: Neon, from: &[f32], at: usize) -> Self {
        let lanes = &from[at..at + LANES];
        // SAFETY: the processor has NEON, and the slice twice four numbers.
        unsafe { Self([vld1q_f32(lanes.as_ptr()), vld1q_f32(lanes.as_ptr().add(HALF))]) }
    }

    #[inline(always)]
    fn times_plus(self, factor: Self, summand: Self) -> Self {
        instruction!(|h| vfmaq_f32(summand.0[h], self.0[h], factor.0[h]))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        instruction!(|h| vsqrtq_f32(self.0[h]))
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // Not vmaxq_f32, which has rules of its own for NaN and for zeros of either sign.
        instruction!(|h| vbslq_f32(vcgtq_f32(self.0[h], other.0[h]), self.0[h], other.0[h]))
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        instruction!(|h| vbslq_f32(vcltq_f32(self.0[h], other.0[h]), self.0[h], other.0[h]))
    }

    #[inline(always)]
    fn recip(self) -> Self {
        instruction!(|h| vdivq_f32(vdupq_n_f32(1.0), self.0[h]))
    }

    #[inline(always)]
    fn where_positive(self, condition: Self) -> Self {
        instruction!(|h| vreinterpretq_f32_u32(vandq_u32(
            vcgtzq_f32(condition.0[h]),
            vreinterpretq_u32_f32(self.0[h])
        )))
    }

    #[inline(always)]
    fn unless_positive(self, condition: Self) -> Self {
        instruction!(|h| vreinterpretq_f32_u32(vbicq_u32(
            vreinterpretq_u32_f32(self.0[h]),
            vcgtzq_f32(condition.0[h])
        )))
    }

    #[inline(always)]
    fn to_array(self) -> [f32; LANES] {
        let mut lanes = [0.0; LANES];
        let to = lanes.as_mut_ptr();
        // SAFETY: the processor has NEON, and the array room for twice four numbers.
        unsafe {
            vst1q_f32(to, self.0[0]);
            vst1q_f32(to.add(HALF), self.0[1]);
        }
        lanes
    }
}

impl Add for NeonLanes {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        instruction!(|h| vaddq_f32(self.0[h], other.0[h]))
    }
}

impl Sub for NeonLanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        instruction!(|h| vsubq_f32(self.0[h], other.0[h]))
    }
}

impl Mul for NeonLanes {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        instruction!(|h| vmulq_f32(self.0[h], other.0[h]))
    }
}
