//! No process copies a whole frame on the live path: counted inside the processes.

use netcord_tests::{Copies, Lab, Running, Watch, one_at_a_time};

#[test]
fn segment_triangulate_and_predict_copy_no_frame() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let copies = Copies::build(&lab.path("."));
    // Frames that are rendered beforehand are patched into slots that were given a whole backdrop once, by a copy:
    // what shows that the counter counts.
    let rig = lab.synthetic_rig(50.0, &["--prerendered", "100"]);
    let mut command = lab.command(&["up", &rig.display().to_string(), "--quiet"]);
    let up = Running::start({
        copies.preload(&mut command);
        command
    });
    let bus = lab.bus();
    let mut watch = Watch::attach(&bus);
    let stages = watch.stages();
    let counts = |stage: &str| copies.of(stages[stage]);
    // Positions flow: whatever is done once, at the start, is done.
    watch.position_after(0);
    let frames_before = watch.counter("capture", "/frames_published");
    let before: Vec<_> = stages.keys().map(|stage| counts(stage)).collect();
    let frames = netcord_tests::until("a hundred frames", || {
        Some(watch.counter("capture", "/frames_published") - frames_before).filter(|n| *n >= 100)
    });
    assert!(frames >= 100);
    for ((stage, _), before) in stages.iter().zip(before) {
        let now = counts(stage);
        if stage == "capture" {
            assert!(now.calls >= 2 && now.bytes >= 2 * 1920 * 1200, "the counter counts: {now:?}");
        } else {
            assert_eq!(now, before, "{stage} copied whole frames");
        }
    }
    drop((watch, bus));
    assert_eq!(up.stop().code, Some(0));
}
