use std::{
    collections::BTreeMap,
    sync::mpsc::{Receiver, SyncSender, sync_channel},
    thread::JoinHandle,
};

use netcord_capture::recording::{
    FramePixels, RecordedTruth, RecordingError, RecordingWriter, WriterOptions,
};
use netcord_common::{
    PixelFormat,
    rig::Rig,
    wire::{Scope, WIRE_VERSION},
};
use thiserror::Error;

use super::{
    stages::{Exposure, Results},
    tables::{Table, TableError},
};
use crate::{
    output::{self, Output},
    recording::{RigTopics, Wanted},
};

/// Where results go.
#[derive(Debug, Default)]
pub(super) struct Paths {
    pub(super) recording: Option<Output>,
    pub(super) positions: Option<Output>,
    pub(super) detections: Option<Output>,
    pub(super) predictions: Option<Output>,
    /// Whether the recording gets the images too.
    pub(super) images: bool,
}

/// Results that cannot be written.
#[derive(Debug, Error)]
pub(super) enum OutputError {
    #[error(transparent)]
    Recording(#[from] RecordingError),
    #[error(transparent)]
    Table(#[from] TableError),
    #[error(transparent)]
    Output(#[from] output::OutputError),
    #[error("the thread that writes results has ended before its time")]
    Gone,
}

/// Triggers whose results may wait for the disk; more make the stages wait, and memory stay bounded.
const WAITING: usize = 16;

/// Writes results on a thread of its own, in the order in which they come. Dropped before [`Self::finish`], no file
/// is left of them.
pub(super) struct Outputs {
    queue: Option<SyncSender<(Exposure, Results)>>,
    thread: Option<JoinHandle<Result<Files, OutputError>>>,
}

impl Outputs {
    /// Begins all files. `truth` goes into the recording, beside the results of its time.
    pub(super) fn create(
        paths: Paths,
        rig: &Rig,
        metadata: &BTreeMap<String, String>,
        truth: Vec<RecordedTruth>,
    ) -> Result<Self, OutputError> {
        let mut files = Files::create(paths, rig, metadata, truth)?;
        let (queue, results) = sync_channel(WAITING);
        let thread = std::thread::Builder::new()
            .name("results".into())
            .spawn(move || files.write_all(&results).map(|()| files))
            .map_err(|_| OutputError::Gone)?;
        Ok(Self { queue: Some(queue), thread: Some(thread) })
    }

    /// Hands on the results of one trigger; waits when the disk is behind.
    pub(super) fn write(&mut self, exposure: Exposure, results: Results) -> Result<(), OutputError> {
        let sent = self.queue.as_ref().is_some_and(|queue| queue.send((exposure, results)).is_ok());
        // The thread has ended: why, it says itself.
        if sent { Ok(()) } else { self.finish().and(Err(OutputError::Gone)) }
    }

    /// Writes what waits, and ends all files.
    pub(super) fn finish(&mut self) -> Result<(), OutputError> {
        match self.end() {
            Some(files) => files?.finish(),
            None => Ok(()),
        }
    }

    /// Has what waits written, and takes the files back.
    fn end(&mut self) -> Option<Result<Files, OutputError>> {
        drop(self.queue.take());
        self.thread.take().map(|thread| thread.join().unwrap_or(Err(OutputError::Gone)))
    }
}

impl Drop for Outputs {
    /// The thread must not outlive this: files that are not finished are removed where it ends.
    fn drop(&mut self) {
        drop(self.end());
    }
}

struct Files {
    rig: Rig,
    recording: Option<(RecordingWriter<FramePixels>, RigTopics, Output)>,
    truth: std::iter::Peekable<std::vec::IntoIter<RecordedTruth>>,
    positions: Option<Table>,
    detections: Option<Table>,
    predictions: Option<Table>,
}

impl Files {
    fn create(
        paths: Paths,
        rig: &Rig,
        metadata: &BTreeMap<String, String>,
        truth: Vec<RecordedTruth>,
    ) -> Result<Self, OutputError> {
        let table =
            |output: Option<Output>, columns| output.map(|output| Table::begin(output, columns)).transpose();
        let recording = match paths.recording {
            Some(output) => {
                let mut writer =
                    RecordingWriter::onto(output.file()?, output.path(), WriterOptions::default())?;
                writer.metadata("netcord", metadata)?;
                let wanted = Wanted { images: paths.images, truth: !truth.is_empty() };
                let topics = RigTopics::new(&mut writer, rig, wanted);
                Some((writer, topics, output))
            }
            None => None,
        };
        Ok(Self {
            rig: rig.clone(),
            recording,
            truth: truth.into_iter().peekable(),
            positions: table(paths.positions, Table::POSITIONS)?,
            detections: table(paths.detections, Table::DETECTIONS)?,
            predictions: table(paths.predictions, Table::PREDICTIONS)?,
        })
    }

    fn write_all(&mut self, results: &Receiver<(Exposure, Results)>) -> Result<(), OutputError> {
        results.iter().try_for_each(|(exposure, results)| self.write(exposure, &results))
    }

    fn write(&mut self, exposure: Exposure, results: &Results) -> Result<(), OutputError> {
        if let Some(table) = &mut self.detections {
            let full = results.detections.iter().flatten().filter(|d| d.scope == Scope::Full.code());
            for detections in full {
                table.detections(&self.rig, detections)?;
            }
        }
        if let (Some(table), Some(position)) = (&mut self.positions, &results.position) {
            table.position(position)?;
        }
        // Predictions are made from positions: a trigger without one only ages the last.
        let made = results.position.as_ref().is_some_and(|p| p.is_present());
        if let (Some(table), Some(trajectory), true) = (&mut self.predictions, &results.trajectory, made) {
            table.predictions(trajectory)?;
        }
        self.record(exposure, results)?;
        Ok(())
    }

    fn record(&mut self, exposure: Exposure, results: &Results) -> Result<(), RecordingError> {
        let Some((writer, topics, _)) = &mut self.recording else { return Ok(()) };
        let stamps = exposure.frames.iter().flatten().map(|f| f.header.stamps.mid_exposure_ns);
        let Some(t_ns) = stamps.min() else { return Ok(()) };
        topics.stand(writer, t_ns)?;
        for frame in exposure.frames.into_iter().flatten() {
            let format = PixelFormat::from_pfnc(frame.header.pixel_format).unwrap_or(PixelFormat::Mono8);
            topics.frame(writer, &frame.header, format, frame.pixels)?;
        }
        while let Some(truth) = self.truth.next_if(|truth| truth.t_ns <= t_ns) {
            topics.truth(writer, &truth)?;
        }
        for ((camera, detections), window) in
            self.rig.cameras.iter().zip(&results.detections).zip(&results.windows)
        {
            for message in detections {
                topics.detections(writer, camera.index, message, window.as_ref())?;
            }
        }
        if let Some(position) = &results.position {
            topics.position(writer, position)?;
        }
        match &results.trajectory {
            Some(trajectory) => topics.trajectory(writer, trajectory),
            None => Ok(()),
        }
    }

    fn finish(self) -> Result<(), OutputError> {
        if let Some((writer, _, output)) = self.recording {
            writer.finish()?;
            output.complete()?;
        }
        for table in [self.positions, self.detections, self.predictions].into_iter().flatten() {
            table.finish()?;
        }
        Ok(())
    }
}

/// What a recording of ours says of itself, beside its messages.
pub(super) fn metadata(
    rig: &Rig,
    source: &BTreeMap<String, String>,
    made_by: &str,
) -> BTreeMap<String, String> {
    let inherited = |key: &str| source.get(key).cloned();
    let mut entries = BTreeMap::from([
        ("rig".to_owned(), rig.name.to_string()),
        ("world_frame".to_owned(), rig.world.to_string()),
        ("netcord_version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ("wire_version".to_owned(), WIRE_VERSION.to_string()),
        ("made_by".to_owned(), made_by.to_owned()),
    ]);
    // What turns stamps into Unix time is known only where the input knew it.
    if let Some(offset) = inherited("unix_minus_monotonic_ns") {
        entries.insert("unix_minus_monotonic_ns".to_owned(), offset);
    }
    entries
}
