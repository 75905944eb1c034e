use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

use netcord_common::{
    Clock, MonotonicClock, Shutdown,
    bus::BusError,
    rig::{CameraIndex, Rig},
    wire::{ControlCommand, ControlRequest, ControlResponse, ControlStatus, FrameHeader, Stamps},
};

use super::{
    Pace,
    pacing::{Readers, sleep_until},
};
use crate::{
    FrameSink, FrameSource, LossReason, SourceControl, SourceError,
    recording::{
        FilmedFrame, FilmedTrigger, Footage, FramePixels, FrameReader, Place, RecordingError, group,
    },
    source::response,
};

/// How a recording is replayed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReplayOptions {
    /// How fast.
    pub pace: Pace,
    /// Whether it begins again at its end.
    pub repeat: bool,
}

impl Default for ReplayOptions {
    fn default() -> Self {
        Self { pace: Pace::Factor(1.0), repeat: false }
    }
}

/// Replays a recording. A frame goes from the file's memory map into the loaned slot with one copy; one of
/// a compressed chunk is unpacked ahead, by another thread.
///
/// Trigger ids are the recording's, moved to follow those of earlier sessions, so that gaps stay gaps.
/// `mid_exposure_ns` is the recording's own stamp; where the recording is repeated, later rounds go on
/// where the last one ended. `mid_exposure_host_ns` is the instant at which the frame was due here.
#[derive(Debug)]
pub struct ReplaySource {
    footage: Arc<Footage>,
    rig: Rig,
    /// Which of the recording's cameras each camera of the rig is.
    places: Vec<Option<usize>>,
    triggers: Vec<FilmedTrigger>,
    options: ReplayOptions,
    control: Arc<Control>,
}

#[derive(Debug)]
struct Control {
    running: AtomicBool,
    trigger_id: AtomicU64,
}

impl SourceControl for Control {
    fn control(&self, request: &ControlRequest) -> ControlResponse {
        let status = match ControlCommand::from_code(request.command) {
            Some(ControlCommand::Start) => {
                self.running.store(true, Ordering::Relaxed);
                ControlStatus::Done
            }
            Some(ControlCommand::Stop) => {
                self.running.store(false, Ordering::Relaxed);
                ControlStatus::Done
            }
            Some(ControlCommand::Status) => ControlStatus::Done,
            _ => {
                return response(
                    ControlStatus::NotSupported,
                    "a recording is as it was recorded; start, stop and status are possible",
                );
            }
        };
        ControlResponse {
            running: u32::from(self.running.load(Ordering::Relaxed)),
            trigger_id: self.trigger_id.load(Ordering::Relaxed),
            ..response(status, "")
        }
    }
}

/// How one round of the recording is moved into the present.
#[derive(Debug, Clone, Copy)]
struct Round {
    /// To be added to the recording's trigger ids.
    id_offset: u64,
    /// To be added to the recording's stamps.
    stamp_offset_ns: u64,
    /// When the first frame is due here.
    start_ns: u64,
}

impl ReplaySource {
    /// A replay of `footage` as the cameras of `rig`.
    ///
    /// # Errors
    /// [`RecordingError::Content`] when the recording has a camera that the rig does not know, or images
    /// of another size.
    pub fn new(footage: Arc<Footage>, rig: &Rig, options: ReplayOptions) -> Result<Self, RecordingError> {
        footage.check_against(rig)?;
        let place = |name: &netcord_common::CameraName| footage.cameras.iter().position(|f| f.name == *name);
        let places = rig.cameras.iter().map(|camera| place(&camera.name)).collect::<Vec<_>>();
        let filmed = places.iter().flatten().map(|place| &footage.cameras[*place]).collect::<Vec<_>>();
        let triggers = group(&filmed, rig.tolerance_ns);
        let control = Arc::new(Control { running: AtomicBool::new(true), trigger_id: AtomicU64::new(0) });
        Ok(Self { footage, rig: rig.clone(), places, triggers, options, control })
    }

    /// The frames of a trigger with the rig's cameras; `None` where a camera of the recording gave none.
    fn frames<'a>(
        &'a self,
        trigger: &'a FilmedTrigger,
    ) -> impl Iterator<Item = (CameraIndex, Option<&'a FilmedFrame>)> {
        let known =
            self.rig.cameras.iter().zip(&self.places).filter_map(|(c, place)| Some((c.index, (*place)?)));
        known.zip(&trigger.frames).map(|((index, place), frame)| {
            (index, frame.map(|frame| &self.footage.cameras[place].frames[frame]))
        })
    }

    fn first_stamp_ns(&self, trigger: &FilmedTrigger) -> Option<u64> {
        self.frames(trigger).filter_map(|(_, frame)| frame.map(|f| f.stamp_ns)).min()
    }

    fn round(
        &self,
        sink: &FrameSink,
        stop: &Shutdown,
        round: Round,
        readers: &mut Option<Readers>,
    ) -> Result<(), SourceError> {
        let places =
            self.triggers.iter().flat_map(|t| self.frames(t)).filter_map(|(_, f)| Some(f?.pixels.clone()));
        if self.is_packed() {
            // Unpacked ahead, so that it takes no time between frames.
            let places = places.collect::<Vec<_>>();
            let (sender, receiver) = std::sync::mpsc::sync_channel(2 * self.rig.cameras.len());
            let reader = FrameReader::new(Arc::clone(&self.footage), places.into_iter());
            let thread = std::thread::spawn(move || {
                for pixels in reader {
                    if sender.send(pixels).is_err() {
                        return;
                    }
                }
            });
            let result = self.publish(sink, stop, round, readers, &mut receiver.iter());
            drop(receiver);
            let _ = thread.join();
            result
        } else {
            let footage = &self.footage;
            let mut mapped = places.map(|place| Ok(FramePixels::mapped(footage, &place)));
            self.publish(sink, stop, round, readers, &mut mapped)
        }
    }

    fn is_packed(&self) -> bool {
        let frames = || self.footage.cameras.iter().flat_map(|c| &c.frames);
        frames().any(|frame| matches!(frame.pixels, Place::Chunk { .. }))
    }

    fn publish(
        &self,
        sink: &FrameSink,
        stop: &Shutdown,
        round: Round,
        readers: &mut Option<Readers>,
        pixels: &mut dyn Iterator<Item = Result<FramePixels, RecordingError>>,
    ) -> Result<(), SourceError> {
        let Some(begin_ns) = self.triggers.first().and_then(|t| self.first_stamp_ns(t)) else {
            return Ok(());
        };
        let mut late_by_pauses = 0;
        for trigger in &self.triggers {
            let id = trigger.id + round.id_offset;
            late_by_pauses += self.pause(stop);
            // For all cameras first, so that the frames of a trigger come together.
            if let Some(readers) = readers {
                self.frames(trigger).try_for_each(|(camera, _)| readers.make_room(camera.get(), id, stop))?;
            }
            for (camera, frame) in self.frames(trigger) {
                let Some(frame) = frame else {
                    sink.lost(camera, id, LossReason::Dropped)?;
                    continue;
                };
                let Some(pixels) = pixels.next().transpose().map_err(SourceError::failed)? else {
                    return Ok(());
                };
                let due_ns = match self.options.pace {
                    Pace::Factor(factor) => {
                        let after = (frame.stamp_ns - begin_ns) as f64 / factor;
                        round.start_ns + late_by_pauses + after.round() as u64
                    }
                    Pace::Readers => MonotonicClock.now().as_ns(),
                };
                if !sleep_until(due_ns, stop) {
                    return Ok(());
                }
                self.deliver(sink, camera, id, frame, pixels.as_ref(), (round.stamp_offset_ns, due_ns))?;
            }
            self.control.trigger_id.store(id, Ordering::Relaxed);
        }
        Ok(())
    }

    /// Waits while the replay is stopped by request; returns for how long, ns.
    fn pause(&self, stop: &Shutdown) -> u64 {
        if self.control.running.load(Ordering::Relaxed) {
            return 0;
        }
        let began = MonotonicClock.now().as_ns();
        while !self.control.running.load(Ordering::Relaxed) && !stop.is_requested() {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        MonotonicClock.now().as_ns() - began
    }

    fn deliver(
        &self,
        sink: &FrameSink,
        camera: CameraIndex,
        trigger_id: u64,
        frame: &FilmedFrame,
        pixels: &[u8],
        (stamp_offset_ns, due_ns): (u64, u64),
    ) -> Result<(), SourceError> {
        let mut slot = match sink.loan_bytes(camera, pixels.len()) {
            Ok(slot) => slot,
            Err(BusError::NoSlot { .. }) => return Ok(sink.lost(camera, trigger_id, LossReason::NoSlot)?),
            Err(e) => return Err(e.into()),
        };
        slot.bytes_mut()[..pixels.len()].copy_from_slice(pixels);
        let rig_camera = &self.rig.cameras[camera.get()];
        let recorded = frame.header.unwrap_or(FrameHeader {
            exposure_ns: rig_camera.exposure_ns,
            gain_db: rig_camera.gain_db,
            ..FrameHeader::default()
        });
        *slot.header_mut() = FrameHeader {
            trigger_id,
            stamps: Stamps {
                mid_exposure_ns: frame.stamp_ns + stamp_offset_ns,
                mid_exposure_host_ns: due_ns,
                frame_complete_ns: MonotonicClock.now().as_ns(),
                ..Stamps::default()
            },
            exposure_ns: recorded.exposure_ns,
            block_id: recorded.block_id,
            gain_db: recorded.gain_db,
            width: frame.width,
            height: frame.height,
            stride: frame.step,
            pixel_format: frame.format.pfnc(),
            ..FrameHeader::default()
        };
        Ok(sink.deliver(camera, slot)?)
    }
}

impl FrameSource for ReplaySource {
    fn slot_bytes(&self, camera: CameraIndex) -> usize {
        let filmed = self.places[camera.get()].map(|place| &self.footage.cameras[place]);
        let bytes = |frame: &FilmedFrame| frame.pixels.len();
        let model = &self.rig.cameras[camera.get()].model;
        let whole = model.width as usize * model.height as usize;
        filmed.and_then(|f| f.frames.iter().map(bytes).max()).unwrap_or(0).max(whole)
    }

    fn control(&self) -> Arc<dyn SourceControl> {
        let control: Arc<Control> = Arc::clone(&self.control);
        control
    }

    fn run(&mut self, sink: &FrameSink, stop: &Shutdown) -> Result<(), SourceError> {
        let (Some(first), Some(last)) = (self.triggers.first(), self.triggers.last()) else { return Ok(()) };
        let stamps = || self.triggers.iter().filter_map(|t| self.first_stamp_ns(t));
        let (begin_ns, end_ns) = (stamps().min().unwrap_or(0), stamps().max().unwrap_or(0));
        let length_ns = end_ns - begin_ns + self.footage.interval_ns().unwrap_or(self.rig.interval_ns());
        let ids = last.id - first.id + 1;
        let mut readers = match self.options.pace {
            Pace::Readers => Some(Readers::open(sink.bus(), &self.rig)?),
            Pace::Factor(_) => None,
        };
        let mut round = Round {
            id_offset: sink.first_trigger_id().saturating_sub(first.id),
            stamp_offset_ns: 0,
            start_ns: MonotonicClock.now().as_ns(),
        };
        loop {
            self.round(sink, stop, round, &mut readers)?;
            if !self.options.repeat || stop.is_requested() {
                return Ok(());
            }
            round.id_offset += ids;
            round.stamp_offset_ns += length_ns;
            round.start_ns = match self.options.pace {
                Pace::Factor(factor) => round.start_ns + (length_ns as f64 / factor).round() as u64,
                Pace::Readers => MonotonicClock.now().as_ns(),
            };
        }
    }
}
