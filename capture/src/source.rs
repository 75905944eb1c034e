use std::sync::Arc;

use netcord_common::{
    Shutdown,
    bus::BusError,
    rig::CameraIndex,
    wire::{ControlRequest, ControlResponse, ControlStatus, Text},
};
use thiserror::Error;

use crate::sink::FrameSink;

/// Where frames come from: a synthetic scene, a recording, or devices. One for a rig and a process.
///
/// The source drives itself, with as many threads of its own as it needs. For each trigger and camera
/// it either fills a slot that it was loaned and delivers it, or says that the frame is lost; cameras
/// complete independently of each other, and several slots of one camera may be out on loan (up to the
/// topic's limit), so that a device can be given its buffers beforehand.
pub trait FrameSource: Send {
    /// Bytes that one slot of `camera` must have: the frame, and what transfers need at its end.
    fn slot_bytes(&self, camera: CameraIndex) -> usize;

    /// The part that answers `rig/control`, from another thread, while the source runs.
    fn control(&self) -> Arc<dyn SourceControl>;

    /// Delivers frames until `stop` is requested or the source is at its end. Threads that it starts
    /// end before it returns.
    ///
    /// # Errors
    /// [`SourceError`] for what the source cannot recover from by itself.
    fn run(&mut self, sink: &FrameSink, stop: &Shutdown) -> Result<(), SourceError>;
}

/// The part of a source that answers requests while it runs.
pub trait SourceControl: Send + Sync {
    /// Carries out a request; what a source cannot do is answered, not ignored.
    fn control(&self, request: &ControlRequest) -> ControlResponse;
}

/// A response that only says how the request ended, and why.
pub fn response(status: ControlStatus, text: &str) -> ControlResponse {
    ControlResponse { status: status.code(), text: Text::new(text), ..ControlResponse::default() }
}

/// Why a source gave up.
#[derive(Debug, Error)]
pub enum SourceError {
    /// The bus refused.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The source itself: the device, the recording, the scene.
    #[error("{what}")]
    Failed {
        /// What went wrong, as a sentence.
        what: String,
        /// The cause.
        source: Option<Box<dyn std::error::Error + Send + Sync>>,
    },
}

impl SourceError {
    /// A failure of the source itself.
    pub fn failed(cause: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Failed { what: cause.to_string(), source: Some(Box::new(cause)) }
    }
}
