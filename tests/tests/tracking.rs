//! What the stages find in scenes whose truth is known: rendered, searched, triangulated and predicted in
//! lockstep, as `netcord process` would, so that no clock and no busy machine has a part in it.

use std::{path::Path, sync::Arc};

use nalgebra::Vector3;
use netcord_capture::synthetic::{
    render::{Exposure, FrameRenderer},
    scene::{Preset, Scene, SceneOptions},
};
use netcord_common::{
    FrameView,
    rig::Rig,
    wire::{CameraTruth, Detections, FrameHeader, Scope, SearchWindow, Stamps},
};
use netcord_detect::{
    flight::{PredictOptions, Predictor},
    segment::{SegmentOptions, Segmenter},
    triangulate::{Matcher, TriangulateOptions},
};

/// Triggers in which the background and the ball's colour are learnt; they are not judged.
const WARM_UP: u64 = 20;
const TRIGGERS: u64 = 420;
/// A position nearer to the truth than this is one of the ball.
const NEAR_M: f64 = 0.050;
/// Share of the ball that a camera must see for it to count as seen.
const SEEN: f64 = 0.5;

/// What came out of one scene.
#[derive(Debug, Default)]
struct Tally {
    findable: usize,
    found: usize,
    false_positions: usize,
    errors_mm: Vec<f64>,
}

impl Tally {
    fn recall(&self) -> f64 {
        self.found as f64 / self.findable as f64
    }

    fn median_mm(&mut self) -> f64 {
        self.errors_mm.sort_by(f64::total_cmp);
        self.errors_mm[self.errors_mm.len() / 2]
    }
}

/// The stages of a rig, and the windows that they were last told to search.
struct Pipeline {
    rig: Rig,
    segmenters: Vec<Segmenter>,
    matcher: Matcher,
    predictor: Predictor,
    windows: Vec<Option<SearchWindow>>,
}

impl Pipeline {
    fn new(rig: Rig) -> Self {
        let segmenters = (0..rig.cameras.len())
            .map(|camera| {
                Segmenter::new(&rig, camera, SegmentOptions::default()).expect("the example rig is valid")
            })
            .collect();
        Self {
            segmenters,
            matcher: Matcher::new(&rig, &TriangulateOptions::default()),
            predictor: Predictor::new(&rig, PredictOptions::default()),
            windows: vec![None; rig.cameras.len()],
            rig,
        }
    }

    /// One camera's messages on one frame, window search first.
    fn search(&mut self, camera: usize, header: &FrameHeader, bytes: &[u8]) -> Vec<Detections> {
        let model = &self.rig.cameras[camera].model;
        let size = (model.width as usize, model.height as usize);
        let format = self.rig.cameras[camera].pixel_format;
        let view = FrameView::new(bytes, size, size.0, format).expect("a whole frame");
        let mut messages = Vec::new();
        let window = self.windows[camera].as_ref();
        self.segmenters[camera]
            .process(header, &view, window, &mut |found| messages.push(*found))
            .expect("the camera's own frame");
        messages
    }

    /// The position of one trigger, if any, from all cameras' messages; and the windows for the next.
    fn conclude(&mut self, messages: &[Detections], now_ns: u64) -> Option<Vector3<f64>> {
        let mut position = None;
        for scope in [Scope::Window, Scope::Full] {
            messages.iter().filter(|m| m.scope == scope.code()).for_each(|m| self.matcher.offer(m, now_ns));
            while let Some(found) = self.matcher.next(now_ns) {
                position = Some(found);
            }
        }
        let position = position?;
        self.predictor.update(&position);
        let next = position.stamps.mid_exposure_ns + self.rig.interval_ns();
        for (slot, window) in self.windows.iter_mut().zip(self.predictor.windows(next)) {
            *slot = Some(window);
        }
        position.is_present().then(|| position.position_m.into())
    }
}

fn track(preset: Preset, seed: u64) -> Tally {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-2cam.toml");
    let rig = Rig::load(&path).expect("the example rig is valid");
    let options = SceneOptions { preset, seed, ..SceneOptions::default() };
    let scene = Arc::new(Scene::new(&rig, &options).expect("a rally needs no file"));
    let mut renderers: Vec<_> = rig.cameras.iter().map(|camera| FrameRenderer::new(&scene, camera)).collect();
    let interval_ns = rig.interval_ns();
    let mut pipeline = Pipeline::new(rig);
    let mut tally = Tally::default();
    let mut mosaic = Vec::new();
    for n in 0..TRIGGERS {
        let at_ns = 1_000_000_000 + n * interval_ns;
        let mut messages = Vec::new();
        let mut seen = 0;
        for camera in 0..renderers.len() {
            let own = &pipeline.rig.cameras[camera];
            let exposure_ns = scene.exposure_ns.unwrap_or(own.exposure_ns);
            mosaic.resize((own.model.width * own.model.height) as usize, 0);
            let exposure =
                Exposure { frame: n, mid_s: at_ns as f64 * 1e-9, length_s: exposure_ns as f64 * 1e-9 };
            let truth: CameraTruth = renderers[camera].render(&exposure, &mut mosaic);
            seen += usize::from(truth.visible >= SEEN);
            let header = FrameHeader {
                trigger_id: n + 1,
                sequence: n,
                exposure_ns,
                stamps: Stamps { mid_exposure_ns: at_ns, mid_exposure_host_ns: at_ns, ..Stamps::default() },
                ..FrameHeader::default()
            };
            messages.extend(pipeline.search(camera, &header, &mosaic));
        }
        let found = pipeline.conclude(&messages, at_ns);
        if n < WARM_UP {
            continue;
        }
        let ball = renderers[0].ball_at(at_ns as f64 * 1e-9).map(|point| point.state.position);
        let findable = ball.is_some() && seen >= 2;
        let error_m = found.zip(ball).map(|(found, ball)| (found - ball).norm());
        let right = error_m.is_some_and(|error| error < NEAR_M);
        tally.findable += usize::from(findable);
        tally.found += usize::from(findable && right);
        tally.false_positions += usize::from(found.is_some() && !right);
        tally.errors_mm.extend(error_m.filter(|_| right).map(|error| error * 1e3));
    }
    tally
}

#[test]
fn the_ball_is_tracked_among_players_and_look_alikes() {
    let mut all = Tally::default();
    for seed in [2, 5] {
        let tally = track(Preset::Normal, seed);
        println!("normal, seed {seed}: {} of {}", tally.found, tally.findable);
        all.findable += tally.findable;
        all.found += tally.found;
        all.false_positions += tally.false_positions;
        all.errors_mm.extend(tally.errors_mm);
    }
    let median_mm = all.median_mm();
    assert!(all.findable > 500, "{}", all.findable);
    assert!(all.recall() >= 0.99, "{} of {}", all.found, all.findable);
    assert_eq!(all.false_positions, 0);
    assert!(median_mm <= 1.0, "{median_mm}");
}

#[test]
fn a_dim_white_ball_is_tracked_through_long_exposures() {
    let mut tally = track(Preset::Hard, 1);
    let median_mm = tally.median_mm();
    assert!(tally.findable > 300 && tally.recall() >= 0.97, "{} of {}", tally.found, tally.findable);
    assert_eq!(tally.false_positions, 0);
    assert!(median_mm <= 2.5, "{median_mm}");
}
