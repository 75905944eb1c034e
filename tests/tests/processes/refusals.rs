//! What is wrong gets an error that says what and where, and nothing else falls over.

use std::{fs, path::Path, process::Command};

use netcord_common::{
    Clock as _, MonotonicClock,
    bus::{Bus, DomainRemains, FramePublisher, Topic},
    wire::WIRE_VERSION,
};
use netcord_tests::{Lab, Running, Watch, executable, one_at_a_time};
use toml_edit::{DocumentMut, value};

#[test]
fn a_second_capture_and_a_second_up_are_refused_and_the_first_work_on() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let (up, rig) = lab.up();
    let bus = lab.bus();
    let mut watch = Watch::attach(&bus);
    let stages = watch.stages();
    for (arguments, said) in [
        (["capture", "--rig", &rig, "--source=synthetic"], "another `netcord capture` runs in this domain"),
        (["up", &rig, "--quiet", "--seconds=60"], "is in use by"),
    ] {
        let second = lab.start(&arguments).wait();
        assert_eq!(second.code, Some(2), "{}", second.err);
        assert!(second.err.contains(said), "{}", second.err);
        watch.position_after(MonotonicClock.now().as_ns());
        assert_eq!(watch.stages(), stages, "nobody was restarted");
    }
    // Whoever joins now still meets the first.
    let listened = lab.start(&["listen", "--rig", &rig, "ball/position", "--count", "1"]).wait();
    assert_eq!((listened.code, listened.out.len()), (Some(0), 1), "{}", listened.err);
    drop((watch, bus));
    assert_eq!(up.stop().code, Some(0));
}

#[test]
fn arguments_that_cannot_be_meant_are_refused_before_anything_runs() {
    let lab = Lab::new();
    let path = lab.synthetic_rig(50.0, &[]);
    let rig = path.display().to_string();
    let out = lab.path("out.mcap").display().to_string();
    let no_folder = lab.path("no/folder.json").display().to_string();
    for (arguments, said) in [
        (vec!["record", &out, "--rig", &rig, "--seconds", "nan"], "valid are 0 to"),
        (vec!["up", &rig, "--seconds", "1e30"], "valid are 0 to"),
        (vec!["latency", "--rig", &rig, "--seconds", "-1"], "valid are 0 to"),
        (vec!["demo", "--warm-up", "nan"], "valid are 0 to"),
        (vec!["demo", "--report", &no_folder], "there is no folder"),
        (vec!["capture", "--rig", &rig, "--recording", "absent.mcap"], "--source replay"),
        (vec!["capture", "--rig", &rig, "--prerendered", "1000000000"], "1..=10000"),
        (vec!["demo", "--seconds", "0"], "valid are 0.1 to"),
        (vec!["demo", "--rate", "nan"], "1 to 10000 Hz"),
        (vec!["demo", "--record", &rig], "is there already"),
        (vec!["import", "pictures", "--out", &out, "--rate", "1e300"], "valid are 0.001 to 100000 Hz"),
        (vec!["rig", "import", &rig, "--out", &out, "--exposure-us", "-1"], "1 to 1000000 microseconds"),
        (vec!["plot", &out, "--at", "0.5,nan"], "0 to 1000000 seconds"),
        (vec!["control", "--rig", &rig, "exposure", "-5"], "1 to 1000000 microseconds"),
        (vec!["predict", "--evaluate", &rig, "--sigma", "nan"], "to 1 metres"),
        (vec!["predict", "--evaluate", &rig, "--hitting-plane-y-m", "1"], "cannot be used with"),
        (vec!["predict", "--rig", &rig, "--sigma", "0.001"], "--sigma is for recorded flights"),
        (vec!["predict", "--rig", &rig, "--table-z", "0.76"], "--table-z is for recorded flights"),
        (vec!["predict", "--rig", &rig, "--report", &out], "--report is for recorded flights"),
        (vec!["rig", "export", &rig, "--format", "json", "--out", &rig], "is read by this command"),
    ] {
        let ended = lab.start(&arguments).wait();
        assert_eq!(ended.code, Some(2), "{arguments:?}: {}", ended.err);
        assert!(ended.err.contains(said), "{arguments:?}: {}", ended.err);
    }
    assert!(!lab.path("out.mcap").exists());
}

#[test]
fn no_output_goes_over_an_input_or_another_output() {
    let lab = Lab::new();
    let rig = lab.rig_file(|_| {}).display().to_string();
    let file = |name: &str, content: &str| {
        fs::write(lab.path(name), content).expect("written");
        lab.path(name).display().to_string()
    };
    fs::create_dir(lab.path("seen")).expect("a folder");
    let picture = file("seen/r-left.png", "what was seen");
    let beside_it = lab.path("seen/r.json").display().to_string();
    let corners = file("corners.json", r#"{"cameras": {"left": {"size": [100, 100], "views": {}}}}"#);
    let [marks, track] = ["marks.csv", "track.csv"].map(|name| file(name, "rows"));
    let new = |name: &str| lab.path(name).display().to_string();
    let report = new("new.json");
    let seen = format!("left={}", lab.path("seen").display());
    let tracked = format!("left={track}");
    let board = ["--board", "chessboard:9x6:25mm"];
    let (read, twice) = ("is read by this command", "is given for two outputs");
    for (arguments, said) in [
        (vec!["calib", "mono", &seen, board[0], board[1], "--report", &picture], read),
        (vec!["calib", "mono", &seen, board[0], board[1], "--report", &beside_it], read),
        (vec!["calib", "mono", &seen, board[0], board[1], "--save-corners", &picture], read),
        (vec!["calib", "mono", &seen, board[0], board[1], "--rig", &rig, "--report", &rig], read),
        (vec!["calib", "mono", "--corners", &corners, "--report", &corners], read),
        (
            vec!["calib", "rig", &seen, board[0], board[1], "--save-corners", &report, "--report", &report],
            twice,
        ),
        (vec!["calib", "table", &rig, "--marks", &marks, "--report", &marks], read),
        (vec!["calib", "table", &rig, "--find", &seen, "--report", &picture], read),
        (vec!["calib", "motion", &rig, "--track", &tracked, "--report", &track], read),
        (vec!["calib", "check", &rig, &seen, board[0], board[1], "--report", &beside_it], read),
        (vec!["calib", "check", &rig, "--track", &tracked, "--length", "1", "--report", &rig], read),
        (vec!["calib", "board", board[1], &report], "must end in"),
        (vec!["calib", "board", board[1], &new("b.svg"), &new("b.svg")], twice),
        (
            vec![
                "calib",
                "board",
                "aruco:4x3:DICT_4X4_50:60mm:9mm:double=4mm",
                &new("b.svg"),
                &new("b-back.svg"),
            ],
            twice,
        ),
        (vec!["compare", "--rig", &rig, "--report", &rig], read),
        (vec!["latency", "--rig", &rig, "--report", &rig], read),
        (vec!["predict", "--evaluate", &track, "--report", &track], read),
        (vec!["segment", "--rig", &rig, "--learn", &new("seen"), "--plot", &picture], read),
        (vec!["demo", "--report", &report, "--record", &new("new-error.png")], twice),
    ] {
        let ended = lab.start(&arguments).wait();
        assert_eq!(ended.code, Some(2), "{arguments:?}: {} {}", ended.out.join("\n"), ended.err);
        assert!(ended.err.contains(said), "{arguments:?}: {}", ended.err);
    }
    for (path, content) in [(&picture, "what was seen"), (&marks, "rows"), (&track, "rows")] {
        assert_eq!(fs::read_to_string(path).expect("there"), content);
    }
    for name in ["new.json", "b.svg"] {
        assert!(!lab.path(name).exists(), "{name} was begun");
    }
}

#[test]
fn a_ball_that_nobody_could_play_is_refused_in_time() {
    let lab = Lab::new();
    let path = lab.rig_file(|document| document["ball"]["diameter_m"] = value(0.15));
    let ended = lab.start(&["capture", "--source", "synthetic", "--rig", &path.display().to_string()]).wait();
    assert_eq!(ended.code, Some(2), "{}", ended.err);
    assert!(ended.err.contains("0.15 m") && ended.err.contains("diameter_m"), "{}", ended.err);
}

#[test]
fn whoever_finds_nobody_leaves_nothing_in_shared_memory() {
    let lab = Lab::new();
    let rig = lab.synthetic_rig(50.0, &[]).display().to_string();
    let out = lab.path("out.mcap").display().to_string();
    let ended = lab.start(&["record", &out, "--rig", &rig, "--seconds", "0.2"]).wait();
    assert_eq!(ended.code, Some(1), "{}", ended.err);
    assert!(ended.err.contains("nothing was published"), "{}", ended.err);
    assert_eq!(DomainRemains::of(lab.domain()).remove().expect("readable"), 0);
}

#[test]
fn a_peer_of_another_wire_version_is_told_so_on_both_sides() {
    let lab = Lab::new();
    let path = lab.synthetic_rig(50.0, &[]);
    let rig = Lab::load(&path);
    let old = Bus::join_with_wire_version(lab.domain(), "capture", WIRE_VERSION + 1).expect("joined");
    let frames = Topic::frames(&rig.cameras[0].name);
    let publisher = FramePublisher::open(&old, &frames, 1000).expect("opened");
    for stage in ["segment", "capture"] {
        let ended = lab.start(&[stage, "--rig", &path.display().to_string()]).wait();
        assert_eq!(ended.code, Some(2), "{}", ended.err);
        assert!(ended.err.contains("another wire version"), "{}", ended.err);
        assert!(ended.err.contains("camera/left/frame"), "{}", ended.err);
    }
    publisher.publish(publisher.loan(1000).expect("a slot")).expect("the older process works on");
}

#[test]
fn no_shared_memory_is_an_error_with_the_cure() {
    let lab = Lab::new();
    let rig = lab.synthetic_rig(50.0, &[]);
    // A /dev/shm of its own that is too small, in namespaces that need no privilege.
    let script = "mount -t tmpfs -o size=1m tmpfs /dev/shm && exec \"$@\"";
    let mut command = Command::new("unshare");
    command
        .args(["--user", "--map-root-user", "--mount", "sh", "-c", script, "sh"])
        .arg(executable())
        .args(["capture", "--source", "synthetic", "--domain", lab.domain().as_str(), "--rig"])
        .arg(&rig);
    let can = Command::new("unshare")
        .args(["--user", "--map-root-user", "--mount", "sh", "-c", script, "sh", "true"])
        .status();
    if !can.is_ok_and(|status| status.success()) {
        eprintln!("SKIPPED: this machine allows no user namespaces");
        return;
    }
    let ended = Running::start(command).wait();
    assert_eq!(ended.code, Some(2), "{:?} {}", ended.code, ended.err);
    assert!(ended.err.contains("no shared memory left"), "{}", ended.err);
    assert!(ended.err.contains("/dev/shm"), "{}", ended.err);
}

fn refused(lab: &Lab, change: impl FnOnce(&mut DocumentMut)) -> String {
    let path = lab.rig_file(|document| {
        document["tolerance_us"] = value(1000.0);
        change(document);
    });
    let path = path.display().to_string();
    let mut said = String::new();
    for command in [vec!["rig", "show", &path], vec!["up", &path], vec!["capture", "--rig", &path]] {
        let ended = lab.start(&command).wait();
        assert_eq!(ended.code, Some(2), "{command:?}: {}", ended.err);
        assert!(ended.err.contains("rig.toml:"), "{command:?} names file and line: {}", ended.err);
        said = ended.err;
    }
    said
}

/// The table of the second camera of the example.
fn right(document: &mut DocumentMut) -> &mut toml_edit::Table {
    document["camera"].as_array_of_tables_mut().and_then(|c| c.get_mut(1)).expect("a second camera")
}

#[test]
fn a_bad_rig_file_is_named_with_line_key_and_what_would_be_valid() {
    let lab = Lab::new();
    let said = refused(&lab, |d| d["ratte_hz"] = value(1.0));
    assert!(said.contains("`ratte_hz`") && said.contains("`rate_hz`"), "{said}");
    let said = refused(&lab, |d| right(d)["name"] = value("left"));
    assert!(said.contains("two cameras are called \"left\""), "{said}");
    let said = refused(&lab, |d| {
        right(d).remove("intrinsics");
    });
    assert!(said.contains("camera right has no [camera.intrinsics]"), "{said}");
    let said =
        refused(&lab, |d| right(d)["pose"]["rotation"][0] = value(0.5).into_value().expect("a value").into());
    assert!(said.contains("camera right: pose") && said.contains("no rotation"), "{said}");
}

#[test]
fn a_missing_rig_file_is_named() {
    let lab = Lab::new();
    let ended = lab.start(&["segment", "--rig", "nowhere.toml"]).wait();
    assert_eq!(ended.code, Some(2));
    assert!(ended.err.contains("nowhere.toml"), "{}", ended.err);
    assert!(!Path::new("nowhere.toml").exists());
}
