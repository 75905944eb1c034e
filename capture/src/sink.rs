use std::sync::{Mutex, MutexGuard, PoisonError};

use netcord_common::{
    Clock, Count, Counters, FrameView, MonotonicClock,
    bus::{Bus, BusError, FramePublisher, FrameSlot, Publisher, Topic},
    rig::{CameraIndex, Rig},
    wire::{Frameset, Verdict},
};

use crate::frameset::{Arrival, FramesetAssembler, FramesetRules};

/// Why a frame that was triggered is not published.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LossReason {
    /// The device gave none, or a fault switch took it.
    Dropped,
    /// Fewer bytes came than its size needs.
    Truncated,
    /// No slot was free.
    NoSlot,
    /// The source fell behind its triggers and left this one out.
    Overrun,
    /// It did not come in time.
    Timeout,
    /// The device said that it failed.
    DeviceError,
    /// The device is gone.
    Disconnected,
    /// The camera delivered this trigger twice; the second is not published.
    Duplicate,
}

impl LossReason {
    /// All reasons, in the order of the counters.
    pub const ALL: [Self; 8] = [
        Self::Dropped,
        Self::Truncated,
        Self::NoSlot,
        Self::Overrun,
        Self::Timeout,
        Self::DeviceError,
        Self::Disconnected,
        Self::Duplicate,
    ];

    /// The counter's name on `rig/health`.
    pub const fn counter(self) -> &'static str {
        match self {
            Self::Dropped => "lost_dropped",
            Self::Truncated => "lost_truncated",
            Self::NoSlot => "lost_no_slot",
            Self::Overrun => "lost_overrun",
            Self::Timeout => "lost_timeout",
            Self::DeviceError => "lost_device_error",
            Self::Disconnected => "lost_disconnected",
            Self::Duplicate => "lost_duplicate",
        }
    }
}

/// Where a source puts its frames: slots out, frames in, losses counted by reason, framesets checked.
/// Shared by all threads of the source.
#[derive(Debug)]
pub struct FrameSink {
    cameras: Vec<CameraSink>,
    framesets: Mutex<Framesets>,
    lost: [Count; LossReason::ALL.len()],
    late: Count,
    bus: Bus,
    session: u64,
}

#[derive(Debug)]
struct CameraSink {
    publisher: FramePublisher,
    /// The last frame's sequence. Held while a frame is sent, so that sequences leave in order.
    sequence: Mutex<u64>,
    published: Count,
    lost: Count,
}

#[derive(Debug)]
struct Framesets {
    assembler: FramesetAssembler,
    publisher: Publisher<Frameset>,
    counts: [Count; 3],
}

/// A trigger waits this many intervals for its last camera, and no less than [`MIN_WAIT_NS`]: a USB3
/// transfer takes 5–6 ms, and frames later than two intervals are useless for a 10 ms budget.
const WAIT_INTERVALS: u64 = 2;
const MIN_WAIT_NS: u64 = 20_000_000;

impl FrameSink {
    /// Opens the writing ends of all cameras of `rig`; `slot_bytes` is the source's.
    ///
    /// # Errors
    /// As [`Bus::publisher`]: another capture in this domain, no shared memory.
    pub fn open(
        bus: &Bus,
        rig: &Rig,
        slot_bytes: impl Fn(CameraIndex) -> usize,
        counters: &Counters,
    ) -> Result<Self, BusError> {
        let session = MonotonicClock.now().as_ns();
        let rules = FramesetRules {
            expected: rig.camera_mask(),
            tolerance_ns: rig.tolerance_ns,
            wait_ns: (WAIT_INTERVALS * rig.interval_ns()).max(MIN_WAIT_NS),
            session,
        };
        let cameras = rig
            .cameras
            .iter()
            .map(|camera| {
                let topic = Topic::frames(&camera.name);
                Ok(CameraSink {
                    publisher: FramePublisher::open(bus, &topic, slot_bytes(camera.index))?,
                    sequence: Mutex::new(0),
                    published: counters.register(&format!("{}/frames_published", camera.name)),
                    lost: counters.register(&format!("{}/frames_lost", camera.name)),
                })
            })
            .collect::<Result<_, BusError>>()?;
        let framesets = Framesets {
            assembler: FramesetAssembler::new(rules),
            publisher: bus.publisher(&Topic::frameset())?,
            counts: [Verdict::Complete, Verdict::Incomplete, Verdict::Unsynchronised]
                .map(|verdict| counters.register(&format!("framesets_{verdict}"))),
        };
        Ok(Self {
            cameras,
            framesets: Mutex::new(framesets),
            lost: LossReason::ALL.map(|reason| counters.register(reason.counter())),
            late: counters.register("frames_late"),
            bus: bus.clone(),
            session,
        })
    }

    /// The first trigger id of this session: later than all of earlier sessions, since triggers come
    /// less than once in a microsecond. A source counts on from here.
    pub const fn first_trigger_id(&self) -> u64 {
        self.session / 1000
    }

    /// CLOCK_MONOTONIC ns at which this session began.
    pub const fn session(&self) -> u64 {
        self.session
    }

    /// The bus that frames go to.
    pub const fn bus(&self) -> &Bus {
        &self.bus
    }

    /// Takes a free slot of `camera`, as large as the source said. It holds what an earlier frame left.
    ///
    /// # Errors
    /// [`BusError::NoSlot`] when readers hold all of them, which is for the source to report as
    /// [`LossReason::NoSlot`]; [`BusError::Service`].
    pub fn loan(&self, camera: CameraIndex) -> Result<FrameSlot, BusError> {
        let publisher = &self.cameras[camera.get()].publisher;
        publisher.loan(publisher.slot_bytes())
    }

    /// Takes a free slot of only `bytes` bytes.
    ///
    /// # Errors
    /// As [`Self::loan`], and [`BusError::FrameTooLarge`].
    pub fn loan_bytes(&self, camera: CameraIndex, bytes: usize) -> Result<FrameSlot, BusError> {
        self.cameras[camera.get()].publisher.loan(bytes)
    }

    /// Publishes a filled slot and feeds the frameset check.
    ///
    /// The source has set trigger id, exposure stamps, `frame_complete_ns`, exposure, gain, block id,
    /// size, stride and format; the sink sets sequence, session, camera and `frame_published_ns`. A
    /// frame whose size does not fit its bytes, and a second frame of one trigger, are counted as lost
    /// and not published.
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn deliver(&self, camera: CameraIndex, mut slot: FrameSlot) -> Result<(), BusError> {
        let sink = &self.cameras[camera.get()];
        let trigger_id = slot.header().trigger_id;
        if FrameView::of(slot.header(), slot.bytes()).is_err() {
            return self.lost(camera, trigger_id, LossReason::Truncated);
        }
        let mid = slot.header().stamps.mid_exposure_ns;
        let now = MonotonicClock.now().as_ns();
        // The frame leaves before the verdict on its trigger does: readers wait for the frame. A frame
        // settles its own trigger, and perhaps an older one whose place it takes.
        let mut verdicts = [None; 2];
        let mut places = verdicts.iter_mut();
        let arrival = self.framesets().assembler.frame(camera, trigger_id, mid, now, |frameset| {
            if let Some(place) = places.next() {
                *place = Some(*frameset);
            }
        });
        match arrival {
            Arrival::InTime => {}
            Arrival::Late => self.late.up(),
            Arrival::Duplicate => {
                self.lost[LossReason::Duplicate as usize].up();
                return Ok(());
            }
        }
        let mut sequence = sink.sequence.lock().unwrap_or_else(PoisonError::into_inner);
        *sequence += 1;
        let header = slot.header_mut();
        header.sequence = *sequence;
        header.session = self.session;
        header.camera = camera.code();
        header.stamps.frame_published_ns = MonotonicClock.now().as_ns();
        sink.publisher.publish(slot)?;
        sink.published.up();
        drop(sequence);
        verdicts.iter().flatten().try_for_each(|frameset| self.framesets().send(frameset))
    }

    /// Says that `camera` does not deliver `trigger_id`, and why.
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn lost(&self, camera: CameraIndex, trigger_id: u64, reason: LossReason) -> Result<(), BusError> {
        self.cameras[camera.get()].lost.up();
        self.lost[reason as usize].up();
        let now = MonotonicClock.now().as_ns();
        self.framesets().note(|assembler, decided| assembler.lost(camera, trigger_id, now, decided))
    }

    /// Gives the verdict on triggers that have waited long enough. Called by [`crate::run`].
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn tick(&self, now_ns: u64) -> Result<(), BusError> {
        self.framesets().note(|assembler, decided| assembler.tick(now_ns, decided))
    }

    fn framesets(&self) -> MutexGuard<'_, Framesets> {
        self.framesets.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Framesets {
    /// Lets `news` reach the assembler, and publishes what it decides.
    fn note(
        &mut self,
        news: impl FnOnce(&mut FramesetAssembler, &mut dyn FnMut(&Frameset)),
    ) -> Result<(), BusError> {
        let Self { assembler, publisher, counts } = self;
        let mut sent = Ok(());
        news(assembler, &mut |frameset| {
            let result = publish(publisher, counts, frameset);
            if sent.is_ok() {
                sent = result;
            }
        });
        sent
    }

    fn send(&self, frameset: &Frameset) -> Result<(), BusError> {
        publish(&self.publisher, &self.counts, frameset)
    }
}

fn publish(
    publisher: &Publisher<Frameset>,
    counts: &[Count; 3],
    frameset: &Frameset,
) -> Result<(), BusError> {
    if let Some(count) = counts.get(frameset.verdict as usize) {
        count.up();
    }
    publisher.send(frameset)
}
