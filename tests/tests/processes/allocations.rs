//! In the steady state no stage takes memory from the heap for a frame.

use netcord_tests::{Lab, Watch, one_at_a_time, until};

#[test]
fn no_stage_allocates_per_frame() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let rig = lab.synthetic_rig(25.0, &[]);
    let up = lab.start(&["up", &rig.display().to_string(), "--quiet"]);
    let bus = lab.bus();
    let mut watch = Watch::attach(&bus);
    let stages = watch.stages();
    watch.position_after(0);
    let triggers = |watch: &mut Watch| watch.counter("capture", "left/frames_published");
    // A rally with hits and bounces passes before the count begins: buffers have grown to what they need.
    let warm = triggers(&mut watch) + 150;
    until("warm stages", || (triggers(&mut watch) >= warm).then_some(()));
    let counts = |watch: &mut Watch| {
        stages.keys().map(|stage| (stage.clone(), watch.counter(stage, "allocations"))).collect::<Vec<_>>()
    };
    let (before, from) = (counts(&mut watch), triggers(&mut watch));
    until("300 triggers", || (triggers(&mut watch) >= from + 300).then_some(()));
    // The counters are published once a second: the last ones may be older than the count of triggers.
    let after = counts(&mut watch);
    for ((stage, before), (_, after)) in before.iter().zip(&after) {
        assert!(*before > 0, "{stage} counts its allocations");
        let taken = after - before;
        assert!(taken < 20, "{stage} took memory {taken} times during 300 triggers");
    }
    drop((watch, bus));
    assert_eq!(up.stop().code, Some(0));
}
