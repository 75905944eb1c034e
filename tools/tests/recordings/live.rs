//! `netcord record` beside a running capture: killed, and on a disk that is full.

use std::{
    path::Path,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use netcord_capture::recording::RecordedTruth;
use netcord_common::{DomainName, bus::DomainRemains};

use crate::{netcord, text};

/// A capture of its own domain; ends with the test.
struct Capture {
    process: Child,
    domain: String,
    rig: String,
}

impl Capture {
    fn start(test: &str) -> Self {
        let rig = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-2cam.toml");
        let rig = rig.to_string_lossy().into_owned();
        let domain = format!("rec-{test}-{}", std::process::id());
        let process = Command::new(env!("CARGO_BIN_EXE_netcord"))
            .args(["capture", "--rig", &rig, "--domain", &domain, "--rate", "20", "--prerendered", "4"])
            .stderr(Stdio::null())
            .spawn()
            .expect("capture starts");
        let capture = Self { process, domain, rig };
        // A recorder looks once for the truth's domain.
        let truth = DomainName::new(format!("{}-truth", capture.domain)).expect("valid");
        let began = Instant::now();
        while DomainRemains::of(&truth).inhabitants().map_or(true, |processes| processes.is_empty()) {
            assert!(began.elapsed() < WATCHDOG, "capture tells no truth");
            std::thread::sleep(Duration::from_millis(50));
        }
        capture
    }

    fn record(&self, folder: &Path, shell: &str) -> Command {
        let mut command = Command::new("sh");
        let netcord = env!("CARGO_BIN_EXE_netcord");
        let (rig, domain) = (&self.rig, &self.domain);
        command
            .args([
                "-c",
                &format!(
                    "{shell} exec {netcord} record out.mcap --rig '{rig}' --domain {domain} --seconds 60"
                ),
            ])
            .current_dir(folder);
        command
    }
}

impl Drop for Capture {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
        for domain in [self.domain.clone(), format!("{}-truth", self.domain)] {
            let _ = DomainName::new(domain).map(|domain| DomainRemains::of(&domain).remove());
        }
    }
}

/// The machine may be busy.
const WATCHDOG: Duration = Duration::from_secs(120);

/// Waits until the file has so many bytes; the watchdog is generous, since the machine may be busy.
fn wait_for_bytes(file: &Path, bytes: u64) {
    let until = Instant::now() + WATCHDOG;
    while std::fs::metadata(file).map_or(0, |m| m.len()) < bytes {
        assert!(Instant::now() < until, "nothing is recorded");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_killed_recorder_leaves_a_file_that_is_whole_up_to_its_last_chunk() {
    let folder = tempfile::tempdir().expect("a folder");
    let capture = Capture::start("kill");
    let mut recorder = capture.record(folder.path(), "").spawn().expect("record starts");
    wait_for_bytes(&folder.path().join("out.mcap"), 40_000_000);
    recorder.kill().expect("SIGKILL");
    recorder.wait().expect("ended");
    let out = netcord(folder.path(), &["recover", "out.mcap", "saved.mcap"]);
    assert!(matches!(out.status.code(), Some(0 | 1)), "{}", text(&out.stderr));
    let saved = std::fs::read(folder.path().join("saved.mcap")).expect("written");
    let images = mcap::MessageStream::new(&saved)
        .expect("valid")
        .filter(|m| m.as_ref().is_ok_and(|m| m.channel.topic.ends_with("/image")))
        .count();
    // 40 MB hold 17 frames of 2.3 MB; four of them may have been on their way.
    assert!(images >= 12, "{images} images saved");

    // The capture is synthetic: what it knows of the ball is there too, and is of the images' instants.
    let messages = |topic: &str| {
        let stream = mcap::MessageStream::new(&saved).expect("valid").filter_map(Result::ok);
        stream.filter(|m| m.channel.topic == topic).collect::<Vec<_>>()
    };
    let truths = messages("/truth/ball");
    assert!(truths.len() >= images / 2 - 2, "{} truths of {images} images", truths.len());
    let stamps = messages("/camera/left/image").iter().map(|m| m.log_time).collect::<Vec<_>>();
    let known = truths.iter().filter(|truth| {
        let truth: RecordedTruth = serde_json::from_slice(&truth.data).expect("as the reader wants it");
        stamps.contains(&truth.t_ns) && truth.cameras.len() == 2
    });
    assert!(known.count() >= stamps.len() / 2);
    // Which `process` holds its results against. Images of four moments, again and again, are no flight.
    let out = netcord(folder.path(), &["process", "saved.mcap", "--report", "r.json"]);
    assert!(out.status.success(), "{}", text(&out.stderr));
    let report = std::fs::read(folder.path().join("r.json")).expect("written");
    let report: serde_json::Value = serde_json::from_slice(&report).expect("JSON");
    assert!(report["triggers"].as_u64().is_some_and(|n| n >= 4), "judged: {report}");
}

#[test]
fn a_full_disk_ends_the_recording_with_a_message_and_a_valid_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let capture = Capture::start("full");
    // 40 MB, in the shell's blocks of 512 bytes.
    let out = capture.record(folder.path(), "ulimit -f 80000;").output().expect("record starts");
    assert_eq!(out.status.code(), Some(1), "{}", text(&out.stderr));
    assert!(text(&out.stderr).contains("cannot write the recording out.mcap"), "{}", text(&out.stderr));
    let file = std::fs::read(folder.path().join("out.mcap")).expect("written");
    let summary = mcap::Summary::read(&file).expect("valid").expect("with an index");
    let counted = summary.stats.expect("there").message_count;
    let read = mcap::MessageStream::new(&file).expect("valid").filter(|m| m.is_ok()).count();
    assert!(counted > 10 && counted == read as u64, "{counted} in the index, {read} read");
}
