use std::{
    collections::BTreeMap,
    fs::File,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use netcord_capture::recording::{METADATA, RecordedTruth, RecordingError, RecordingWriter, WriterOptions};
use netcord_common::{
    PixelFormat,
    bus::Frame,
    rig::Rig,
    unix_minus_monotonic_ns,
    wire::{BallPosition, BallTrajectory, BallTruth, Detections, FrameHeader, SearchWindow, WIRE_VERSION},
};

use crate::recording::{RigTopics, Wanted};

/// A frame that waits for the disk: in shared memory, given back when it is written; or, where the disk is behind by
/// more than a reader may hold there, a copy.
#[derive(Debug)]
pub(super) struct RecordedFrame {
    header: FrameHeader,
    pixels: Pixels,
    /// What it takes of `account`: a place in shared memory, or bytes of copies.
    share: usize,
    account: Arc<AtomicUsize>,
}

#[derive(Debug)]
enum Pixels {
    Held(Frame, usize),
    Copied(Box<[u8]>),
}

impl RecordedFrame {
    /// Keeps the slot, and counts it in `held`.
    pub(super) fn hold(frame: Frame, held: &Arc<AtomicUsize>) -> Self {
        let (header, bytes) = (*frame.header(), mosaic_bytes(&frame));
        Self::on(held, 1, header, Pixels::Held(frame, bytes))
    }

    /// Gives the slot back, and counts the copy's bytes in `copied`.
    pub(super) fn copy(frame: &Frame, copied: &Arc<AtomicUsize>) -> Self {
        let bytes = mosaic_bytes(frame);
        Self::on(copied, bytes, *frame.header(), Pixels::Copied(frame.bytes()[..bytes].into()))
    }

    fn on(account: &Arc<AtomicUsize>, share: usize, header: FrameHeader, pixels: Pixels) -> Self {
        // Acquire and Release, with the loads in Gather::drain: a place counts as free only after the frame
        // has gone back.
        account.fetch_add(share, Ordering::AcqRel);
        Self { header, pixels, share, account: Arc::clone(account) }
    }
}

/// A slot may hold slack behind the last row.
fn mosaic_bytes(frame: &Frame) -> usize {
    let header = frame.header();
    (header.stride as usize * header.height as usize).min(frame.bytes().len())
}

impl AsRef<[u8]> for RecordedFrame {
    fn as_ref(&self) -> &[u8] {
        match &self.pixels {
            Pixels::Held(frame, bytes) => &frame.bytes()[..*bytes],
            Pixels::Copied(bytes) => bytes,
        }
    }
}

impl Drop for RecordedFrame {
    fn drop(&mut self) {
        // The frame itself is dropped after this: one more may be asked for too early by that much, which
        // the spare place of a reader covers.
        self.account.fetch_sub(self.share, Ordering::AcqRel);
    }
}

/// What is to be stored.
#[derive(Debug)]
pub(super) enum Event {
    Frame(RecordedFrame),
    Detections(Box<Detections>, Option<SearchWindow>),
    Position(Box<BallPosition>),
    Trajectory(Box<BallTrajectory>),
    Truth(Box<BallTruth>),
}

/// What became of it all.
#[derive(Debug, Default)]
pub(super) struct Stored {
    pub(super) bytes: u64,
    /// Why recording ended before it was told to.
    pub(super) failed: Option<String>,
    pub(super) messages_given_up: u64,
}

/// Writes on a thread of its own, so that the disk makes nobody wait.
pub(super) struct Store {
    queue: Option<SyncSender<Event>>,
    thread: Option<JoinHandle<Result<Stored, RecordingError>>>,
    ended: Arc<AtomicBool>,
}

/// Events that may wait for the disk: seconds of small messages; frames are bounded by what may be held.
const WAITING: usize = 4096;

/// Frames of a chunk: they are held in shared memory until it is written.
const FRAMES_A_CHUNK: usize = 4;

/// What has been gathered is written at least this often, so that a killed recorder loses less than a
/// second.
const AT_LEAST: Duration = Duration::from_millis(100);

/// How often the system is told to bring to the disk what it still holds in memory: for the case that not
/// this process but the machine dies.
const SYNC: Duration = Duration::from_millis(500);

impl Store {
    /// Begins the file.
    pub(super) fn begin(
        path: &Path,
        rig: &Rig,
        rig_text: &str,
        images: bool,
        truth: bool,
    ) -> Result<Self, RecordingError> {
        // No checksums: they would read every frame once more, beside the stages that need that memory.
        let options = WriterOptions { checksums: false, ..WriterOptions::default() };
        let mut writer = RecordingWriter::create(path, options)?;
        writer.metadata(METADATA, &metadata(rig, rig_text))?;
        let topics = RigTopics::new(&mut writer, rig, Wanted { images, truth });
        let (queue, events) = sync_channel(WAITING);
        let ended = Arc::new(AtomicBool::new(false));
        let failed = |cause| RecordingError::File { doing: "share", path: path.to_owned(), cause };
        let file = writer.file().try_clone().map_err(failed)?;
        let mut keeper = Keeper { writer, topics, rig: rig.clone(), written: Instant::now() };
        let has_ended = Arc::clone(&ended);
        let thread = std::thread::Builder::new()
            .name("store".into())
            .spawn(move || {
                let syncing = keep_in_step(file, Arc::clone(&has_ended));
                let result = keeper.keep(&events);
                has_ended.store(true, Ordering::Release);
                let stored = keeper.end(result);
                if let Ok(thread) = syncing {
                    let _ = thread.join();
                }
                stored
            })
            .map_err(failed)?;
        Ok(Self { queue: Some(queue), thread: Some(thread), ended })
    }

    /// Hands on an event; false when there is no room or no disk for it.
    pub(super) fn offer(&self, event: Event) -> bool {
        self.queue.as_ref().is_some_and(|queue| queue.try_send(event).is_ok())
    }

    /// Whether the store has given up.
    pub(super) fn has_ended(&self) -> bool {
        self.ended.load(Ordering::Acquire)
    }

    /// Writes what waits, and ends the file.
    pub(super) fn finish(mut self) -> Result<Stored, RecordingError> {
        drop(self.queue.take());
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(stored)) => stored,
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            None => Ok(Stored::default()),
        }
    }
}

/// Lets the system write out what it holds, on yet another thread: that may take as long as the disk wants.
fn keep_in_step(file: File, ended: Arc<AtomicBool>) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name("sync".into()).spawn(move || {
        while !ended.load(Ordering::Acquire) {
            std::thread::sleep(SYNC);
            // A disk that fails says so to the writer too.
            let _ = file.sync_data();
        }
    })
}

struct Keeper {
    writer: RecordingWriter<RecordedFrame>,
    topics: RigTopics,
    rig: Rig,
    written: Instant,
}

impl Keeper {
    fn keep(&mut self, events: &Receiver<Event>) -> Result<(), RecordingError> {
        loop {
            match events.recv_timeout(AT_LEAST) {
                Ok(event) => self.store(event)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
            if self.writer.waiting_parts() >= FRAMES_A_CHUNK || self.written.elapsed() >= AT_LEAST {
                self.writer.flush()?;
                self.written = Instant::now();
            }
        }
    }

    fn store(&mut self, event: Event) -> Result<(), RecordingError> {
        let (topics, writer) = (&mut self.topics, &mut self.writer);
        topics.stand(writer, event.stamp_ns())?;
        match event {
            Event::Frame(frame) => {
                let header = frame.header;
                let format = PixelFormat::from_pfnc(header.pixel_format).unwrap_or(PixelFormat::Mono8);
                topics.frame(writer, &header, format, frame)
            }
            Event::Detections(detections, window) => {
                let Some(camera) = self.rig.cameras.get(detections.camera as usize) else { return Ok(()) };
                topics.detections(writer, camera.index, &detections, window.as_ref())
            }
            Event::Position(position) => topics.position(writer, &position),
            Event::Trajectory(trajectory) => topics.trajectory(writer, &trajectory),
            Event::Truth(truth) => topics.truth(writer, &RecordedTruth::of(&truth, &self.rig)),
        }
    }

    /// The file's index and end, also where the disk is full.
    fn end(self, result: Result<(), RecordingError>) -> Result<Stored, RecordingError> {
        let mut writer = self.writer;
        let result = result.and_then(|()| writer.flush());
        let bytes = writer.written_bytes();
        let Err(e) = result else {
            // Even now the disk may be full: the index is the last straw.
            writer.finish()?;
            return Ok(Stored { bytes, ..Stored::default() });
        };
        let messages_given_up = writer.finish_without_space()?;
        Ok(Stored { bytes, failed: Some(e.to_string()), messages_given_up })
    }
}

impl Event {
    fn stamp_ns(&self) -> u64 {
        match self {
            Self::Frame(frame) => frame.header.stamps.mid_exposure_ns,
            Self::Detections(detections, _) => detections.stamps.mid_exposure_ns,
            Self::Position(position) => position.stamps.mid_exposure_ns,
            Self::Trajectory(trajectory) => trajectory.stamps.mid_exposure_ns,
            Self::Truth(truth) => truth.mid_exposure_ns,
        }
    }
}

/// What the recording says of itself.
fn metadata(rig: &Rig, rig_text: &str) -> BTreeMap<String, String> {
    BTreeMap::from([
        ("rig".to_owned(), rig.name.to_string()),
        ("rig_toml".to_owned(), rig_text.to_owned()),
        ("world_frame".to_owned(), rig.world.to_string()),
        ("netcord_version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ("wire_version".to_owned(), WIRE_VERSION.to_string()),
        ("made_by".to_owned(), "netcord record".to_owned()),
        ("unix_minus_monotonic_ns".to_owned(), unix_minus_monotonic_ns().to_string()),
    ])
}
