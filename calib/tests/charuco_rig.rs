//! Four webcams around a room, software-synchronised, and a ChArUco board carried about: half of the instants
//! calibrate, the other half judge.

mod support;

use std::{fs, path::Path, process::Command, sync::Arc};

use netcord_calib::{
    check::{Limits, check_boards},
    detect::{Absence, Depth, Detector},
    gather::{Rejection, read},
    session::{Outcome, Session, SessionCamera, Setup, Shot, Sight, Solver, Task},
    solve::{CameraViews, Loss, MonoOptions, RigOptions},
    table::TableCamera,
};
use rayon::prelude::*;
use support::{detector, shared};

const BOARD: &str = "charuco:4x5:DICT_4X4_1000:54mm:40.5mm:inverted";
const CAMERAS: usize = 4;

/// What each camera saw at each instant, with the stamps that go with it; `None`, said aloud, where the videos or
/// a decoder are absent.
fn shots(detector: &Detector) -> Option<Vec<Shot>> {
    let folder = shared("boards/charuco-4cam/charuco_calibration/calibration/extrinsic")?;
    let python = std::env::var("NETCORD_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let pictures = tempfile::tempdir().expect("a folder");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/frames.py");
    for camera in 0..CAMERAS {
        let to = pictures.path().join(camera.to_string());
        fs::create_dir(&to).expect("created");
        let video = folder.join(format!("cam_{camera}.mp4"));
        let run = Command::new(&python).arg(script).args([&video, &to]).output();
        if !run.is_ok_and(|r| r.status.success()) {
            println!(
                "SKIPPED: {python} has no OpenCV to decode videos; NETCORD_PYTHON may name one that has"
            );
            return None;
        }
    }
    let stamps = stamps(&folder.join("timestamps.csv"));
    let sight = |camera: usize, instant: usize| -> Result<Sight, Rejection> {
        let luma = read(&pictures.path().join(format!("{camera}/{instant:04}.png")))?;
        let size = (luma.width() as u32, luma.height() as u32);
        let nothing = || Absence::Nothing { wanted: BOARD.to_owned() };
        let board = detector.find(&luma, Depth::Final).ok_or_else(nothing);
        Ok(Sight { size, stamp_ns: Some(stamps[instant][camera]), board, blur_px: None })
    };
    let shot = |instant: usize| Shot {
        name: format!("{instant:03}"),
        sights: (0..CAMERAS).map(|c| Some(sight(c, instant))).collect(),
    };
    Some((0..stamps.len()).into_par_iter().map(shot).collect())
}

/// Per instant and camera, ns.
fn stamps(path: &Path) -> Vec<[u64; CAMERAS]> {
    let text = fs::read_to_string(path).expect("readable");
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|v| v.parse().expect("a number")).collect())
        .collect();
    let first = rows.iter().map(|r| r[0] as usize).min().expect("rows");
    let mut stamps = vec![[0; CAMERAS]; rows.len() / CAMERAS];
    for row in rows {
        stamps[row[0] as usize - first][row[1] as usize] = (row[3] * 1e9) as u64;
    }
    stamps
}

/// A session's rig from the shots of even places.
fn calibrate(shots: Vec<Shot>, detector: &Arc<Detector>, solver: Solver) -> (Vec<TableCamera>, usize) {
    let camera = |i: usize| SessionCamera { name: format!("cam{i}"), model: None, camera_from_first: None };
    let setup = Setup { solver, ..Setup::new(Task::Rig, (0..CAMERAS).map(camera).collect()) };
    let mut session = Session::new(setup, Arc::clone(detector));
    for o in session.offer_all(shots).expect("gathers") {
        if std::env::var_os("SHOW").is_some() {
            let v: Vec<String> = o
                .verdict
                .cameras
                .iter()
                .map(|c| match c {
                    Some(Ok(())) => "kept".into(),
                    Some(Err(e)) => e.kind().to_string(),
                    None => "-".into(),
                })
                .collect();
            println!("{}: {}", o.name, v.join(" | "));
        }
    }
    let kept = session.kept().len();
    let result = session.process().expect("views").solve(&|_, _| {}).expect("calibrates");
    let Outcome::Rig { rig, .. } = result else { panic!("a rig") };
    println!("rig: {:.3} px RMS over {kept} shots; rejected: {:?}", rig.rms_px, rig.rejected.len());
    let cameras = rig.cameras.iter().map(|c| TableCamera {
        name: c.name.clone(),
        model: c.model,
        camera_from_first: c.camera_from_first,
    });
    (cameras.collect(), kept)
}

#[test]
fn views_that_were_not_used_fit_to_a_pixel() {
    let detector = Arc::new(detector(BOARD));
    let Some(shots) = shots(&detector) else { return };
    let copy = |k: usize| {
        shots
            .iter()
            .skip(k)
            .step_by(2)
            .map(|s| Shot { name: s.name.clone(), sights: s.sights.clone() })
            .collect::<Vec<_>>()
    };
    let fresh = copy(1);
    let mut views: Vec<CameraViews> = (0..CAMERAS)
        .map(|c| CameraViews { name: format!("cam{c}"), size: (1280, 720), views: Vec::new() })
        .collect();
    for shot in &fresh {
        let stamps: Vec<u64> = shot
            .sights
            .iter()
            .flatten()
            .flatten()
            .filter(|s| s.board.is_ok())
            .filter_map(|s| s.stamp_ns)
            .collect();
        let apart = stamps.iter().max().zip(stamps.iter().min()).map_or(0, |(a, b)| a - b);
        for (c, sight) in shot.sights.iter().enumerate() {
            if let Some(Ok(s)) = sight
                && let Ok(b) = &s.board
                && b.corners.len() >= 6
                && apart <= 5_000_000
            {
                views[c].views.push(detector.view(&shot.name, b));
            }
        }
    }
    let few = [true, true, true, true, true, true, false, false, false];
    let no_k3 = [true, true, true, true, true, true, true, true, false];
    for (name, mono, free, loss) in [
        ("full fixed", MonoOptions::default(), [false; 9], Loss::Squares),
        ("full free", MonoOptions::default(), [true; 9], Loss::Squares),
        ("no k3 fixed", MonoOptions { free: no_k3, ..MonoOptions::default() }, [false; 9], Loss::Squares),
        (
            "few fixed",
            MonoOptions { free: few, tie_aspect: true, ..MonoOptions::default() },
            [false; 9],
            Loss::Squares,
        ),
        (
            "few free",
            MonoOptions { free: few, tie_aspect: true, ..MonoOptions::default() },
            few,
            Loss::Squares,
        ),
        (
            "few free cauchy",
            MonoOptions {
                free: few,
                tie_aspect: true,
                loss: Loss::Cauchy { scale_px: 0.5 },
                ..MonoOptions::default()
            },
            few,
            Loss::Cauchy { scale_px: 0.5 },
        ),
    ] {
        println!("== {name}");
        let (cameras, _) = calibrate(copy(0), &detector, Solver { mono, rig: RigOptions { free, loss } });
        let (check, _) = check_boards(&cameras, &views, &Limits::default());
        for (c, cam) in check.cameras.iter().zip(&cameras) {
            println!(
                "  {}: {} views, own {:?} common {:?}; f {:.1}",
                c.camera,
                c.views,
                c.own_px.map(|s| (s.median, s.p95)),
                c.common_px.map(|s| (s.median, s.p95)),
                cam.model.fx
            );
        }
    }
}
