//! Detection on real pictures.

mod support;

use nalgebra::Vector2;
use netcord_calib::{
    detect::Depth,
    solve::{CameraViews, MonoOptions, calibrate_mono},
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
        let rms = calibrate_mono(&camera, &MonoOptions::default()).expect("calibrates").rms_px;
        println!("{side}: {rms:.4} px from own corners");
        assert!(rms <= best_rms, "{side}: {rms}");
    }
}
