//! What the stages find in scenes whose truth is known: rendered, searched, triangulated and predicted in
//! lockstep, as `netcord process` would, so that no clock and no busy machine has a part in it.

use std::{path::Path, sync::Arc};

use nalgebra::Vector3;
use netcord_capture::synthetic::{
    render::{Exposure, FrameRenderer},
    scene::{Preset, Scene, SceneOptions},
};
use netcord_common::{
    rig::Rig,
    wire::{BallPosition, CameraTruth, FrameHeader, Stamps},
};
use netcord_detect::segment::SegmentOptions;
use netcord_tests::Lockstep;

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

fn track(preset: Preset, seed: u64) -> Tally {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-2cam.toml");
    let rig = Rig::load(&path).expect("the example rig is valid");
    let options = SceneOptions { preset, seed, ..SceneOptions::default() };
    let scene = Arc::new(Scene::new(&rig, &options).expect("a rally needs no file"));
    let mut renderers: Vec<_> = rig.cameras.iter().map(|camera| FrameRenderer::new(&scene, camera)).collect();
    let interval_ns = rig.interval_ns();
    let mut stages = Lockstep::new(rig, &SegmentOptions::default());
    let mut tally = Tally::default();
    let mut mosaic = Vec::new();
    for n in 0..TRIGGERS {
        let at_ns = 1_000_000_000 + n * interval_ns;
        let mut messages = Vec::new();
        let mut seen = 0;
        for camera in 0..renderers.len() {
            let own = &stages.rig.cameras[camera];
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
            messages.extend(stages.search(camera, &header, &mosaic));
        }
        let found = stages.conclude(&messages, at_ns);
        let found = found.filter(BallPosition::is_present).map(|p| Vector3::from(p.position_m));
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
