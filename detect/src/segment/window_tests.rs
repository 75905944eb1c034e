//! What a search window may make the segmenter believe, and what it may not.

use netcord_common::{
    rig::BallColour,
    wire::{Detections, Scope, SearchWindow},
};

use super::{
    Segmenter,
    scene::{Cover, Flight, Stage, Style},
};

/// A window around a place, in which a ball of 18 px is expected to leave a path.
fn window([u, v]: [f64; 2], path: [f64; 2]) -> SearchWindow {
    SearchWindow {
        present: 1,
        x0_px: u - 40.0,
        y0_px: v - 40.0,
        x1_px: u + 40.0,
        y1_px: v + 40.0,
        u_px: u,
        v_px: v,
        covariance_px2: [4.0, 0.0, 4.0],
        diameter_px: 18.0,
        // Exposures of the stage are 10 ms long.
        velocity_px_s: path.map(|p| p * 100.0),
        ..SearchWindow::default()
    }
}

fn search(
    stage: &Stage,
    segmenter: &mut Segmenter,
    frame: &[u8],
    n: u64,
    window: &SearchWindow,
) -> Vec<Detections> {
    let mut messages = Vec::new();
    let mut emit = |message: &Detections| messages.push(*message);
    segmenter.process(&stage.header(n), &stage.view(frame), Some(window), &mut emit).expect("it fits");
    messages
}

#[test]
fn what_has_always_been_there_is_no_ball_because_one_is_expected_there() {
    let mut stage = Stage::new(Style::hall(), 21);
    // Painted on the wall, so to speak: round, as large as a ball, and of its colour.
    let lamp = (stage.flight([300.0, 200.0], 18.0, [0.0; 2]), stage.style.ball);
    let mut segmenter = stage.segmenter(BallColour::Orange);
    for _ in 0..60 {
        let frame = stage.render(&[lamp], &[], 1.0);
        stage.search(&mut segmenter, &frame, None);
    }
    for n in 0..10 {
        let frame = stage.render(&[lamp], &[], 1.0);
        let expected = window([301.0, 199.0], [2.0, 0.0]);
        let messages = search(&stage, &mut segmenter, &frame, 100 + n, &expected);
        let sure = |m: &Detections| m.items().iter().any(|d| d.score >= 0.5);
        assert!(!messages.iter().any(sure), "frame {n}: {:?}", messages[0].items());
    }
}

#[test]
fn something_else_in_the_window_does_not_hide_a_ball_before_a_limb() {
    let mut stage = Stage::new(Style { ball: [0.9, 0.9, 0.88], ..Style::hall() }, 22);
    let mut segmenter = stage.warmed(BallColour::White, 30);
    let (mut seen, mut frames) = (0, 0);
    for n in 0..40_u32 {
        let t = f64::from(n % 20);
        let place = [120.0 + 20.0 * t, 140.0 + 2.0 * t];
        let ball: Flight = stage.flight(place, 18.0, [6.0, 1.0]);
        let x = place[0] as f32 + 9.0;
        let limb = Cover {
            area: [x - 60.0, 60.0, x + 35.0, 200.0],
            reflectance: [0.09, 0.05, 0.04],
            in_front: false,
        };
        // It flies, too, and passes through the window, but not where the ball is expected in it.
        let other = stage.flight([560.0 - 20.0 * t, 330.0], 18.0, [-6.0, 0.0]);
        let expected = window([560.0 - 20.0 * t - 30.0, 320.0], [6.0, 1.0]);
        // First alone, so that its colour is learnt.
        let covers = if n < 20 { vec![] } else { vec![limb] };
        let white = stage.style.ball;
        let frame = stage.render(&[(ball, white), (other, white)], &covers, 1.0);
        let messages = search(&stage, &mut segmenter, &frame, 100 + u64::from(n), &expected);
        let full = messages.iter().find(|m| m.scope == Scope::Full.code()).expect("each frame gives one");
        let [u, v] = stage.image(&ball);
        let found = full.items().iter().any(|d| (d.u_px - u).hypot(d.v_px - v) < 2.0 && d.score > 0.5);
        if n >= 20 {
            frames += 1;
            seen += u32::from(found);
        }
    }
    assert!(seen >= frames - 1, "{seen} of {frames}");
}
