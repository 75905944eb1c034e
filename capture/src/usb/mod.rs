//! USB3 Vision cameras, through rusb and nothing proprietary.
//!
//! - [`gencp`], [`genapi`] and [`stream`] are the protocols, free of I/O and clocks.
//! - [`discover`] lists what is plugged in; [`Camera`] is one that is open.
//! - [`UsbSource`] is the [`FrameSource`](crate::FrameSource) of a rig's cameras: transfers go straight
//!   into the slots of shared memory that readers see.
//! - [`DeviceClock`] and [`TriggerMatcher`] bring frames to the host's clock and to their triggers.

mod access;
mod bytes;
mod checks;
mod clock;
mod device;
mod discovery;
pub mod genapi;
pub mod gencp;
mod matching;
#[cfg(test)]
mod mutation;
mod settings;
mod source;
pub mod stream;
#[cfg(test)]
mod testing;
mod transfers;

pub use access::FeatureAccess;
pub use checks::{Check, CheckResult, UDEV_RULE, UDEV_RULE_PATH, check_all};
pub use clock::{ClockReading, DeviceClock, HostInstant};
pub use device::{Camera, CameraError, UsbPipe};
pub use discovery::{
    DeviceInfo, Discovery, DiscoveryError, Endpoints, FoundCamera, NotVision, VENDORS, discover,
    endpoints_of, usb_context,
};
pub use matching::{Grid, Matched, TriggerMatcher};
pub use settings::{InForce, apply, is_host_triggered, set_exposure, set_gain, set_rate, set_white_balance};
pub use source::{UsbOptions, UsbSource};
