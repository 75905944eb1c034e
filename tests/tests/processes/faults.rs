//! Faults of the synthetic source: each shows as a verdict and as a loss under its own name, and the pipeline
//! goes on.

use netcord_common::wire::{Frameset, Verdict};
use netcord_tests::{Lab, Watch, one_at_a_time, until};

/// What two seconds of a rig whose capture makes `faults` show: the framesets, and capture's counters by name.
struct Seen {
    framesets: Vec<Frameset>,
    counters: Vec<(String, u64)>,
    positions: usize,
}

impl Seen {
    fn of(faults: &[&str]) -> Self {
        let lab = Lab::new();
        let switches: Vec<&str> = faults.iter().flat_map(|fault| ["--fault", fault]).collect();
        let rig = lab.synthetic_rig(50.0, &switches);
        let up = lab.start(&["up", &rig.display().to_string(), "--quiet"]);
        let bus = lab.bus();
        let mut watch = Watch::attach(&bus);
        let stages = watch.stages();
        watch.position_after(0);
        let (mut framesets, mut positions) = (Vec::new(), 0);
        until("a hundred framesets", || {
            framesets.extend(watch.framesets());
            positions += watch.positions().iter().filter(|p| p.is_present()).count();
            (framesets.len() >= 100).then_some(())
        });
        assert_eq!(watch.stages(), stages, "nobody fell over");
        // The counters of the whole run: the last ones are published when capture ends.
        drop(up.stop());
        let health = watch.health()["capture"];
        let counters = health.counters().iter().map(|c| (c.name.as_str().to_owned(), c.value)).collect();
        Self { framesets, counters, positions }
    }

    fn verdicts(&self, verdict: Verdict) -> usize {
        self.framesets.iter().filter(|f| f.verdict == verdict.code()).count()
    }

    fn counter(&self, name: &str) -> u64 {
        let found = self.counters.iter().find(|(n, _)| n == name);
        found.unwrap_or_else(|| panic!("no counter {name} in {:?}", self.counters)).1
    }
}

#[test]
fn a_source_without_faults_gives_complete_framesets_only() {
    let _turn = one_at_a_time();
    let seen = Seen::of(&[]);
    // A busy machine may cost a frame or hold it back, which is counted as such; nothing else may.
    let incomplete = seen.framesets.len() - seen.verdicts(Verdict::Complete);
    let busy = seen.counter("lost_overrun") + seen.counter("frames_late");
    assert!(incomplete as u64 <= busy, "{:?}", seen.counters);
    for name in ["lost_dropped", "lost_truncated", "lost_duplicate", "lost_no_slot"] {
        assert_eq!(seen.counter(name), 0, "{name}");
    }
}

#[test]
fn dropped_and_truncated_frames_are_lost_by_reason_and_their_triggers_incomplete() {
    let _turn = one_at_a_time();
    let seen = Seen::of(&["drop,camera=left,every=10", "truncate,camera=right,every=7"]);
    let (dropped, truncated) = (seen.counter("lost_dropped"), seen.counter("lost_truncated"));
    // A trigger that a busy machine left out was not there to be dropped.
    let overrun = seen.counter("lost_overrun");
    assert!(dropped + overrun >= 10 && truncated + overrun >= 14, "{:?}", seen.counters);
    let incomplete = seen.verdicts(Verdict::Incomplete);
    // Of a hundred triggers 10 lack the left frame and 14 the right one, at one or two both.
    let share = incomplete as f64 / seen.framesets.len() as f64;
    let busy = overrun as f64 / seen.framesets.len() as f64;
    assert!((0.18 - busy..=0.27 + busy).contains(&share), "{share}: {:?}", seen.counters);
    for frameset in seen.framesets.iter().filter(|f| f.verdict == Verdict::Incomplete.code()) {
        assert_ne!(frameset.delivered, frameset.expected);
        assert_eq!(frameset.expected, 0b11);
    }
    assert!(seen.positions > 0, "the other triggers have positions");
}

#[test]
fn a_camera_that_exposes_late_is_unsynchronised_and_gives_no_position() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let rig = lab.synthetic_rig(50.0, &["--fault", "desync,camera=right,us=3000,every=2"]);
    let up = lab.start(&["up", &rig.display().to_string(), "--quiet"]);
    let bus = lab.bus();
    let mut watch = Watch::attach(&bus);
    watch.stages();
    watch.position_after(0);
    let (mut framesets, mut positions) = (Vec::new(), Vec::new());
    until("a hundred framesets", || {
        framesets.extend(watch.framesets());
        positions.extend(watch.positions());
        (framesets.len() >= 100 && positions.len() >= 100).then_some(())
    });
    let unsynchronised: Vec<u64> = framesets
        .iter()
        .filter(|f| f.verdict == Verdict::Unsynchronised.code())
        .inspect(|f| assert!(f.skew_ns.abs_diff(3_000_000) < 1000 && f.skew_ns > f.tolerance_ns, "{f:?}"))
        .map(|f| f.trigger_id)
        .collect();
    // Every other one; framesets come in batches, so that there may be more than a hundred.
    let off = (2 * unsynchronised.len()).abs_diff(framesets.len());
    assert!(off <= 10, "{} of {}", unsynchronised.len(), framesets.len());
    assert!(positions.iter().any(netcord_common::wire::BallPosition::is_present));
    for position in positions.iter().filter(|p| unsynchronised.contains(&p.trigger_id)) {
        assert!(!position.is_present(), "a position from exposures 3 ms apart: {position:?}");
    }
    drop((watch, bus));
    assert_eq!(up.stop().code, Some(0));
}

#[test]
fn a_frame_that_comes_twice_or_out_of_order_is_told_by_its_trigger() {
    let _turn = one_at_a_time();
    let seen = Seen::of(&["duplicate,camera=left,every=9", "reorder,camera=right,every=11"]);
    assert!(seen.counter("lost_duplicate") >= 10, "{:?}", seen.counters);
    // Out of order, but in time: every trigger is complete all the same.
    let complete = seen.verdicts(Verdict::Complete);
    let overrun = seen.counter("lost_overrun") as usize;
    assert!(complete + 2 + overrun >= seen.framesets.len(), "{complete}: {:?}", seen.counters);
    assert!(seen.positions > 0);
}
