//! The OpenCV sample pictures, against what OpenCV and mrcal make of the same corners.

use std::path::PathBuf;

use nalgebra::{Vector2, Vector3};
use netcord_calib::solve::{
    CameraViews, INTRINSIC_NAMES, MonoOptions, RigOptions, View, calibrate_mono, calibrate_rig,
    cross_validate,
};
use serde_json::Value;

fn shared(path: &str) -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data").join(path);
    let there = path.exists();
    if !there {
        println!("SKIPPED: {} is not here", path.display());
    }
    there.then_some(path)
}

fn reference() -> Option<(Value, Value)> {
    let read = |v: &str| -> Option<Value> {
        let path = shared(&format!("boards/chessboard-stereo/cv2_{v}_reference.json"))?;
        Some(serde_json::from_str(&std::fs::read_to_string(path).expect("readable")).expect("JSON"))
    };
    Some((read("4.14.0")?, read("5.0.0")?))
}

fn views(reference: &Value, side: &str) -> CameraViews {
    let object: Vec<_> =
        (0..54).map(|i| Vector3::new(f64::from(i % 9) * 0.025, f64::from(i / 9) * 0.025, 0.0)).collect();
    let names = reference["mono"][format!("{side}_cls5")]["images"].as_array().expect("images");
    let views = names
        .iter()
        .map(|n| {
            let n = n.as_str().expect("name");
            let image = reference["detect"][format!("{side}{n}")]["cls5"]
                .as_array()
                .expect("corners")
                .iter()
                .map(|p| Vector2::new(p[0].as_f64().expect("u"), p[1].as_f64().expect("v")))
                .collect();
            View::new(n.to_owned(), object.clone(), image)
        })
        .collect();
    CameraViews { name: side.to_owned(), size: (640, 480), views }
}

/// Largest deviation that is still the same number to its last useful digit: a thousandth of its standard
/// deviation.
const SAME_SD: f64 = 1e-3;

#[test]
fn mono_gives_what_opencv_gives() {
    let Some((reference, _)) = reference() else { return };
    for (side, rms) in [("left", 0.195_431), ("right", 0.207_029)] {
        let views = views(&reference, side);
        let found = calibrate_mono(&views, &MonoOptions::default()).expect("calibrates");
        assert!((found.rms_px - rms).abs() < 1e-6, "{side}: {}", found.rms_px);
        let expected = &reference["mono"][format!("{side}_cls5")];
        let number = |v: &Value| v.as_f64().expect("number");
        let mut truth = ["fx", "fy", "cx", "cy"].map(|n| number(&expected[n])).to_vec();
        truth.extend(expected["dist"].as_array().expect("five").iter().map(number));
        let sds = found.standard_deviations();
        for (i, name) in INTRINSIC_NAMES.iter().enumerate() {
            let (sd, value) = (number(&expected["stddev_intrinsics"][i]), found.model.parameters()[i]);
            assert!((value - truth[i]).abs() < SAME_SD * sd, "{side} {name}: {value}, not {}", truth[i]);
            assert!((sds[i] - sd).abs() < SAME_SD * sd, "{side} sd of {name}: {}, not {sd}", sds[i]);
        }
        for (view, rms) in found.views.iter().zip(expected["per_view_rms"].as_array().expect("views")) {
            assert!((view.rms_px() - number(rms)).abs() < 1e-5, "{side} view {}", view.name);
        }
        let validation = cross_validate(&views, &MonoOptions::default(), &found, 5).expect("enough views");
        assert!(validation.held_out_rms_px > found.rms_px && validation.held_out_rms_px < 1.5 * found.rms_px);
    }
}

#[test]
fn projection_uncertainty_is_of_mrcals_size() {
    let Some((reference, _)) = reference() else { return };
    // mrcal 2.2, no board warp, at infinity: it lets the boards carry the turn of the camera, we take the
    // best turn out; away from the centre the two differ by a tenth.
    let found = calibrate_mono(&views(&reference, "left"), &MonoOptions::default()).expect("calibrates");
    for ((u, v), mrcal) in [((160.0, 120.0), 0.197), ((20.0, 20.0), 5.5)] {
        let sd = found.uncertainty.worst_sd_px(&Vector2::new(u, v)).expect("inside the lens");
        assert!((sd / mrcal - 1.0).abs() < 0.15, "({u}, {v}): {sd} px, mrcal {mrcal} px");
    }
}

#[test]
fn stereo_gives_what_opencv_5_gives() {
    let Some((_, reference)) = reference() else { return };
    let cameras = [views(&reference, "left"), views(&reference, "right")];
    let models: Vec<_> = cameras
        .iter()
        .map(|c| calibrate_mono(c, &MonoOptions::default()).expect("calibrates").model)
        .collect();
    let fixed = calibrate_rig(&cameras, &models, &RigOptions::default()).expect("calibrates");
    assert!((fixed.rms_px - 0.216_819).abs() < 1e-6, "{}", fixed.rms_px);
    let t = fixed.cameras[1].camera_from_first.translation;
    let expected = Vector3::new(-0.083_199_556_8, 0.000_931_141_0, 0.000_361_287_8);
    assert!((t - expected).norm() < 2e-8, "{t}");

    let free = RigOptions { free: [true; 9], ..RigOptions::default() };
    let free = calibrate_rig(&cameras, &models, &free).expect("calibrates");
    assert!((free.rms_px - 0.215_057).abs() < 1e-6, "{}", free.rms_px);
    let baseline = free.cameras[1].camera_from_first.translation.norm();
    assert!((baseline - 0.083_18).abs() < 5e-6, "{baseline}");
    assert!(fixed.rejected.is_empty() && free.rejected.is_empty());
}
