//! A wand waved before four cameras, one of which is wrong.

mod support;

use nalgebra::Vector2;
use netcord_calib::solve::{MotionCalibration, MotionOptions, MovingPoints, calibrate_motion};
use netcord_common::camera::{CameraModel, Distortion};
use support::shared;

/// Numbers of the first `data: [...]` list after `key`.
fn list(text: &str, key: &str) -> Vec<f64> {
    let after = &text[text.find(key).expect("key")..];
    let open = after.find("data: [").expect("list") + 7;
    let close = open + after[open..].find(']').expect("end");
    after[open..close].split(',').map(|v| v.trim().parse().expect("number")).collect()
}

fn camera(folder: &std::path::Path, n: usize) -> MovingPoints {
    let yaml = std::fs::read_to_string(folder.join(format!("frame_{n}.yaml"))).expect("readable");
    let (k, d) = (list(&yaml, "camera_matrix"), list(&yaml, "distortion_coefficients"));
    let lens = Distortion::from_array([d[0], d[1], d[2], d[3], d[4]]);
    let model = CameraModel::new((1280, 1024), (k[0], k[4]), (k[2], k[5]), lens).expect("valid");
    let csv = std::fs::read_to_string(folder.join(format!("frame_{n}.csv"))).expect("readable");
    let (mut pixels, mut times_s) = (Vec::new(), Vec::new());
    for line in csv.lines() {
        let v: Vec<f64> = line.split(';').map(|v| v.parse().expect("number")).collect();
        times_s.push(v[0] * 1e-9);
        pixels
            .extend((0..3).map(|i| (v[1 + 2 * i] >= 0.0).then(|| Vector2::new(v[1 + 2 * i], v[2 + 2 * i]))));
    }
    // Camera 0 saw six instants more than the others, at the end; only what is common counts.
    MovingPoints { name: format!("camera {n}"), model, pixels, velocities: Vec::new() }
        .with_velocities(3, &times_s)
}

fn show(found: &MotionCalibration) {
    for c in &found.cameras {
        println!(
            "{}: median {:.3} px, RMS {:.3} px, {:.3} px with the {:.1} % of outliers; f {:.1} {:.1} px",
            c.name,
            c.median_px,
            c.rms_px,
            c.rms_all_px,
            100.0 * c.outliers,
            c.model.fx,
            c.model.fy,
        );
    }
    for i in &found.inconsistent {
        println!("{} is inconsistent: {:.2} px against the others; {:?}", i.name, i.median_px, i.delay);
    }
}

#[test]
fn three_cameras_agree_and_the_fourth_is_named_with_its_clocks_error() {
    let Some(folder) = shared("boards/wand-4cam/calibration_framework/test") else { return };
    let cameras: Vec<MovingPoints> = (0..4).map(|n| camera(&folder, n)).collect();
    let found = calibrate_motion(&cameras, &MotionOptions::default()).expect("calibrates");
    show(&found);
    let refined = MotionOptions { intrinsics: [true, true, true, true, true, true, false, false, false] };
    let refined = calibrate_motion(&cameras, &refined).expect("calibrates");
    println!("intrinsics refined:");
    show(&refined);
    // Most of what does not fit comes from lenses that are not quite as given: refined, three in a hundred are left.
    let outliers = |found: &MotionCalibration| found.cameras.iter().map(|c| c.outliers).sum::<f64>() / 3.0;
    assert!(
        outliers(&found) < 0.2 && outliers(&refined) < 0.04,
        "{} {}",
        outliers(&found),
        outliers(&refined)
    );
    for found in [&found, &refined] {
        let names: Vec<&str> = found.inconsistent.iter().map(|i| i.name.as_str()).collect();
        assert_eq!(names, ["camera 0"]);
        for c in &found.cameras {
            assert!(c.rms_px <= 0.5, "{}: {} px", c.name, c.rms_px);
            assert!(c.median_px <= 0.25, "{}: {} px", c.name, c.median_px);
        }
        // Independently, by essential matrices of pairs of cameras alone: 7 to 9 ms.
        let delay = found.inconsistent[0].delay.expect("a clock's error explains it");
        assert!((delay.later_s + 0.008).abs() < 0.001, "{delay:?}");
        // What is left is its lens, as with the others.
        assert!(delay.median_px < 0.3 * found.inconsistent[0].median_px, "{delay:?}");
    }
}
