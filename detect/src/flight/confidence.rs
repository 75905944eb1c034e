//! How sure a prediction is.

use nalgebra::Matrix3;

use super::forecast::{Crossing, chance_within};

/// A prediction holds when the ball comes within this distance of it, m.
pub const TOLERANCE_M: f64 = 0.04;

// What the filter's covariance does not know, fitted by maximum likelihood to whether 20,700 predictions of
// the hitting point of 275 recorded flights held (`netcord predict --evaluate`).

/// The filter's standard deviations are so much too large: they carry slow errors of the positions too,
/// which the truth of a recording shares.
const SCALE: f64 = 0.64;
/// Error of the model in free flight: metres after a second, and how it grows with time.
const DRIFT_M: f64 = 0.069;
const DRIFT_GROWTH: f64 = 1.97;
/// Error of the model after a bounce that lies ahead, m for each second of the prediction.
const AFTER_BOUNCE_M_S: f64 = 0.026;
/// Share of flights that go wrong: a ball that the positions lost, an edge, a net, a hit not yet seen.
const ASTRAY: f64 = 0.155;
/// How much further off those are.
const ASTRAY_SCALE: f64 = 5.9;
/// What the unlikelier hypotheses say is often near to what the likeliest does.
const WEIGHT_POWER: f64 = 0.575;

/// What held of what was so sure by all this: flights differ more from each other than a normal distribution
/// with tails says. Confidence as computed, and as given; straight lines between (isotonic calibration,
/// Zadrozny & Elkan 2002, by hand).
const HELD: [(f64, f64); 7] =
    [(0.0, 0.0), (0.2, 0.25), (0.4, 0.46), (0.57, 0.55), (0.72, 0.63), (0.835, 0.83), (1.0, 1.0)];

fn held(computed: f64) -> f64 {
    let after = HELD.partition_point(|(x, _)| *x < computed).clamp(1, HELD.len() - 1);
    let ((x0, y0), (x1, y1)) = (HELD[after - 1], HELD[after]);
    (y0 + (y1 - y0) * (computed - x0) / (x1 - x0)).clamp(0.0, 1.0)
}

/// How far off a predicted place may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Doubt {
    /// Covariance of the place, m², with what the filter does not know of.
    pub covariance: Matrix3<f64>,
}

impl Doubt {
    /// Of a place that the filter gives the covariance `covariance`, `after_s` ahead; `bounces`: whether a
    /// bounce lies between.
    pub fn of_place(covariance: &Matrix3<f64>, after_s: f64, bounces: bool) -> Self {
        Self::new(covariance, &Matrix3::identity(), after_s, bounces)
    }

    /// Of where a plane is crossed.
    pub fn of_crossing(crossing: &Crossing) -> Self {
        let mut within = Matrix3::identity();
        within[(crossing.axis, crossing.axis)] = 0.0;
        Self::new(&crossing.covariance, &within, crossing.after_s, crossing.after_bounce)
    }

    fn new(covariance: &Matrix3<f64>, directions: &Matrix3<f64>, after_s: f64, bounces: bool) -> Self {
        let drift = DRIFT_M * after_s.max(0.0).powf(DRIFT_GROWTH);
        let bounce = if bounces { AFTER_BOUNCE_M_S * after_s } else { 0.0 };
        let unknown = drift * drift + bounce * bounce;
        Self { covariance: covariance * (SCALE * SCALE) + directions * unknown }
    }

    /// Chance that the ball comes within [`TOLERANCE_M`] of the place, which the likeliest hypothesis, of
    /// weight `weight`, predicts.
    pub fn confidence(&self, weight: f64) -> f64 {
        let near = chance_within(TOLERANCE_M, &self.covariance);
        let astray = chance_within(TOLERANCE_M, &(self.covariance * (ASTRAY_SCALE * ASTRAY_SCALE)));
        held(weight.powf(WEIGHT_POWER) * ((1.0 - ASTRAY) * near + ASTRAY * astray))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn confidence_falls_with_the_horizon_the_scatter_and_the_weight() {
        let scatter = |sigma: f64| Matrix3::identity() * (sigma * sigma);
        let sure = Doubt::of_place(&scatter(0.002), 0.05, false).confidence(1.0);
        assert!(sure > 0.97, "{sure}");
        for doubted in [
            Doubt::of_place(&scatter(0.002), 0.5, false).confidence(1.0),
            Doubt::of_place(&scatter(0.002), 0.4, true).confidence(1.0),
            Doubt::of_place(&scatter(0.03), 0.05, false).confidence(1.0),
            Doubt::of_place(&scatter(0.002), 0.05, false).confidence(0.7),
        ] {
            assert!((0.0..sure).contains(&doubted), "{doubted} {sure}");
        }
    }
}
