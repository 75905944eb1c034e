//! How sure a prediction is.

use nalgebra::{Matrix2, Matrix3, Vector2};

use super::forecast::Crossing;

/// A prediction holds when the ball comes within this distance of it, m.
pub const TOLERANCE_M: f64 = 0.04;

/// Chance that a prediction holds, by the standard deviation σ (root of the covariance's trace) that the filter
/// gives its place: 1 / (1 + (σ / σ₀)^k), a logistic curve over ln σ.
///
/// It falls with σ and has two numbers only. A normal distribution with what the filter leaves out added (seven
/// numbers, and five more for what held of it) foretold whether flights hold less well where they had not been
/// fitted: flights differ more from each other than its tails allow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Curve {
    /// σ₀, where every other prediction holds, m.
    pub even_m: f64,
    /// k.
    pub power: f64,
}

/// Of the hitting points of 275 recorded flights: near the likeliest curve for them (0.0908 m, 1.97), and such that
/// none of ten equal bins is far off. `netcord predict --evaluate` fits the likeliest anew to four fifths of the
/// recordings that it is given, in turn, and shows what held of the rest.
pub const CURVE: Curve = Curve { even_m: 0.0925, power: 2.1 };

impl Curve {
    /// Chance that a prediction of standard deviation `sigma_m` holds.
    pub fn chance(&self, sigma_m: f64) -> f64 {
        if sigma_m > 0.0 { 1.0 / (1.0 + (sigma_m / self.even_m).powf(self.power)) } else { 1.0 }
    }

    /// The likeliest curve for predictions of these standard deviations (m), of which it is known whether they
    /// held: Newton's method on a convex function. `None` where they do not say, as when all held.
    pub fn fit(seen: impl Iterator<Item = (f64, bool)> + Clone) -> Option<Self> {
        let mut b = Vector2::new(-4.0, -1.5);
        for _ in 0..50 {
            let (mut gradient, mut hessian) = (Vector2::zeros(), Matrix2::identity() * 1e-6);
            for (sigma_m, held) in seen.clone().filter(|(s, _)| s.is_finite() && *s > 0.0) {
                let x = Vector2::new(1.0, sigma_m.ln());
                let p = 1.0 / (1.0 + (-b.dot(&x)).exp());
                gradient += x * (f64::from(u8::from(held)) - p);
                hessian += x * x.transpose() * (p * (1.0 - p));
            }
            let step = hessian.cholesky()?.solve(&gradient);
            // Far from the solution a whole step may leap over it.
            b += step * (1.0 / step.norm()).min(1.0);
            if step.norm() < 1e-9 {
                let curve = Self { even_m: (-b.x / b.y).exp(), power: -b.y };
                return (curve.power > 0.0 && curve.even_m.is_finite()).then_some(curve);
            }
        }
        None
    }
}

/// Standard deviation of a place, m: of its distance from the mean.
pub fn sigma_m(covariance: &Matrix3<f64>) -> f64 {
    covariance.trace().max(0.0).sqrt()
}

/// Chance that the ball comes within [`TOLERANCE_M`] of a place of this covariance (m²), which the likeliest
/// hypothesis, of weight `weight`, predicts.
pub fn of_place(covariance: &Matrix3<f64>, weight: f64) -> f64 {
    weight * CURVE.chance(sigma_m(covariance))
}

/// The same of where a plane is crossed.
pub fn of_crossing(crossing: &Crossing, weight: f64) -> f64 {
    of_place(&crossing.covariance, weight)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn confidence_falls_with_the_scatter_and_the_weight() {
        let scatter = |sigma: f64| Matrix3::identity() * (sigma * sigma);
        let sure = of_place(&scatter(0.002), 1.0);
        assert!(sure > 0.97, "{sure}");
        for doubted in [of_place(&scatter(0.03), 1.0), of_place(&scatter(0.002), 0.7)] {
            assert!((0.0..sure).contains(&doubted), "{doubted} {sure}");
        }
    }

    #[test]
    fn the_curve_that_predictions_were_drawn_from_is_found() {
        let truth = Curve { even_m: 0.05, power: 2.2 };
        let mut rng = Pcg64::seed_from_u64(3);
        let seen: Vec<(f64, bool)> = (0..20_000)
            .map(|_| {
                let sigma_m = 0.003 * 60_f64.powf(rng.random::<f64>());
                (sigma_m, rng.random::<f64>() < truth.chance(sigma_m))
            })
            .collect();
        let found = Curve::fit(seen.iter().copied()).expect("both outcomes occur");
        assert!((found.even_m / truth.even_m - 1.0).abs() < 0.05, "{found:?}");
        assert!((found.power / truth.power - 1.0).abs() < 0.05, "{found:?}");
        assert_eq!(Curve::fit(seen.iter().map(|(s, _)| (*s, true))), None, "all held");
    }
}
