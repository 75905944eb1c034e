use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use netcord_common::{
    Clock, Count, HealthReporter, MonotonicClock,
    bus::{Bus, BusError, FrameSubscriber, Listen, SequenceGaps, Subscriber, Topic, wait_any},
    wire::{BallPosition, BallTrajectory, BallTruth, Detections, ProcessState, SearchWindow},
};

use super::store::{Event, RecordedFrame, Store, Stored};
use crate::{exit::Outcome, stage::Stage};

/// Frames of one camera that may wait for the disk in shared memory, beside the bus's own queue: one less
/// than a reader may hold.
const HELD: usize = 7;

/// Bytes of frames that may wait beside that as copies, made only while the disk is behind: half a second of two
/// cameras at 100 Hz. A disk that is fast enough still pauses for tenths of a second, when the system makes writers
/// wait for what is not on the disk yet.
const COPIED: usize = 256 << 20;

/// How long the loop waits before it looks at the shutdown flag again.
const PATIENCE: Duration = Duration::from_millis(50);

/// How often losses are told while they happen.
const TELL: Duration = Duration::from_secs(5);

/// The reading ends of everything that is recorded.
pub(super) struct Gather {
    cameras: Vec<CameraEnds>,
    positions: Subscriber<BallPosition>,
    trajectories: Subscriber<BallTrajectory>,
    truth: Option<Subscriber<BallTruth>>,
    health: HealthReporter,
    /// Bytes of copies that wait.
    copied: Arc<AtomicUsize>,
    /// Frames exposed later are not recorded, ns of this machine's clock.
    until_ns: Option<u64>,
    /// Whether one of them has come.
    over: bool,
    frames: Count,
    messages: Count,
    lost_frames: Count,
    lost_messages: Count,
}

struct CameraEnds {
    frames: Option<FrameSubscriber>,
    detections: Subscriber<Detections>,
    windows: Subscriber<SearchWindow>,
    /// The last two windows: detections of a trigger were searched with the one made before it.
    window: Option<SearchWindow>,
    gaps: SequenceGaps,
    held: Arc<AtomicUsize>,
}

impl Gather {
    pub(super) fn attach(stage: &Stage, truth: Option<&Bus>, images: bool) -> Result<Self, BusError> {
        let bus = &stage.bus;
        let cameras = stage
            .rig
            .cameras
            .iter()
            .map(|camera| {
                let topic = Topic::frames(&camera.name);
                let queue = topic.limits().queue;
                Ok(CameraEnds {
                    frames: images.then(|| FrameSubscriber::open(bus, &topic, queue)).transpose()?,
                    detections: bus.subscriber(&Topic::detections(&camera.name))?,
                    windows: bus.subscriber(&Topic::window(&camera.name))?,
                    window: None,
                    gaps: SequenceGaps::new(),
                    held: Arc::new(AtomicUsize::new(0)),
                })
            })
            .collect::<Result<_, BusError>>()?;
        let [frames, messages, lost_frames, lost_messages] =
            ["frames", "messages", "lost_frames", "lost_messages"].map(|name| stage.counters.register(name));
        Ok(Self {
            cameras,
            positions: bus.subscriber(&Topic::position())?,
            trajectories: bus.subscriber(&Topic::trajectory())?,
            truth: truth.map(|bus| bus.subscriber(&Topic::truth())).transpose()?,
            health: HealthReporter::open(bus, "record", &stage.counters)?,
            copied: Arc::new(AtomicUsize::new(0)),
            until_ns: None,
            over: false,
            frames,
            messages,
            lost_frames,
            lost_messages,
        })
    }

    /// Hands everything to `store` until the end is asked for, the time is over, or the store gives up.
    pub(super) fn run(
        &mut self,
        stage: &Stage,
        store: &Store,
        length: Option<Duration>,
    ) -> Result<(), BusError> {
        stage.counters.set_state(ProcessState::Running);
        self.health.publish(MonotonicClock.now().as_ns())?;
        let began = Instant::now();
        self.until_ns = length.map(|length| MonotonicClock.now().after(length).as_ns());
        let (mut told, mut told_at) = (0, Instant::now());
        let in_time = || length.is_none_or(|length| began.elapsed() < length);
        while !stage.stop.is_requested() && in_time() && !self.over && !store.has_ended() {
            self.wait()?;
            self.drain(store)?;
            self.health.tick(MonotonicClock.now().as_ns())?;
            let lost = self.lost_frames.get();
            if lost > told && told_at.elapsed() > TELL {
                tracing::warn!("disk or processors are too slow: {lost} frames lost so far");
                (told, told_at) = (lost, Instant::now());
            }
        }
        self.drain(store)?;
        stage.counters.set_state(ProcessState::Stopping);
        self.health.publish(MonotonicClock.now().as_ns())
    }

    fn wait(&self) -> Result<(), BusError> {
        let mut ends: Vec<&dyn Listen> = vec![&self.positions, &self.trajectories];
        for camera in &self.cameras {
            if let Some(frames) = &camera.frames {
                ends.push(frames);
            }
            ends.push(&camera.detections);
        }
        if let Some(truth) = &self.truth {
            ends.push(truth);
        }
        wait_any(&ends, PATIENCE)
    }

    fn drain(&mut self, store: &Store) -> Result<(), BusError> {
        let (messages, lost_messages) = (&self.messages, &self.lost_messages);
        let count = |stored: bool| if stored { messages.up() } else { lost_messages.up() };
        let copied = &self.copied;
        for camera in &mut self.cameras {
            let has_place = |held: &AtomicUsize| held.load(Ordering::Acquire) < HELD;
            while (has_place(&camera.held) || copied.load(Ordering::Acquire) < COPIED)
                && let Some(frame) = camera.frames.as_ref().map_or(Ok(None), FrameSubscriber::receive)?
            {
                // By their stamps: where processors are short, frames come as fast as they are taken, and long after.
                if self.until_ns.is_some_and(|until| frame.header().stamps.mid_exposure_host_ns > until) {
                    self.over = true;
                    break;
                }
                self.lost_frames.add(camera.gaps.see_frame(frame.header()));
                let frame = match has_place(&camera.held) {
                    true => RecordedFrame::hold(frame, &camera.held),
                    false => RecordedFrame::copy(&frame, copied),
                };
                match store.offer(Event::Frame(frame)) {
                    true => self.frames.up(),
                    false => self.lost_frames.up(),
                }
            }
            if let Some(window) = camera.windows.receive_newest()? {
                camera.window = Some(window);
            }
            while let Some(detections) = camera.detections.receive()? {
                // A window is for one trigger; one that is newer already is none of this frame's.
                let stamp = detections.stamps.mid_exposure_ns;
                let near = |w: &SearchWindow| w.mid_exposure_ns.abs_diff(stamp) < 5_000_000;
                let window = camera.window.filter(near);
                count(store.offer(Event::Detections(Box::new(detections), window)));
            }
        }
        while let Some(position) = self.positions.receive()? {
            count(store.offer(Event::Position(Box::new(position))));
        }
        while let Some(trajectory) = self.trajectories.receive()? {
            count(store.offer(Event::Trajectory(Box::new(trajectory))));
        }
        while let Some(truth) = self.truth.as_ref().map_or(Ok(None), Subscriber::receive)? {
            count(store.offer(Event::Truth(Box::new(truth))));
        }
        Ok(())
    }

    /// Says what was recorded and what was lost.
    pub(super) fn report(&self, out: &Path, stored: &Stored) -> Outcome {
        println!(
            "{}: {} frames, {} messages{}, {:.1} MB",
            out.display(),
            self.frames.get(),
            self.messages.get(),
            // Some of them were still on their way when the disk was full.
            if stored.failed.is_some() { " taken" } else { "" },
            stored.bytes as f64 * 1e-6
        );
        let (frames, messages) = (self.lost_frames.get(), self.lost_messages.get());
        if let Some(why) = &stored.failed {
            eprintln!("netcord: recording ended early: {why}. {} is valid up to there", out.display());
            if stored.messages_given_up > 0 {
                eprintln!("netcord: its last {} messages made room for the index", stored.messages_given_up);
            }
        }
        if frames + messages > 0 {
            eprintln!(
                "netcord: {frames} frames and {messages} messages were lost: the disk, or what the stages leave of \
                 the processors, is too slow for this rate"
            );
        }
        let nothing = self.frames.get() + self.messages.get() == 0;
        if nothing {
            eprintln!("netcord: nothing was published meanwhile: does the rig run in this domain?");
        }
        if stored.failed.is_some() || nothing || frames + messages > 0 {
            Outcome::Missed
        } else {
            Outcome::Good
        }
    }
}
