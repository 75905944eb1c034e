use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use netcord_common::{
    Clock, Counters, HealthReporter, MonotonicClock, Shutdown,
    bus::{Bus, BusError, ControlServer},
    rig::Rig,
    wire::ProcessState,
};
use thiserror::Error;

use crate::{
    sink::FrameSink,
    source::{FrameSource, SourceControl, SourceError},
};

/// Why capture ended early.
#[derive(Debug, Error)]
pub enum CaptureError {
    /// The bus refused: another capture in this domain, no shared memory, another version.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The source gave up.
    #[error("the frame source failed: {0}")]
    Source(#[source] SourceError),
}

/// How often requests are answered and waiting triggers looked at: a request takes no longer than a
/// frame, and an incomplete frameset is published this much late at most.
const HOUSEKEEPING: Duration = Duration::from_millis(4);

/// The body of `netcord capture`: publishes what `source` delivers, checks framesets, answers
/// `rig/control` and reports health, until `stop` is requested or the source is at its end.
///
/// # Errors
/// [`CaptureError`].
pub fn run(
    bus: &Bus,
    rig: &Rig,
    source: &mut dyn FrameSource,
    stop: &Shutdown,
    counters: &Arc<Counters>,
) -> Result<(), CaptureError> {
    let sink = FrameSink::open(bus, rig, |camera| source.slot_bytes(camera), counters)?;
    let mut desk = Desk {
        server: ControlServer::open(bus)?,
        health: HealthReporter::open(bus, "capture", counters)?,
        control: source.control(),
    };
    counters.set_state(ProcessState::Running);
    desk.health.publish(MonotonicClock.now().as_ns())?;
    tracing::info!(domain = %bus.domain(), cameras = rig.cameras.len(), "capture runs");

    let ended = AtomicBool::new(false);
    let (sourced, kept) = thread::scope(|scope| {
        let desk_thread = scope.spawn(|| {
            let kept = desk.keep(&sink, &ended);
            if kept.is_err() {
                stop.request();
            }
            counters.set_state(ProcessState::Stopping);
            let last = desk.health.publish(MonotonicClock.now().as_ns());
            kept.and(last)
        });
        let sourced = source.run(&sink, stop);
        // Release, with the Acquire in Desk::keep.
        ended.store(true, Ordering::Release);
        (sourced, desk_thread.join())
    });
    sourced.map_err(CaptureError::Source)?;
    match kept {
        Ok(kept) => Ok(kept?),
        Err(panic) => std::panic::resume_unwind(panic),
    }
}

/// What capture does beside the frames.
struct Desk {
    server: ControlServer,
    health: HealthReporter,
    control: Arc<dyn SourceControl>,
}

impl Desk {
    fn keep(&mut self, sink: &FrameSink, ended: &AtomicBool) -> Result<(), BusError> {
        while !ended.load(Ordering::Acquire) {
            let now = MonotonicClock.now().as_ns();
            sink.tick(now)?;
            self.health.tick(now)?;
            self.server.answer(|request| self.control.control(request))?;
            thread::sleep(HOUSEKEEPING);
        }
        Ok(())
    }
}
