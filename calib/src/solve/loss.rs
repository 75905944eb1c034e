use serde::{Deserialize, Serialize};

/// What a residual costs. `s` is the squared length of a point's 2D residual, in px².
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Loss {
    /// s: plain least squares.
    #[default]
    Squares,
    /// Huber (1964): quadratic up to `scale_px`, then linear.
    Huber {
        /// Residual in px at which the loss turns linear.
        scale_px: f64,
    },
    /// Cauchy: c² ln(1 + s/c²), which all but forgets gross outliers.
    Cauchy {
        /// Residual in px at which a point has half its weight.
        scale_px: f64,
    },
}

impl Loss {
    /// ρ(s), in px².
    pub fn cost(self, s: f64) -> f64 {
        match self {
            Self::Squares => s,
            Self::Huber { scale_px: c } if s > c * c => 2.0 * c * s.sqrt() - c * c,
            Self::Huber { .. } => s,
            Self::Cauchy { scale_px: c } => c * c * (s / (c * c)).ln_1p(),
        }
    }

    /// ρ′(s): the weight of the point in the reweighted least squares of the next step.
    pub fn weight(self, s: f64) -> f64 {
        match self {
            Self::Squares => 1.0,
            Self::Huber { scale_px: c } if s > c * c => c / s.sqrt(),
            Self::Huber { .. } => 1.0,
            Self::Cauchy { scale_px: c } => 1.0 / (1.0 + s / (c * c)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_the_slopes_of_the_costs() {
        for loss in [Loss::Squares, Loss::Huber { scale_px: 0.5 }, Loss::Cauchy { scale_px: 0.7 }] {
            for s in [0.01, 0.2, 0.26, 3.0, 100.0] {
                let h = 1e-6;
                let slope = (loss.cost(s + h) - loss.cost(s - h)) / (2.0 * h);
                assert!((slope - loss.weight(s)).abs() < 1e-6, "{loss:?} at {s}: {slope}");
            }
        }
    }
}
