//! The session with simulated cameras and people.

use std::sync::Arc;

use nalgebra::{Rotation3, Vector3};
use netcord_common::{
    camera::{CameraModel, Distortion},
    geometry::{Board, Camera, Point, Transform, World},
};

use super::*;
use crate::{
    board::CalibrationBoard,
    detect::{Absence, BoardView, Corner, Detector, Luma},
    gather::Rejection,
};

const SIZE: (u32, u32) = (1280, 800);

fn lens() -> CameraModel {
    let distortion = Distortion::from_array([-0.12, 0.06, 3e-4, -2e-4, 0.0]);
    CameraModel::new(SIZE, (900.0, 902.0), (650.0, 395.0), distortion).expect("valid")
}

fn detector() -> Arc<Detector> {
    let board = CalibrationBoard::parse("charuco:8x6:DICT_5X5_250:40mm:30mm", |_| Err(String::new()));
    Arc::new(Detector::new(board.expect("valid")))
}

fn session(task: Task, cameras: usize, known: bool, continuous: bool) -> Session {
    let camera = |i: usize| SessionCamera {
        name: ["left", "right"][i].into(),
        model: known.then(lens),
        camera_from_first: None,
    };
    let setup = Setup { continuous, ..Setup::new(task, (0..cameras).map(camera).collect()) };
    Session::new(setup, detector())
}

/// The board's middle at the pixel `(u, v)`, `distance` away, turned by the angles about the camera's x and y axes.
fn pose(u: f64, v: f64, distance: f64, about_x: f64, about_y: f64) -> Transform<Camera, Board> {
    let turn = Rotation3::new(Vector3::y() * about_y) * Rotation3::new(Vector3::x() * about_x);
    let middle = Vector3::new(0.16, 0.12, 0.0);
    let at = Vector3::new((u - 650.0) / 900.0, (v - 395.0) / 900.0, 1.0) * distance;
    Transform::new(turn, at - turn * middle)
}

/// What a camera sees of the board, with noise of 0.03 px that no two corners share.
fn board_at(pose: &Transform<Camera, Board>) -> BoardView {
    let model = lens();
    let corners = detector()
        .points()
        .iter()
        .enumerate()
        .filter_map(|(id, p)| {
            let at = model.project(&(pose * Point::from(*p)))?;
            let phase = at.x * 12.9898 + at.y * 78.233 + id as f64;
            let noise = |s: f64| 0.06 * ((phase * s).sin() * 43_758.545).fract();
            let at = at + nalgebra::Vector2::new(noise(1.0), noise(1.7));
            model.contains(&at).then_some(Corner { id, at })
        })
        .collect();
    BoardView { corners, markers: Vec::new(), anchored: true }
}

fn sight(pose: &Transform<Camera, Board>, stamp_ns: u64) -> Sight {
    Sight { size: SIZE, stamp_ns: Some(stamp_ns), board: Ok(board_at(pose)), blur_px: Some(0.7) }
}

fn shot(name: &str, sights: Vec<Option<Sight>>) -> Shot {
    Shot { name: name.into(), sights: sights.into_iter().map(|s| s.map(Ok)).collect() }
}

fn alone(name: &str, pose: &Transform<Camera, Board>) -> Shot {
    shot(name, vec![Some(sight(pose, 0))])
}

fn reason(session: &Session, camera: usize) -> &'static str {
    let verdict = session.last_verdict().expect("looked").cameras[camera].as_ref().expect("a picture");
    verdict.as_ref().expect_err("rejected").kind()
}

#[test]
fn every_reason_to_reject_is_given_and_counted() {
    let mut session = session(Task::Mono, 1, false, false);
    let here = pose(640.0, 400.0, 0.6, 0.0, 0.0);
    assert!(session.offer(&alone("early", &here)).is_none(), "nothing is kept in the preview");
    session.gather().expect("may");
    assert_eq!(session.offer(&alone("first", &here)).map(|k| k.name.as_str()), Some("first"));
    assert!(session.offer(&alone("again", &pose(645.0, 402.0, 0.6, 0.0, 0.0))).is_none());
    assert_eq!(reason(&session, 0), "like a kept view (IoU)");

    let there = pose(300.0, 300.0, 0.8, 0.3, 0.3);
    let changed = |change: &dyn Fn(&mut Sight)| {
        let mut sight = sight(&there, 0);
        change(&mut sight);
        shot("changed", vec![Some(sight)])
    };
    let cases: [(&str, &dyn Fn(&mut Sight)); 4] = [
        ("blurred", &|s| s.blur_px = Some(4.0)),
        ("other picture size", &|s| s.size = (640, 480)),
        ("no board", &|s| s.board = Err(Absence::Nothing { wanted: "a board".into() })),
        ("too few corners", &|s| s.board.as_mut().expect("a board").corners.truncate(5)),
    ];
    for (kind, change) in cases {
        assert!(session.offer(&changed(change)).is_none(), "{kind}");
        assert_eq!(reason(&session, 0), kind);
    }
    let unreadable =
        Shot { name: "x".into(), sights: vec![Some(Err(Rejection::Unreadable("cut off".into())))] };
    assert!(session.offer(&unreadable).is_none());
    assert_eq!(reason(&session, 0), "unreadable picture");

    let counted = &session.tallies()[0].rejected;
    assert_eq!((counted.len(), counted.values().sum::<u64>()), (6, 6), "{counted:?}");
    assert!(session.offer(&alone("second", &there)).is_some());
    assert_eq!(session.undo().expect("two are kept").name, "second");
    assert!(session.offer(&alone("second again", &there)).is_some(), "undone, it is new again");
    assert_eq!(session.drop_shot("first").expect("kept").name, "first");
    assert_eq!(session.drop_shot("first"), Err(SessionError::Unknown("first".into())));
    assert_eq!(session.kept().len(), 1);
}

#[test]
fn a_board_must_be_held_still_and_waiting_counts_once() {
    let mut session = session(Task::Mono, 1, false, true);
    session.gather().expect("may");
    let at = |u: f64| alone("look", &pose(u, 400.0, 0.7, 0.2, 0.0));
    assert!(!session.look(&at(500.0)).keeps_any());
    assert!(matches!(session.advice(), Advice::HoldStill { .. }), "just seen: {}", session.advice());
    for u in [520.0, 540.0, 560.0] {
        assert!(!session.look(&at(u)).keeps_any(), "{u}");
        assert_eq!(reason(&session, 0), "moving");
    }
    assert!(session.look(&at(560.2)).keeps_any(), "still");
    assert_eq!(session.tallies()[0].rejected["moving"], 1);
    assert!(session.offer(&at(560.2)).is_some());
    for _ in 0..5 {
        assert!(!session.look(&at(560.2)).keeps_any());
    }
    assert_eq!(session.tallies()[0].rejected["like a kept view (IoU)"], 1);
}

/// Does what the session says: where the board goes next.
fn obey(advice: &Advice, turn: usize) -> Transform<Camera, Board> {
    let jitter = |k: usize| ((turn * 37 + k * 11) % 17) as f64 / 17.0 - 0.5;
    let tilt = 0.5 + 0.2 * jitter(1);
    match advice {
        Advice::MoveTo { place, .. } => {
            let (u, v) = (230.0 + 420.0 * place.column as f64, 170.0 + 230.0 * place.row as f64);
            pose(u, v, 0.85 + 0.1 * jitter(0), 0.3 * jitter(2), 0.3 * jitter(3))
        }
        Advice::Tilt { edge, .. } => {
            // Turned about x by +a, the board's bottom (larger y) goes away.
            let (x, y) = match edge {
                Tilt::Bottom => (tilt, 0.0),
                Tilt::Top => (-tilt, 0.0),
                Tilt::Left => (0.0, tilt),
                Tilt::Right => (0.0, -tilt),
            };
            pose(640.0 + 200.0 * jitter(4), 400.0 + 120.0 * jitter(5), 0.7, x, y)
        }
        Advice::Closer { .. } => pose(640.0, 400.0, 0.4, 0.1, 0.1),
        Advice::Farther { .. } => pose(640.0, 400.0, 1.3, 0.1, -0.1),
        _ => pose(640.0 + 500.0 * jitter(6), 400.0 + 300.0 * jitter(7), 0.9, jitter(8), jitter(9)),
    }
}

#[test]
fn a_person_who_does_as_told_is_done_and_the_lens_is_right() {
    let mut session = session(Task::Mono, 1, false, false);
    assert_eq!(session.advice(), Advice::Start);
    session.gather().expect("may");
    let mut given = Vec::new();
    for turn in 0..60 {
        let advice = session.advice();
        if advice == Advice::Process {
            break;
        }
        session.offer(&alone(&format!("view{turn}"), &obey(&advice, turn)));
        given.push(advice.to_string());
    }
    assert_eq!(session.advice(), Advice::Process, "{given:#?}");
    assert!(session.kept().len() <= 30, "{} views", session.kept().len());
    let places = given.iter().filter(|a| a.contains("Move the board to")).count();
    let tilts = given.iter().filter(|a| a.contains("Tilt the board")).count();
    assert!(places >= 3 && tilts >= 2, "{given:#?}");

    let problem = session.process().expect("views are there");
    assert!(session.gather().is_err() && session.undo().is_err(), "not while processing");
    let steps = std::cell::RefCell::new(Vec::new());
    let outcome = problem.solve(&|what, share| steps.borrow_mut().push((what.to_owned(), share)));
    assert!(steps.borrow().iter().all(|(_, s)| (0.0..1.0).contains(s)) && !steps.borrow().is_empty());
    session.finish(outcome);
    assert_eq!(session.phase(), Phase::Review);
    let outcome = Arc::clone(session.outcome().expect("a result"));
    let model = outcome.model("left").expect("calibrated");
    let truth = lens();
    assert!((model.fx - truth.fx).abs() < 0.5 && (model.cx - truth.cx).abs() < 0.5, "{model:?}");
    let name = session.kept()[0].name.clone();
    assert_eq!(
        outcome.residuals("left", &name).expect("took part").len(),
        session.kept()[0].views[0].as_ref().expect("kept").view.image.len()
    );
    // A view that goes makes the result stale; saving needs one.
    session.drop_shot(&name).expect("kept");
    assert!(session.is_stale());
    session.saved().expect("there is a result");
    assert_eq!(session.phase(), Phase::Saved);
}

#[test]
fn what_cannot_be_solved_is_said_and_the_session_goes_on() {
    let mut session = session(Task::Mono, 1, false, false);
    assert_eq!(session.process().expect_err("nothing kept"), SessionError::NoViews);
    assert!(session.saved().is_err());
    session.gather().expect("may");
    for (i, u) in [300.0, 640.0, 980.0].iter().enumerate() {
        session.offer(&alone(&format!("{i}"), &pose(*u, 400.0, 0.9, 0.0, 0.0)));
    }
    let problem = session.process().expect("three views");
    session.finish(problem.solve(&|_, _| {}));
    let failure = session.failure().expect("all alike").to_owned();
    assert!(failure.contains("left"), "{failure}");
    assert_eq!(session.phase(), Phase::Preview);
    session.gather().expect("goes on");
    assert_eq!(session.kept().len(), 3);
}

/// The second camera stands 0.3 m to the right of the first, turned inwards.
fn right_from_left() -> Transform<Camera, World> {
    Transform::from_rodrigues(Vector3::new(0.01, 0.25, -0.02), Vector3::new(-0.3, 0.01, 0.05))
}

fn both(name: &str, left: &Transform<Camera, Board>, apart_ns: u64) -> Shot {
    let in_world = Transform::<World, Board>::new(left.rotation, left.translation);
    let right = &right_from_left() * &in_world;
    shot(name, vec![Some(sight(left, 1_000_000_000)), Some(sight(&right, 1_000_000_000 + apart_ns))])
}

#[test]
fn poses_need_views_that_two_cameras_have_at_once() {
    let mut session = session(Task::Rig, 2, true, false);
    session.gather().expect("may");
    let near = pose(640.0, 400.0, 0.9, 0.1, 0.1);
    assert!(matches!(session.advice(), Advice::ShowToBoth { common: 0, .. }), "{}", session.advice());
    assert!(session.offer(&both("late", &near, 20_000_000)).is_none());
    assert_eq!(reason(&session, 1), "not simultaneous");
    assert!(matches!(session.advice(), Advice::HoldStill { .. }), "{}", session.advice());
    let mut one = both("one", &near, 0);
    one.sights[1] = None;
    assert!(session.offer(&one).is_none());
    assert_eq!(reason(&session, 0), "one camera only");

    for turn in 0..40 {
        if session.advice() == Advice::Process {
            break;
        }
        let left = obey(&session.advice(), turn);
        session.offer(&both(&format!("{turn}"), &left, 1000));
    }
    assert_eq!(session.advice(), Advice::Process);
    let again = both("again", &near, 0);
    let first_time = session.offer(&again).is_some();
    assert!(session.offer(&again).is_none() || !first_time);
    let problem = session.process().expect("views");
    let outcome = problem.solve(&|_, _| {}).expect("solves");
    let Outcome::Rig { solved, rig, .. } = &outcome else { panic!("poses were asked for") };
    assert!(solved.is_empty(), "intrinsics were known");
    let off = rig.cameras[1].camera_from_first.translation - right_from_left().translation;
    assert!(off.norm() < 3e-4, "{off}");
    assert_eq!(outcome.report().kind, "stereo");
}

/// A board in a hand.
fn carried(t: f64) -> Transform<Camera, Board> {
    let swing = |reach: f64, period: f64| reach * (t / period * std::f64::consts::TAU).sin();
    pose(
        640.0 + swing(180.0, 3.1),
        400.0 + swing(110.0, 2.3),
        0.95 + swing(0.1, 4.1),
        swing(0.3, 3.7),
        swing(0.3, 2.9),
    )
}

#[test]
fn a_clock_is_found_while_the_board_is_carried_from_place_to_place() {
    for later_s in [0.0, 0.03] {
        let mut session = session(Task::Rig, 2, true, true);
        session.gather().expect("may");
        for turn in 0..12 {
            session.offer(&both(&format!("still {turn}"), &obey(&Advice::Wait, turn), 1000));
        }
        for look in 0..60u64 {
            let (stamp_ns, t) = (1_000_000_000 + look * 100_000_000, look as f64 * 0.1);
            let then = carried(t + later_s);
            let right = &right_from_left() * &Transform::<World, Board>::new(then.rotation, then.translation);
            let sights = vec![Some(sight(&carried(t), stamp_ns)), Some(sight(&right, stamp_ns))];
            session.look(&shot(&format!("look {look}"), sights));
        }
        let outcome = session.process().expect("views").solve(&|_, _| {}).expect("solves");
        let Outcome::Rig { rig, .. } = &outcome else { panic!("poses were asked for") };
        assert!(rig.timed);
        let clock = rig.cameras[1].clock.as_ref();
        let found_s = clock.map_or(0.0, |c| c.later_s);
        assert!(
            clock.is_some() == (later_s != 0.0) && (found_s - later_s).abs() < 2e-3,
            "{clock:?}, {later_s} s"
        );
        // Poses come from views that were kept, which stood still.
        let off = rig.cameras[1].camera_from_first.translation - right_from_left().translation;
        assert!(off.norm() < 1e-3, "{off}");
    }
}

#[test]
fn a_lens_that_is_not_known_is_calibrated_from_the_views_for_poses() {
    let mut session = session(Task::Rig, 2, false, false);
    session.gather().expect("may");
    let mut one = both("one", &pose(500.0, 300.0, 0.7, 0.4, 0.0), 0);
    one.sights[1] = None;
    assert!(session.offer(&one).is_some(), "good for the lens");
    for turn in 0..25 {
        session.offer(&both(&format!("{turn}"), &obey(&Advice::Wait, turn), 0));
    }
    let outcome = session.process().expect("views").solve(&|_, _| {}).expect("solves");
    let Outcome::Rig { solved, rig, .. } = &outcome else { panic!("poses were asked for") };
    assert_eq!(solved.len(), 2);
    assert!((rig.cameras[1].camera_from_first.translation - right_from_left().translation).norm() < 3e-3);
}

#[test]
fn the_table_is_found_from_a_board_on_it_and_from_marks() {
    let (left, right) = (0.3, -0.2);
    let truth = Transform::<World, crate::table::Table>::from_rodrigues(
        Vector3::new(2.3, 0.1, -0.2),
        Vector3::new(0.1, 0.2, 2.2),
    );
    let poses = [Transform::identity(), right_from_left()];
    let cameras = (0..2).map(|i| SessionCamera {
        name: ["left", "right"][i].into(),
        model: Some(lens()),
        camera_from_first: Some(poses[i]),
    });
    let mut session = Session::new(Setup::new(Task::Table, cameras.collect()), detector());
    assert_eq!(session.process().expect_err("nothing yet"), SessionError::NoTable);
    session.gather().expect("may");
    assert_eq!(session.advice(), Advice::LayOnTable);
    let place = crate::table::BoardOnTable { origin_m: [left, right], yaw_rad: 0.4, height_m: 0.004 };
    let first_from_board = &truth * &place.table_from_board();
    for look in 0..4 {
        let sights = poses.iter().map(|pose| Some(sight(&(pose * &first_from_board), 0)));
        assert!(session.offer(&shot(&format!("{look}"), sights.collect())).is_some(), "{look}");
    }
    assert_eq!(session.advice(), Advice::Process);
    assert_eq!(session.process().expect_err("where does it lie?"), SessionError::NoPlace);
    session.place_board(place);
    let solved = session.process().expect("something to solve").solve(&|_, _| {});
    session.finish(solved);
    let by_board = Arc::clone(session.outcome().expect("solved"));
    let Outcome::Table(table) = by_board.as_ref() else { panic!("a table was asked for") };
    assert!((table.table.first_from_table.translation - truth.translation).norm() < 2e-3);
    assert_eq!(by_board.residuals("right", "2").expect("took part").len(), 35);
    assert_eq!(by_board.report().kind, "table");

    // Marks alone, in one camera.
    while !session.kept().is_empty() {
        session.undo().expect("kept");
    }
    for (name, at) in crate::table::MARKS.iter().take(4) {
        let in_first = &truth * Point::from(Vector3::from(*at));
        let Some(pixel) = lens().project(&(&poses[0] * in_first)) else { panic!("{name} is not seen") };
        let mark = Mark { camera: "left".into(), mark: (*name).into(), at: pixel.into() };
        session.set_mark(mark.clone()).expect("a mark");
        session.set_mark(mark).expect("again, in place of the first");
    }
    assert_eq!(session.marks().len(), 4);
    let wrong = Mark { camera: "left".into(), mark: "corner".into(), at: [0.0, 0.0] };
    assert!(session.set_mark(wrong).expect_err("no such mark").to_string().contains("x-y-"));
    let solved = session.process().expect("something to solve").solve(&|_, _| {});
    session.finish(solved);
    let Outcome::Table(table) = session.outcome().expect("solved").as_ref() else { panic!("a table") };
    assert!((table.table.first_from_table.translation - truth.translation).norm() < 1e-6);
}

#[test]
fn what_was_gathered_is_on_disk_and_goes_on_after_a_kill() {
    let root = tempfile::tempdir().expect("a folder");
    let board = detector().board().to_string();
    let folder = SessionFolder::open(root.path(), &board).expect("begins");
    let mut first = session(Task::Mono, 1, false, false);
    first.gather().expect("may");
    let picture = Luma::new(SIZE.0 as usize, SIZE.1 as usize, vec![9; 1280 * 800]).expect("fits");
    for (name, u) in [("a/b", 300.0), ("c", 900.0)] {
        let kept = first.offer(&alone(name, &pose(u, 400.0, 0.8, 0.2, 0.1))).expect("kept").clone();
        folder.store(Task::Mono, &first.setup().cameras, &kept, &[Some(&picture)]).expect("stored");
    }
    folder.note(Task::Mono, "d", Some("left: blurred".into())).expect("noted");
    // Killed while it wrote: half a shot, half a line.
    let half = root.path().join("mono/.new-3");
    std::fs::create_dir(&half).expect("a folder");
    std::fs::write(half.join("corners.json"), "{\"cam").expect("written");
    let log = root.path().join("mono/looked.jsonl");
    let text = std::fs::read_to_string(&log).expect("noted") + "{\"name\":\"e";
    std::fs::write(&log, text).expect("written");

    let folder = SessionFolder::open(root.path(), &board).expect("goes on");
    let cameras = first.setup().cameras.clone();
    let kept = folder.load(Task::Mono, &cameras).expect("reads");
    let corners = |kept: &[KeptShot]| -> Vec<(String, nalgebra::Vector2<f64>)> {
        let views = kept.iter().flat_map(|k| k.views.iter().flatten().map(|v| (k.name.clone(), &v.view)));
        views.flat_map(|(name, v)| v.image.iter().map(move |p| (name.clone(), *p))).collect()
    };
    let (before, now) = (corners(first.kept()), corners(&kept));
    assert_eq!(before.len(), now.len());
    for (a, b) in before.iter().zip(&now) {
        assert!(a.0 == b.0 && (a.1 - b.1).norm() < 1e-9, "{a:?} {b:?}");
    }
    assert_eq!(folder.looked(Task::Mono).expect("reads").into_iter().collect::<Vec<_>>(), ["d"]);
    let mut second = session(Task::Mono, 1, false, false);
    second.restore(kept);
    second.gather().expect("may");
    let third = second.offer(&alone("f", &pose(640.0, 200.0, 0.6, 0.3, 0.3))).expect("kept").clone();
    folder.store(Task::Mono, &cameras, &third, &[Some(&picture)]).expect("over the half one");
    assert_eq!(second.undo().expect("three").name, "f");
    folder.remove(Task::Mono, "f").expect("removed");
    folder.remove(Task::Mono, "a/b").expect("removed");
    let names: Vec<String> =
        folder.load(Task::Mono, &cameras).expect("reads").into_iter().map(|k| k.name).collect();
    assert_eq!(names, ["c"]);
    let path = folder.picture(Task::Mono, "c", "left").expect("listed").expect("there");
    assert_eq!(crate::gather::read(&path).expect("a PNG"), picture);
    // The corners are in the form that the folder commands read.
    let text = std::fs::read_to_string(path.with_file_name("corners.json")).expect("there");
    assert_eq!(crate::solve::read_corners(&text).expect("corners")[0].views[0].name, "c");

    let error = SessionFolder::open(root.path(), "chessboard:9x6:25mm").expect_err("another board");
    assert!(error.to_string().contains("charuco:8x6"), "{error}");
    std::fs::write(root.path().join("mono/0002-c/corners.json"), "{}").expect("written");
    let error = folder.load(Task::Mono, &cameras).expect_err("damaged");
    assert!(error.to_string().contains("0002-c"), "{error}");
}
