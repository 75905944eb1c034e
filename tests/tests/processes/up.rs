//! `netcord up`: order, state, and ends.

use std::os::unix::net::UnixDatagram;

use netcord_common::{Clock as _, MonotonicClock};
use netcord_tests::{Lab, Running, WATCHDOG, Watch, one_at_a_time, signal_process, until};
use nix::sys::signal::Signal;
use serde_json::Value;

fn is_alive(pid: u32) -> bool {
    // A zombie has a folder in /proc too; its stat says Z.
    std::fs::read_to_string(format!("/proc/{pid}/stat"))
        .is_ok_and(|stat| stat.rsplit_once(") ").is_some_and(|(_, state)| !state.starts_with('Z')))
}

#[test]
fn processes_start_in_order_each_when_the_one_before_is_ready_and_all_stop() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let rig = lab.synthetic_rig(50.0, &[]);
    let up = lab.start(&["up", &rig.display().to_string(), "--events", "--quiet"]);
    let mut events = Vec::new();
    while events.len() < 8 {
        let event: Value = serde_json::from_str(&up.line()).expect("JSON");
        let text = |key: &str| event[key].as_str().unwrap_or_default().to_owned();
        if text("event") != "line" {
            events.push(format!("{} {}", text("process"), text("event")));
        }
    }
    let expected = ["capture", "segment", "triangulate", "predict"]
        .iter()
        .flat_map(|process| [format!("{process} started"), format!("{process} ready")]);
    assert_eq!(events, expected.collect::<Vec<_>>());

    let stages = Watch::attach(&lab.bus()).stages();
    assert!(stages.values().all(|pid| is_alive(*pid)));
    let ended = up.stop();
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    let ends: Vec<String> = ended
        .out
        .iter()
        .map(|line| serde_json::from_str::<Value>(line).expect("JSON"))
        .filter(|event| event["event"] == "ended")
        .map(|event| {
            format!("{} {}", event["process"].as_str().unwrap_or("?"), event["how"].as_str().unwrap_or("?"))
        })
        .collect();
    assert_eq!(ends, ["capture ended", "segment ended", "triangulate ended", "predict ended"]);
    assert!(stages.values().all(|pid| !is_alive(*pid)));
    assert_eq!(lab.shared_memory(), Vec::<std::path::PathBuf>::new());
}

#[test]
fn the_children_end_when_up_is_killed_and_the_next_up_finds_a_clean_house() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let (up, rig) = lab.up();
    let bus = lab.bus();
    let mut watch = Watch::attach(&bus);
    let stages = watch.stages();
    watch.position_after(0);
    up.signal(Signal::SIGKILL);
    assert_eq!(up.wait().code, None);
    until("the end of all children", || stages.values().all(|pid| !is_alive(*pid)).then_some(()));

    let up = lab.start(&["up", &rig, "--quiet"]);
    let now = until("new processes", || {
        let now = watch.stages();
        now.iter().all(|(stage, pid)| stages[stage] != *pid).then_some(now)
    });
    assert!(now.values().all(|pid| is_alive(*pid)));
    watch.position_after(MonotonicClock.now().as_ns());
    drop(watch);
    drop(bus);
    assert_eq!(up.stop().code, Some(0));
    assert_eq!(lab.shared_memory(), Vec::<std::path::PathBuf>::new());
}

#[test]
fn a_stage_that_is_ready_and_publishes_nothing_is_named_once() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let rig = lab.synthetic_rig(50.0, &[]);
    let up = lab.start(&["up", &rig.display().to_string(), "--events", "--quiet"]);
    let bus = lab.bus();
    let mut watch = Watch::attach(&bus);
    let stages = watch.stages();
    watch.position_after(0);
    signal_process(stages["triangulate"], Signal::SIGSTOP);
    let event = || -> Value { serde_json::from_str(&up.line()).expect("JSON") };
    let silent = std::iter::repeat_with(event).find(|event| event["event"] == "silent").expect("one comes");
    assert_eq!(silent["process"], "triangulate", "{silent}");
    let what = silent["what"].as_str().expect("a text");
    for part in ["ball/position", "camera/…/detections", "it hangs", "netcord listen --rig"] {
        assert!(what.contains(part), "{what}");
    }
    signal_process(stages["triangulate"], Signal::SIGCONT);
    watch.position_after(MonotonicClock.now().as_ns());
    let ended = up.stop();
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    let more: Vec<&String> = ended.out.iter().filter(|line| line.contains("\"silent\"")).collect();
    assert!(more.is_empty(), "it was told of already, and the others had nothing to pass on: {more:?}");
}

#[test]
fn what_does_not_start_is_given_up_with_its_reason() {
    let lab = Lab::new();
    let rig = lab.synthetic_rig(50.0, &["--no-such-switch"]);
    let ended = lab.start(&["up", &rig.display().to_string(), "--quiet"]).wait();
    assert_eq!(ended.code, Some(2), "{}", ended.err);
    assert!(
        ended.err.contains("--no-such-switch") && ended.err.contains("capture does not start"),
        "{}",
        ended.err
    );
    assert_eq!(lab.shared_memory(), Vec::<std::path::PathBuf>::new());
}

#[test]
fn an_outside_supervisor_is_told_when_all_are_ready_and_when_they_stop() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let rig = lab.synthetic_rig(50.0, &[]).display().to_string();
    let address = lab.path("notify");
    let socket = UnixDatagram::bind(&address).expect("a socket");
    socket.set_read_timeout(Some(WATCHDOG)).expect("a bound");
    let heard = || {
        let mut buffer = [0; 256];
        let length = socket.recv(&mut buffer).expect("a message");
        String::from_utf8_lossy(&buffer[..length]).into_owned()
    };
    let mut command = lab.command(&["up", &rig, "--quiet"]);
    command.env("NOTIFY_SOCKET", &address);
    let up = Running::start(command);
    let ready = heard();
    assert!(ready.lines().any(|line| line == "READY=1"), "{ready}");
    // All are, not only the first.
    assert_eq!(Watch::attach(&lab.bus()).stages().len(), 4);
    assert_eq!(up.stop().code, Some(0));
    let stopping = heard();
    assert!(stopping.lines().any(|line| line == "STOPPING=1"), "{stopping}");
}
