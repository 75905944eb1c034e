//! The raw mirror of the file: every key it may hold, and no other.

use serde::Deserialize;
use toml::Spanned;

use super::{BallColour, ColourKind, Restart, StampMeaning, TriggerEdge, TriggerRole};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RigFile {
    pub(super) name: Spanned<String>,
    pub(super) rate_hz: Option<Spanned<f64>>,
    pub(super) tolerance_us: Option<Spanned<f64>>,
    #[serde(default)]
    pub(super) ball: BallTable,
    pub(super) table: Option<PoseTable>,
    #[serde(default)]
    pub(super) flight: FlightTable,
    #[serde(default)]
    pub(super) camera: Vec<Spanned<CameraTable>>,
    #[serde(default)]
    pub(super) process: Vec<Spanned<ProcessTable>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BallTable {
    pub(super) diameter_m: Option<Spanned<f64>>,
    #[serde(default)]
    pub(super) colour: BallColour,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FlightTable {
    pub(super) hitting_plane_y_m: Option<Spanned<f64>>,
    pub(super) mass_kg: Option<Spanned<f64>>,
    pub(super) drag: Option<Spanned<f64>>,
    pub(super) gravity_m_s2: Option<Spanned<f64>>,
    pub(super) drag_induced: Option<Spanned<f64>>,
    pub(super) magnus: Option<Spanned<f64>>,
    pub(super) magnus_saturation: Option<Spanned<f64>>,
    pub(super) air_density_kg_m3: Option<Spanned<f64>>,
    pub(super) restitution: Option<Spanned<f64>>,
    pub(super) restitution_slope_s_m: Option<Spanned<f64>>,
    pub(super) friction: Option<Spanned<f64>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraTable {
    pub(super) name: Spanned<String>,
    #[serde(default)]
    pub(super) serial: String,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) pixel_format: Spanned<String>,
    pub(super) device_format: Option<Spanned<String>>,
    pub(super) exposure_us: Spanned<f64>,
    pub(super) gain_db: Option<Spanned<f64>>,
    #[serde(default)]
    pub(super) trigger: TriggerRole,
    #[serde(default)]
    pub(super) master: bool,
    pub(super) line: Option<String>,
    pub(super) line_delay_us: Option<Spanned<f64>>,
    #[serde(default)]
    pub(super) trigger_edge: TriggerEdge,
    pub(super) trigger_delay_us: Option<Spanned<f64>>,
    #[serde(default)]
    pub(super) stamp: StampMeaning,
    /// How much later than stamped its frames are exposed.
    pub(super) clock_delay_ms: Option<Spanned<f64>>,
    pub(super) clock_delay_sigma_ms: Option<Spanned<f64>>,
    pub(super) intrinsics: Option<Spanned<IntrinsicsTable>>,
    pub(super) pose: Option<PoseTable>,
    pub(super) ball: Option<Spanned<LearntTable>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct IntrinsicsTable {
    pub(super) fx: f64,
    pub(super) fy: f64,
    pub(super) cx: f64,
    pub(super) cy: f64,
    /// k1 k2 p1 p2 k3.
    pub(super) distortion: [f64; 5],
    /// Of fx fy cx cy k1 k2 p1 p2 k3.
    pub(super) sigma: Option<[f64; 9]>,
    #[serde(rename = "calibrated")]
    pub(super) _calibrated: Option<NoteTable>,
}

/// The ball's colour in one camera.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LearntTable {
    pub(super) from: ColourKind,
    /// r, g, b, bound.
    pub(super) tests: Spanned<Vec<[f64; 4]>>,
    pub(super) mean: [f64; 3],
    /// Upper triangle, row by row.
    pub(super) covariance: Spanned<[f64; 6]>,
    pub(super) diameter_px: Spanned<[f64; 2]>,
    #[serde(rename = "learnt")]
    pub(super) _learnt: Option<LearningTable>,
}

/// What learning notes beside its result, for people.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LearningTable {
    #[serde(rename = "date")]
    pub(super) _date: Option<String>,
    #[serde(rename = "frames")]
    pub(super) _frames: Option<u64>,
    #[serde(rename = "balls")]
    pub(super) _balls: Option<u64>,
    #[serde(rename = "kept")]
    pub(super) _kept: Option<f64>,
    #[serde(rename = "let_through")]
    pub(super) _let_through: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PoseTable {
    /// Row-major.
    pub(super) rotation: Spanned<[f64; 9]>,
    pub(super) translation_m: [f64; 3],
    /// Of the rotation vector (rad) and the translation (m).
    #[serde(rename = "sigma")]
    pub(super) _sigma: Option<[f64; 6]>,
    #[serde(rename = "calibrated")]
    pub(super) _calibrated: Option<NoteTable>,
}

/// What calibration notes beside its result, for people.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NoteTable {
    #[serde(rename = "date")]
    pub(super) _date: Option<String>,
    #[serde(rename = "board")]
    pub(super) _board: Option<String>,
    #[serde(rename = "frames")]
    pub(super) _frames: Option<u64>,
    #[serde(rename = "rms_px")]
    pub(super) _rms_px: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ProcessTable {
    pub(super) command: String,
    #[serde(default)]
    pub(super) args: Vec<String>,
    #[serde(default)]
    pub(super) affinity: Vec<usize>,
    pub(super) priority: Option<i32>,
    #[serde(default)]
    pub(super) restart: Restart,
}
