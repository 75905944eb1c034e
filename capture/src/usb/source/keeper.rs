use std::{
    cell::Cell,
    sync::{Arc, Mutex, atomic::Ordering},
    time::Duration,
};

use netcord_common::{
    Clock, MonotonicClock, Shutdown,
    rig::{RigCamera, TriggerRole},
};
use rusb::Context;

use super::{
    Shared, UsbOptions,
    deliver::{Deliver, News, Slot, StreamState},
    lock,
};
use crate::{
    FrameSink, LossReason,
    usb::{
        CameraError, FeatureAccess,
        clock::DeviceClock,
        device::Camera,
        settings::{InForce, apply, is_host_triggered, set_rate},
        stream::{Expected, FrameLoss, FramePlan, Ring},
        transfers::Stream,
    },
};

/// A camera that is open and set up.
#[derive(Debug)]
pub(in crate::usb) struct OpenCamera {
    pub(super) camera: Camera,
    pub(super) in_force: Arc<Mutex<InForce>>,
}

/// Opens a camera, keeps its stream going, and opens it again when it was gone.
pub(super) struct Keeper<'a> {
    pub(super) context: &'a Context,
    pub(super) camera: &'a RigCamera,
    pub(super) options: &'a UsbOptions,
    pub(super) shared: &'a Shared,
    pub(super) sink: &'a FrameSink,
    pub(super) stop: &'a Shutdown,
    pub(super) slot_bytes: usize,
    /// Triggers up to this one have been delivered or reported lost.
    pub(super) settled: Cell<Option<u64>>,
}

/// How a streaming session ended.
enum Ended {
    /// It was asked to.
    Asked,
    /// The device has gone.
    Gone,
    /// The stream must be set up anew.
    Restart,
}

/// How often a camera that is not there is looked for: with enumeration, well within the two seconds
/// after which frames must flow again.
const RETRY: Duration = Duration::from_millis(200);
/// How often the device's clock is read once it is known.
const CLOCK_EVERY: Duration = Duration::from_millis(500);
/// A camera that exposes by itself, or is triggered, is silent this long only when something is wrong.
const SILENCE_INTERVALS: u64 = 20;
const SILENCE_LEAST_NS: u64 = 500_000_000;
/// A device sends its trailer right behind the payload; one that takes longer than this, and than a quarter
/// of an interval, is lost. Much shorter, and an event thread that waits for a processor would look like it.
const TRAILER_NS: u64 = 5_000_000;

type Live<'a> = Stream<Deliver<'a>>;

impl<'a> Keeper<'a> {
    pub(super) fn keep(&self) {
        let state = &self.shared.cameras[self.camera.index.get()];
        let mut complained = String::new();
        while !self.stop.is_requested() {
            if !self.shared.running.load(Ordering::Relaxed) {
                // What nobody wants is not lost.
                self.settled.set(None);
                std::thread::sleep(Duration::from_millis(20));
                continue;
            }
            match self.session() {
                Ok(Ended::Asked | Ended::Restart) => complained.clear(),
                Ok(Ended::Gone) => {
                    tracing::warn!(camera = %self.camera.name, "the camera has gone: waiting for it");
                    complained.clear();
                }
                Err(e) => {
                    // The same every 200 ms would bury all else.
                    let text = e.to_string();
                    if text != complained {
                        tracing::warn!(camera = %self.camera.name, "{text}");
                        complained = text;
                    }
                    *lock(&state.device) = None;
                    std::thread::sleep(RETRY);
                }
            }
            if lock(&state.device).is_none() {
                self.report_missed();
            }
        }
        if let Some(open) = lock(&state.device).as_mut() {
            // Best effort on the way out; the next to open it does the same first.
            let _ = open.camera.quiet();
        }
        *lock(&state.device) = None;
    }

    /// Reports the triggers that have passed while the camera was not there.
    fn report_missed(&self) {
        let Some(settled) = self.settled.get() else { return };
        let passed = lock(&self.shared.matcher).passed(self.camera.trigger, MonotonicClock.now().as_ns());
        for id in settled + 1..=passed {
            if let Err(e) = self.sink.lost(self.camera.index, id, LossReason::Disconnected) {
                tracing::warn!(camera = %self.camera.name, "{e}");
            }
        }
        self.settled.set(Some(settled.max(passed)));
    }

    /// From opening the camera, or from setting its stream up anew, to the end of the stream.
    fn session(&self) -> Result<Ended, CameraError> {
        let state = &self.shared.cameras[self.camera.index.get()];
        state.restart.store(false, Ordering::Relaxed);
        let mut device = lock(&state.device);
        if device.is_none() {
            let mut camera = Camera::open(self.context, &self.camera.serial)?;
            camera.quiet()?;
            let in_force = apply(&mut camera, self.camera)?;
            if self.camera.trigger == TriggerRole::FreeRun {
                let hz = 1e9 / lock(&self.shared.matcher).grid().interval_ns as f64;
                // A camera may have a fixed rate, which follows from its exposure.
                if let Err(e) = set_rate(&mut camera, hz) {
                    tracing::warn!(camera = %self.camera.name, "its rate cannot be set: {e}");
                }
            }
            tracing::info!(
                camera = %self.camera.name, model = %camera.abrm().model, serial = %camera.abrm().serial,
                exposure_us = in_force.exposure_ns as f64 / 1e3, gain_db = in_force.gain_db, "camera opened"
            );
            state.counts.opened.up();
            self.report_missed();
            *device = Some(OpenCamera { camera, in_force: Arc::new(Mutex::new(in_force)) });
        }
        let Some(open) = device.as_mut() else { return Ok(Ended::Restart) };
        open.camera.quiet()?;
        let plan = open.camera.plan()?;
        if plan.slot > self.slot_bytes {
            return Err(CameraError::Setup(format!(
                "the camera's transfers need {} bytes for a frame, but the rig's slots have {}",
                plan.slot, self.slot_bytes
            )));
        }
        let clock = Arc::new(Mutex::new(DeviceClock::default()));
        for _ in 0..8 {
            let reading = open.camera.read_clock()?;
            lock(&clock).add(reading);
        }
        let news = Arc::new(News::default());
        let stream = self.stream(open, &plan, &clock, &news)?;
        drop(device);
        lock(&self.shared.matcher).forget(self.camera.index.get());
        let ended = self.stream_until_it_ends(&stream, &plan, &clock, &news);
        self.settled.set(stream.with(|_, handler| handler.settled));
        if !stream.drain() {
            tracing::error!(camera = %self.camera.name, "transfers do not come back");
        }
        drop(stream);
        if matches!(ended, Ok(Ended::Gone)) || matches!(&ended, Err(e) if e.is_gone()) {
            *lock(&state.device) = None;
            return Ok(Ended::Gone);
        }
        if let Some(open) = lock(&state.device).as_mut() {
            open.camera.quiet()?;
        }
        ended
    }

    fn stream(
        &self,
        open: &OpenCamera,
        plan: &FramePlan,
        clock: &Arc<Mutex<DeviceClock>>,
        news: &Arc<News>,
    ) -> Result<Live<'a>, CameraError> {
        let failed = |e: &dyn std::fmt::Display| CameraError::Setup(e.to_string());
        let in_force = *lock(&open.in_force);
        let expected =
            Expected { width: in_force.width, height: in_force.height, pixel_format: in_force.device_format };
        let slots = (0..self.options.depth)
            .map(|_| self.sink.loan(self.camera.index).map(Slot))
            .collect::<Result<Vec<_>, _>>()
            .map_err(|e| failed(&e))?;
        let ring = Ring::new(plan.clone(), expected, slots)
            .ok_or_else(|| failed(&"the slots are smaller than the camera's frames"))?;
        let deliver = Deliver {
            sink: self.sink,
            shared: self.shared,
            camera: self.camera.index,
            role: self.camera.trigger,
            line_delay_ns: self.camera.line_delay_ns,
            wiring: self.camera.wiring,
            in_force: open.in_force.clone(),
            clock: clock.clone(),
            tick_ns: open.camera.abrm().tick_ns.max(1),
            news: news.clone(),
            settled: self.settled.get(),
        };
        let (handle, endpoint) = open.camera.raw();
        Stream::new(handle, endpoint, ring, deliver).map_err(|e| failed(&e))
    }

    fn with_camera<T>(
        &self,
        work: impl FnOnce(&mut Camera) -> Result<T, CameraError>,
    ) -> Result<T, CameraError> {
        let mut device = lock(&self.shared.cameras[self.camera.index.get()].device);
        match device.as_mut() {
            Some(open) => work(&mut open.camera),
            None => Err(CameraError::Usb { doing: "looking for it", cause: rusb::Error::NoDevice }),
        }
    }

    /// Brings the stream into step: nothing queued, device idle, transfers queued, acquisition on.
    fn start(&self, stream: &Live<'a>, plan: &FramePlan, news: &News) -> Result<(), CameraError> {
        stream.drain();
        *lock(&news.state) =
            StreamState { last_frame_ns: MonotonicClock.now().as_ns(), ..StreamState::default() };
        self.with_camera(|camera| {
            camera.quiet()?;
            camera.arm(plan)
        })?;
        stream.submit().map_err(|e| CameraError::Setup(e.to_string()))?;
        self.with_camera(Camera::start)
    }

    fn stream_until_it_ends(
        &self,
        stream: &Live<'a>,
        plan: &FramePlan,
        clock: &Mutex<DeviceClock>,
        news: &News,
    ) -> Result<Ended, CameraError> {
        let state = &self.shared.cameras[self.camera.index.get()];
        let count_name = &self.camera.name;
        self.start(stream, plan, news)?;
        let mut clock_due = MonotonicClock.now().as_ns();
        let mut silent = 0;
        let waits_for_nobody = self.camera.trigger != TriggerRole::Hardware || self.camera.master;
        // A trigger that was sent is not sent again.
        let mut sent = 0;
        loop {
            if self.stop.is_requested() || !self.shared.running.load(Ordering::Relaxed) {
                return Ok(Ended::Asked);
            }
            if state.restart.load(Ordering::Relaxed) {
                return Ok(Ended::Restart);
            }
            let now = MonotonicClock.now().as_ns();
            let (grid, interval) = {
                let grid = lock(&self.shared.matcher).grid();
                (grid, grid.interval_ns)
            };
            let (mut id, mut at) = grid.next(now);
            if id <= sent {
                id = sent + 1;
                at = grid.origin_ns + (id - grid.first.min(id)) * interval;
            }
            let triggers = is_host_triggered(self.camera);
            let housekeeping = now + (interval / 4).clamp(2_000_000, 20_000_000);
            let until = if triggers { at.min(housekeeping) } else { housekeeping };
            let heard = self.wait(news, until);
            if heard.gone {
                return Ok(Ended::Gone);
            }
            let now = MonotonicClock.now().as_ns();
            let patience = TRAILER_NS.max(interval / 4);
            let overdue = heard.trailer_since_ns.filter(|since| now.saturating_sub(*since) > patience);
            let ended = overdue.is_some_and(|since| {
                stream.end_without_trailer(|_| lock(&news.state).trailer_since_ns == Some(since))
            });
            if heard.stopped || ended {
                state.counts.restarts.up();
                tracing::warn!(camera = %count_name, "the stream is out of step: it is restarted");
                stream.drain();
                stream.with(|ring, _| ring.assembler().restarted(1));
                self.start(stream, plan, news)?;
                continue;
            }
            if triggers && now >= at {
                sent = id;
                match self.with_camera(|camera| Ok(camera.execute("TriggerSoftware")?)) {
                    Ok(()) => {}
                    Err(e) if e.is_gone() => return Ok(Ended::Gone),
                    Err(e) => tracing::warn!(camera = %count_name, "trigger {id}: {e}"),
                }
            }
            if now >= clock_due && !(triggers && at > now && at - now < interval / 4) {
                match self.with_camera(|camera| Ok(camera.read_clock()?)) {
                    Ok(reading) => {
                        let mut clock = lock(clock);
                        clock.add(reading);
                        tracing::debug!(
                            camera = %count_name, drift_ppm = clock.drift().map(|d| d * 1e6),
                            sigma_us = clock.host(reading.device_ns).map(|at| at.sigma_ns / 1e3), "device clock"
                        );
                    }
                    Err(e) if e.is_gone() => return Ok(Ended::Gone),
                    Err(e) => tracing::warn!(camera = %count_name, "its clock cannot be read: {e}"),
                }
                clock_due = now + CLOCK_EVERY.as_nanos() as u64;
            }
            // A slave is silent when nobody triggers it.
            let limit = (SILENCE_INTERVALS * interval).max(SILENCE_LEAST_NS) << silent.min(6);
            if waits_for_nobody && now.saturating_sub(heard.last_frame_ns) > limit {
                silent += 1;
                state.counts.restarts.up();
                tracing::warn!(camera = %count_name, "no frame for {} ms: the stream is restarted", limit / 1_000_000);
                stream.with(|ring, handler| {
                    ring.assembler().restarted(0);
                    crate::usb::transfers::StreamHandler::lost(handler, FrameLoss::Restarted, 0);
                });
                self.start(stream, plan, news)?;
            }
        }
    }

    /// Waits for news of the stream, until an instant at the latest.
    fn wait(&self, news: &News, until_ns: u64) -> StreamState {
        let mut state = lock(&news.state);
        loop {
            let left = until_ns.saturating_sub(MonotonicClock.now().as_ns());
            if state.stopped || left == 0 {
                return *state;
            }
            state = news
                .changed
                .wait_timeout(state, Duration::from_nanos(left))
                .map_or_else(|e| e.into_inner().0, |(s, _)| s);
        }
    }
}
