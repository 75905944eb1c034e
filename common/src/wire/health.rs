use iceoryx2::prelude::ZeroCopySend;

use super::{Message, Text, assert_layout, code_enum};

/// Most counters of one process.
pub const MAX_COUNTERS: usize = 64;

code_enum! {
    /// What a process is doing.
    ProcessState {
        /// Not ready yet.
        Starting = 0 => "starting",
        /// At work.
        Running = 1 => "running",
        /// On its way out.
        Stopping = 2 => "stopping",
    }
}

/// One counter: only ever grows while its process lives.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("netcord.Counter")]
#[repr(C)]
pub struct Counter {
    /// What is counted, such as `frames_published` or `lost_overflow`; per camera `left/frames`.
    pub name: Text<56>,
    /// How many.
    pub value: u64,
}

assert_layout!(Counter, size = 64);

/// A process's counters, once a second: `rig/health`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ZeroCopySend)]
#[type_name("netcord.Health")]
#[repr(C)]
pub struct Health {
    /// `capture`, `segment`, `triangulate`, `predict`, …; with a suffix `:<camera>` where a process
    /// serves one camera.
    pub process: Text<48>,
    /// Process id.
    pub pid: u32,
    /// [`ProcessState`] as its code.
    pub state: u32,
    /// CLOCK_MONOTONIC ns of the process's start.
    pub started_ns: u64,
    /// CLOCK_MONOTONIC ns of this message.
    pub now_ns: u64,
    /// How many of `counters` are filled.
    pub count: u32,
    #[doc(hidden)]
    pub _reserved: u32,
    /// The counters.
    pub counters: [Counter; MAX_COUNTERS],
}

assert_layout!(Health, size = 80 + 64 * MAX_COUNTERS, pid = 48, counters = 80);

impl Message for Health {}

impl Default for Health {
    fn default() -> Self {
        Self {
            process: Text::default(),
            pid: 0,
            state: ProcessState::Starting.code(),
            started_ns: 0,
            now_ns: 0,
            count: 0,
            _reserved: 0,
            counters: [Counter::default(); MAX_COUNTERS],
        }
    }
}

impl Health {
    /// The filled counters.
    pub fn counters(&self) -> &[Counter] {
        &self.counters[..(self.count as usize).min(MAX_COUNTERS)]
    }
}
