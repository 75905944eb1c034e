//! How sure a prediction is.

use nalgebra::Matrix3;

use super::forecast::chance_within;

/// A prediction holds when the ball comes within this distance of it, m.
pub const TOLERANCE_M: f64 = 0.04;

/// Chance that the ball comes within [`TOLERANCE_M`] of a prediction with error covariance `covariance`
/// that the likeliest hypothesis, of weight `weight`, makes.
pub fn of(covariance: &Matrix3<f64>, weight: f64) -> f64 {
    weight * chance_within(TOLERANCE_M, covariance)
}
