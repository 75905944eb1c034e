use std::{
    cell::Cell,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use netcord_common::{
    Clock, Counters, MonotonicClock, Shutdown,
    rig::{CameraIndex, Rig},
};
use rusb::{Context, UsbContext as _};

use super::{
    discovery::usb_context,
    matching::{Grid, TriggerMatcher},
};
use crate::{FrameSink, FrameSource, SourceControl, SourceError};

mod control;
mod counts;
mod deliver;
mod keeper;

use counts::CameraCounts;

/// How the cameras are driven, beside what the rig file says.
#[derive(Debug, Clone)]
pub struct UsbOptions {
    /// Frames in flight of each camera: 2 to 7.
    pub depth: usize,
    /// Processors of the event thread; empty for all.
    pub event_cpus: Vec<usize>,
    /// SCHED_FIFO priority of the event thread.
    pub event_priority: Option<i32>,
}

impl Default for UsbOptions {
    fn default() -> Self {
        Self { depth: 4, event_cpus: Vec::new(), event_priority: None }
    }
}

/// Room at a slot's end for transfers that are rounded up to a device's alignment.
const SLACK: usize = 64 << 10;

/// The USB3 Vision cameras of a rig as a frame source.
///
/// One thread handles the events of all cameras: it judges transfers, publishes frames and queues the
/// next ones. Each camera has a keeper beside it, which opens it, triggers it, reads its clock, brings
/// its stream back in step, and opens it anew when it was unplugged; none of them waits for another.
#[derive(Debug)]
pub struct UsbSource {
    rig: Rig,
    options: UsbOptions,
    context: Context,
    shared: Arc<Shared>,
}

/// What the threads of a source share.
#[derive(Debug)]
pub(super) struct Shared {
    /// One for each camera, in the rig's order.
    cameras: Vec<CameraState>,
    matcher: Mutex<TriggerMatcher>,
    /// How far apart exposures of one trigger may lie, ns: instants must be better known than that.
    tolerance_ns: u64,
    /// Whether frames are wanted.
    running: AtomicBool,
}

/// A camera as requests and its keeper see it.
#[derive(Debug)]
pub(super) struct CameraState {
    device: Mutex<Option<keeper::OpenCamera>>,
    counts: CameraCounts,
    /// A new region of interest that the keeper must bring into force.
    restart: AtomicBool,
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl UsbSource {
    /// A source for the cameras of `rig`; they need not be plugged in yet.
    ///
    /// # Errors
    /// [`SourceError`] when libusb does not start, or the rig names a camera without serial number.
    pub fn new(rig: &Rig, options: UsbOptions, counters: &Arc<Counters>) -> Result<Self, SourceError> {
        let context = usb_context().map_err(SourceError::failed)?;
        if let Some(camera) = rig.cameras.iter().find(|c| c.serial.is_empty() && rig.cameras.len() > 1) {
            return Err(SourceError::Failed {
                what: format!("camera {} has no serial number in the rig file: give it one", camera.name),
                source: None,
            });
        }
        let grid = Grid { origin_ns: 0, first: 0, interval_ns: rig.interval_ns() };
        let cameras = rig
            .cameras
            .iter()
            .map(|_| CameraState {
                device: Mutex::new(None),
                counts: CameraCounts::new(counters),
                restart: AtomicBool::new(false),
            })
            .collect();
        let matcher = Mutex::new(TriggerMatcher::new(grid, rig.cameras.len()));
        let shared = Arc::new(Shared {
            cameras,
            matcher,
            tolerance_ns: rig.tolerance_ns,
            running: AtomicBool::new(true),
        });
        let options = UsbOptions { depth: options.depth.clamp(1, 7), ..options };
        Ok(Self { rig: rig.clone(), options, context, shared })
    }
}

impl FrameSource for UsbSource {
    fn slot_bytes(&self, camera: CameraIndex) -> usize {
        let model = &self.rig.cameras[camera.get()].model;
        model.width as usize * model.height as usize + SLACK
    }

    fn control(&self) -> Arc<dyn SourceControl> {
        Arc::new(control::UsbControl { rig: self.rig.clone(), shared: self.shared.clone() })
    }

    fn run(&mut self, sink: &FrameSink, stop: &Shutdown) -> Result<(), SourceError> {
        // The first trigger lies a little ahead, so that all cameras are ready for it.
        let origin_ns = MonotonicClock.now().as_ns();
        let grid = Grid { origin_ns, first: sink.first_trigger_id(), interval_ns: self.rig.interval_ns() };
        *lock(&self.shared.matcher) = TriggerMatcher::new(grid, self.rig.cameras.len());
        let ended = AtomicBool::new(false);
        thread::scope(|scope| {
            let events = scope.spawn(|| self.handle_events(&ended));
            let keepers: Vec<_> = self
                .rig
                .cameras
                .iter()
                .map(|camera| {
                    let keeper = keeper::Keeper {
                        context: &self.context,
                        camera,
                        options: &self.options,
                        shared: &self.shared,
                        sink,
                        stop,
                        slot_bytes: self.slot_bytes(camera.index),
                        settled: Cell::new(None),
                    };
                    scope.spawn(move || keeper.keep())
                })
                .collect();
            let kept = keepers.into_iter().map(thread::ScopedJoinHandle::join).collect::<Vec<_>>();
            // Release, with the Acquire in handle_events.
            ended.store(true, Ordering::Release);
            for result in kept.into_iter().chain([events.join()]) {
                if let Err(panic) = result {
                    std::panic::resume_unwind(panic);
                }
            }
        });
        Ok(())
    }
}

impl UsbSource {
    fn handle_events(&self, ended: &AtomicBool) {
        if !self.options.event_cpus.is_empty()
            && let Err(e) = netcord_common::realtime::bind_to_cpus(&self.options.event_cpus)
        {
            tracing::warn!("{e}");
        }
        if let Some(priority) = self.options.event_priority
            && let Err(e) = netcord_common::realtime::set_fifo_priority(priority)
        {
            tracing::warn!("{e}");
        }
        while !ended.load(Ordering::Acquire) {
            if let Err(e) = self.context.handle_events(Some(Duration::from_millis(100)))
                && e != rusb::Error::Interrupted
            {
                tracing::warn!("libusb cannot handle events: {e}");
                thread::sleep(Duration::from_millis(10));
            }
        }
    }
}
