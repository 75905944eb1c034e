//! Detection on real pictures.

mod support;

use std::path::Path;

use nalgebra::{DMatrix, Vector2};
use netcord_calib::{
    detect::{BoardView, Depth, Detector},
    solve::{CameraViews, MonoOptions, apply_homography, calibrate_mono, homography},
};
use support::{detector, grey, shared};

#[test]
fn chessboards_of_the_opencv_samples_are_found_whole_and_calibrate_better_than_opencvs_corners() {
    let Some(folder) = shared("boards/chessboard-stereo") else { return };
    let text = std::fs::read_to_string(folder.join("cv2_4.14.0_reference.json")).expect("readable");
    let reference: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let detector = detector("chessboard:9x6:25mm");
    for (side, best_rms) in [("left", 0.182), ("right", 0.170)] {
        let mut views = Vec::new();
        for n in (1..=14).filter(|n| *n != 10) {
            let name = format!("{side}{n:02}");
            let picture = grey(&folder.join(format!("{name}.jpg")));
            let found = detector.find(&picture, Depth::Final).expect("a board");
            assert!(found.anchored && found.corners.len() == 54, "{name}: {}", found.corners.len());
            // OpenCV may count from the other end; the places are the same.
            let theirs: Vec<Vector2<f64>> = reference["detect"][&name]["cls5"]
                .as_array()
                .expect("corners")
                .iter()
                .map(|p| Vector2::new(p[0].as_f64().expect("u"), p[1].as_f64().expect("v")))
                .collect();
            for c in &found.corners {
                let off = theirs.iter().map(|t| (t - c.at).norm()).fold(f64::INFINITY, f64::min);
                assert!(off < 1.5, "{name}, corner {}: {off} px from OpenCV's", c.id);
            }
            assert!(detector.find(&picture, Depth::Guiding).is_some(), "{name}: guiding");
            views.push(detector.view(&name, &found));
        }
        let camera = CameraViews { name: side.to_owned(), size: (640, 480), views };
        let fitted = calibrate_mono(&camera, &MonoOptions::default()).expect("calibrates");
        let rms = fitted.rms_px;
        println!("{side}: {rms:.4} px from own corners");
        let furthest = fitted.views.iter().flat_map(|v| &v.residuals).map(|r| r.norm()).fold(0.0, f64::max);
        assert!(furthest < RIGHT_PX, "{side}: {furthest} px");
        assert!(rms <= best_rms, "{side}: {rms}");
    }
}

/// A corner further from its fitted board than this is wrong.
const RIGHT_PX: f64 = 1.0;

/// What takes up the lens, and paper that lies nearly flat.
const FLAT: i32 = 3;
/// The same for paper that is bent between two hands.
const BENT: i32 = 4;

/// How far each corner is from its board: a homography and a polynomial of this degree, by least squares over all
/// corners alike.
fn off_the_board(detector: &Detector, found: &BoardView, degree: i32) -> Vec<f64> {
    let from: Vec<Vector2<f64>> = found.corners.iter().map(|c| detector.points()[c.id].xy()).collect();
    let to: Vec<Vector2<f64>> = found.corners.iter().map(|c| c.at).collect();
    let h = homography(&from, &to).expect("a plane");
    let forecast: Vec<Vector2<f64>> = from.iter().map(|p| apply_homography(&h, p).expect("finite")).collect();
    let scale = from.iter().map(|p| p.amax()).fold(0.0, f64::max);
    let terms: Vec<(i32, i32)> = (0..=degree).flat_map(|d| (0..=d).map(move |i| (d - i, i))).collect();
    let design = DMatrix::from_fn(from.len(), terms.len(), |r, c| {
        (from[r].x / scale).powi(terms[c].0) * (from[r].y / scale).powi(terms[c].1)
    });
    let off = DMatrix::from_fn(from.len(), 2, |r, c| (to[r] - forecast[r])[c]);
    let fit = design.clone().svd(true, true).solve(&off, 1e-9).expect("solves");
    let left = off - design * fit;
    left.row_iter().map(|r| r.norm()).collect()
}

/// Corners found in a picture, all of which must be right.
fn right_corners(detector: &Detector, picture: &Path, degree: i32) -> usize {
    let name = picture.file_name().expect("a name").to_string_lossy().into_owned();
    let found = detector.find(&grey(picture), Depth::Final).unwrap_or_else(|| panic!("{name}: no board"));
    let off = off_the_board(detector, &found, degree);
    let worst = off.iter().copied().fold(0.0, f64::max);
    println!("{name}: {} corners, the worst {worst:.2} px off the board", off.len());
    assert!(worst < RIGHT_PX, "{name}: {worst} px");
    off.len()
}

/// Ninety-nine in a hundred of what the best of all programs found.
fn at_least(found: usize, best: usize, what: &str) {
    println!("{what}: {found} right corners, {best} by the best");
    assert!(found as f64 >= 0.99 * best as f64, "{what}: {found} of {best}");
}

#[test]
fn charuco_boards_are_found_as_whole_as_by_the_best() {
    let Some(folder) = shared("boards/aruco-opencv") else { return };
    let detector = detector("charuco:5x7:DICT_6X6_250:40mm:20mm");
    let views = folder.join("opencv_charuco_calib");
    let misc = folder.join("opencv_aruco_misc");
    let mut pictures: Vec<_> = (0..4).map(|n| views.join(format!("img_{n:02}.jpg"))).collect();
    pictures.extend([misc.join("choriginal.jpg"), misc.join("chocclusion_original.jpg")]);
    // The best takes for a twentieth corner of the last picture a place of which a mouse covers a half.
    let found = pictures.iter().map(|p| right_corners(&detector, p, FLAT)).sum();
    at_least(found, 5 * 24 + 20, "ChArUco boards");
}

#[test]
fn a_grid_of_markers_is_found_whole_and_under_a_hand_and_drawings() {
    let Some(misc) = shared("boards/aruco-opencv/opencv_aruco_misc") else { return };
    let detector = detector(&format!("aruco:5x7:{}:40mm:8mm", misc.join("tutorial_dict.yml").display()));
    at_least(right_corners(&detector, &misc.join("gboriginal.png"), FLAT), 35 * 4, "whole grid");
    at_least(right_corners(&detector, &misc.join("gbocclusion.png"), FLAT), 19 * 4, "covered grid");
}

#[test]
fn single_markers_are_told_when_a_board_is_missing() {
    let Some(misc) = shared("boards/aruco-opencv/opencv_aruco_misc") else { return };
    let said = detector("aruco:3x2:DICT_6X6_250:50mm:10mm")
        .diagnose(&grey(&misc.join("singlemarkersoriginal.jpg")))
        .to_string();
    assert!(said.contains("6 markers of DICT_6X6_250"), "{said}");
}

#[test]
fn chessboards_of_other_cameras_are_found_whole() {
    let Some(boards) = shared("boards") else { return };
    let detector = detector("chessboard:9x6:25mm");
    let pictures = |folder: &str| {
        let entries = std::fs::read_dir(boards.join(folder)).expect("readable");
        let mut files: Vec<_> = entries.map(|e| e.expect("readable").path()).collect();
        files.sort();
        files
    };
    let photos = pictures("aruco-opencv/chessboard-9x6-photos");
    assert_eq!(photos.len(), 16);
    at_least(photos.iter().map(|p| right_corners(&detector, p, FLAT)).sum(), 16 * 54, "photos");
    // Of these OpenCV finds seven of eight; in the eighth the picture ends before the board does.
    let webcams = pictures("charuco-4cam/chessboard_intrinsic");
    at_least(webcams.iter().map(|p| right_corners(&detector, p, BENT)).sum(), 7 * 54, "webcams");
}
