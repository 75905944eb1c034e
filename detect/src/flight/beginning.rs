//! The beginning of a flight: a few positions that only a ball set flying explains.

use nalgebra::{Matrix3, Vector3};

use super::{
    bank::{Bank, Hypothesis},
    belief::Belief,
    flow::{Exempt, Flow},
    habits::Habits,
    physics::{DRAG, StateMatrix, join},
    prior,
    tracker::{GATE_CHI2, Observation, seconds},
};

/// Positions of one beginning lie within this time, ns.
pub const LONGEST_BEGINNING_NS: u64 = 120_000_000;
/// Slower than this nothing flies, m/s.
const SLOWEST_M_S: f64 = 0.3;
/// Faster than this no ball is hit, m/s: the record is about 36.
const FASTEST_M_S: f64 = 40.0;
/// Most drag and Magnus force together while a beginning is sought, m/s².
const UNMODELLED_M_S2: f64 = 40.0;

/// A parabola through a few positions.
#[derive(Debug, Clone, Copy)]
pub struct Beginning {
    /// At the first position's instant, m.
    pub position: Vector3<f64>,
    /// At the first position's instant, m/s.
    pub velocity: Vector3<f64>,
    /// Standard deviation of the velocity, m/s.
    pub velocity_sigma: f64,
}

impl Beginning {
    /// Least squares of p + v t + g t²/2; `None` where the positions are not of one flight.
    pub fn fit(observations: &[Observation], flow: &Flow) -> Option<Self> {
        let (first, last) = (observations.first()?, observations.last()?);
        if last.t_ns - first.t_ns > LONGEST_BEGINNING_NS {
            return None;
        }
        let gravity = flow.forces.gravity_m_s2;
        let (mut n, mut st, mut stt) = (0.0, 0.0, 0.0);
        let (mut sx, mut stx) = (Vector3::zeros(), Vector3::zeros());
        for o in observations {
            let t = seconds(first.t_ns, o.t_ns);
            let weight = 1.0 / o.covariance.trace().max(1e-12);
            let x = o.position - 0.5 * t * t * gravity;
            n += weight;
            st += weight * t;
            stt += weight * t * t;
            sx += weight * x;
            stx += weight * t * x;
        }
        let determinant = n * stt - st * st;
        if determinant <= 0.0 {
            return None;
        }
        let velocity = (n * stx - st * sx) / determinant;
        let position = (stt * sx - st * stx) / determinant;
        if !(SLOWEST_M_S..FASTEST_M_S).contains(&velocity.norm()) {
            return None;
        }
        let fits = observations.iter().all(|o| {
            let t = seconds(first.t_ns, o.t_ns);
            let span = seconds(first.t_ns, last.t_ns);
            let off = o.position - (position + velocity * t + 0.5 * t * t * gravity);
            // Largest deviation of a parabola from its chord.
            let slack = UNMODELLED_M_S2 * span * span / 8.0;
            let tolerated = o.covariance + Matrix3::identity() * (slack * slack);
            tolerated.cholesky().is_some_and(|c| off.dot(&c.solve(&off)) < GATE_CHI2)
        });
        // The weights are inverse variances of all three coordinates together.
        let velocity_sigma = (n / determinant).sqrt();
        fits.then_some(Self { position, velocity, velocity_sigma })
    }

    /// Hypotheses at the first position's instant. Position and velocity are left open, since the
    /// positions that they were fitted to are taken in afterwards; the fit is where the flight is
    /// linearised.
    pub fn bank(&self, habits: &Habits) -> Bank {
        let mut bank = Bank::default();
        let remembered = habits.strokes.like(&self.velocity);
        let unlike = 1.0 - remembered.map_or(0.0, |(share, ..)| share);
        let kinds = prior::spin(&self.velocity).map(|(share, mean, cov)| (unlike * share, mean, cov));
        for (share, spin, spin_covariance) in kinds.into_iter().chain(remembered) {
            let mut mean = join(&self.position, &self.velocity, &spin);
            let mut covariance = StateMatrix::zeros();
            for i in 0..3 {
                covariance[(i, i)] = 1.0;
                covariance[(i + 3, i + 3)] = 400.0;
            }
            for (i, (learned, variance)) in (DRAG..).zip(habits.peculiar) {
                mean[i] = learned;
                covariance[(i, i)] = variance;
            }
            covariance.fixed_view_mut::<3, 3>(6, 6).copy_from(&spin_covariance);
            let belief = Belief::new(mean, covariance);
            bank.add(Hypothesis { belief, weight: share, bounces: 0, exempt: Exempt::default() });
        }
        bank
    }
}
