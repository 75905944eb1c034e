use nalgebra::{Matrix3, Vector3};
use netcord_common::{
    geometry::{Point, World},
    wire::MAX_CAMERAS,
};

use super::{Observation, PosedCamera};

/// A triangulated point with what is known of its quality.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The point.
    pub point: Point<World>,
    /// Its covariance, m².
    pub covariance_m2: Matrix3<f64>,
    /// Root mean square over the views used of the distance between observation and re-projection, px.
    pub residual_px: f64,
    /// That distance in each camera of the rig, px; zero where `views` lacks it.
    pub residual_by_camera_px: [f64; MAX_CAMERAS],
    /// Sum of the squared residuals over their covariance; expected 2 × views − 3.
    pub chi2: f64,
    /// Bit i: camera i of the rig took part.
    pub views: u32,
}

impl Estimate {
    /// Measures the residuals of `point` in all `observations`.
    pub(super) fn assess(
        cameras: &[PosedCamera],
        observations: &[Observation],
        point: Vector3<f64>,
        covariance_m2: Matrix3<f64>,
    ) -> Self {
        let mut estimate = Self {
            point: Point::from(point),
            covariance_m2,
            residual_px: 0.0,
            residual_by_camera_px: [0.0; MAX_CAMERAS],
            chi2: 0.0,
            views: 0,
        };
        let mut squares = 0.0;
        let mut seen = 0.0;
        for o in observations {
            // A point that a method put outside a lens's model has no residual there.
            let Some(pixel) = cameras[o.camera].project(&estimate.point) else { continue };
            let residual = o.pixel - pixel;
            squares += residual.norm_squared();
            seen += 1.0;
            estimate.chi2 += residual.dot(&(o.information * residual));
            estimate.residual_by_camera_px[o.camera] = residual.norm();
            estimate.views |= 1 << o.camera;
        }
        if seen > 0.0 {
            estimate.residual_px = (squares / seen).sqrt();
        }
        estimate
    }
}
