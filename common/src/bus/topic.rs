use std::marker::PhantomData;

use crate::{
    name::CameraName,
    wire::{
        BallPosition, BallTrajectory, BallTruth, Detections, FrameHeader, Frameset, Health, MAX_CAMERAS,
        SearchWindow,
    },
};

/// How many peers a service serves, and how much it queues. Part of the service: all peers must agree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Processes that may write at a time.
    pub writers: usize,
    /// Processes that may read at a time.
    pub readers: usize,
    /// Messages that wait for one reader; one more drops the oldest.
    pub queue: usize,
    /// Messages that one reader may hold at a time.
    pub borrowed: usize,
    /// Messages that one writer may fill at a time.
    pub loaned: usize,
}

impl Limits {
    /// Slots that the writer's shared memory has: enough for every reader to hold and queue its fill,
    /// so that no reader, slow or dead, can starve the writer.
    pub const fn slots(&self) -> usize {
        self.readers * (self.queue + self.borrowed) + self.loaned + 1
    }
}

/// A service of the bus and what its payload is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic<T> {
    name: String,
    limits: Limits,
    writer: &'static str,
    payload: PhantomData<T>,
}

/// For messages of up to some kilobytes of which every one counts. 16 readers of 32 messages.
const MESSAGES: Limits = Limits { writers: 1, readers: 16, queue: 32, borrowed: 4, loaned: 2 };

/// For frames: at 100 Hz a queue of 8 bridges 80 ms of a reader's absence. The pool has
/// 8 × (8 + 8) + 8 + 1 = 137 slots; only those that have been in use at one time take memory.
const FRAMES: Limits = Limits { writers: 1, readers: 8, queue: 8, borrowed: 8, loaned: 8 };

/// Only the newest message counts.
const NEWEST: Limits = Limits { writers: 1, readers: 16, queue: 1, borrowed: 2, loaned: 2 };

/// Every process of a domain writes: a segmenter per camera, the other stages, and tools.
const EVERYONE: Limits = Limits { writers: MAX_CAMERAS + 16, readers: 16, queue: 64, borrowed: 4, loaned: 2 };

impl<T> Topic<T> {
    const fn new(name: String, writer: &'static str, limits: Limits) -> Self {
        Self { name, limits, writer, payload: PhantomData }
    }

    /// The service's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The service's limits.
    pub const fn limits(&self) -> &Limits {
        &self.limits
    }

    /// The subcommand that writes this service.
    pub const fn writer(&self) -> &'static str {
        self.writer
    }
}

impl Topic<FrameHeader> {
    /// `camera/<name>/frame`: the mosaic with its header.
    pub fn frames(camera: &CameraName) -> Self {
        Self::new(format!("camera/{camera}/frame"), "capture", FRAMES)
    }
}

impl Topic<Detections> {
    /// `camera/<name>/detections`.
    pub fn detections(camera: &CameraName) -> Self {
        Self::new(format!("camera/{camera}/detections"), "segment", MESSAGES)
    }
}

impl Topic<SearchWindow> {
    /// `camera/<name>/window`.
    pub fn window(camera: &CameraName) -> Self {
        Self::new(format!("camera/{camera}/window"), "predict", NEWEST)
    }
}

impl Topic<Frameset> {
    /// `rig/frameset`.
    pub fn frameset() -> Self {
        Self::new("rig/frameset".into(), "capture", MESSAGES)
    }
}

impl Topic<BallPosition> {
    /// `ball/position`.
    pub fn position() -> Self {
        Self::new("ball/position".into(), "triangulate", MESSAGES)
    }
}

impl Topic<BallTrajectory> {
    /// `ball/trajectory`.
    pub fn trajectory() -> Self {
        Self::new("ball/trajectory".into(), "predict", MESSAGES)
    }
}

impl Topic<Health> {
    /// `rig/health`.
    pub fn health() -> Self {
        Self::new("rig/health".into(), "any process", EVERYONE)
    }
}

impl Topic<BallTruth> {
    /// `truth/ball`, in the truth domain.
    pub fn truth() -> Self {
        Self::new("truth/ball".into(), "capture", Limits { queue: 512, ..MESSAGES })
    }
}

/// Name of the request–response service that capture answers.
pub(super) const CONTROL: &str = "rig/control";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_reader_can_starve_the_frame_pool() {
        let camera = CameraName::new("left").expect("valid");
        let topic = Topic::frames(&camera);
        assert_eq!(topic.name(), "camera/left/frame");
        let l = topic.limits();
        assert!(l.slots() > l.readers * (l.queue + l.borrowed) + l.loaned);
    }
}
