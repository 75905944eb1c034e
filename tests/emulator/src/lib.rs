//! An emulated USB3 Vision camera: registers with a GenApi description of its own making, control
//! packets, a stream with leader, payload and trailer in real packets, trigger lines between cameras,
//! and faults on demand.
//!
//! Everything but [`usbip`] is free of I/O and clocks: [`Camera`] is told the instant, so that driver
//! tests run on it directly, in milliseconds. It shares no code with the driver, so that a mistake of
//! one is seen by the other.

mod camera;
mod config;
mod control;
mod description;
mod descriptors;
mod endpoint;
mod fault;
pub mod footage;
mod frame;
pub mod pattern;
mod registers;
mod rig;
pub mod usbip;

pub use camera::{Camera, Edge};
pub use config::{CameraConfig, LinkSpeed, StampAt};
pub use descriptors::Descriptors;
pub use endpoint::{Completion, InEndpoint, UrbEnd};
pub use fault::{Fault, FaultError, FaultPlan, FaultRule, Victim};
pub use frame::{ImageSource, PatternImages, Shot};
pub use rig::{Rig, Wire};
