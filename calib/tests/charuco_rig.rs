//! Four webcams around a room, software-synchronised, and a ChArUco board carried about: half of the instants
//! calibrate, the other half judge. The clock of one is off.

mod support;

use std::{fs, path::Path, process::Command, sync::Arc};

use netcord_calib::{
    check::{Limits, check_boards},
    detect::{Absence, BoardView, Depth, Detector},
    gather::{Rejection, read},
    session::{Outcome, Session, SessionCamera, Setup, Shot, Sight, Task},
    solve::{CameraViews, RigCalibration, View, looks_around, on_time},
    table::TableCamera,
};
use rayon::prelude::*;
use support::{detector, shared};

const BOARD: &str = "charuco:4x5:DICT_4X4_1000:54mm:40.5mm:inverted";
const CAMERAS: usize = 4;
/// The instant from which the board is in the room.
const ARRIVES: usize = 60;

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
    Some((ARRIVES..stamps.len()).into_par_iter().map(shot).collect())
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

/// A session's rig.
fn calibrate(shots: Vec<Shot>, detector: &Arc<Detector>) -> RigCalibration {
    let camera = |i: usize| SessionCamera { name: format!("cam{i}"), model: None, camera_from_first: None };
    let setup = Setup::new(Task::Rig, (0..CAMERAS).map(camera).collect());
    let mut session = Session::new(setup, Arc::clone(detector));
    session.offer_all(shots).expect("gathers");
    let kept = session.kept().len();
    let result = session.process().expect("views").solve(&|_, _| {}).expect("calibrates");
    let Outcome::Rig { rig, .. } = result else { panic!("a rig") };
    println!("{kept} shots, {:.3} px RMS; rejected: {:?}", rig.rms_px, rig.rejected.len());
    for c in &rig.cameras {
        println!("{}: {:?}, {} views without known motion", c.name, c.clock, c.unmoved);
    }
    *rig
}

/// Every second instant calibrates; how the board moves in it is told by those alone, too. The others judge.
const fn is_used(instant: usize) -> bool {
    instant.is_multiple_of(2)
}

/// Views of the other shots, as simultaneous as the session asks for; all shots tell how the board moves in
/// them.
fn fresh_views(shots: &[Shot], detector: &Detector) -> Vec<CameraViews> {
    const TOGETHER_NS: u64 = 5_000_000;
    const LEAST: usize = 6;
    let camera = |c: usize| CameraViews { name: format!("cam{c}"), size: (1280, 720), views: Vec::new() };
    let mut views: Vec<CameraViews> = (0..CAMERAS).map(camera).collect();
    let view = |shot: &Shot, sight: &Sight, board: &BoardView| View {
        stamp_ns: sight.stamp_ns,
        ..detector.view(&shot.name, board)
    };
    let mut looks: Vec<Vec<View>> = vec![Vec::new(); CAMERAS];
    for shot in shots {
        for (looks, sight) in looks.iter_mut().zip(&shot.sights) {
            if let Some(Ok(sight)) = sight
                && let Ok(board) = &sight.board
            {
                looks.push(view(shot, sight, board));
            }
        }
    }
    for (_, shot) in shots.iter().enumerate().filter(|(i, _)| !is_used(*i)) {
        let boards: Vec<(usize, &Sight, &BoardView)> = (0..CAMERAS)
            .filter_map(|c| {
                let sight = shot.sights[c].as_ref()?.as_ref().ok()?;
                Some((c, sight, sight.board.as_ref().ok().filter(|b| b.corners.len() >= LEAST)?))
            })
            .collect();
        let stamps = || boards.iter().filter_map(|(_, s, _)| s.stamp_ns);
        if stamps().max().zip(stamps().min()).is_some_and(|(last, first)| last - first <= TOGETHER_NS) {
            for (c, sight, board) in boards {
                views[c].views.push(view(shot, sight, board));
            }
        }
    }
    for (camera, looks) in views.iter_mut().zip(&looks) {
        looks_around(&mut camera.views, looks);
    }
    views
}

#[test]
fn views_that_were_not_used_fit_to_a_pixel() {
    let detector = Arc::new(detector(BOARD));
    let Some(shots) = shots(&detector) else { return };
    let used = shots.iter().enumerate().filter(|(i, _)| is_used(*i)).map(|(_, s)| s.clone()).collect();
    let rig = calibrate(used, &detector);
    let cameras: Vec<TableCamera> = rig
        .cameras
        .iter()
        .map(|c| TableCamera { name: c.name.clone(), model: c.model, camera_from_first: c.camera_from_first })
        .collect();
    let clocks: Vec<f64> = rig.cameras.iter().map(|c| c.clock.as_ref().map_or(0.0, |k| k.later_s)).collect();
    let views = on_time(&fresh_views(&shots, &detector), &clocks);
    let (check, corners) = check_boards(&cameras, &views, &Limits::default());
    for c in &check.cameras {
        let (own, common) = (c.own_px.expect("views"), c.common_px.expect("views in common"));
        println!(
            "{}: {} fresh views; by itself {:.3} px (median), among the others {:.3} px, 95 % {:.2} px",
            c.camera, c.views, own.median, common.median, common.p95
        );
        // Each lens explains its own pictures: what is more comes from between the cameras.
        assert!(own.median < 0.2, "{}: {} px", c.camera, own.median);
        assert!(common.median <= 1.0, "{}: {} px", c.camera, common.median);
    }
    // The board is carried at 40 px/s and more, and cam1's frames were exposed an eighth of a second before the others'
    // of the same stamp: a webcam's clock.
    let clock = rig.cameras[1].clock.as_ref().expect("cam1's clock is off");
    assert!(clock.later_s < -4.0 * clock.sd_s, "{clock:?}");
    // The standard deviation is honest: the other half of the instants, with other jitter, gives the same within it.
    let others = shots.iter().enumerate().filter(|(i, _)| !is_used(*i)).map(|(_, s)| s.clone()).collect();
    let other = calibrate(others, &detector);
    let second = other.cameras[1].clock.as_ref().expect("cam1's clock is off");
    let apart = (clock.later_s - second.later_s).abs();
    println!(
        "cam1's clock: {clock:?} and {second:?}, {:.1} standard deviations apart",
        apart / clock.sd_s.hypot(second.sd_s)
    );
    assert!(apart < 3.0 * clock.sd_s.hypot(second.sd_s), "{clock:?} {second:?}");
    let mut all: Vec<f64> = corners.iter().map(|c| c.residual.norm()).collect();
    all.sort_by(f64::total_cmp);
    let median = all[all.len() / 2];
    println!("all {} corners: {median:.3} px (median)", all.len());
    assert!(median <= 1.0, "{median} px");
}
