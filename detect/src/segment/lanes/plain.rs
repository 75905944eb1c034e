//! In portable Rust.

use std::ops::{Add, Mul, Sub};

use super::{LANES, Lanes};

/// What every machine has.
#[derive(Debug, Clone, Copy)]
pub struct Plain;

/// Eight numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(32))]
pub struct PlainLanes([f32; LANES]);

impl PlainLanes {
    #[inline(always)]
    fn each(self, f: impl Fn(f32) -> f32) -> Self {
        Self(self.0.map(f))
    }

    #[inline(always)]
    fn both(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let mut out = self.0;
        for (lane, other) in out.iter_mut().zip(other.0) {
            *lane = f(*lane, other);
        }
        Self(out)
    }
}

impl Lanes for PlainLanes {
    type Level = Plain;

    #[inline(always)]
    fn all(_: Plain, value: f32) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    fn load(_: Plain, from: &[f32], at: usize) -> Self {
        let mut lanes = [0.0; LANES];
        lanes.copy_from_slice(&from[at..at + LANES]);
        Self(lanes)
    }

    #[inline(always)]
    fn times_plus(self, factor: Self, summand: Self) -> Self {
        let mut out = self.0;
        for ((lane, factor), summand) in out.iter_mut().zip(factor.0).zip(summand.0) {
            *lane = lane.mul_add(factor, summand);
        }
        Self(out)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.each(f32::sqrt)
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // Not f32::max, whose rule for NaN vector instructions do not have.
        self.both(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.both(other, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn recip(self) -> Self {
        self.each(|a| 1.0 / a)
    }

    #[inline(always)]
    fn where_positive(self, condition: Self) -> Self {
        self.both(condition, |a, c| if c > 0.0 { a } else { 0.0 })
    }

    #[inline(always)]
    fn unless_positive(self, condition: Self) -> Self {
        self.both(condition, |a, c| if c > 0.0 { 0.0 } else { a })
    }

    #[inline(always)]
    fn to_array(self) -> [f32; LANES] {
        self.0
    }
}

impl Add for PlainLanes {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.both(other, |a, b| a + b)
    }
}

impl Sub for PlainLanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.both(other, |a, b| a - b)
    }
}

impl Mul for PlainLanes {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.both(other, |a, b| a * b)
    }
}
