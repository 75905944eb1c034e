//! What scripts rely on: JSON lines, exit codes, help.

use std::path::Path;

use netcord_common::bus::DomainRemains;
use netcord_tests::{Lab, Running, Watch, executable, one_at_a_time};
use serde_json::Value;

#[test]
fn listen_and_latency_attach_to_a_running_rig() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let (up, rig) = lab.up();
    let bus = lab.bus();
    Watch::attach(&bus).position_after(0);
    drop(bus);

    let ended = lab.start(&["listen", "--rig", &rig, "ball/position", "--count", "5"]).wait();
    assert_eq!((ended.code, ended.out.len()), (Some(0), 5), "{}", ended.err);
    let mut last = 0;
    for line in &ended.out {
        let message: Value = serde_json::from_str(line).expect("JSON");
        assert_eq!(message["topic"], "ball/position");
        let trigger = message["trigger_id"].as_u64().expect("a number");
        assert!(trigger > last);
        last = trigger;
        assert_ne!(message.get("position_m").is_some(), message.get("reason").is_some(), "{message}");
    }
    let ended = lab.start(&["listen", "--rig", &rig, "truth", "camera/left/frame", "--count", "40"]).wait();
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    assert!(ended.out.iter().any(|line| line.contains("truth/ball")), "{:?}", ended.out);
    let ended = lab.start(&["listen", "--rig", &rig, "ball/velocity"]).wait();
    assert_eq!(ended.code, Some(2));
    assert!(ended.err.contains("ball/trajectory"), "it says what would be valid: {}", ended.err);

    let report = lab.path("latency.json");
    let report_text = report.display().to_string();
    let ended = lab.start(&["latency", "--rig", &rig, "--seconds", "2", "--report", &report_text]).wait();
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    let report: Value = serde_json::from_slice(&std::fs::read(report).expect("a report")).expect("JSON");
    assert!(
        report["latency_ms"]["frame_to_position"]["p50"].as_f64().is_some_and(|ms| ms > 0.0),
        "{report:#}"
    );
    assert!(report["frames"]["published"].as_u64().is_some_and(|n| n > 100), "{report:#}");
    assert!(report["rate_hz"].as_f64().is_some_and(|hz| (hz - 50.0).abs() < 5.0), "{report:#}");
    assert_eq!(up.stop().code, Some(0));
}

#[test]
fn latency_of_a_rig_that_does_not_run_is_a_miss_and_no_error() {
    let lab = Lab::new();
    let rig = lab.synthetic_rig(50.0, &[]);
    let ended = lab.start(&["latency", "--rig", &rig.display().to_string(), "--seconds", "0.2"]).wait();
    assert_eq!(ended.code, Some(1), "{}", ended.err);
}

#[test]
fn the_launch_script_leaves_nothing_behind() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let rig = lab.synthetic_rig(50.0, &[]).display().to_string();
    let mut script = std::process::Command::new("sh");
    script.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/launch/rig.sh"));
    script.args([&rig, "--source", "synthetic"]);
    script
        .env("NETCORD", executable())
        .env("NETCORD_DOMAIN", lab.domain().as_str())
        .env_remove("NOTIFY_SOCKET");
    let running = Running::start(script);
    let bus = lab.bus();
    Watch::attach(&bus).position_after(0);

    // Whose processes are at work is not cleaned up.
    let ended = lab.start(&["rig", "clean", "--rig", &rig]).wait();
    assert_eq!(ended.code, Some(2), "{}", ended.err);
    assert!(ended.err.contains("capture") && ended.err.contains("segment"), "{}", ended.err);

    drop(bus);
    assert_eq!(running.stop().code, Some(0));
    let left = [lab.domain(), &lab.truth_domain()].map(|domain| DomainRemains::of(domain).files());
    assert_eq!(left.concat(), Vec::<std::path::PathBuf>::new());
}

#[test]
fn every_subcommand_explains_itself() {
    let help = std::process::Command::new(executable()).arg("--help").output().expect("it runs");
    let help = String::from_utf8(help.stdout).expect("text");
    let commands: Vec<&str> = help
        .lines()
        .skip_while(|line| !line.starts_with("Commands:"))
        .skip(1)
        .take_while(|line| !line.trim().is_empty())
        .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|command| *command != "help")
        .collect();
    for needed in ["up", "demo", "capture", "segment", "triangulate", "predict", "latency", "listen", "rig"] {
        assert!(commands.contains(&needed), "{needed} is missing from {commands:?}");
    }
    for command in commands {
        let output =
            std::process::Command::new(executable()).args([command, "--help"]).output().expect("it runs");
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && text.contains("Usage:"), "{command}");
        assert!(
            text.lines().next().is_some_and(|line| line.len() > 20),
            "{command} says what it is for: {text}"
        );
    }
}
