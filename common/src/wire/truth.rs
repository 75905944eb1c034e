use iceoryx2::prelude::ZeroCopySend;

use super::{MAX_CAMERAS, Message, assert_layout};

/// The ball's true image in one camera.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("netcord.CameraTruth")]
#[repr(C)]
pub struct CameraTruth {
    /// Image of the ball's centre at mid-exposure, x, px; meaningless where `visible` is 0.
    pub u_px: f64,
    /// Image of the ball's centre at mid-exposure, y, px.
    pub v_px: f64,
    /// Share of the ball's image that is inside the frame and not hidden, 0–1.
    pub visible: f64,
}

assert_layout!(CameraTruth, size = 24);

/// What the synthetic source knows of one trigger: `truth/ball`, in a domain of its own
/// (`<domain>-truth`) that no stage opens.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("netcord.BallTruth")]
#[repr(C)]
pub struct BallTruth {
    /// The trigger.
    pub trigger_id: u64,
    /// Middle of the exposure, ns.
    pub mid_exposure_ns: u64,
    /// Counts flights (from one racket to the next) from 1; 0 where there is no ball.
    pub flight_id: u64,
    /// Position in the table frame at mid-exposure, m.
    pub position_m: [f64; 3],
    /// Velocity, m/s.
    pub velocity_m_s: [f64; 3],
    /// Spin, rad/s.
    pub spin_rad_s: [f64; 3],
    /// In each camera of the rig.
    pub cameras: [CameraTruth; MAX_CAMERAS],
    /// 1: there is a ball in the scene.
    pub present: u32,
    #[doc(hidden)]
    pub _reserved: u32,
}

assert_layout!(BallTruth, size = 104 + 24 * MAX_CAMERAS, position_m = 24, cameras = 96);

impl Message for BallTruth {}
