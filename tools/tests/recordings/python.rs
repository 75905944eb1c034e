//! Recordings of ours read by other programs' packages: `mcap` and `foxglove-schemas-protobuf` of Python.

use std::{io::Write as _, process::Command};

use crate::{
    filming::{Film, Shot},
    netcord, text,
};

const CHECK: &str = include_str!("check.py");

/// The interpreter; another one, such as a virtual environment's, by `NETCORD_PYTHON`.
fn python() -> String {
    std::env::var("NETCORD_PYTHON").unwrap_or_else(|_| "python3".into())
}

#[test]
fn a_recording_keeps_to_the_schemas_as_python_knows_them() {
    let imports = "import mcap, mcap_protobuf, foxglove_schemas_protobuf, numpy";
    let there = Command::new(python()).args(["-c", imports]).output();
    if !there.is_ok_and(|out| out.status.success()) {
        // Straight to the terminal: the test harness holds back what passing tests print.
        let _ = writeln!(
            std::io::stderr(),
            "SKIPPED: {} lacks mcap, mcap-protobuf-support, foxglove-schemas-protobuf or numpy",
            python()
        );
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    Film::new(12).write(&folder.path().join("in.mcap"), &Shot::default());
    let out = netcord(folder.path(), &["process", "in.mcap", "--out", "out.mcap", "--positions", "p.csv"]);
    assert!(out.status.success(), "{}", text(&out.stderr));
    let check =
        Command::new(python()).args(["-c", CHECK, "out.mcap", "p.csv"]).current_dir(folder.path()).output();
    let check = check.expect("python starts");
    assert!(check.status.success(), "{}{}", text(&check.stdout), text(&check.stderr));
}
