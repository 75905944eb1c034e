use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Vector3};

use super::*;
use crate::{geometry::Point, rig::RigEdit, wire::WorldFrame};

fn example() -> Rig {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("rigs/example-4cam.toml");
    Rig::load(&path).expect("an example rig")
}

/// The rig that the texts make, by way of a rig file.
fn imported(set: &CameraSet) -> Rig {
    let mut edit = RigEdit::create(&PathBuf::from("rig.toml"), "imported");
    set.write_into(&mut edit, &ImportDefaults::default());
    edit.resolve().unwrap_or_else(|e| panic!("{e}\n{}", edit.text()))
}

#[test]
fn json_goes_there_and_back_to_a_billionth_of_a_pixel() {
    let rig = example();
    let text = write(&rig, Format::Json, None).expect("has a place for all");
    let set = read(&text, Path::new("cameras.json"), None, None).expect("valid");
    assert_eq!(set.world, WorldFrame::Table);
    let again = imported(&set);
    assert_eq!(again.world, WorldFrame::Table);
    for (a, b) in rig.cameras.iter().zip(&again.cameras) {
        assert_eq!((&a.name, a.model), (&b.name, b.model));
        for (x, y, z) in [(0.0, 0.0, 0.0), (0.7, -1.3, 0.4), (-0.5, 1.2, 0.9)] {
            let at = Point::new(x, y, z);
            let pa = a.model.project(&(&a.camera_from_world * at)).expect("in view");
            let pb = b.model.project(&(&b.camera_from_world * at)).expect("in view");
            assert!((pa - pb).norm() < 1e-9, "{}", a.name);
        }
    }
}

#[test]
fn chains_and_rodrigues_vectors_keep_the_poses_between_cameras() {
    let rig = example();
    for format in [Format::Parameters, Format::Kalibr] {
        if format == Format::Kalibr {
            let mut with_k3 = rig.clone();
            let mut p = with_k3.cameras[1].model.parameters();
            p[8] = 0.01;
            with_k3.cameras[1].model = with_k3.cameras[1].model.with_parameters(p).expect("valid");
            let error = write(&with_k3, format, None).expect_err("radtan has none").to_string();
            assert!(error.contains("k3"), "{error}");
        }
        let text = write(&rig, format, None).expect("has a place for all");
        let set = read(&text, Path::new("rig.yaml"), None, None).expect("valid");
        assert_eq!(set.world, WorldFrame::FirstCamera);
        let again = imported(&set);
        for (a, b) in rig.cameras.iter().zip(&again.cameras) {
            assert_eq!(a.model, b.model, "{format}: {}", a.name);
            assert_eq!(a.name, b.name);
            let expected = &a.camera_from_world * &rig.cameras[0].camera_from_world.inverse();
            assert!((expected.rotation.matrix() - b.camera_from_world.rotation.matrix()).amax() < 1e-12);
            assert!((expected.translation - b.camera_from_world.translation).norm() < 1e-12);
        }
    }
}

#[test]
fn single_cameras_go_through_opencv_and_ros() {
    let rig = example();
    let name = rig.cameras[2].name.clone();
    for format in [Format::OpenCv, Format::Ros] {
        let error = write(&rig, format, None).expect_err("which of four?").to_string();
        assert!(error.contains("--camera"), "{error}");
        let text = write(&rig, format, Some(&name)).expect("one camera");
        assert_eq!(Format::of(&text), Some(format));
        let set = read(&text, Path::new("some dir/Left cam (2).yaml"), None, None).expect("valid");
        assert_eq!(set.cameras[0].model, rig.cameras[2].model);
        assert_eq!(set.cameras[0].camera_from_world, None);
        let expected = if format == Format::Ros { name.as_str() } else { "Left-cam--2" };
        assert_eq!(set.cameras[0].name.as_str(), expected);
    }
}

/// As OpenCV 4 writes it, with its line breaks, and dots without digits behind them.
const OPENCV_STEREO: &str = r#"%YAML:1.0
---
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3591573396163199e+02, 0., 3.4228315473308373e+02, 0.,
       5.3591573396163199e+02, 2.3557082909788173e+02, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -2.6637260909660682e-01, -3.8588898922304653e-02,
       1.7831947042852964e-03, -2.8122100441115472e-04,
       2.3839153080878486e-01 ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.4e+02, 0., 3.3e+02, 0., 5.4e+02, 2.4e+02, 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -2.8e-01, 1.e-01, 0., 0., 0. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 0., -1., 0., 1., 0. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -3.3, 4.e-02, 1.5e-01 ]
"#;

#[test]
fn an_opencv_stereo_pair_needs_its_size_and_gives_both_cameras() {
    let path = Path::new("stereo.yml");
    let error = read(OPENCV_STEREO, path, None, None).expect_err("no size").to_string();
    assert!(error.contains("stereo.yml") && error.contains("--size"), "{error}");
    let rig = imported(&read(OPENCV_STEREO, path, None, Some((640, 480))).expect("valid"));
    assert_eq!(rig.cameras[0].model.fx, 535.915_733_961_632);
    assert_eq!(rig.cameras[0].model.distortion.k3, 0.238_391_530_808_784_86);
    assert_eq!((rig.cameras[1].model.cy, rig.cameras[1].model.height), (240.0, 480));
    assert_eq!(rig.cameras[1].camera_from_world.translation, Vector3::new(-3.3, 0.04, 0.15));
    let r = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0);
    assert!((rig.cameras[1].camera_from_world.rotation.matrix() - r).amax() < 1e-15);
}

/// As Kalibr writes it.
const KALIBR: &str = r#"cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.2, 0.05, 0.0001, -0.0002]
  distortion_model: radtan
  intrinsics: [461.6, 460.3, 362.7, 248.1]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.0, -1.0, 0.0, -0.11]
  - [1.0, 0.0, 0.0, 0.0004]
  - [0.0, 0.0, 1.0, -0.0008]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 0.00002]
  distortion_model: radtan
  intrinsics: [457.6, 456.1, 379.9, 255.2]
  resolution: [752, 480]
  rostopic: /right/image_raw
"#;

#[test]
fn a_kalibr_chain_is_read_as_kalibr_writes_it() {
    let rig = imported(&read(KALIBR, Path::new("camchain.yaml"), None, None).expect("valid"));
    assert_eq!(rig.cameras[1].name.as_str(), "right");
    assert_eq!(rig.cameras[1].camera_from_world.translation, Vector3::new(-0.11, 0.0004, -0.0008));
    assert_eq!(rig.cameras[1].camera_from_world.rotation[(1, 0)], 1.0);
    let fisheye = KALIBR.replacen("radtan", "equidistant", 1);
    let error = read(&fisheye, Path::new("c.yaml"), None, None).expect_err("fisheye").to_string();
    assert!(error.contains("cam0") && error.contains("equidistant"), "{error}");
}

#[test]
fn mistakes_are_named() {
    let of = |text: &str| read(text, Path::new("x.y"), None, None).expect_err(text).to_string();
    assert!(of("hello: 1").contains("none of the formats"));
    assert!(of("{\"cameras\": []}").contains("no camera"));
    let rig = example();
    let json = write(&rig, Format::Json, None).expect("JSON");
    let second = rig.cameras[1].name.as_str();
    let error = of(&json.replace(&format!("\"{second}\""), &format!("{:?}", rig.cameras[0].name.as_str())));
    assert!(error.contains("two cameras are called"), "{error}");
    let error = of(&json.replacen("\"K\"", "\"k\"", 1));
    assert!(error.contains("\"K\"") && error.contains(rig.cameras[0].name.as_str()), "{error}");
    let parameters = write(&rig, Format::Parameters, None).expect("YAML");
    let error = of(&parameters.replacen("distortion_coefs: [", "distortion_coefs: [0.1, 0.1, 0.1, ", 1));
    assert!(error.contains("coefficients"), "{error}");
    let error = of(&parameters.replacen(", 0.0, 0.0, 1.0]", ", 0.0, 0.0, 2.0]", 1));
    assert!(error.contains("camera matrix"), "{error}");
}

#[test]
fn the_original_rigs_file_is_read() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/rig-2cam/camera_params.yaml");
    let Ok(text) = std::fs::read_to_string(&path) else {
        println!("SKIPPED: {} is not there", path.display());
        return;
    };
    let rig = imported(&read(&text, &path, None, None).expect("valid"));
    assert_eq!(rig.cameras.len(), 2);
    assert_eq!(rig.cameras[0].model.fx, 672.282_472_526_775_7);
    assert_eq!(rig.cameras[1].model.distortion.k3, -0.003_645_360_450_147_547);
    let turn = rig.cameras[1].camera_from_world.rotation.scaled_axis();
    let expected = Vector3::new(0.011_754_198_955_182_42, 2.170_836_441_913_732, 2.193_332_428_763_24);
    assert!((turn - expected).norm() < 1e-9, "{turn}");
    assert!((rig.cameras[1].camera_from_world.translation.norm() - 1.6388).abs() < 1e-3);
}
