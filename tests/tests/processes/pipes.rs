//! Whoever reads an output may leave at any time: `netcord … | head -1`.

use std::{
    fs,
    io::{self, BufRead as _, BufReader, Read as _},
    process::{Child, Command, Stdio},
};

use netcord_tests::{Lab, one_at_a_time, signal_process, until};
use nix::sys::signal::Signal;

/// A pipe that nobody reads any more.
fn unread() -> Stdio {
    let (reader, writer) = io::pipe().expect("a pipe");
    drop(reader);
    writer.into()
}

/// Waits for the end; the exit code, which is none where a signal ended it.
fn ended(mut child: Child) -> Option<i32> {
    until("the end of a process", || child.try_wait().expect("our child")).code()
}

/// Runs `command` with an output that nobody reads; its exit code and what it complains of.
fn run_unread(mut command: Command) -> (Option<i32>, String) {
    let mut child = command.stdout(unread()).stderr(Stdio::piped()).spawn().expect("it starts");
    let mut said = String::new();
    child.stderr.take().expect("piped").read_to_string(&mut said).expect("text");
    (ended(child), said)
}

#[test]
fn commands_whose_output_nobody_reads_do_their_work_and_end_quietly() {
    let lab = Lab::new();
    let rig = lab.rig_file(|_| {}).display().to_string();
    let flight = lab.path("flight.csv");
    let falling = |n: u32| {
        let t = f64::from(n) * 0.006;
        format!("{t},{},{},{}\n", 0.1 * t, -1.0 + 4.0 * t, 0.3 + 1.5 * t - 4.905 * t * t)
    };
    let rows: String = (0..80).map(falling).collect();
    fs::write(&flight, format!("Timestamp,X,Y,Z\n{rows}")).expect("written");
    let flight = flight.display().to_string();
    let (points, solved) = (lab.path("points.csv").display().to_string(), lab.path("solved"));
    fs::write(&points, "id,camera,x_px,y_px\n1,left,900,500\n1,right,1060,500\n").expect("written");
    let out = solved.display().to_string();
    for arguments in [
        vec!["rig", "show", &rig],
        vec!["predict", "--evaluate", &flight],
        vec!["compare", "--rig", &rig, "--points", &points, "--out", &out],
    ] {
        let read = lab.start(&arguments).wait();
        assert!(matches!(read.code, Some(0 | 1)) && !read.out.is_empty(), "{arguments:?}: {}", read.err);
        let (code, said) = run_unread(lab.command(&arguments));
        assert_eq!(code, read.code, "{arguments:?}: {said}");
        assert!(!said.contains("panicked") && !said.contains("netcord:"), "{arguments:?}: {said}");
        // Nor when complaints go the same way.
        let mut command = lab.command(&arguments);
        let child = command.stdout(unread()).stderr(unread()).spawn().expect("it starts");
        assert_eq!(ended(child), read.code, "{arguments:?}");
    }
    assert!(solved.join("dlt-svd.csv").is_file(), "what was asked for is written all the same");
}

#[test]
fn an_output_that_cannot_be_written_is_an_error() {
    let lab = Lab::new();
    let rig = lab.rig_file(|_| {}).display().to_string();
    let Ok(full) = fs::OpenOptions::new().write(true).open("/dev/full") else {
        eprintln!("SKIPPED: this machine has no /dev/full");
        return;
    };
    let output = lab.command(&["rig", "show", &rig]).stdout(full).output().expect("it runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("standard output is not complete") && !said.contains("panicked"), "{said}");
}

#[test]
fn a_listener_ends_with_its_reader_and_services_go_on_without_one() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let rig = lab.synthetic_rig(20.0, &[]).display().to_string();
    // Its events and its complaints go nowhere.
    let mut up = lab.command(&["up", &rig, "--quiet", "--events"]);
    let up = up.stdout(unread()).stderr(unread()).spawn().expect("it starts");

    let mut listen = lab.command(&["listen", "--rig", &rig, "ball/position"]);
    let mut listen = listen.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    let mut out = BufReader::new(listen.stdout.take().expect("piped"));
    let mut line = String::new();
    out.read_line(&mut line).expect("text");
    assert!(line.contains("ball/position"), "{line}");
    drop(out);
    let mut said = String::new();
    listen.stderr.take().expect("piped").read_to_string(&mut said).expect("text");
    assert_eq!((ended(listen), said.contains("panicked")), (Some(0), false), "{said}");

    // The rig works on, and ends in order.
    let heard = lab.start(&["listen", "--rig", &rig, "ball/position", "--count", "3"]).wait();
    assert_eq!((heard.code, heard.out.len()), (Some(0), 3), "{}", heard.err);
    signal_process(up.id(), Signal::SIGTERM);
    assert_eq!(ended(up), Some(0));
    assert!(lab.shared_memory().is_empty(), "{:?}", lab.shared_memory());
}
