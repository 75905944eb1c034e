use netcord_common::wire::MethodCode;

/// What a calibration may be off by, one standard deviation, px: rigs with a reprojection error of some
/// tenths of a pixel, and a stand that has settled a little since, still work.
pub const CALIBRATION_SLACK_PX: f64 = 0.75;

/// How to triangulate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriangulateOptions {
    /// The method that computes the point, once candidates have been associated.
    pub method: MethodCode,
    /// What the calibration may be off by, one standard deviation, px: widens the gates, not the
    /// covariances of results.
    pub slack_px: f64,
    /// Time to wait for the other cameras after the last arrival, ns; default: half a frame interval where
    /// two cameras have delivered, and where one is alone a whole one, and no less than 5 ms.
    pub patience_ns: Option<u64>,
}

impl Default for TriangulateOptions {
    fn default() -> Self {
        Self { method: MethodCode::Robust, slack_px: CALIBRATION_SLACK_PX, patience_ns: None }
    }
}
