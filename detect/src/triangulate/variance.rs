/// How far the residuals are from what the covariances of the detections promise: the variance of unit
/// weight, rolling. Results are scaled by it, so that their covariances are honest although blur, noise
/// and calibration are never known exactly.
#[derive(Debug, Clone, Copy)]
pub(super) struct UnitVariance {
    sum: f64,
    weight: f64,
}

/// Degrees of freedom that are looked back on: 5 s of two cameras at 100 Hz.
const MEMORY: f64 = 500.0;

/// Degrees of freedom that the promise itself is worth before anything has been seen.
const PRIOR: f64 = 50.0;

/// A single trigger counts at most this times the expected sum: a wrong association says nothing of the
/// covariances. Of honest ones the cut takes 0.4 % of the mean.
const CUT: f64 = 12.0;

impl UnitVariance {
    pub const fn new() -> Self {
        Self { sum: PRIOR, weight: PRIOR }
    }

    /// The factor on covariances.
    pub fn factor(&self) -> f64 {
        (self.sum / self.weight).clamp(0.25, 100.0)
    }

    /// Takes note of a result from `views` cameras.
    pub fn see(&mut self, chi2: f64, views: usize) {
        if views < 2 {
            return;
        }
        let freedom = 2.0 * views as f64 - 3.0;
        let keep = 1.0 - freedom / (MEMORY + freedom);
        self.sum = self.sum * keep + chi2.min(CUT * self.factor() * freedom);
        self.weight = self.weight * keep + freedom;
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    #[test]
    fn the_factor_follows_the_true_scatter() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(5);
        for sigma in [0.7_f64, 1.0, 2.0] {
            let mut variance = UnitVariance::new();
            let mut mean = 0.0;
            for i in 0..5000 {
                let z: f64 = StandardNormal.sample(&mut random);
                variance.see((sigma * z).powi(2), 2);
                if i >= 1000 {
                    mean += variance.factor() / 4000.0;
                }
            }
            let ratio = mean / (sigma * sigma);
            assert!((0.93..1.07).contains(&ratio), "σ {sigma}: {ratio}");
        }
    }
}
