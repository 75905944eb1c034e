//! The OpenCV sample pictures, against what OpenCV and mrcal make of the same corners.

use std::path::PathBuf;

use nalgebra::{Vector2, Vector3};
use netcord_calib::solve::{CameraViews, MonoOptions, View, calibrate_mono};
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
            View { name: n.to_owned(), object: object.clone(), image }
        })
        .collect();
    CameraViews { name: side.to_owned(), size: (640, 480), views }
}

#[test]
fn mono_gives_what_opencv_gives() {
    let Some((reference, _)) = reference() else { return };
    for (side, rms) in [("left", 0.195431), ("right", 0.207029)] {
        let found = calibrate_mono(&views(&reference, side), &MonoOptions::default()).expect("calibrates");
        let expected = &reference["mono"][format!("{side}_cls5")];
        println!("{side}: {} in {} steps {:?}", found.rms_px, found.steps, found.model.parameters());
        println!("sd {:?}", found.standard_deviations());
        println!("cv {:?} {:?} {:?}", expected["fx"], expected["dist"], expected["stddev_intrinsics"]);
        println!("{:?}", expected["rms"]);
        for (u, v) in [(319.5, 239.5), (160.0, 120.0), (20.0, 20.0)] {
            println!("unc {:?}", found.uncertainty.worst_sd_px(&Vector2::new(u, v)));
        }
        assert!((found.rms_px - rms).abs() < 1e-6);
    }
}
