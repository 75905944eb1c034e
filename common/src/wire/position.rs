use iceoryx2::prelude::ZeroCopySend;

use super::{MAX_CAMERAS, Message, Stamps, assert_layout, code_enum};

code_enum! {
    /// The frame of reference of results.
    WorldFrame {
        /// Origin at the centre of the playing surface, x along the width, y along the length, z up.
        Table = 0 => "table",
        /// The first camera's frame: no table has been calibrated.
        FirstCamera = 1 => "first-camera",
    }
}

code_enum! {
    /// Why a trigger has no position.
    NoPosition {
        /// No camera saw a candidate.
        NoDetection = 1 => "NoDetection",
        /// Only one camera saw a candidate.
        OneView = 2 => "OneView",
        /// The rays are so nearly parallel that depth is undetermined.
        ParallelRays = 3 => "ParallelRays",
        /// The point would lie behind a camera.
        BehindCamera = 4 => "BehindCamera",
        /// No two candidates agree on a point.
        ResidualTooLarge = 5 => "ResidualTooLarge",
        /// The exposures do not belong together.
        NotSynchronised = 6 => "NotSynchronised",
    }
}

code_enum! {
    /// Triangulation methods by their codes in messages.
    MethodCode {
        /// Homogeneous DLT.
        DltSvd = 0 => "dlt-svd",
        /// Inhomogeneous DLT.
        DltLs = 1 => "dlt-ls",
        /// Nearest point to all rays.
        Midpoint = 2 => "midpoint",
        /// Depth in the first camera from one coordinate of the second.
        RtFirst = 3 => "rt-first",
        /// The cameras swapped.
        RtSecond = 4 => "rt-second",
        /// Both combined.
        RtSymmetric = 5 => "rt-symmetric",
        /// Least weighted reprojection error.
        Reprojection = 6 => "reprojection",
        /// Largest consistent subset, then reprojection.
        Robust = 7 => "robust",
    }
}

/// A position or the reason why there is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PositionOutcome {
    /// `position_m` holds.
    Position,
    /// There is none.
    None(NoPosition),
}

/// The ball at one trigger: `ball/position`. At most one for each trigger.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("netcord.BallPosition")]
#[repr(C)]
pub struct BallPosition {
    /// The trigger.
    pub trigger_id: u64,
    /// Counts this triangulator's messages from 1.
    pub sequence: u64,
    /// `mid_exposure_ns` is that of the first camera, in rig order, that took part; the other stamps
    /// are those of the detections that came last.
    pub stamps: Stamps,
    /// x, y, z in metres.
    pub position_m: [f64; 3],
    /// Covariance of the position, m², row-major.
    pub covariance_m2: [f64; 9],
    /// Root mean square over the views used of the distance between detection and re-projection, px.
    pub residual_px: f64,
    /// Distance between detection and re-projection in each camera, px; zero where `views` lacks it.
    pub residual_by_camera_px: [f64; MAX_CAMERAS],
    /// Sum of squared residuals over their covariance; expected about 2 × views − 3.
    pub chi2: f64,
    /// Bit i: camera i took part.
    pub views: u32,
    /// Bit i: camera i saw a candidate that took no part although it was offered.
    pub rejected: u32,
    /// Which candidate of each camera's message was used; 255 where the camera took no part.
    pub candidate: [u8; MAX_CAMERAS],
    /// 0, or [`NoPosition`] as its code.
    pub reason: u32,
    /// [`MethodCode`] as its code.
    pub method: u32,
    /// [`WorldFrame`] as its code.
    pub frame: u32,
    /// [`super::Scope`] of the detections used: `window` when all came from search windows.
    pub scope: u32,
    /// Bit i: camera i no longer fits the rig and was left out.
    pub distrusted: u32,
    #[doc(hidden)]
    pub _reserved: u32,
}

assert_layout!(
    BallPosition,
    size = 384,
    stamps = 16,
    position_m = 96,
    views = 336,
    candidate = 344,
    reason = 360
);

impl Message for BallPosition {}

impl BallPosition {
    /// Position, or the reason for its absence.
    pub fn outcome(&self) -> PositionOutcome {
        match NoPosition::from_code(self.reason) {
            Some(reason) => PositionOutcome::None(reason),
            None => PositionOutcome::Position,
        }
    }

    /// Whether `position_m` holds.
    pub fn is_present(&self) -> bool {
        self.outcome() == PositionOutcome::Position
    }

    /// How many cameras took part.
    pub fn view_count(&self) -> u32 {
        self.views.count_ones()
    }
}
