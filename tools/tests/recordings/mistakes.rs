//! Recordings that cannot be processed: each is refused with what is wrong, where, and what would be right.

use std::path::Path;

use crate::{
    filming::{Film, Shot},
    netcord, text,
};

fn refusal(shot: &Shot, options: &[&str]) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    Film::new(5).write(&folder.path().join("in.mcap"), shot);
    let arguments = [&["process", "in.mcap", "--positions", "p.csv"], options].concat();
    let out = netcord(folder.path(), &arguments);
    assert_eq!(out.status.code(), Some(2), "{}", text(&out.stderr));
    text(&out.stderr)
}

#[test]
fn an_image_whose_size_and_step_do_not_fit_is_named() {
    let error = refusal(&Shot { spoil: |image| image.step -= 4, ..Shot::default() }, &[]);
    assert!(error.contains("/camera/right/image, message 3") && error.contains("step of 956"), "{error}");
    let error = refusal(&Shot { spoil: |image| image.height += 1, ..Shot::default() }, &[]);
    assert!(
        error.contains("/camera/right/image, message 3") && error.contains("needs 576960 bytes"),
        "{error}"
    );
}

#[test]
fn a_recording_without_calibration_says_what_is_needed() {
    let error = refusal(&Shot { calibrated: false, ..Shot::default() }, &[]);
    assert!(error.contains("/camera/left/calibration") && error.contains("--rig"), "{error}");
}

#[test]
fn a_camera_that_the_rig_does_not_know_is_named_beside_those_it_knows() {
    let rigs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs");
    let rig = std::fs::read_to_string(rigs.join("example-2cam.toml")).expect("there");
    let folder = tempfile::tempdir().expect("a folder");
    let other = folder.path().join("other.toml");
    std::fs::write(&other, rig.replace("name = \"right\"", "name = \"far\"")).expect("written");
    let other = other.to_string_lossy();
    let error = refusal(&Shot::default(), &["--rig", &other]);
    assert!(error.contains("/camera/right/image") && error.contains("left, far"), "{error}");
    // The cameras are right, but twice as large.
    let rig = rigs.join("example-2cam.toml");
    let error = refusal(&Shot::default(), &["--rig", &rig.to_string_lossy()]);
    assert!(error.contains("960 × 600") && error.contains("1920 × 1200"), "{error}");
}

#[test]
fn what_is_no_recording_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("in.mcap"), b"PNG and so on").expect("written");
    let out = netcord(folder.path(), &["process", "in.mcap", "--positions", "p.csv"]);
    assert_eq!(out.status.code(), Some(2));
    assert!(text(&out.stderr).contains("is no MCAP recording"), "{}", text(&out.stderr));
    let out = netcord(folder.path(), &["process", "none.mcap", "--positions", "p.csv"]);
    assert!(text(&out.stderr).contains("cannot open the recording none.mcap"), "{}", text(&out.stderr));
}
