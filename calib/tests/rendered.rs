//! Detection against exact truth, on rendered pictures of 1920 × 1200 px through a wide lens.

#[path = "support/render.rs"]
mod render;
mod support;

use netcord_calib::detect::{Depth, Detector};
use netcord_common::geometry::Point;
use render::{CLEAN, HARD, Look, SIZE, lens, pose, render};
use support::detector;

/// Corners nearer to the frame than this, in px, are not counted as visible.
const FRAME_PX: f64 = 8.0;

#[derive(Default)]
struct Score {
    visible: usize,
    found: usize,
    wrong: usize,
    squares: f64,
}

/// Detection over pictures with tilts up to 60°.
fn score(detector: &Detector, look: &Look, pictures: u64) -> Score {
    let model = lens();
    let mut score = Score::default();
    for seed in 0..pictures {
        let pose = pose(detector.board(), seed, pictures);
        let picture = render(detector.board(), &model, &pose, look, seed);
        let found = detector.find(&picture, Depth::Final);
        for (id, point) in detector.points().iter().enumerate() {
            let Some(truth) = model.project(&(&pose * Point::from(*point))) else { continue };
            let inside = truth.x > FRAME_PX
                && truth.y > FRAME_PX
                && truth.x < SIZE.0 as f64 - FRAME_PX
                && truth.y < SIZE.1 as f64 - FRAME_PX;
            let corner = found.iter().flat_map(|f| &f.corners).find(|c| c.id == id);
            score.visible += usize::from(inside);
            let Some(corner) = corner else { continue };
            let off = (corner.at - truth).norm();
            if off > 1.0 {
                score.wrong += 1;
            } else {
                score.found += usize::from(inside);
                score.squares += off * off;
            }
        }
    }
    score
}

fn assert_score(spec: &str, clean_px: f64, hard_px: f64) {
    let detector = detector(spec);
    for (name, look, limit) in [("clean", &CLEAN, clean_px), ("hard", &HARD, hard_px)] {
        let s = score(&detector, look, 4);
        let rms = (s.squares / s.found.max(1) as f64).sqrt();
        println!(
            "{spec} {name}: {} of {} visible corners, {} wrong, {rms:.4} px RMS",
            s.found, s.visible, s.wrong
        );
        assert_eq!(s.wrong, 0, "{spec} {name}");
        assert!(s.found as f64 >= 0.99 * s.visible as f64, "{spec} {name}: {} of {}", s.found, s.visible);
        assert!(rms <= limit, "{spec} {name}: {rms} px");
    }
}

#[test]
fn charuco_boards_are_found_to_a_fortieth_of_a_pixel() {
    assert_score("charuco:11x8:DICT_5X5_250:40mm:30mm", 0.027, 0.11);
}

#[test]
fn chessboards_are_found_to_a_fortieth_of_a_pixel() {
    assert_score("chessboard:10x7:40mm", 0.027, 0.11);
}

#[test]
fn aruco_grids_are_found_to_a_twenty_fifth_of_a_pixel() {
    assert_score("aruco:8x5:DICT_5X5_250:45mm:12mm", 0.042, 0.18);
}
