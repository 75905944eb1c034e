//! Eight single-precision numbers at a time, in portable Rust that compilers turn into vector instructions.
//!
//! Every operation is one IEEE 754 operation per lane and sums run in a fixed order, so that results have
//! the same bits whatever the instructions.

use std::ops::{Add, Mul, Sub};

/// Lanes of one vector.
pub const LANES: usize = 8;

/// Eight numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(32))]
pub struct Lanes(pub [f32; LANES]);

impl Lanes {
    pub const ZERO: Self = Self([0.0; LANES]);

    #[inline(always)]
    pub const fn all(value: f32) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    pub fn load(from: &[f32], at: usize) -> Self {
        let mut lanes = [0.0; LANES];
        lanes.copy_from_slice(&from[at..at + LANES]);
        Self(lanes)
    }

    #[inline(always)]
    fn each(self, f: impl Fn(f32) -> f32) -> Self {
        let mut out = self.0;
        for lane in &mut out {
            *lane = f(*lane);
        }
        Self(out)
    }

    #[inline(always)]
    fn both(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let mut out = self.0;
        for (lane, other) in out.iter_mut().zip(other.0) {
            *lane = f(*lane, other);
        }
        Self(out)
    }

    /// `self × factor + summand`, rounded once.
    #[inline(always)]
    pub fn times_plus(self, factor: Self, summand: Self) -> Self {
        let mut out = self.0;
        for ((lane, factor), summand) in out.iter_mut().zip(factor.0).zip(summand.0) {
            *lane = lane.mul_add(factor, summand);
        }
        Self(out)
    }

    #[inline(always)]
    pub fn sqrt(self) -> Self {
        self.each(f32::sqrt)
    }

    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        // Not f32::max: its rule for NaN costs instructions.
        self.both(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        self.both(other, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    pub fn recip(self) -> Self {
        self.each(|a| 1.0 / a)
    }

    #[inline(always)]
    pub fn positive(self) -> Self {
        self.max(Self::ZERO)
    }

    /// `self` where `condition` is above zero, else zero.
    #[inline(always)]
    pub fn where_positive(self, condition: Self) -> Self {
        self.both(condition, |a, c| if c > 0.0 { a } else { 0.0 })
    }

    /// The sum of the lanes, always in the same order.
    #[inline(always)]
    pub fn sum(self) -> f32 {
        let [a, b, c, d, e, f, g, h] = self.0;
        ((a + e) + (b + f)) + ((c + g) + (d + h))
    }
}

impl Add for Lanes {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.both(other, |a, b| a + b)
    }
}

impl Sub for Lanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.both(other, |a, b| a - b)
    }
}

impl Mul for Lanes {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.both(other, |a, b| a * b)
    }
}
