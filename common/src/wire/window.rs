use iceoryx2::prelude::ZeroCopySend;

use super::{Message, assert_layout};

/// Where the predictor expects the ball in one camera at the next trigger: `camera/<name>/window`.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("netcord.SearchWindow")]
#[repr(C)]
pub struct SearchWindow {
    /// The trigger whose position the prediction was made from.
    pub made_from_trigger: u64,
    /// The instant that the window is for, in the clock of `Stamps::mid_exposure_ns`.
    pub mid_exposure_ns: u64,
    /// Left edge, px.
    pub x0_px: f64,
    /// Top edge, px.
    pub y0_px: f64,
    /// Right edge, px.
    pub x1_px: f64,
    /// Bottom edge, px.
    pub y1_px: f64,
    /// Expected image of the ball's centre, x, px.
    pub u_px: f64,
    /// Expected image of the ball's centre, y, px.
    pub v_px: f64,
    /// Covariance of (u, v), px²: uu, uv, vv.
    pub covariance_px2: [f64; 3],
    /// Expected diameter of the ball's image, px.
    pub diameter_px: f64,
    /// Expected velocity of the image, px/s.
    pub velocity_px_s: [f64; 2],
    /// Place of the camera in the rig file, from 0.
    pub camera: u32,
    /// 1: a ball is expected here; 0: none is expected in this camera, search the whole frame only.
    pub present: u32,
}

assert_layout!(SearchWindow, size = 120, x0_px = 16, covariance_px2 = 64, camera = 112);

impl Message for SearchWindow {}
