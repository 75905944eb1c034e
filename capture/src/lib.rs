//! Where netcord's frames come from: sources, triggers, and the check that the frames of one trigger
//! belong together.
//!
//! - [`FrameSource`] is what a synthetic scene, a recording and a set of devices have in common; a
//!   source fills slots that it gets from the [`FrameSink`].
//! - [`run`] is the body of `netcord capture`.
//! - [`usb`] drives USB3 Vision cameras.
//! - [`FramesetAssembler`] gives the verdict on each trigger.
//! - [`replay`] is a recording as a source.
//! - [`recording`] reads and writes recordings, for replay and for `netcord process`.

mod frameset;
mod pace;
pub mod recording;
pub mod replay;
mod run;
mod sink;
mod source;
pub mod synthetic;
pub mod usb;

pub use frameset::{Arrival, FramesetAssembler, FramesetRules};
pub use run::{CaptureError, run};
pub use sink::{FrameSink, LossReason};
pub use source::{FrameSource, SourceControl, SourceError, response};
