//! The methods of triangulation, behind one trait.

mod dlt;
mod midpoint;
mod reprojection;
mod robust;
mod two_view;

pub use dlt::{DltLs, DltSvd};
pub use midpoint::Midpoint;
pub use reprojection::Reprojection;
pub use robust::Robust;
pub use two_view::{RtFirst, RtSecond, RtSymmetric};

pub(super) use midpoint::middle;
pub(super) use reprojection::{Refined, refine};
pub(super) use robust::reason;

use std::fmt;

use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};
use netcord_common::{
    geometry::{Point, World},
    wire::{MAX_CAMERAS, MethodCode, NoPosition},
};

use super::{Estimate, Observation, PosedCamera};

/// A way to find a point from where cameras saw it.
pub trait Method: fmt::Debug + Send + Sync {
    /// Its code in messages, which has its name.
    fn code(&self) -> MethodCode;

    /// Most views that it takes.
    fn max_views(&self) -> usize {
        MAX_CAMERAS
    }

    /// The point; `observations` are of different cameras of `cameras`, at least one.
    ///
    /// # Errors
    /// The reason why there is none.
    fn locate(
        &self,
        cameras: &[PosedCamera],
        observations: &[Observation],
    ) -> Result<Point<World>, NoPosition>;

    /// The point with its covariance and residuals. By default the covariance of the observations is
    /// carried to the point by the method's numerical derivative, so that it is that of this method and
    /// not of a better one.
    ///
    /// # Errors
    /// As [`Self::locate`].
    fn estimate(
        &self,
        cameras: &[PosedCamera],
        observations: &[Observation],
    ) -> Result<Estimate, NoPosition> {
        let point = self.locate(cameras, observations)?;
        let covariance = propagated(self, cameras, observations)?;
        Ok(Estimate::assess(cameras, observations, point.coords, covariance))
    }
}

/// Every method, in the order of the design's table.
pub fn all_methods() -> [&'static dyn Method; 8] {
    [
        &DltSvd,
        &DltLs,
        &Midpoint,
        &RtFirst,
        &RtSecond,
        &RtSymmetric,
        &Reprojection,
        &const { Robust::with_slack_px(super::CALIBRATION_SLACK_PX) },
    ]
}

/// The method of a code.
pub fn method(code: MethodCode) -> &'static dyn Method {
    all_methods()[code.code() as usize]
}

/// Step of the numerical derivative, px: far above rounding, far below the scale on which a
/// projection bends.
const STEP_PX: f64 = 1e-3;

fn propagated<M: Method + ?Sized>(
    method: &M,
    cameras: &[PosedCamera],
    observations: &[Observation],
) -> Result<Matrix3<f64>, NoPosition> {
    let Some(first) = observations.first() else { return Err(NoPosition::NoDetection) };
    let mut moved = [*first; MAX_CAMERAS];
    let moved = &mut moved[..observations.len()];
    moved.copy_from_slice(observations);
    let mut covariance = Matrix3::zeros();
    for (i, seen) in observations.iter().enumerate() {
        let mut by_pixel = nalgebra::Matrix3x2::zeros();
        for axis in 0..2 {
            let mut ends = [Vector3::zeros(); 2];
            for (end, sign) in ends.iter_mut().zip([-1.0, 1.0]) {
                let mut step = Vector2::zeros();
                step[axis] = sign * STEP_PX;
                moved[i] = cameras[seen.camera]
                    .observe(seen.camera, seen.pixel + step, seen.covariance_px2)
                    .ok_or(NoPosition::BehindCamera)?;
                *end = method.locate(cameras, moved)?.coords;
            }
            by_pixel.set_column(axis, &((ends[1] - ends[0]) / (2.0 * STEP_PX)));
        }
        moved[i] = *seen;
        covariance += by_pixel * seen.covariance_px2 * by_pixel.transpose();
    }
    Ok(covariance)
}

/// Whether all cameras have the point in front of them.
fn in_front(
    cameras: &[PosedCamera],
    observations: &[Observation],
    point: Vector3<f64>,
) -> Result<Point<World>, NoPosition> {
    if !point.iter().all(|v| v.is_finite()) {
        return Err(NoPosition::ParallelRays);
    }
    let seen =
        observations.iter().all(|o| cameras[o.camera].in_camera(&point).z > super::camera::MIN_DEPTH_M);
    if seen { Ok(Point::from(point)) } else { Err(NoPosition::BehindCamera) }
}

/// Fewer than two views have no depth.
fn at_least_two(observations: &[Observation]) -> Result<(), NoPosition> {
    match observations.len() {
        0 => Err(NoPosition::NoDetection),
        1 => Err(NoPosition::OneView),
        _ => Ok(()),
    }
}

/// Jᵀ W J and Jᵀ W r of one view.
fn normal_equation(
    observation: &Observation,
    residual: &Vector2<f64>,
    jacobian: &Matrix2x3<f64>,
) -> (Matrix3<f64>, Vector3<f64>) {
    let weighted = observation.information * jacobian;
    (jacobian.tr_mul(&weighted), weighted.tr_mul(residual))
}

#[cfg(test)]
mod degenerate;
#[cfg(test)]
mod tests;
