//! Recordings of ours read by other programs' packages: `mcap`, `foxglove-schemas-protobuf` and `rerun-sdk` of
//! Python.

use std::{io::Write as _, process::Command};

use crate::{
    filming::{Film, Shot},
    netcord, text,
};

const CHECK: &str = include_str!("check.py");
const RERUN: &str = include_str!("rerun.py");

/// The interpreter; another one, such as a virtual environment's, by `NETCORD_PYTHON`.
fn python() -> String {
    std::env::var("NETCORD_PYTHON").unwrap_or_else(|_| "python3".into())
}

/// Whether the interpreter has these modules; says so where it has not.
fn has(modules: &str) -> bool {
    // Not where the test runs: a folder of the module's name there would count as the module.
    let there = Command::new(python())
        .args(["-c", &format!("import {modules}")])
        .current_dir(std::env::temp_dir())
        .output();
    let has = there.is_ok_and(|out| out.status.success());
    if !has {
        // Straight to the terminal: the test harness holds back what passing tests print.
        let _ = writeln!(std::io::stderr(), "SKIPPED: {} lacks one of {modules}", python());
    }
    has
}

/// Processes a film into `out.mcap` and `p.csv`, and runs a program with them.
fn check_with(program: &str, arguments: &[&str]) {
    let folder = tempfile::tempdir().expect("a folder");
    Film::new(12).write(&folder.path().join("in.mcap"), &Shot::default());
    let out = netcord(folder.path(), &["process", "in.mcap", "--out", "out.mcap", "--positions", "p.csv"]);
    assert!(out.status.success(), "{}", text(&out.stderr));
    let check =
        Command::new(python()).args(["-c", program]).args(arguments).current_dir(folder.path()).output();
    let check = check.expect("python starts");
    assert!(check.status.success(), "{}{}", text(&check.stdout), text(&check.stderr));
}

#[test]
fn a_recording_keeps_to_the_schemas_as_python_knows_them() {
    if has("mcap, mcap_protobuf, foxglove_schemas_protobuf, numpy") {
        check_with(CHECK, &["out.mcap", "p.csv"]);
    }
}

#[test]
fn rerun_opens_a_recording_with_its_pictures_cameras_and_poses() {
    if has("rerun") {
        check_with(RERUN, &["out.mcap"]);
    }
}
