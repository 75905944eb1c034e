//! Everything that lies in shared memory: the messages of the bus.
//!
//! The contract, for readers in other languages too:
//! - `#[repr(C)]`, little-endian, fixed size, no pointers; padding is spelled out as `_reserved`
//!   fields, which writers leave zero.
//! - Sizes and offsets are asserted at compile time, in each file. Changing a layout means raising
//!   [`WIRE_VERSION`]: an old and a new process that meet get an error that says so.
//! - Every field says its unit; the service's writer is the only one who writes it.
//! - Instants are nanoseconds of CLOCK_MONOTONIC ([`Stamps`] says which clock where a recording is
//!   replayed). The stamp 0 means that the stage has not been reached.
//! - Lengths are metres, image positions pixels ((0, 0) is the centre of the top-left pixel), angles
//!   radians. Covariances are row-major.
//! - What is absent says why: a code with a reason stands beside the value, and the value is zero.

mod control;
mod detections;
mod frame;
mod frameset;
mod health;
mod position;
mod stamps;
mod text;
mod trajectory;
mod truth;
mod window;

pub use control::{ALL_CAMERAS, ControlCommand, ControlRequest, ControlResponse, ControlStatus};
pub use detections::{Detection, DetectionFlags, Detections, MAX_DETECTIONS, Scope};
pub use frame::FrameHeader;
pub use frameset::{Frameset, Verdict};
pub use health::{Counter, Health, MAX_COUNTERS, ProcessState};
pub use position::{BallPosition, MethodCode, NoPosition, PositionOutcome, WorldFrame};
pub use stamps::Stamps;
pub use text::Text;
pub use trajectory::{
    BallTrajectory, Landing, LandingKind, MAX_PATH, PathPoint, PlaneCrossing, TrajectoryOutcome,
};
pub use truth::{BallTruth, CameraTruth};
pub use window::SearchWindow;

use iceoryx2::prelude::ZeroCopySend;

/// Version of all layouts in this module: an attribute that every service of the bus demands.
pub const WIRE_VERSION: u32 = 1;

/// Most cameras of one rig: the width of per-camera arrays and masks in messages.
pub const MAX_CAMERAS: usize = 16;

/// A message of the bus: plain old data.
pub trait Message: ZeroCopySend + Copy + core::fmt::Debug + Send + Sync + 'static {}

macro_rules! code_enum {
    ($(#[$doc:meta])* $name:ident { $($(#[$vdoc:meta])* $variant:ident = $code:literal => $text:literal),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[repr(u32)]
        pub enum $name { $($(#[$vdoc])* $variant = $code),+ }

        impl $name {
            /// Every value, in the order of the codes.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// The code that stands in messages.
            pub const fn code(self) -> u32 {
                self as u32
            }

            /// The value of a code; `None` for one that this version does not know.
            pub const fn from_code(code: u32) -> Option<Self> {
                match code { $($code => Some(Self::$variant),)+ _ => None }
            }

            /// The name that reports, CSV and JSON lines use.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $text),+ }
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}
pub(crate) use code_enum;

/// Asserts a layout at compile time: size, then the offset of each named field.
macro_rules! assert_layout {
    ($type:ty, size = $size:expr $(, $field:ident = $offset:expr)* $(,)?) => {
        const _: () = {
            assert!(core::mem::size_of::<$type>() == $size);
            assert!(core::mem::align_of::<$type>() == 8);
            $(assert!(core::mem::offset_of!($type, $field) == $offset);)*
        };
    };
}
pub(crate) use assert_layout;
