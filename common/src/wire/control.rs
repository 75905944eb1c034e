use iceoryx2::prelude::ZeroCopySend;

use super::{Message, Text, assert_layout, code_enum};

/// `camera` of a request that speaks to all cameras.
pub const ALL_CAMERAS: u32 = u32::MAX;

code_enum! {
    /// What `rig/control` can ask of capture.
    ControlCommand {
        /// Expose once, now (trigger role `software`).
        Trigger = 1 => "trigger",
        /// Exposure in ns, `values[0]`.
        SetExposure = 2 => "set-exposure",
        /// Gain in dB, `values[0]`.
        SetGain = 3 => "set-gain",
        /// Begin to deliver frames.
        Start = 4 => "start",
        /// Stop delivering frames; the process stays.
        Stop = 5 => "stop",
        /// Nothing changes; the answer tells the state.
        Status = 6 => "status",
        /// Frame rate in Hz, `values[0]`.
        SetRate = 7 => "set-rate",
        /// White balance: factors of red and blue against green, `values[0..2]`.
        SetWhiteBalance = 8 => "set-white-balance",
        /// Region of interest: x, y, width, height in px, `values[0..4]`.
        SetRegion = 9 => "set-region",
    }
}

code_enum! {
    /// How a request ended.
    ControlStatus {
        /// Done; `values` hold what is now in force.
        Done = 0 => "done",
        /// The source cannot do this; `text` says why.
        NotSupported = 1 => "not-supported",
        /// A value or camera is out of range; `text` says what would be valid.
        Invalid = 2 => "invalid",
        /// The device refused or failed; `text` says how.
        Failed = 3 => "failed",
    }
}

/// Request of `rig/control`.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("netcord.ControlRequest")]
#[repr(C)]
pub struct ControlRequest {
    /// [`ControlCommand`] as its code.
    pub command: u32,
    /// Place of the camera in the rig file, or [`ALL_CAMERAS`].
    pub camera: u32,
    /// Meaning by command.
    pub values: [f64; 4],
}

assert_layout!(ControlRequest, size = 40);

impl Message for ControlRequest {}

/// Answer of `rig/control`.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("netcord.ControlResponse")]
#[repr(C)]
pub struct ControlResponse {
    /// [`ControlStatus`] as its code.
    pub status: u32,
    /// 1 while frames are delivered.
    pub running: u32,
    /// The values now in force, meaning by command.
    pub values: [f64; 4],
    /// The last trigger's id.
    pub trigger_id: u64,
    /// What a person should know.
    pub text: Text<208>,
}

assert_layout!(ControlResponse, size = 256);

impl Message for ControlResponse {}
