//! How balls were struck of late: a player repeats strokes, and a launcher does hardly anything else.

use nalgebra::{Matrix3, Vector3};

/// Strokes that are remembered.
const MOST: usize = 32;
/// Strokes whose velocities differ by this much have half as much to do with each other as like ones (e^−½), m/s.
const REACH_M_S: f64 = 0.6;
/// A spin known no better than this, as a standard deviation along each axis, counts half, rad/s.
const VAGUE_RAD_S: f64 = 40.0;
/// Standard deviation along each axis by which one stroke differs from another like it, rad/s.
const SCATTER_RAD_S: f64 = 12.0;
/// Chance that a ball spins as like strokes did, when many are remembered.
const REPEATED: f64 = 0.6;
/// With so many like strokes the chance is half of that.
const FEW: f64 = 1.0;
/// Fewer like strokes than this say nothing.
const NONE: f64 = 0.05;

/// The beginning of a flight that is over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    /// Velocity with which it began, m/s.
    pub velocity: Vector3<f64>,
    /// Spin with which it began, rad/s, as the whole flight shows it.
    pub spin: Vector3<f64>,
    /// Covariance of the spin, (rad/s)².
    pub covariance: Matrix3<f64>,
}

/// The last strokes. Which spin to expect of a velocity is a weighted mean over strokes of like velocity (Nadaraya
/// 1964, Watson 1964), in the frame of the positions: like strokes have like headings.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Strokes {
    kept: [Option<Stroke>; MOST],
    next: usize,
}

impl Strokes {
    /// Remembers a stroke, in the place of the oldest.
    pub fn keep(&mut self, stroke: Stroke) {
        self.kept[self.next] = Some(stroke);
        self.next = (self.next + 1) % MOST;
    }

    /// Chance that a ball struck to fly with `velocity` (m/s) repeats earlier strokes, and mean and covariance of
    /// its spin then, rad/s. `None` where no stroke was like it.
    pub fn like(&self, velocity: &Vector3<f64>) -> Option<(f64, Vector3<f64>, Matrix3<f64>)> {
        let weigh = |s: &Stroke| {
            let apart = (s.velocity - velocity) / REACH_M_S;
            let doubt = s.covariance.trace() / (3.0 * VAGUE_RAD_S * VAGUE_RAD_S);
            (-0.5 * apart.norm_squared()).exp() / (1.0 + doubt)
        };
        let strokes = || self.kept.iter().flatten().map(|s| (weigh(s), s));
        let count: f64 = strokes().map(|(w, _)| w).sum();
        if count < NONE {
            return None;
        }
        let mean = strokes().map(|(w, s)| s.spin * (w / count)).sum::<Vector3<f64>>();
        let spread = strokes().map(|(w, s)| {
            let off = s.spin - mean;
            (s.covariance + off * off.transpose()) * (w / count)
        });
        let covariance = spread.sum::<Matrix3<f64>>() + Matrix3::identity() * (SCATTER_RAD_S * SCATTER_RAD_S);
        Some((REPEATED * count / (count + FEW), mean, covariance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stroke(velocity: [f64; 3], spin: [f64; 3], sigma: f64) -> Stroke {
        Stroke {
            velocity: velocity.into(),
            spin: spin.into(),
            covariance: Matrix3::identity() * (sigma * sigma),
        }
    }

    #[test]
    fn a_launcher_that_repeats_itself_is_believed_more_with_each_ball_and_others_are_not_touched() {
        let (drive, push) = (Vector3::new(0.2, -8.0, 1.0), Vector3::new(0.0, 5.0, 1.5));
        let mut strokes = Strokes::default();
        assert_eq!(strokes.like(&drive), None);
        let (mut last, spin) = (0.0, Vector3::new(150.0, 0.0, 40.0));
        // More than there is room for.
        for k in 0..40 {
            let off = 3.0 * f64::from(k % 5 - 2);
            strokes.keep(stroke([0.2 + 0.01 * off, -8.0, 1.0], [150.0 + off, -off, 40.0], 10.0));
            let (share, mean, covariance) = strokes.like(&drive).expect("one is like it");
            // Once there is room for no more, one of them goes for each that comes.
            assert!(share > last - 1e-3 && share < REPEATED, "{share} {last}");
            assert!((mean - spin).norm() < 10.0, "{mean}");
            // Never surer than the spins are known and strokes repeat.
            let least = 100.0 + SCATTER_RAD_S * SCATTER_RAD_S;
            assert!(covariance.symmetric_eigenvalues().min() >= least - 1e-9);
            last = share;
        }
        assert!(last > 0.9 * REPEATED);
        assert_eq!(strokes.like(&push), None);
    }

    #[test]
    fn different_spins_of_one_velocity_widen_the_expectation_and_vague_ones_count_little() {
        let velocity = Vector3::new(0.0, 7.0, 1.0);
        let mut strokes = Strokes::default();
        strokes.keep(stroke(velocity.into(), [-200.0, 0.0, 0.0], 10.0));
        strokes.keep(stroke(velocity.into(), [100.0, 0.0, 0.0], 10.0));
        let (_, mean, covariance) = strokes.like(&velocity).expect("two are like it");
        assert!((mean.x + 50.0).abs() < 1e-9, "{mean}");
        assert!((covariance[(0, 0)].sqrt() / 150.0 - 1.0).abs() < 0.02, "{covariance}");
        strokes.keep(stroke(velocity.into(), [900.0, 0.0, 0.0], 400.0));
        let (_, moved, _) = strokes.like(&velocity).expect("three are like it");
        assert!((moved.x - mean.x).abs() < 10.0, "{moved}");
    }
}
