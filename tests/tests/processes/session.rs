//! Calibration sessions from the preview to the saved rig, over HTTP and in a browser, held against the truth.

use std::{
    fs,
    path::{Path, PathBuf},
};

use image::GrayImage;
use nalgebra::Vector3;
use netcord_capture::synthetic::scene::BoardPath;
use netcord_common::{
    board::CalibrationBoard,
    geometry::{Board, Point, Transform, World},
    rig::{Rig, RigEdit},
};
use netcord_tests::{Browser, Lab, Page, Photographer, Running, one_at_a_time};
use nix::sys::signal::Signal;
use serde_json::{Value, json};
use toml_edit::{DocumentMut, value};

pub(super) const BOARD: &str = "charuco:6x4:DICT_4X4_50:120mm:90mm";

fn board() -> CalibrationBoard {
    CalibrationBoard::parse(BOARD, |_| Err(String::new())).expect("valid")
}

/// The cameras with fewer pixels along each side, by `by`: less work.
fn shrink(document: &mut DocumentMut, by: i64) {
    for camera in document["camera"].as_array_of_tables_mut().expect("cameras").iter_mut() {
        for size in ["width", "height"] {
            camera[size] = value(camera[size].as_integer().expect("a number") / by);
        }
        for (key, offset) in [("fx", 0.0), ("fy", 0.0), ("cx", 0.5), ("cy", 0.5)] {
            let full = camera["intrinsics"][key].as_float().expect("a number");
            camera["intrinsics"][key] = value((full + offset) / by as f64 - offset);
        }
    }
}

/// Along each side; with still fewer pixels the markers of a board over the table are no longer read.
const FEWER: i64 = 2;

/// The rig as it is, in `truth.toml`, and a file of the same rig whose cameras have lost `lost` of their tables.
pub(super) fn rigs(lab: &Lab, lost: &[&str]) -> (Rig, PathBuf) {
    let path = lab.rig_file(|document| shrink(document, FEWER));
    fs::copy(&path, lab.path("truth.toml")).expect("copied");
    let truth = Lab::load(&path);
    let path = lab.rig_file(|document| {
        shrink(document, FEWER);
        document.remove("table");
        for camera in document["camera"].as_array_of_tables_mut().expect("cameras").iter_mut() {
            for table in lost {
                camera.remove(table);
            }
        }
    });
    (truth, path)
}

/// Nobody has calibrated anything yet.
pub(super) const ALL: [&str; 2] = ["intrinsics", "pose"];

/// Where a person would hold the board: a tour before all cameras.
pub(super) fn places(rig: &Rig) -> Vec<Transform<World, Board>> {
    let csv = BoardPath::tour(rig, &board()).to_csv();
    let stop = |line: &str| {
        let n: Vec<f64> = line.split(',').map(|v| v.parse().expect("a number")).collect();
        Transform::from_rodrigues(Vector3::new(n[4], n[5], n[6]), Vector3::new(n[1], n[2], n[3]))
    };
    // Each place stands there twice: when the board comes and when it goes. The last is the first.
    let stops: Vec<_> = csv.lines().skip(1).step_by(2).map(stop).collect();
    stops[..stops.len() - 1].to_vec()
}

/// Pictures of the board at `places` by each camera that sees it, in a folder of each camera's name.
pub(super) fn photograph(lab: &Lab, rig: &Rig, places: &[Transform<World, Board>]) {
    for camera in &rig.cameras {
        let folder = lab.path(camera.name.as_str());
        fs::create_dir(&folder).expect("a folder");
        let photographer = Photographer::new(&camera.model);
        for (i, world_from_board) in places.iter().enumerate() {
            let camera_from_board = &camera.camera_from_world * world_from_board;
            if photographer.sees(&board(), &camera_from_board) {
                let picture = photographer.picture(&board(), &camera_from_board);
                picture.save(folder.join(format!("{i:03}.png"))).expect("written");
            }
        }
    }
}

pub(super) fn start(lab: &Lab, rig: &Path, more: &[&str]) -> (Running, Page, String) {
    let rig = rig.display().to_string();
    let mut arguments = vec!["calib", "session", &rig, "--board", BOARD, "--port", "0"];
    arguments.extend(more);
    let session = lab.start(&arguments);
    let url = session.line();
    let page = Page::at(&url);
    page.state_when("the session's first state", |_| true);
    (session, page, url)
}

fn from_pictures(lab: &Lab, rig: &Path, more: &[&str]) -> (Running, Page, String) {
    let images = ["left", "right"].map(|name| format!("{name}={}", lab.path(name).display()));
    start(lab, rig, &[&["--images", &images[0], &images[1]], more].concat())
}

fn phase(state: &Value) -> &str {
    state["session"]["phase"].as_str().expect("a phase")
}

fn kept(state: &Value) -> usize {
    state["session"]["kept"].as_array().expect("a list").len()
}

/// Computes, looks and saves.
fn process_and_save(page: &Page) -> Value {
    page.act(&json!({ "do": "process" })).expect("there are views");
    let state = page.state_when("a result", |s| phase(s) != "processing");
    assert_eq!(phase(&state), "review", "{}", state["session"]["failure"]);
    let result = page.json("result");
    page.act(&json!({ "do": "save" })).expect("there is a result");
    page.state_when("saved", |s| phase(s) == "saved");
    result
}

/// How far, px, the images of points all over a camera's view are from where they are in truth, at most, when the
/// camera is turned as suits them best: what is wrong with the lens, and nothing else.
fn lens_error_px(rig: &Path, truth: &Rig) -> Vec<f64> {
    let edit = RigEdit::open(rig).expect("a rig file");
    let cameras = truth.cameras.iter().map(|camera| {
        let found = edit.intrinsics(camera.name.as_str()).expect("calibrated");
        let (w, h) = (f64::from(camera.model.width), f64::from(camera.model.height));
        let grid = (0..63).map(|i| (f64::from(i % 9) / 8.0, f64::from(i / 9) / 6.0));
        let shifts: Vec<_> = grid
            .map(|(x, y)| nalgebra::Vector2::new(w * (0.1 + 0.8 * x), h * (0.1 + 0.8 * y)))
            .map(|pixel| {
                let ray = camera.model.ray(&pixel).expect("inside");
                found.project(&Point::from(ray)).expect("in view") - pixel
            })
            .collect();
        // A small turn moves all pixels about alike.
        let mean = shifts.iter().sum::<nalgebra::Vector2<f64>>() / shifts.len() as f64;
        shifts.iter().map(|s| (s - mean).norm()).fold(0.0, f64::max)
    });
    cameras.collect()
}

/// How far the second camera stands, seen from the first, from where it does in truth: mm and degrees.
fn pose_error(rig: &Path, truth: &Rig) -> (f64, f64) {
    // Without a table, the rig's frame is the first camera's.
    let found = Lab::load(rig);
    let right_from_left =
        |rig: &Rig| &rig.cameras[1].camera_from_world * &rig.cameras[0].camera_from_world.inverse();
    let (found, truth) = (right_from_left(&found), right_from_left(truth));
    let off_mm = (found.translation - truth.translation).norm() * 1e3;
    (off_mm, (found.rotation * truth.rotation.inverse()).angle().to_degrees())
}

#[test]
fn a_session_on_pictures_survives_a_kill_and_ends_in_a_rig_that_is_right() {
    let lab = Lab::new();
    let (truth, rig) = rigs(&lab, &ALL);
    photograph(&lab, &truth, &places(&truth));
    // What a person takes along by mistake.
    GrayImage::from_pixel(960, 600, image::Luma([90]))
        .save(lab.path("left").join("wall.png"))
        .expect("written");
    fs::write(lab.path("left").join("broken.png"), b"\x89PNG\r\n\x1a\nno more").expect("written");

    let (mut session, page, _) = from_pictures(&lab, &rig, &[]);
    assert!(String::from_utf8_lossy(&page.get("")).contains("<title>netcord calibration</title>"));
    let foreign = "Origin: http://evil.example\r\nContent-Type: application/json\r\n";
    assert_eq!(page.request("POST", "act", foreign, "{\"do\":\"gather\"}").0, 403);
    let state = page.state_when("a preview", |s| {
        !s["session"]["cameras"][0]["corners"].as_array().expect("a list").is_empty()
    });
    assert_eq!((phase(&state), kept(&state)), ("preview", 0));
    assert!(page.get("picture?camera=left").starts_with(&[0xff, 0xd8]));
    assert!(page.act(&json!({ "do": "process" })).expect_err("nothing kept").contains("no view"));
    assert!(page.act(&json!({ "do": "save" })).expect_err("nothing to save").contains("process first"));
    assert!(page.act(&json!({ "do": "dance" })).expect_err("no command").contains("dance"));

    page.act(&json!({ "do": "gather" })).expect("may");
    page.state_when("some views", |s| kept(s) >= 6);
    session.signal(Signal::SIGKILL);
    while session.runs() {
        std::thread::yield_now();
    }
    let (session, page, _) = from_pictures(&lab, &rig, &[]);
    let state = page.state_when("the session again", |s| s["version"].as_u64() > Some(0));
    assert!(kept(&state) >= 6, "goes on where it was: {state:#}");
    page.act(&json!({ "do": "gather" })).expect("may");
    let state = page.state_when("the last picture", |s| s["source"]["ended"] == true);
    let names = |state: &Value| -> Vec<String> {
        let kept = state["session"]["kept"].as_array().expect("a list").iter();
        kept.map(|k| k["name"].as_str().expect("a name").to_owned()).collect()
    };
    let all = names(&state);
    assert!(all.is_sorted() && all.windows(2).all(|w| w[0] != w[1]), "each picture once, in order: {all:?}");
    let tally = &state["session"]["cameras"][0]["tally"];
    assert_eq!((&tally["no board"], &tally["unreadable picture"]), (&json!(1), &json!(1)), "{tally}");

    page.act(&json!({ "do": "undo" })).expect("something to undo");
    let state = page.state_when("undone", |s| kept(s) < all.len());
    assert_eq!(names(&state), all[..all.len() - 1]);
    let result = process_and_save(&page);
    for camera in 0..2 {
        let views = result["cameras"][camera]["views"].as_array().expect("a list");
        assert!(views.len() >= 12, "camera {camera}: {} views", views.len());
    }
    let rms = result["report"]["rms_px"].as_f64().expect("a number");
    assert!(rms < 0.1, "{rms}");
    let shot = names(&state)[0].clone();
    let raw = page.get(&format!("view?shot={shot}&camera=left"));
    let straight = page.get(&format!("view?shot={shot}&camera=left&undistorted=1"));
    assert!(raw.starts_with(&[0xff, 0xd8]) && straight.starts_with(&[0xff, 0xd8]) && raw != straight);
    let lens = lens_error_px(&rig, &truth);
    assert!(lens.iter().all(|e| *e < 0.5), "{lens:?} px");

    page.act(&json!({ "do": "task", "task": "rig" })).expect("there are two cameras");
    page.act(&json!({ "do": "gather" })).expect("may");
    let state = page.state_when("the last picture", |s| s["source"]["ended"] == true);
    let tally = &state["session"]["cameras"][0]["tally"];
    assert!(tally["one camera only"].as_u64() >= Some(10), "{tally}");
    let result = process_and_save(&page);
    assert_eq!(result["report"]["kind"], "stereo");
    let (off_mm, off_deg) = pose_error(&rig, &truth);
    assert!(off_mm < 4.0 && off_deg < 0.1, "{off_mm} mm, {off_deg}°");
    assert!(rig.with_extension("toml.bak").exists(), "the old file is kept");
    assert_eq!(session.stop().code, Some(0));

    // At last the board lies on the table; its place there is given in the page.
    let lying = places(&truth).last().copied().expect("the tour ends on the table");
    let along = lying.rotation * Vector3::x();
    fs::create_dir(lab.path("table")).expect("a folder");
    let images: Vec<String> = truth
        .cameras
        .iter()
        .map(|camera| {
            let picture =
                Photographer::new(&camera.model).picture(&board(), &(&camera.camera_from_world * &lying));
            let folder = lab.path("table").join(camera.name.as_str());
            fs::create_dir(&folder).expect("a folder");
            picture.save(folder.join("lying.png")).expect("written");
            format!("{}={}", camera.name, folder.display())
        })
        .collect();
    let (session, page, _) = start(&lab, &rig, &["--images", &images[0], &images[1], "--task", "table"]);
    page.act(&json!({ "do": "gather" })).expect("may");
    let state = page.state_when("the picture", |s| s["source"]["ended"] == true);
    assert_eq!(kept(&state), 1, "{:#}", state["session"]["cameras"]);
    assert!(page.act(&json!({ "do": "process" })).expect_err("where?").contains("how the board lies"));
    let (at, turned_deg) = (lying.translation, along.y.atan2(along.x).to_degrees());
    let place =
        json!({ "do": "place", "x_m": at.x, "y_m": at.y, "turned_deg": turned_deg, "height_m": at.z });
    page.act(&place).expect("four numbers");
    let result = process_and_save(&page);
    assert_eq!(result["report"]["kind"], "table");
    let found = Lab::load(&rig);
    for (found, truth) in found.cameras.iter().zip(&truth.cameras) {
        let (found, truth) = (found.camera_from_world.origin(), truth.camera_from_world.origin());
        assert!(found.distance(&truth) < 6e-3, "{found:?} in place of {truth:?}");
    }
    assert_eq!(session.stop().code, Some(0));
}

#[test]
fn a_session_on_a_recording_finds_the_poses() {
    let lab = Lab::new();
    let (truth, rig) = rigs(&lab, &["pose"]);
    let board = board();
    let cameras: Vec<_> = truth.cameras.iter().map(|c| (c, Photographer::new(&c.model))).collect();
    let pose = |camera: &netcord_common::rig::RigCamera, place: &Transform<World, Board>| {
        &camera.camera_from_world * place
    };
    let seen_by_all = places(&truth)
        .into_iter()
        .filter(|place| cameras.iter().all(|(c, p)| p.sees(&board, &pose(c, place))));
    let mut shots = 0;
    for place in seen_by_all.take(12) {
        for (camera, photographer) in &cameras {
            let folder = lab.path("film").join(camera.name.as_str());
            fs::create_dir_all(&folder).expect("a folder");
            let picture = photographer.picture(&board, &pose(camera, &place));
            // A board that is held still is in two pictures.
            for copy in ["a", "b"] {
                picture.save(folder.join(format!("{shots:02}{copy}.png"))).expect("written");
            }
        }
        shots += 1;
    }
    assert!(shots >= 10, "{shots}");
    let (film, file) = (lab.path("film").display().to_string(), lab.path("film.mcap").display().to_string());
    let ended = lab.start(&["import", &film, "--out", &file, "--rate", "10"]).wait();
    assert_eq!(ended.code, Some(0), "{}", ended.err);

    let (session, page, _) = start(&lab, &rig, &["--recording", &file, "--task", "rig"]);
    page.act(&json!({ "do": "gather" })).expect("may");
    let state = page.state_when("the recording's end", |s| s["source"]["ended"] == true);
    assert!(kept(&state) >= 8 && kept(&state) <= shots, "{} of {shots}", kept(&state));
    let tally = &state["session"]["cameras"][0]["tally"];
    assert!(tally["moving"].as_u64() >= Some(8), "the first of two pictures is on the move: {tally}");
    process_and_save(&page);
    let (off_mm, off_deg) = pose_error(&rig, &truth);
    assert!(off_mm < 4.0 && off_deg < 0.1, "{off_mm} mm, {off_deg}°");
    assert_eq!(session.stop().code, Some(0));
}

#[test]
fn a_session_on_a_running_rig_leads_from_nothing_to_a_rig_that_is_right() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let (truth, rig) = rigs(&lab, &ALL);
    // The tour's places before the left camera, the right one, and both: each in three frames, one on the way. They
    // are rendered beforehand, so that a busy machine loses none.
    let tour = BoardPath::tour(&truth, &board()).to_csv();
    let stops: Vec<&str> = tour.lines().skip(1).step_by(2).collect();
    let mut way = String::new();
    for (i, stop) in stops[..stops.len() - 1].iter().enumerate() {
        let (_, pose) = stop.split_once(',').expect("seven numbers");
        let t_s = i as f64 * 0.5;
        way.push_str(&format!("{t_s},{pose}\n{},{pose}\n", t_s + 0.375));
    }
    fs::write(lab.path("way.csv"), way).expect("written");
    let (truth_file, way) =
        (lab.path("truth.toml").display().to_string(), lab.path("way.csv").display().to_string());
    let frames = (4 * (stops.len() - 1)).to_string();
    let capture = lab.start(&[
        "capture",
        "--rig",
        &truth_file,
        "--source",
        "synthetic",
        "--scene",
        "clean",
        "--rate",
        "8",
        "--prerendered",
        &frames,
        "--board",
        BOARD,
        "--board-path",
        &way,
    ]);
    let (session, page, _) = start(&lab, &rig, &[]);
    page.state_when("a live preview", |s| !s["session"]["cameras"][0]["size"].is_null());
    page.act(&json!({ "do": "gather" })).expect("may");
    let views = |state: &Value, camera: usize| state["session"]["cameras"][camera]["views"].as_u64();
    let state =
        page.state_when("views of both lenses", |s| views(s, 0) >= Some(14) && views(s, 1) >= Some(14));
    assert!(state["session"]["cameras"][0]["tally"]["moving"].as_u64() >= Some(1), "{state:#}");
    page.act(&json!({ "do": "pause" })).expect("may");
    process_and_save(&page);
    let lens = lens_error_px(&rig, &truth);
    assert!(lens.iter().all(|e| *e < 1.0), "{lens:?} px");
    page.act(&json!({ "do": "task", "task": "rig" })).expect("there are two cameras");
    page.act(&json!({ "do": "gather" })).expect("may");
    page.state_when("views of both at once", |s| kept(s) >= 6);
    process_and_save(&page);
    let (off_mm, off_deg) = pose_error(&rig, &truth);
    assert!(off_mm < 10.0 && off_deg < 0.3, "{off_mm} mm, {off_deg}°");
    assert_eq!(session.stop().code, Some(0));
    assert_eq!(capture.stop().code, Some(0));
}

#[test]
fn a_session_that_cannot_be_is_refused_with_what_would_do() {
    let lab = Lab::new();
    let (_, rig) = rigs(&lab, &ALL);
    let rig = rig.display().to_string();
    fs::create_dir(lab.path("empty")).expect("a folder");
    let empty = lab.path("empty").display().to_string();
    let cases: [(&[&str], &str); 5] = [
        (&["--board", "chessboard:9x6"], "too few"),
        (&["--board", BOARD, "--images", "middle=x"], "no such camera; it has left, right"),
        (&["--board", BOARD, "--images", &empty], "Write NAME="),
        (&["--board", BOARD, "--images", &format!("left={empty}")], "holds no PNG or JPEG"),
        (&["--board", BOARD, "--recording", &rig], "rig.toml"),
    ];
    for (arguments, says) in cases {
        let ended = lab.start(&[&["calib", "session", &rig, "--port", "0"], arguments].concat()).wait();
        assert_eq!(ended.code, Some(2), "{arguments:?}");
        assert!(ended.err.contains(says), "{arguments:?}: {}", ended.err);
    }
}

#[test]
fn the_page_leads_from_preview_to_save_in_chromium() {
    let Some(chromium) = Browser::installed() else {
        println!("SKIPPED: Chromium is not installed (tests/chromium.sh installs Debian's)");
        return;
    };
    let lab = Lab::new();
    let (truth, rig) = rigs(&lab, &ALL);
    // One camera's pictures are enough for the page.
    photograph(&lab, &truth, &places(&truth)[..15]);
    let image = format!("left={}", lab.path("left").display());
    let (session, page, url) = start(&lab, &rig, &["--images", &image]);
    let mut browser = Browser::open(&chromium, &url, (1280, 800));
    browser.wait_for("document.querySelectorAll('.camera .corner').length >= 15");
    browser.wait_for("[...document.querySelectorAll('.camera img')].some(i => i.naturalWidth > 300)");
    assert_eq!(browser.value("document.querySelector('#steps .now').textContent"), "Preview");
    browser.click("#do-gather");
    browser.wait_for("document.querySelectorAll('#strip figure').length >= 10");
    browser.wait_for("document.querySelector('#do-process.main')");
    let before = page.json("state");
    assert!(browser.value("document.querySelectorAll('.map .heat').length").as_u64() > Some(20));
    browser.click("#do-undo");
    page.state_when("undone", |s| kept(s) + 1 == kept(&before));
    browser.click("#do-process");
    browser.wait_for("document.querySelectorAll('#bars button').length >= 10");
    browser.wait_for("document.querySelectorAll('#review-frame .residual').length >= 15");
    browser.click("#bars button:nth-of-type(2)");
    browser.wait_for(
        "document.querySelector('#bars button:nth-of-type(2)').getAttribute('aria-pressed') === 'true'",
    );
    browser.click("#lens [data-lens=undistorted]");
    browser.wait_for("document.querySelector('#review-frame img').src.includes('undistorted') && document.querySelector('#review-frame img').naturalWidth > 300");
    assert!(
        browser.value("document.querySelector('#figures').innerText").as_str().expect("text").contains("RMS")
    );
    // Nothing is cut off at the sides of a small laptop's screen.
    assert_eq!(browser.value("document.documentElement.scrollWidth"), json!(1280));
    browser.click("#do-save");
    browser.wait_for("document.querySelector('#do-save').disabled");
    assert!(RigEdit::open(&rig).expect("a rig file").intrinsics("left").is_some());
    assert!(browser.complaints().is_empty(), "{:?}", browser.complaints());
    assert_eq!(session.stop().code, Some(0));
    browser.wait_for("!document.querySelector('#lost').hidden");
}
