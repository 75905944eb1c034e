use nalgebra::Vector2;
use rayon::prelude::*;
use serde::Serialize;

use super::{
    error::CalibrationError,
    mono::{MonoCalibration, MonoOptions, calibrate_mono},
    pose::board_pose,
    views::CameraViews,
};

/// What views that took no part say of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CrossValidation {
    /// Number of parts that the views were split into.
    pub folds: usize,
    /// RMS over views left out, each with its board's pose fitted, in px.
    pub held_out_rms_px: f64,
    /// The same views' RMS in the calibration from all of them, in px.
    pub all_rms_px: f64,
    /// Whether more frames would make it better: views left out fit worse than
    /// [`MORE_FRAMES_RATIO`] times those that took part.
    pub more_frames_help: bool,
}

/// Held-out over own RMS from which more frames are worth taking. With enough frames the two agree
/// to a few percent: nine unknowns are shared by all views.
pub const MORE_FRAMES_RATIO: f64 = 1.05;

/// Splits the views of one camera into `folds` parts; each part is tested against the calibration from
/// the others.
///
/// # Errors
/// As [`calibrate_mono`], when what is left without a part is no longer enough.
pub fn cross_validate(
    camera: &CameraViews,
    options: &MonoOptions,
    all: &MonoCalibration,
    folds: usize,
) -> Result<CrossValidation, CalibrationError> {
    let folds = folds.clamp(2, camera.views.len().max(2));
    let parts: Vec<(f64, usize)> = (0..folds)
        .into_par_iter()
        .map(|fold| {
            let mut rest = camera.clone();
            let mut index = 0;
            rest.views.retain(|_| {
                index += 1;
                (index - 1) % folds != fold
            });
            let start = MonoOptions { start: Some(all.model), ..options.clone() };
            let model = calibrate_mono(&rest, &start)?.model;
            let held = camera.views.iter().skip(fold).step_by(folds);
            let fits = held
                .filter_map(|v| board_pose(&model, &v.object, &v.image).map(|p| (p.rms_px, v.image.len())));
            Ok(fits.fold((0.0, 0), |(s, n), (rms, points)| (s + rms * rms * points as f64, n + points)))
        })
        .collect::<Result<_, CalibrationError>>()?;
    let (squares, points) = parts.iter().fold((0.0, 0), |(s, n), (a, b)| (s + a, n + b));
    let own: f64 = all.views.iter().flat_map(|v| &v.residuals).map(Vector2::norm_squared).sum();
    let own_points: usize = all.views.iter().map(|v| v.residuals.len()).sum();
    let held_out_rms_px = (squares / points.max(1) as f64).sqrt();
    let all_rms_px = (own / own_points.max(1) as f64).sqrt();
    Ok(CrossValidation {
        folds,
        held_out_rms_px,
        all_rms_px,
        more_frames_help: held_out_rms_px > MORE_FRAMES_RATIO * all_rms_px,
    })
}
