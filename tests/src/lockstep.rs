//! The stages in lockstep, as `netcord process` would run them: no clock and no busy machine has a part in it.

use std::time::Duration;

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
use nix::time::{ClockId, clock_gettime};

/// The stages of a rig, and the windows that they were last told to search.
pub struct Lockstep {
    /// The rig that the stages were made for.
    pub rig: Rig,
    segmenters: Vec<Segmenter>,
    matcher: Matcher,
    predictor: Predictor,
    windows: Vec<Option<SearchWindow>>,
}

/// One camera's messages on one frame, each with the computing time until it was there.
pub type Searched = Vec<(Detections, Duration)>;

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
    pub fn search(&mut self, camera: usize, header: &FrameHeader, bytes: &[u8]) -> Searched {
        let model = &self.rig.cameras[camera].model;
        let size = (model.width as usize, model.height as usize);
        let format = self.rig.cameras[camera].pixel_format;
        let view = FrameView::new(bytes, size, size.0, format).expect("a whole frame");
        let mut messages = Searched::with_capacity(2);
        let window = self.windows[camera].as_ref();
        let started = thread_time();
        self.segmenters[camera]
            .process(header, &view, window, &mut |found| messages.push((*found, thread_time() - started)))
            .expect("the camera's own frame");
        messages
    }

    /// The position of one trigger from all cameras' messages, and the scope that was enough for it; then the
    /// windows for the next.
    pub fn conclude(&mut self, searched: &[Searched], now_ns: u64) -> Option<(BallPosition, Scope)> {
        let mut concluded = None;
        for scope in [Scope::Window, Scope::Full] {
            for (message, _) in searched.iter().flatten().filter(|(m, _)| m.scope == scope.code()) {
                self.matcher.offer(message, now_ns);
            }
            while let Some(found) = self.matcher.next(now_ns) {
                concluded = Some((found, scope));
            }
        }
        let (position, scope) = concluded?;
        self.predictor.update(&position);
        let next = position.stamps.mid_exposure_ns + self.rig.interval_ns();
        for (slot, window) in self.windows.iter_mut().zip(self.predictor.windows(next)) {
            *slot = Some(window);
        }
        Some((position, scope))
    }
}

/// Computing time of the calling thread.
fn thread_time() -> Duration {
    clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).map_or(Duration::ZERO, Duration::from)
}
