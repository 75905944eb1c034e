use std::{collections::BTreeSet, error::Error, path::Path, sync::Arc};

use netcord_calib::{detect::Luma, gather::Rejection};
use netcord_capture::recording::{FilmedTrigger, Footage, FrameReader, group};
use netcord_common::FrameView;

use super::{Next, Picture, RawShot, Source};

/// Looks a second of recorded time: a board that is held up stays for longer than that.
const LOOKS_HZ: f64 = 10.0;

/// The triggers of a recording, ten a second.
#[derive(Debug)]
pub struct RecordingSource {
    footage: Arc<Footage>,
    /// Which of the recording's cameras each camera of the session is.
    places: Vec<Option<usize>>,
    triggers: Vec<FilmedTrigger>,
    next: usize,
    looked: BTreeSet<String>,
}

impl RecordingSource {
    /// Of the recording's cameras that are called as in `cameras`.
    ///
    /// # Errors
    /// When the file does not read or has none of the cameras.
    pub fn open(path: &Path, cameras: &[String]) -> Result<Self, Box<dyn Error>> {
        let footage = Arc::new(Footage::open(path)?);
        let places: Vec<Option<usize>> =
            cameras.iter().map(|c| footage.cameras.iter().position(|f| f.name.as_str() == c)).collect();
        if places.iter().all(Option::is_none) {
            let found: Vec<&str> = footage.cameras.iter().map(|c| c.name.as_str()).collect();
            return Err(format!(
                "{} has none of the rig's cameras ({}); it has {}",
                path.display(),
                cameras.join(", "),
                found.join(", ")
            )
            .into());
        }
        let filmed: Vec<_> = places.iter().flatten().map(|p| &footage.cameras[*p]).collect();
        let interval_ns = footage.interval_ns().unwrap_or(1_000_000_000);
        let step = ((1e9 / LOOKS_HZ / interval_ns as f64).round() as usize).max(1);
        let triggers = group(&filmed, interval_ns / 2).into_iter().step_by(step).collect();
        Ok(Self { footage, places, triggers, next: 0, looked: BTreeSet::new() })
    }

    fn shot(&self, name: String, trigger: &FilmedTrigger) -> Result<RawShot, Box<dyn Error>> {
        let mut frames = trigger.frames.iter();
        let mut pictures = Vec::new();
        for place in &self.places {
            let frame = place.and_then(|place| {
                let frame = frames.next().copied().flatten()?;
                self.footage.cameras[place].frames.get(frame)
            });
            let Some(frame) = frame else {
                pictures.push(None);
                continue;
            };
            let wanted = std::iter::once(frame.pixels.clone());
            let Some(pixels) = FrameReader::new(Arc::clone(&self.footage), wanted).next() else {
                pictures.push(None);
                continue;
            };
            let pixels = pixels?;
            let view = FrameView::new(pixels.as_ref(), frame.size(), frame.step as usize, frame.format);
            pictures.push(Some(match view {
                Ok(view) => {
                    Ok(Picture { luma: Arc::new(Luma::of_frame(&view)), stamp_ns: Some(frame.stamp_ns) })
                }
                Err(e) => Err(Rejection::Unreadable(e.to_string())),
            }));
        }
        Ok(RawShot { name, pictures })
    }
}

impl Source for RecordingSource {
    fn kind(&self) -> &'static str {
        "recording"
    }

    fn next(&mut self) -> Result<Next, Box<dyn Error>> {
        while let Some(trigger) = self.triggers.get(self.next) {
            self.next += 1;
            let name = format!("trigger{}", trigger.id);
            if !self.looked.contains(&name) {
                return Ok(Next::Shot(self.shot(name, trigger)?));
            }
        }
        Ok(Next::End)
    }

    fn position(&self) -> Option<(usize, usize)> {
        Some((self.next, self.triggers.len()))
    }

    fn is_continuous(&self) -> bool {
        true
    }

    fn rewind(&mut self, looked: BTreeSet<String>) {
        self.next = 0;
        self.looked = looked;
    }
}
