//! Pictures of boards that are not as they should be: each `netcord calib` command says what is wrong in one message,
//! ends with 2, and never panics; a session goes on.

use std::{fs, path::PathBuf};

use image::{GrayImage, Luma, imageops};
use netcord_tests::{Ended, Lab};
use serde_json::json;

use crate::session::{ALL, BOARD, photograph, places, rigs, start};

/// A session's folders of pictures: good ones in `left` and `right`, and what people take along by mistake.
struct Album {
    lab: Lab,
}

impl Album {
    fn new() -> Self {
        let lab = Lab::new();
        let (truth, _) = rigs(&lab, &ALL);
        // The tour begins before the left camera.
        let places = places(&truth);
        photograph(&lab, &truth, &places[..6]);
        let album = Self { lab };
        let good = album.pictures("left");
        assert!(good.len() >= 4, "{} pictures", good.len());
        let left = |k: usize| image::open(&good[k]).expect("a picture").to_luma8();
        let wall = GrayImage::from_pixel(960, 600, Luma([90]));
        for k in 0..4 {
            let name = format!("{k}.png");
            wall.save(album.new_file("walls", &name)).expect("written");
            fs::write(album.new_file("broken", &name), &fs::read(&good[k]).expect("readable")[..300])
                .expect("written");
            left(0).save(album.new_file("alike", &name)).expect("written");
            // Two of the right size, two of others.
            let picture = match k {
                0 | 1 => left(k),
                _ => imageops::resize(&left(k), 640 + 32 * k as u32, 400, imageops::FilterType::Triangle),
            };
            picture.save(album.new_file("mixed", &name)).expect("written");
            left(k).save(album.new_file("others", &format!("other-{k}.png"))).expect("written");
        }
        (0..2).for_each(|k| left(k).save(album.new_file("few", &format!("{k}.png"))).expect("written"));
        album
    }

    fn folder(&self, name: &str) -> String {
        self.lab.path(name).display().to_string()
    }

    fn new_file(&self, folder: &str, name: &str) -> PathBuf {
        fs::create_dir_all(self.lab.path(folder)).expect("a folder");
        self.lab.path(folder).join(name)
    }

    fn pictures(&self, folder: &str) -> Vec<PathBuf> {
        let entries = fs::read_dir(self.lab.path(folder)).expect("a folder");
        let mut found: Vec<PathBuf> = entries.map(|e| e.expect("an entry").path()).collect();
        found.sort();
        found
    }

    /// Runs `netcord calib` on `images`, NAME=FOLDER each.
    fn calib(&self, action: &[&str], board: &str, images: &[(&str, &str)]) -> Ended {
        let images: Vec<String> = images.iter().map(|(n, f)| format!("{n}={}", self.folder(f))).collect();
        let images: Vec<&str> = images.iter().map(String::as_str).collect();
        self.lab.start(&[&["calib"], action, &["--board", board], &images].concat()).wait()
    }

    /// The same, which must be refused; `says` are parts of what is said.
    fn refused(&self, action: &[&str], board: &str, images: &[(&str, &str)], says: &[&str]) {
        let ended = self.calib(action, board, images);
        let said = format!("{}\n{}", ended.out.join("\n"), ended.err);
        assert_eq!(ended.code, Some(2), "{action:?} {images:?}: {said}");
        for part in says {
            assert!(said.contains(part), "{action:?} {images:?}: no {part:?} in {said}");
        }
        let messages = ended.err.lines().filter(|l| l.starts_with("netcord:")).count();
        assert_eq!(messages, 1, "one message: {}", ended.err);
        assert!(!said.contains("panicked"), "{said}");
    }
}

const OTHER_DICTIONARY: &str = "charuco:6x4:DICT_6X6_50:120mm:90mm";
const CHESSBOARD: &str = "chessboard:4x7:120mm";

#[test]
fn lenses_are_refused_with_what_is_wrong_and_what_would_be_right() {
    let album = Album::new();
    let refused = |board: &str, folder: &str, says: &[&str]| {
        album.refused(&["mono"], board, &[("left", folder)], says);
    };
    refused(BOARD, "walls", &["camera left: none of its 4 pictures", "nothing else was recognised"]);
    refused(BOARD, "broken", &["camera left: none of its 4 pictures", "cannot be read as a picture"]);
    refused(BOARD, "mixed", &["it is 704 × 400 px", "pictures are 960 × 600 px", "usable views: 2"]);
    refused(BOARD, "few", &["camera left: too few usable views: 2; at least 3", "better 10 to 30"]);
    refused(BOARD, "alike", &["much as in a view that is kept", "usable views: 1", "differ from each other"]);
    refused(OTHER_DICTIONARY, "left", &["no charuco:6x4:DICT_6X6_50", "seen instead", "DICT_4X4"]);
    refused(CHESSBOARD, "left", &["chessboard:4x7", "inner corners"]);
    album.refused(
        &["mono", "--max-iou", "1"],
        BOARD,
        &[("left", "alike")],
        &["camera left: all views show the board at the same tilt", "tilt the board"],
    );
}

#[test]
fn poses_are_refused_with_what_is_wrong_and_what_would_be_right() {
    let album = Album::new();
    for action in [&["stereo"], &["rig"]] {
        let refused = |board: &str, right: &str, says: &[&str]| {
            album.refused(action, board, &[("left", "left"), ("right", right)], says);
        };
        refused(BOARD, "walls", &["camera right: none of its 4 pictures", "nothing else was recognised"]);
        refused(BOARD, "broken", &["camera right: none of its 4 pictures", "cannot be read as a picture"]);
        refused(
            BOARD,
            "mixed",
            &["it is 704 × 400 px", "pictures are 960 × 600 px", "camera right: too few"],
        );
        refused(BOARD, "few", &["camera right: too few usable views: 2; at least 3"]);
        refused(BOARD, "others", &["camera right shares no usable view with left"]);
        refused(OTHER_DICTIONARY, "left", &["camera left: none", "seen instead", "DICT_4X4"]);
        let loose = [action[0], "--max-iou", "1"];
        let alike = [("left", "alike"), ("right", "alike")];
        album.refused(&loose, BOARD, &alike, &["all views show the board at the same tilt"]);
        album.refused(action, BOARD, &[("left", "left")], &["1", "two"]);
    }
}

#[test]
fn tables_are_refused_with_what_is_wrong_and_what_would_be_right() {
    let album = Album::new();
    let truth = album.folder("truth.toml");
    let before = fs::read(&truth).expect("readable");
    let refused = |board: &str, camera: &str, folder: &str, says: &[&str]| {
        let action = ["table", &truth, "--board-at", "0,0,0"];
        album.refused(&action, board, &[(camera, folder)], says);
    };
    refused(BOARD, "left", "walls", &["camera left: none of its 4 pictures", "nothing else was recognised"]);
    refused(BOARD, "left", "broken", &["camera left: none of its 4 pictures", "cannot be read"]);
    refused(OTHER_DICTIONARY, "left", "left", &["camera left: none", "seen instead", "DICT_4X4"]);
    refused(BOARD, "middle", "left", &["no camera \"middle\"; it has left, right"]);
    album.new_file("small", "1.png");
    GrayImage::new(640, 400).save(album.new_file("small", "1.png")).expect("written");
    let find = format!("left={}", album.folder("small"));
    let ended = album.lab.start(&["calib", "table", &truth, "--find", &find]).wait();
    assert_eq!(ended.code, Some(2), "{}", ended.err);
    assert!(ended.err.contains("left, 1: the picture is 640 × 400 px"), "{}", ended.err);
    assert_eq!(fs::read(&truth).expect("readable"), before, "a refusal leaves the rig file as it was");
}

#[test]
fn a_session_names_what_it_cannot_use_and_goes_on() {
    let album = Album::new();
    let rig = album.lab.path("rig.toml");
    // Beside two that can be used a picture of another size, one of nothing, and none.
    for (from, to) in [("mixed/2.png", "m.png"), ("walls/0.png", "n.png"), ("broken/0.png", "o.png")] {
        fs::copy(album.lab.path(from), album.lab.path("few").join(to)).expect("copied");
    }
    let images = format!("left={}", album.folder("few"));
    let (session, page, _) = start(&album.lab, &rig, &["--images", &images]);
    page.act(&json!({ "do": "gather" })).expect("may");
    let state = page.state_when("the last picture", |s| s["source"]["ended"] == true);
    let tally = &state["session"]["cameras"][0]["tally"];
    for kind in ["other picture size", "no board", "unreadable picture"] {
        assert_eq!(tally[kind], json!(1), "{kind}: {tally}");
    }
    page.act(&json!({ "do": "process" })).expect("there are views");
    let state = page.state_when("an end", |s| !s["session"]["failure"].is_null());
    let failure = state["session"]["failure"].as_str().expect("words");
    assert!(failure.contains("camera left: too few usable views: 2; at least 3"), "{failure}");
    assert_eq!(state["session"]["phase"], "preview", "it goes on");
    page.act(&json!({ "do": "undo" })).expect("there is something to undo");
    assert_eq!(session.stop().code, Some(0));
}
