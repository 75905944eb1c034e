use std::sync::{Arc, Condvar, Mutex};

use netcord_common::{
    Clock, MonotonicClock,
    bus::FrameSlot,
    rig::{CameraIndex, StampMeaning, TriggerRole, Wiring},
};

use super::{Shared, counts, lock};
use crate::{
    FrameSink, LossReason,
    usb::{
        clock::DeviceClock,
        settings::InForce,
        stream::{FrameLoss, ReceivedFrame},
        transfers::StreamHandler,
    },
};

/// A loaned slot as the memory of a frame in flight.
#[derive(Debug)]
pub(super) struct Slot(pub(super) FrameSlot);

impl AsMut<[u8]> for Slot {
    fn as_mut(&mut self) -> &mut [u8] {
        self.0.bytes_mut()
    }
}

/// What a keeper hears of its stream.
#[derive(Debug, Default)]
pub(super) struct News {
    pub(super) state: Mutex<StreamState>,
    pub(super) changed: Condvar,
}

#[derive(Debug, Default, Clone, Copy)]
pub(super) struct StreamState {
    /// The stream stopped by itself.
    pub(super) stopped: bool,
    /// The device has gone.
    pub(super) gone: bool,
    /// CLOCK_MONOTONIC of the last frame, whole or not.
    pub(super) last_frame_ns: u64,
    /// Since when a frame lacks nothing but its trailer.
    pub(super) trailer_since_ns: Option<u64>,
}

/// Gives a camera's frames to the sink, with their instants and triggers. Runs on the event thread.
pub(super) struct Deliver<'a> {
    pub(super) sink: &'a FrameSink,
    pub(super) shared: &'a Shared,
    pub(super) camera: CameraIndex,
    pub(super) role: TriggerRole,
    pub(super) line_delay_ns: u64,
    pub(super) wiring: Wiring,
    pub(super) in_force: Arc<Mutex<InForce>>,
    pub(super) clock: Arc<Mutex<DeviceClock>>,
    pub(super) tick_ns: u64,
    pub(super) news: Arc<News>,
    /// Triggers up to this one have been delivered or reported lost.
    pub(super) settled: Option<u64>,
}

impl Deliver<'_> {
    fn report(&mut self, trigger_id: u64, reason: LossReason) {
        if let Err(e) = self.sink.lost(self.camera, trigger_id, reason) {
            tracing::warn!("{e}");
        }
    }

    fn heard(&self) {
        let mut state = lock(&self.news.state);
        state.last_frame_ns = MonotonicClock.now().as_ns();
        state.trailer_since_ns = None;
    }
}

impl StreamHandler for Deliver<'_> {
    type Buffer = Slot;

    fn frame(&mut self, frame: &ReceivedFrame, slot: &mut Slot) {
        let complete_ns = MonotonicClock.now().as_ns();
        self.heard();
        let in_force = *lock(&self.in_force);
        let stamp = frame.leader.timestamp.wrapping_mul(self.tick_ns);
        let half = in_force.exposure_ns / 2;
        // The device's instants: where its exposure began, and its middle.
        let start = match self.wiring.stamp {
            StampMeaning::ExposureStart => stamp.wrapping_add(self.line_delay_ns),
            StampMeaning::ExposureEnd => stamp.wrapping_sub(in_force.exposure_ns),
        };
        let mid = lock(&self.clock).host(start.wrapping_add(half));
        let Some(mid) = mid else {
            self.shared.cameras[self.camera.get()].counts.unmatched.up();
            return;
        };
        let block = frame.leader.block;
        let matched = {
            let mut matcher = lock(&self.shared.matcher);
            match self.role {
                TriggerRole::FreeRun => Some(matcher.free_running(self.camera.get(), mid.ns, block)),
                TriggerRole::Software | TriggerRole::Hardware => {
                    let impulse = mid.ns.saturating_sub(half + self.line_delay_ns + self.wiring.delay_ns);
                    matcher.triggered(self.camera.get(), impulse, block)
                }
            }
        };
        let counts = &self.shared.cameras[self.camera.get()].counts;
        let Some(matched) = matched else {
            counts.unmatched.up();
            return;
        };
        if mid.sigma_ns > self.shared.tolerance_ns as f64 {
            counts.uncertain.up();
        }
        if matched.slipped {
            counts.slips.up();
        }
        let trigger_id = matched.trigger_id;
        // What lies between was triggered, and no frame came of it.
        if let Some(settled) = self.settled.filter(|s| self.role != TriggerRole::FreeRun && *s < trigger_id) {
            for missing in (settled + 1..trigger_id).take(64) {
                self.report(missing, LossReason::Timeout);
            }
        }
        self.settled = Some(self.settled.map_or(trigger_id, |s| s.max(trigger_id)));

        let next = match self.sink.loan(self.camera) {
            Ok(next) => next,
            Err(_) => {
                // The readers hold every slot: this one must serve the next frame.
                self.report(trigger_id, LossReason::NoSlot);
                return;
            }
        };
        let mut full = std::mem::replace(&mut slot.0, next);
        let header = full.header_mut();
        header.trigger_id = trigger_id;
        header.stamps = netcord_common::wire::Stamps {
            mid_exposure_ns: mid.ns,
            mid_exposure_host_ns: mid.ns,
            frame_complete_ns: complete_ns,
            ..Default::default()
        };
        header.exposure_ns = in_force.exposure_ns;
        header.gain_db = in_force.gain_db;
        header.block_id = block;
        header.width = frame.leader.width;
        header.height = frame.leader.height;
        header.stride = u32::try_from(frame.stride).unwrap_or(u32::MAX);
        header.pixel_format = in_force.true_format.pfnc();
        if let Err(e) = self.sink.deliver(self.camera, full) {
            tracing::warn!("{e}");
        }
    }

    fn lost(&mut self, loss: FrameLoss, count: u64) {
        self.heard();
        self.shared.cameras[self.camera.get()].counts.lost(loss, count);
        // Which trigger it was is not known of a frame that did not come: the next one that is not
        // settled; its neighbours will show if it was another.
        for _ in 0..count.min(64) {
            let Some(settled) = self.settled else { return };
            self.report(settled + 1, counts::reason(loss));
            self.settled = Some(settled + 1);
        }
    }

    fn awaits_trailer(&mut self) {
        lock(&self.news.state).trailer_since_ns = Some(MonotonicClock.now().as_ns());
    }

    fn stopped(&mut self, gone: bool) {
        let mut state = lock(&self.news.state);
        state.stopped = true;
        state.gone = gone;
        self.news.changed.notify_all();
    }
}
