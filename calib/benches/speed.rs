//! How long detection and calibration take: minima and medians of repeated runs, as lines of text.
//!
//! `cargo bench -p netcord-calib`; with `NETCORD_PYTHON` naming a Python that has OpenCV, that is timed on the same
//! corners in the same run.

#[path = "../tests/support/render.rs"]
mod render;

use std::{process::Command, time::Instant};

use nalgebra::{Rotation3, Vector2, Vector3};
use netcord_calib::{
    board::CalibrationBoard,
    detect::{Depth, Detector},
    solve::{CameraViews, MonoOptions, RigOptions, View, calibrate_mono, calibrate_rig, write_corners},
};
use netcord_common::geometry::{Board, Camera, Point, Transform};
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;

fn time(what: &str, runs: usize, mut run: impl FnMut()) {
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let begin = Instant::now();
            run();
            begin.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    println!("{what:<60} least {:>8.2} ms, median {:>8.2} ms", times[0], times[runs / 2]);
}

/// Views of a 9 × 6 board by `camera`, all corners seen, ± 0.1 px.
fn views(count: usize, seed: u64) -> (CameraViews, Vec<Transform<Camera, Board>>) {
    let model = render::lens();
    let noise = Normal::new(0.0, 0.1).expect("positive");
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut found = CameraViews { name: "camera".to_owned(), size: (1920, 1200), views: Vec::new() };
    let mut poses = Vec::new();
    while found.views.len() < count {
        let mut any = |reach: f64| random.random_range(-reach..reach);
        let turn = Rotation3::new(Vector3::new(any(0.7), any(0.7), any(0.5)));
        let centre = Vector3::new(any(0.35), any(0.2), 0.6 + any(0.15));
        let pose = Transform::<Camera, Board>::new(turn, centre - turn * Vector3::new(0.16, 0.1, 0.0));
        let mut view = View::new(format!("{}", found.views.len()), Vec::new(), Vec::new());
        for i in 0..54 {
            let object = Vector3::new(f64::from(i % 9) * 0.04, f64::from(i / 9) * 0.04, 0.0);
            let Some(pixel) = model.project(&(&pose * Point::from(object))).filter(|p| model.contains(p))
            else {
                continue;
            };
            let shake = Vector2::new(noise.sample(&mut random), noise.sample(&mut random));
            view.object.push(object);
            view.image.push(pixel + shake);
        }
        if view.image.len() == 54 {
            found.views.push(view);
            poses.push(pose);
        }
    }
    (found, poses)
}

/// OpenCV's time for the same corners.
fn time_opencv(views: &CameraViews) {
    let Some(python) = std::env::var_os("NETCORD_PYTHON") else {
        println!("OpenCV: not timed, NETCORD_PYTHON names no Python that has it");
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let corners = folder.path().join("corners.json");
    std::fs::write(&corners, write_corners(std::slice::from_ref(views))).expect("written");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/opencv.py");
    let run = Command::new(python).arg(script).arg(&corners).arg("15").output().expect("starts");
    let text = String::from_utf8_lossy(&run.stdout);
    let fields: Vec<&str> = text.split_whitespace().collect();
    let [least, median, rms, version] = fields[..] else {
        println!("OpenCV: not timed: {}", String::from_utf8_lossy(&run.stderr));
        return;
    };
    let what = format!("the same 40 views by OpenCV {version} ({rms:.8} px RMS)");
    println!("{what:<60} least {least:>8.5} ms, median {median:>8.5} ms");
}

fn main() {
    for spec in
        ["chessboard:10x7:40mm", "charuco:11x8:DICT_5X5_250:40mm:30mm", "aruco:8x5:DICT_5X5_250:45mm:12mm"]
    {
        let board = CalibrationBoard::parse(spec, |_| Err("no files".to_owned())).expect(spec);
        let pose = render::pose(&board, 1, 4);
        let looks = [("clean", &render::CLEAN), ("hard", &render::HARD)];
        let pictures =
            looks.map(|(name, look)| (name, render::render(&board, &render::lens(), &pose, look, 1)));
        let detector = Detector::new(board);
        for (name, picture) in &pictures {
            for depth in [Depth::Guiding, Depth::Final] {
                time(&format!("{spec}, {name}, {depth:?}"), 15, || {
                    assert!(detector.find(picture, depth).is_some());
                });
            }
        }
    }
    for count in [5, 10, 20, 40, 80] {
        let (views, _) = views(count, 1);
        time(&format!("mono, {count} views of 54 corners"), 15, || {
            calibrate_mono(&views, &MonoOptions::default()).expect("calibrates");
        });
        if count == 40 {
            time_opencv(&views);
        }
    }
    let (first, _) = views(30, 2);
    let second = CameraViews { name: "second".to_owned(), ..first.clone() };
    let models = [render::lens(), render::lens()];
    time("stereo, 30 views, intrinsics fixed", 15, || {
        calibrate_rig(&[first.clone(), second.clone()], &models, &RigOptions::default()).expect("calibrates");
    });
}
