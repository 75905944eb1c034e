use serde::Deserialize;

use super::{LearntColour, Wiring};
use crate::{
    camera::{CameraModel, INTRINSICS},
    geometry::{Camera, Transform, World},
    name::CameraName,
    pixel::PixelFormat,
    wire::MAX_CAMERAS,
};

/// The place of a camera in its rig file, from 0: the index of per-camera arrays in messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CameraIndex(u8);

impl CameraIndex {
    /// The index `index`; `None` from [`MAX_CAMERAS`] on.
    pub fn new(index: usize) -> Option<Self> {
        (index < MAX_CAMERAS).then(|| Self(u8::try_from(index).expect("at most 16")))
    }

    /// For arrays.
    pub const fn get(self) -> usize {
        self.0 as usize
    }

    /// For messages.
    pub const fn code(self) -> u32 {
        self.0 as u32
    }

    /// The bit of masks in messages.
    pub const fn bit(self) -> u32 {
        1 << self.0
    }
}

/// How a camera is told to expose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum TriggerRole {
    /// By a command from the host, at the rig's rate.
    #[default]
    Software,
    /// By an impulse on a line: from the master's strobe, or from outside.
    Hardware,
    /// By itself, at its own rate.
    FreeRun,
}

/// Standard deviations of `fx fy cx cy k1 k2 p1 p2 k3`, as calibration found them.
pub type IntrinsicsSigma = [f64; INTRINSICS];

/// How much later than its stamps say a camera's frames are exposed, as calibration by a moving board found it.
/// Negative: earlier.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockDelay {
    /// The delay, s.
    pub delay_s: f64,
    /// Its standard deviation, s.
    pub sigma_s: f64,
}

/// One camera of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigCamera {
    /// Its name in services, topics and reports.
    pub name: CameraName,
    /// Its place in the rig file.
    pub index: CameraIndex,
    /// The device's serial number; empty for a camera that exists only in a scene or a recording.
    pub serial: String,
    /// The mosaic, as it truly is (some devices name it wrongly).
    pub pixel_format: PixelFormat,
    /// The format that the device must be set to, where its name for this mosaic is another.
    pub device_format: Option<PixelFormat>,
    /// Length of the exposure, ns.
    pub exposure_ns: u64,
    /// Gain, dB.
    pub gain_db: f64,
    /// How it is told to expose.
    pub trigger: TriggerRole,
    /// Whether it strobes its exposure for the others.
    pub master: bool,
    /// Input line of the trigger and output line of the strobe, by their GenICam names.
    pub line: Option<String>,
    /// Time from the trigger impulse to the start of the exposure, ns.
    pub line_delay_ns: u64,
    /// Polarity and delay of its trigger, and the meaning of its stamps.
    pub wiring: Wiring,
    /// Its clock's error, where calibration found one. Frames of one trigger are taken for simultaneous whatever it
    /// says: it serves to compare stamps of cameras that no trigger holds together.
    pub clock_delay: Option<ClockDelay>,
    /// Intrinsics.
    pub model: CameraModel,
    /// Standard deviations of the intrinsics, where calibration gave them.
    pub intrinsics_sigma: Option<IntrinsicsSigma>,
    /// The ball's colour as this camera sees it, where it was learnt; else [`super::Ball::colour`] counts.
    pub ball: Option<LearntColour>,
    /// Pose in the world frame.
    pub camera_from_world: Transform<Camera, World>,
}
