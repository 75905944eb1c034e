use nalgebra::{Matrix3, Vector3};
use netcord_common::{
    geometry::{Point, World},
    wire::{MethodCode, NoPosition},
};

use super::{Method, at_least_two, dlt, in_front, midpoint, normal_equation};
use crate::triangulate::{Estimate, Observation, PosedCamera};

/// The point of least squared reprojection error in raw pixels, weighted by the observations'
/// covariances, through the whole camera model: the maximum likelihood under Gaussian noise. Gauss–Newton
/// from the linear solution, with steps halved where they overshoot.
#[derive(Debug, Clone, Copy, Default)]
pub struct Reprojection;

impl Method for Reprojection {
    fn code(&self) -> MethodCode {
        MethodCode::Reprojection
    }

    fn locate(
        &self,
        cameras: &[PosedCamera],
        observations: &[Observation],
    ) -> Result<Point<World>, NoPosition> {
        let start = start(cameras, observations)?;
        let refined = refine(cameras, observations, start).ok_or(NoPosition::BehindCamera)?;
        in_front(cameras, observations, refined.point)
    }

    fn estimate(
        &self,
        cameras: &[PosedCamera],
        observations: &[Observation],
    ) -> Result<Estimate, NoPosition> {
        let start = start(cameras, observations)?;
        let refined = refine(cameras, observations, start).ok_or(NoPosition::BehindCamera)?;
        let covariance = refined.covariance().ok_or(NoPosition::ParallelRays)?;
        Ok(Estimate::assess(cameras, observations, refined.point, covariance))
    }
}

/// The linear solution where it lies in front of all cameras, else the point nearest to the rays.
fn start(cameras: &[PosedCamera], observations: &[Observation]) -> Result<Vector3<f64>, NoPosition> {
    at_least_two(observations)?;
    let linear = dlt::linear(cameras, observations).ok_or(NoPosition::ParallelRays)?;
    in_front(cameras, observations, linear)
        .or_else(|_| midpoint::Midpoint.locate(cameras, observations))
        .map(|point| point.coords)
}

/// A minimum of the weighted reprojection error.
#[derive(Debug, Clone, Copy)]
pub(in crate::triangulate) struct Refined {
    /// The point, m, in the world.
    pub point: Vector3<f64>,
    /// Jᵀ W J there, 1/m².
    pub information: Matrix3<f64>,
}

impl Refined {
    /// Covariance of the point, m²; `None` where a direction is not determined.
    pub fn covariance(&self) -> Option<Matrix3<f64>> {
        self.information.cholesky().map(|c| c.inverse())
    }
}

/// A step shorter than this, in metres, ends the iteration. The residuals are small, so each step is
/// at least a hundred times shorter than the one before: what is left is below 1e-12 m.
const CONVERGED_M: f64 = 1e-10;

/// Steps after which a point that has not settled is no minimum in sight of all cameras.
const MAX_STEPS: usize = 50;

/// Gauss–Newton from `start`; `None` when no point near it has an image in all cameras.
pub(in crate::triangulate) fn refine(
    cameras: &[PosedCamera],
    observations: &[Observation],
    start: Vector3<f64>,
) -> Option<Refined> {
    let mut point = start;
    let (mut information, mut gradient, mut chi2) = linearise(cameras, observations, &point)?;
    for _ in 0..MAX_STEPS {
        let step = information.cholesky()?.solve(&gradient);
        let mut scale = 1.0;
        let last = step.norm() < CONVERGED_M;
        loop {
            let tried = point + step * scale;
            match linearise(cameras, observations, &tried) {
                // Rounding makes the sum of squares jitter in its last digits.
                Some((i, g, c)) if last || c <= chi2 * (1.0 + 1e-9) + 1e-12 => {
                    (point, information, gradient, chi2) = (tried, i, g, c);
                    break;
                }
                _ => {
                    scale *= 0.5;
                    if scale < 1e-4 {
                        return Some(Refined { point, information });
                    }
                }
            }
        }
        if last {
            break;
        }
    }
    Some(Refined { point, information })
}

fn linearise(
    cameras: &[PosedCamera],
    observations: &[Observation],
    point: &Vector3<f64>,
) -> Option<(Matrix3<f64>, Vector3<f64>, f64)> {
    let mut information = Matrix3::zeros();
    let mut gradient = Vector3::zeros();
    let mut chi2 = 0.0;
    for o in observations {
        let (pixel, jacobian) = cameras[o.camera].project_with_jacobian(point)?;
        let residual = o.pixel - pixel;
        let (i, g) = normal_equation(o, &residual, &jacobian);
        information += i;
        gradient += g;
        chi2 += residual.dot(&(o.information * residual));
    }
    Some((information, gradient, chi2))
}
