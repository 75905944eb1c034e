use iceoryx2::prelude::ZeroCopySend;

use super::{MAX_CAMERAS, Message, assert_layout, code_enum};

code_enum! {
    /// What became of one trigger.
    Verdict {
        /// All cameras delivered, within the tolerance.
        Complete = 0 => "complete",
        /// At least one camera did not deliver in time.
        Incomplete = 1 => "incomplete",
        /// All delivered, but their exposures lie further apart than the tolerance.
        Unsynchronised = 2 => "unsynchronised",
    }
}

/// Which cameras delivered one trigger: `rig/frameset`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("netcord.Frameset")]
#[repr(C)]
pub struct Frameset {
    /// The trigger.
    pub trigger_id: u64,
    /// Session of the capture process.
    pub session: u64,
    /// Largest difference between the exposures' middles, ns.
    pub skew_ns: u64,
    /// The tolerance that it was held against, ns.
    pub tolerance_ns: u64,
    /// CLOCK_MONOTONIC ns at which the verdict was given.
    pub decided_ns: u64,
    /// Middle of each camera's exposure, ns; 0 where none was delivered.
    pub mid_exposure_ns: [u64; MAX_CAMERAS],
    /// Bit i: camera i of the rig should deliver.
    pub expected: u32,
    /// Bit i: camera i delivered.
    pub delivered: u32,
    /// [`Verdict`] as its code.
    pub verdict: u32,
    #[doc(hidden)]
    pub _reserved: u32,
}

assert_layout!(Frameset, size = 184, mid_exposure_ns = 40, expected = 168);

impl Message for Frameset {}
