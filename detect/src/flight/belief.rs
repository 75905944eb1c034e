//! A state with its covariance: what is believed of the ball at one instant.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::physics::{STATE, State, StateMatrix};

/// Position and velocity: what free flight changes of a state. The first of it.
const MOVING: usize = 6;

/// Normal distribution over the ball's state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Belief {
    /// The mean.
    pub mean: State,
    /// The covariance.
    pub covariance: StateMatrix,
    /// Spin with which the flight began, before bounces changed it, rad/s: a fixed-point smoother
    /// (Anderson & Moore 1979, §7.2) beside the filter.
    pub struck_spin: Vector3<f64>,
    /// Covariance of [`Self::struck_spin`] with the state.
    pub struck_cross: SMatrix<f64, 3, STATE>,
    /// Covariance of [`Self::struck_spin`], (rad/s)².
    pub struck_covariance: Matrix3<f64>,
}

impl Default for Belief {
    fn default() -> Self {
        Self::new(State::zeros(), StateMatrix::zeros())
    }
}

/// How well a measured position agreed with a belief.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Squared Mahalanobis distance; expected 3 for a true position.
    pub chi2: f64,
    /// Logarithm of the probability density of the position, without the constant −3/2 ln 2π.
    pub log_likelihood: f64,
}

impl Belief {
    /// At the beginning of a flight.
    pub fn new(mean: State, covariance: StateMatrix) -> Self {
        Self {
            mean,
            covariance,
            struck_spin: mean.fixed_rows::<3>(6).into_owned(),
            struck_cross: covariance.fixed_rows::<3>(6).into_owned(),
            struck_covariance: covariance.fixed_view::<3, 3>(6, 6).into_owned(),
        }
    }

    /// Mean position, m.
    pub fn position(&self) -> Vector3<f64> {
        self.mean.fixed_rows::<3>(0).into_owned()
    }

    /// Mean velocity, m/s.
    pub fn velocity(&self) -> Vector3<f64> {
        self.mean.fixed_rows::<3>(3).into_owned()
    }

    /// Mean spin, rad/s.
    pub fn spin(&self) -> Vector3<f64> {
        self.mean.fixed_rows::<3>(6).into_owned()
    }

    /// Covariance of the position, m².
    pub fn position_covariance(&self) -> Matrix3<f64> {
        self.covariance.fixed_view::<3, 3>(0, 0).into_owned()
    }

    /// The mean becomes `mean`, and the covariance F P Fᵀ.
    pub(super) fn map(&mut self, mean: State, f: &StateMatrix) {
        self.mean = mean;
        self.covariance = f * self.covariance * f.transpose();
        self.struck_cross *= f.transpose();
    }

    /// As [`Self::map`] for free flight, in which only position and velocity change: a third of the work.
    pub(super) fn map_flight(&mut self, mean: State, f: &StateMatrix) {
        self.mean = mean;
        let moving = f.fixed_view::<MOVING, STATE>(0, 0).into_owned();
        let moved = moving * self.covariance;
        let cross = moved.fixed_view::<MOVING, { STATE - MOVING }>(0, MOVING).into_owned();
        let p = &mut self.covariance;
        p.fixed_view_mut::<MOVING, MOVING>(0, 0).copy_from(&(moved * moving.transpose()));
        p.fixed_view_mut::<MOVING, { STATE - MOVING }>(0, MOVING).copy_from(&cross);
        p.fixed_view_mut::<{ STATE - MOVING }, MOVING>(MOVING, 0).copy_from(&cross.transpose());
        let struck = self.struck_cross * moving.transpose();
        self.struck_cross.fixed_view_mut::<3, MOVING>(0, 0).copy_from(&struck);
    }

    /// How well a position with covariance `r` agrees; `None` where the covariances are degenerate.
    pub fn agreement(&self, position: &Vector3<f64>, r: &Matrix3<f64>) -> Option<Agreement> {
        let chol = (self.position_covariance() + r).cholesky()?;
        let innovation = position - self.position();
        let chi2 = innovation.dot(&chol.solve(&innovation));
        let half_log_det: f64 = (0..3).map(|i| chol.l_dirty()[(i, i)].ln()).sum();
        Some(Agreement { chi2, log_likelihood: -0.5 * chi2 - half_log_det })
    }

    /// Takes a measured position with covariance `r` in (Kalman's update); leaves the belief as it was
    /// where the covariances are degenerate.
    pub fn take_in(&mut self, position: &Vector3<f64>, r: &Matrix3<f64>) {
        let Some(chol) = (self.position_covariance() + r).cholesky() else { return };
        let to_position = self.covariance.fixed_view::<STATE, 3>(0, 0).into_owned();
        let inverse = chol.inverse();
        let gain = to_position * inverse;
        let innovation = position - self.position();
        let struck_gain = self.struck_cross.fixed_view::<3, 3>(0, 0) * inverse;
        self.struck_spin += struck_gain * innovation;
        let to_place = self.struck_cross.fixed_view::<3, 3>(0, 0).transpose();
        self.struck_covariance -= struck_gain * to_place;
        self.struck_cross -= struck_gain * to_position.transpose();
        self.mean += gain * innovation;
        let reduced = self.covariance - gain * to_position.transpose();
        self.covariance = 0.5 * (reduced + reduced.transpose());
    }
}
