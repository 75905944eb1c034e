//! Calibration mathematics: from corners to cameras whose every number carries its uncertainty.

mod block;
mod bundle;
mod clocks;
mod delay;
mod epipolar;
mod error;
mod gravity;
mod homography;
mod looks;
mod loss;
mod mono;
mod motion;
mod pose;
mod report;
mod resection;
mod rig;
mod strays;
mod uncertainty;
mod validate;
mod views;
mod wand;
mod zhang;

pub use block::Block;
pub use bundle::{Bundle, BundleCamera, Freedom, Sighting, Solution, SolveOptions};
pub use clocks::Clock;
pub use delay::Delay;
pub use error::CalibrationError;
pub use gravity::{STANDARD_GRAVITY, scale_by_gravity};
pub use homography::{apply as apply_homography, homography};
pub use looks::{looks_around, on_time};
pub use loss::Loss;
pub use mono::{INTRINSIC_NAMES, MonoCalibration, MonoOptions, Outlier, ViewFit, calibrate_mono};
pub use motion::{
    Inconsistent, MotionCalibration, MotionMember, MotionOptions, MovingPoints, calibrate_motion,
};
pub use pose::{FittedPose, board_pose};
pub use report::{CameraReport, OutlierReport, RejectedReport, Report, Uncertain, ViewReport, coverage};
pub use rig::{RejectedView, RigCalibration, RigMember, RigOptions, RigViewFit, calibrate_rig};
pub use strays::Stray;
pub use uncertainty::ProjectionUncertainty;
pub use validate::{CrossValidation, MORE_FRAMES_RATIO, cross_validate};
pub use views::{CameraViews, PixelMotion, View, read_corners, write_corners};
