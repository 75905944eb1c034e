//! The segmenter on the bus: frames and search windows in, detections out; one thread per camera.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use netcord_common::{
    CameraName, Clock, Count, Counters, FrameView, FrameViewError, HealthReporter, MonotonicClock, Shutdown,
    bus::{Bus, BusError, FrameSubscriber, Publisher, SequenceGaps, Subscriber, Topic},
    realtime,
    rig::{Rig, RigCamera},
    wire::{Detections, FrameHeader, ProcessState, Scope, SearchWindow},
};
use thiserror::Error;

use super::{SegmentError, SegmentOptions, Segmenter};

/// How long a loop sleeps at most, so that it sees a request to stop.
const LONGEST_WAIT: Duration = Duration::from_millis(100);

/// Frames that may wait for one camera's thread: a hiccup of three frames loses nothing, and what is behind
/// by more than that is dropped, oldest first, rather than carried along as latency.
const QUEUE: usize = 4;

/// Shorter than other programs' turns, of which none then keeps a frame waiting; longer than those of the stages
/// that follow, which need not wait for the rest of a frame.
const TURN: Duration = Duration::from_millis(1);

/// How the stage runs, beside what it looks for.
#[derive(Debug, Clone, Default)]
pub struct LiveOptions {
    /// What is looked for.
    pub segment: SegmentOptions,
    /// The only camera that this process serves; `None`: all of the rig's, a thread each.
    pub camera: Option<CameraName>,
    /// How long before the next frame is due a thread stops sleeping and watches for it: a core that wakes up
    /// takes 0.1–0.2 ms. Zero where cores are shared with other stages.
    pub spin: Duration,
}

/// Why the stage ended early.
#[derive(Debug, Error)]
pub enum LiveError {
    /// The bus refused.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A camera cannot be searched.
    #[error(transparent)]
    Segment(#[from] SegmentError),
    /// There is no camera of that name.
    #[error("the rig has no camera {name}; it has {valid}")]
    NoSuchCamera {
        /// What was asked for.
        name: CameraName,
        /// The names that there are.
        valid: String,
    },
}

/// Runs the segmenter of a rig until `stop` is requested; `on_ready` is called once, when all its threads
/// listen. A frame that is not what the rig file says is counted, and said once.
///
/// # Errors
/// [`LiveError`], also when another segmenter serves one of the cameras.
pub fn run(
    bus: &Bus,
    rig: &Rig,
    options: &LiveOptions,
    stop: &Shutdown,
    counters: &Arc<Counters>,
    on_ready: impl FnOnce(),
) -> Result<(), LiveError> {
    let wanted = |camera: &&RigCamera| options.camera.as_ref().is_none_or(|name| *name == camera.name);
    let cameras = rig.cameras.iter().filter(wanted).collect::<Vec<_>>();
    if cameras.is_empty() {
        let valid = rig.cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ");
        let name = options.camera.clone().expect("a rig has cameras, so that only a name can exclude all");
        return Err(LiveError::NoSuchCamera { name, valid });
    }
    let mut watchers = cameras
        .iter()
        .map(|c| Watcher::open(bus, rig, c, options, counters))
        .collect::<Result<Vec<_>, _>>()?;
    let process = options.camera.as_ref().map_or("segment".to_owned(), |name| format!("segment:{name}"));
    let mut health = HealthReporter::open(bus, &process, counters)?;

    counters.set_state(ProcessState::Running);
    health.publish(MonotonicClock.now().as_ns())?;
    on_ready();
    let ended = AtomicBool::new(false);
    let failure = Mutex::new(None);
    thread::scope(|scope| {
        for watcher in &mut watchers {
            let (ended, failure) = (&ended, &failure);
            scope.spawn(move || {
                realtime::take_short_turns(TURN);
                while !ended.load(Ordering::Relaxed) {
                    if let Err(error) = watcher.next() {
                        failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                        // Relaxed: the mutex orders the failure itself.
                        ended.store(true, Ordering::Relaxed);
                    }
                }
            });
        }
        while !stop.is_requested() && !ended.load(Ordering::Relaxed) {
            thread::sleep(LONGEST_WAIT / 2);
            if let Err(error) = health.tick(MonotonicClock.now().as_ns()) {
                failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                break;
            }
        }
        ended.store(true, Ordering::Relaxed);
    });
    counters.set_state(ProcessState::Stopping);
    health.publish(MonotonicClock.now().as_ns())?;
    match failure.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(error) => Err(error.into()),
        None => Ok(()),
    }
}

/// Serves one camera.
struct Watcher {
    name: CameraName,
    segmenter: Segmenter,
    frames: FrameSubscriber,
    windows: Subscriber<SearchWindow>,
    window: Option<SearchWindow>,
    detections: Publisher<Detections>,
    gaps: SequenceGaps,
    half_interval_ns: u64,
    due: Due,
    tally: Tally,
    complained: bool,
}

impl Watcher {
    fn open(
        bus: &Bus,
        rig: &Rig,
        camera: &RigCamera,
        options: &LiveOptions,
        counters: &Counters,
    ) -> Result<Self, LiveError> {
        Ok(Self {
            name: camera.name.clone(),
            segmenter: Segmenter::new(rig, camera.index.get(), options.segment.clone())?,
            frames: FrameSubscriber::open(bus, &Topic::frames(&camera.name), QUEUE)?,
            windows: bus.subscriber(&Topic::window(&camera.name))?,
            window: None,
            detections: bus.publisher(&Topic::detections(&camera.name))?,
            gaps: SequenceGaps::new(),
            half_interval_ns: rig.interval_ns() / 2,
            due: Due::new(options.spin),
            tally: Tally::register(counters, &camera.name),
            complained: false,
        })
    }

    /// Waits for frames and searches those that have come.
    fn next(&mut self) -> Result<(), BusError> {
        self.wait()?;
        while let Some(frame) = self.frames.receive()? {
            let start_ns = MonotonicClock.now().as_ns();
            self.due.came(start_ns);
            let mut header = *frame.header();
            header.stamps.segment_start_ns = start_ns;
            self.tally.lost.add(self.gaps.see_frame(&header));
            self.tally.frames.up();
            if let Some(window) = self.windows.receive_newest()? {
                self.window = Some(window);
            }
            match FrameView::of(&header, frame.bytes()) {
                Ok(view) => self.search(&header, &view)?,
                Err(error) => self.complain(&header, &Refused::Frame(error)),
            }
        }
        Ok(())
    }

    fn wait(&self) -> Result<(), BusError> {
        if self.frames.has_frame() {
            return Ok(());
        }
        let now = MonotonicClock.now().as_ns();
        let Some((from, until)) = self.due.watch_ns(now) else { return self.frames.wait(LONGEST_WAIT) };
        if from > now {
            self.frames.wait(Duration::from_nanos(from - now).min(LONGEST_WAIT))?;
        }
        while !self.frames.has_frame() {
            if MonotonicClock.now().as_ns() > until {
                return self.frames.wait(LONGEST_WAIT);
            }
            std::hint::spin_loop();
        }
        Ok(())
    }

    fn search(&mut self, header: &FrameHeader, view: &FrameView<'_>) -> Result<(), BusError> {
        let at = header.stamps.mid_exposure_ns;
        // A window is for one instant: an older one says where the ball was.
        let window = self.window.filter(|w| w.mid_exposure_ns.abs_diff(at) <= self.half_interval_ns);
        let (detections, tally, lost) = (&self.detections, &self.tally, self.gaps.lost());
        let mut sent = Ok(());
        let searched = self.segmenter.process(header, view, window.as_ref(), &mut |message| {
            let mut message = *message;
            message.frames_lost = lost;
            message.stamps.segment_published_ns = MonotonicClock.now().as_ns();
            if let Err(error) = detections.send(&message) {
                sent = Err(error);
            }
            if message.scope == Scope::Window.code() {
                tally.by_window.up();
            } else {
                tally.candidates.add(u64::from(message.count));
            }
        });
        if let Err(error) = searched {
            self.complain(header, &Refused::Search(error));
        }
        sent
    }

    /// Counts a frame that cannot be searched; says so for the first one only.
    fn complain(&mut self, header: &FrameHeader, why: &Refused) {
        self.tally.refused.up();
        if !self.complained {
            self.complained = true;
            tracing::error!(camera = %self.name, trigger = header.trigger_id, "frames are not searched: {why}");
        }
    }
}

/// Why a frame was not searched.
#[derive(Debug, Error)]
enum Refused {
    #[error(transparent)]
    Frame(FrameViewError),
    #[error(transparent)]
    Search(SegmentError),
}

/// When the next frame is due, by the rhythm of the last ones.
#[derive(Debug)]
struct Due {
    spin_ns: u64,
    last_ns: u64,
    interval_ns: u64,
}

/// Longer pauses than this are no rhythm.
const LONGEST_INTERVAL_NS: u64 = 1_000_000_000;

impl Due {
    fn new(spin: Duration) -> Self {
        Self { spin_ns: u64::try_from(spin.as_nanos()).unwrap_or(0), last_ns: 0, interval_ns: 0 }
    }

    fn came(&mut self, now_ns: u64) {
        let interval = now_ns.saturating_sub(self.last_ns);
        if self.last_ns != 0 && interval < LONGEST_INTERVAL_NS {
            // A running mean over about eight frames; the first one counts in full.
            self.interval_ns =
                if self.interval_ns == 0 { interval } else { (self.interval_ns * 7 + interval) / 8 };
        }
        self.last_ns = now_ns;
    }

    /// From when until when to watch for the next frame; `None` where there is no rhythm, or none is wanted,
    /// or it has passed.
    fn watch_ns(&self, now_ns: u64) -> Option<(u64, u64)> {
        if self.spin_ns == 0 || self.interval_ns == 0 {
            return None;
        }
        // Never for more than a quarter of the interval on either side.
        let spin = self.spin_ns.min(self.interval_ns / 4);
        let due = self.last_ns + self.interval_ns;
        (now_ns < due + spin).then(|| (due.saturating_sub(spin), due + spin))
    }
}

/// Counters of one camera.
#[derive(Debug)]
struct Tally {
    frames: Count,
    lost: Count,
    refused: Count,
    by_window: Count,
    candidates: Count,
}

impl Tally {
    fn register(counters: &Counters, camera: &CameraName) -> Self {
        let count = |what: &str| counters.register(&format!("{camera}/{what}"));
        Self {
            frames: count("frames_searched"),
            lost: count("frames_lost"),
            refused: count("frames_refused"),
            by_window: count("found_in_window"),
            candidates: count("candidates"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_frame_is_watched_for_just_around_the_time_it_is_due() {
        let mut due = Due::new(Duration::from_micros(300));
        assert_eq!(due.watch_ns(0), None);
        for frame in 1..=20 {
            due.came(frame * 10_000_000);
        }
        assert_eq!(due.watch_ns(200_100_000), Some((209_700_000, 210_300_000)));
        assert_eq!(due.watch_ns(210_400_000), None, "it did not come: sleep");
        assert_eq!(Due::new(Duration::ZERO).watch_ns(5), None);
    }
}
