//! Eight single-precision numbers at a time, by whatever instructions the machine has.
//!
//! Every operation is one IEEE 754 operation per lane and sums run in a fixed order, so that results have
//! the same bits whatever the instructions.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "aarch64")]
mod neon;
mod plain;
#[cfg(test)]
mod tests;

use std::ops::{Add, Mul, Sub};

#[cfg(target_arch = "x86_64")]
pub use avx2::{Avx2, Avx2Lanes};
#[cfg(target_arch = "aarch64")]
pub use neon::{Neon, NeonLanes};
pub use plain::{Plain, PlainLanes};

/// Lanes of one vector.
pub const LANES: usize = 8;

/// Eight numbers.
pub trait Lanes: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// Proof that the machine has the instructions.
    type Level: Copy;

    /// Eight times `value`.
    fn all(level: Self::Level, value: f32) -> Self;

    /// Eight numbers of a slice, from `at` on.
    ///
    /// # Panics
    /// Where the slice ends before.
    fn load(level: Self::Level, from: &[f32], at: usize) -> Self;

    /// `self × factor + summand`, rounded once.
    fn times_plus(self, factor: Self, summand: Self) -> Self;

    /// Square roots.
    fn sqrt(self) -> Self;

    /// The greater of two; `other` where they cannot be compared.
    fn max(self, other: Self) -> Self;

    /// The lesser of two; `other` where they cannot be compared.
    fn min(self, other: Self) -> Self;

    /// 1 / `self`.
    fn recip(self) -> Self;

    /// `self` where `condition` is above zero, else zero.
    fn where_positive(self, condition: Self) -> Self;

    /// `self` where `condition` is not above zero, else zero.
    fn unless_positive(self, condition: Self) -> Self;

    /// The lanes.
    fn to_array(self) -> [f32; LANES];

    /// `self`, or zero where that is negative.
    #[inline(always)]
    fn positive(self) -> Self {
        self.where_positive(self)
    }

    /// The sum of the lanes, always in the same order.
    #[inline(always)]
    fn sum(self) -> f32 {
        let [a, b, c, d, e, f, g, h] = self.to_array();
        ((a + e) + (b + f)) + ((c + g) + (d + h))
    }
}
