//! The stages in lockstep, as `netcord process` would run them: no clock and no busy machine has a part in it.

use netcord_common::{
    FrameView,
    rig::Rig,
    wire::{BallPosition, Detections, FrameHeader, Scope, SearchWindow},
};
use netcord_detect::{
    flight::{PredictOptions, Predictor},
    segment::{SegmentOptions, Segmenter},
    triangulate::{Matcher, TriangulateOptions},
};

/// The stages of a rig, and the windows that they were last told to search.
pub struct Lockstep {
    /// The rig that the stages were made for.
    pub rig: Rig,
    segmenters: Vec<Segmenter>,
    matcher: Matcher,
    predictor: Predictor,
    windows: Vec<Option<SearchWindow>>,
}

impl Lockstep {
    /// Stages for a rig, which is valid.
    #[must_use]
    pub fn new(rig: Rig, options: &SegmentOptions) -> Self {
        let segmenters = (0..rig.cameras.len())
            .map(|camera| Segmenter::new(&rig, camera, options.clone()).expect("the rig's own camera"))
            .collect();
        Self {
            segmenters,
            matcher: Matcher::new(&rig, &TriangulateOptions::default()),
            predictor: Predictor::new(&rig, PredictOptions::default()),
            windows: vec![None; rig.cameras.len()],
            rig,
        }
    }

    /// Searches one camera's frame, the window first; `bytes` is the whole mosaic.
    pub fn search(&mut self, camera: usize, header: &FrameHeader, bytes: &[u8]) -> Vec<Detections> {
        let model = &self.rig.cameras[camera].model;
        let size = (model.width as usize, model.height as usize);
        let format = self.rig.cameras[camera].pixel_format;
        let view = FrameView::new(bytes, size, size.0, format).expect("a whole frame");
        let mut messages = Vec::with_capacity(2);
        let window = self.windows[camera].as_ref();
        self.segmenters[camera]
            .process(header, &view, window, &mut |found| messages.push(*found))
            .expect("the camera's own frame");
        messages
    }

    /// The position of one trigger from all cameras' messages; then the windows for the next.
    pub fn conclude(&mut self, messages: &[Detections], now_ns: u64) -> Option<BallPosition> {
        let mut concluded = None;
        for scope in [Scope::Window, Scope::Full] {
            messages.iter().filter(|m| m.scope == scope.code()).for_each(|m| self.matcher.offer(m, now_ns));
            while let Some(found) = self.matcher.next(now_ns) {
                concluded = Some(found);
            }
        }
        let position = concluded?;
        self.predictor.update(&position);
        let next = position.stamps.mid_exposure_ns + self.rig.interval_ns();
        for (slot, window) in self.windows.iter_mut().zip(self.predictor.windows(next)) {
            *slot = Some(window);
        }
        Some(position)
    }
}
