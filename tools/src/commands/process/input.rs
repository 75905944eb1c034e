use std::{
    sync::{Arc, mpsc::sync_channel},
    thread,
};

use netcord_capture::recording::{FilmedCamera, FilmedTrigger, Footage, FrameReader, RecordingError, group};
use netcord_common::{
    rig::Rig,
    wire::{FrameHeader, Stamps},
};

use super::stages::{Exposure, Frame};

/// Triggers that are unpacked ahead of the stages.
const AHEAD: usize = 8;

/// The recording as the stages see it: triggers in order, frames by camera in rig order.
pub(super) struct Input {
    footage: Arc<Footage>,
    rig: Rig,
    /// Which of the recording's cameras each camera of the rig is.
    places: Vec<Option<usize>>,
    triggers: Arc<Vec<FilmedTrigger>>,
}

/// Of a rig from a file, what the recording knows better: how fast it was recorded, and the mosaic.
pub(super) fn adopt_recording(rig: &mut Rig, footage: &Footage) {
    if let Some(interval_ns) = footage.interval_ns() {
        rig.rate_hz = 1e9 / interval_ns as f64;
    }
    for camera in &mut rig.cameras {
        let filmed = footage.cameras.iter().find(|f| f.name == camera.name);
        let Some(frame) = filmed.and_then(|f| f.frames.first()) else { continue };
        if frame.format != camera.pixel_format {
            tracing::warn!(
                "camera {}: the rig file says {}, the recording {}; the recording's is used",
                camera.name,
                camera.pixel_format,
                frame.format
            );
            camera.pixel_format = frame.format;
        }
    }
}

impl Input {
    pub(super) fn new(footage: &Arc<Footage>, rig: &Rig) -> Self {
        let place = |name: &netcord_common::CameraName| {
            footage.cameras.iter().position(|filmed| filmed.name == *name)
        };
        let places = rig.cameras.iter().map(|camera| place(&camera.name)).collect::<Vec<_>>();
        let filmed = places.iter().flatten().map(|place| &footage.cameras[*place]).collect::<Vec<_>>();
        let mut triggers = group(&filmed, rig.tolerance_ns);
        // Cameras of the rig that the recording lacks delivered nothing.
        for trigger in &mut triggers {
            let mut known = std::mem::take(&mut trigger.frames).into_iter();
            trigger.frames = places.iter().map(|place| place.and_then(|_| known.next().flatten())).collect();
        }
        Self { footage: Arc::clone(footage), rig: rig.clone(), places, triggers: Arc::new(triggers) }
    }

    pub(super) fn triggers(&self) -> usize {
        self.triggers.len()
    }

    /// Time between triggers, where it is known.
    pub(super) fn interval_ns(&self) -> Option<u64> {
        self.footage.interval_ns()
    }

    /// The first `count` triggers with their pixels, fetched ahead by a thread of their own.
    pub(super) fn exposures(&self, count: usize) -> impl Iterator<Item = Result<Exposure, RecordingError>> {
        let (sender, receiver) = sync_channel(AHEAD);
        let (footage, places) = (Arc::clone(&self.footage), self.places.clone());
        let (triggers, rig) = (Arc::clone(&self.triggers), self.rig.clone());
        thread::spawn(move || {
            let triggers = &triggers[..count.min(triggers.len())];
            let filmed = places.iter().map(|p| p.map(|p| &footage.cameras[p])).collect::<Vec<_>>();
            let frames = triggers.iter().flat_map(|t| frames_of(t, &filmed));
            let mut pixels = FrameReader::new(Arc::clone(&footage), frames.map(|(_, f)| f.pixels.clone()));
            let mut sequences = vec![0; rig.cameras.len()];
            for trigger in triggers {
                let mut exposure =
                    Exposure { trigger: trigger.clone(), frames: vec![None; rig.cameras.len()] };
                for (camera, frame) in frames_of(trigger, &filmed) {
                    let pixels = match pixels.next() {
                        Some(Ok(pixels)) => pixels,
                        // The receiver's end ends with the first error.
                        Some(Err(e)) => return drop(sender.send(Err(e))),
                        None => return,
                    };
                    sequences[camera] += 1;
                    let header = header(&rig, camera, trigger.id, sequences[camera], frame);
                    exposure.frames[camera] = Some(Frame { header, pixels });
                }
                // Nobody listens any more: the stages have failed.
                if sender.send(Ok(exposure)).is_err() {
                    return;
                }
            }
        });
        receiver.into_iter()
    }
}

/// The frames of a trigger with their cameras, in rig order.
fn frames_of<'a>(
    trigger: &'a FilmedTrigger,
    filmed: &'a [Option<&'a FilmedCamera>],
) -> impl Iterator<Item = (usize, &'a netcord_capture::recording::FilmedFrame)> {
    trigger
        .frames
        .iter()
        .zip(filmed)
        .enumerate()
        .filter_map(|(camera, (frame, filmed))| Some((camera, &(*filmed)?.frames[(*frame)?])))
}

/// The header that capture would have given the frame: the recorded one where there is one.
fn header(
    rig: &Rig,
    camera: usize,
    trigger_id: u64,
    sequence: u64,
    frame: &netcord_capture::recording::FilmedFrame,
) -> FrameHeader {
    let camera = &rig.cameras[camera];
    let recorded = frame.header.unwrap_or(FrameHeader {
        stamps: Stamps { mid_exposure_host_ns: frame.stamp_ns, ..Stamps::default() },
        exposure_ns: camera.exposure_ns,
        gain_db: camera.gain_db,
        ..FrameHeader::default()
    });
    FrameHeader {
        trigger_id,
        sequence,
        // Results carry the image's stamp, exactly.
        stamps: Stamps { mid_exposure_ns: frame.stamp_ns, ..recorded.stamps },
        width: frame.width,
        height: frame.height,
        stride: frame.step,
        pixel_format: frame.format.pfnc(),
        camera: camera.index.code(),
        ..recorded
    }
}
