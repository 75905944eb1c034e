//! kill -9 of each process: `up` restarts it, the others live on, positions flow again, nothing stays.

use netcord_common::{Clock as _, MonotonicClock};
use netcord_tests::{Lab, Watch, one_at_a_time, signal_process, until};
use nix::sys::signal::Signal;

#[test]
fn any_process_killed_is_restarted_alone_and_positions_flow_again() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let rig = lab.synthetic_rig(50.0, &[]);
    let up = lab.start(&["up", &rig.display().to_string(), "--quiet"]);
    let bus = lab.bus();
    let mut watch = Watch::attach(&bus);
    let mut stages = watch.stages();
    let mut trigger = watch.position_after(0).trigger_id;
    let settled = lab.shared_memory().len();
    for victim in ["capture", "segment", "triangulate", "predict"] {
        signal_process(stages[victim], Signal::SIGKILL);
        let successor = until("a successor", || {
            let pid = watch.health().get(victim)?.pid;
            (pid != stages[victim]).then_some(pid)
        });
        let position = watch.position_after(MonotonicClock.now().as_ns());
        assert!(position.trigger_id > trigger, "triggers only grow, also over a restart of {victim}");
        trigger = position.trigger_id;
        stages.insert(victim.into(), successor);
        assert_eq!(watch.stages(), stages, "only {victim} was killed");
    }
    // What the dead had in shared memory is gone: as much is there as before they died.
    until("shared memory as before", || (lab.shared_memory().len() <= settled).then_some(()));
    drop(watch);
    drop(bus);
    let ended = up.stop();
    assert_eq!(ended.code, Some(1), "processes died on the way:\n{}", ended.err);
    assert_eq!(lab.shared_memory(), Vec::<std::path::PathBuf>::new());
}
