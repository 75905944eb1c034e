//! Faults of the synthetic source: each shows as a verdict and as a loss under its own name, and the pipeline
//! goes on.

use netcord_common::wire::{Frameset, Verdict};
use netcord_tests::{Lab, Running, Watch, one_at_a_time, until};

/// A running rig whose capture makes faults.
struct Faulty {
    lab: Lab,
    up: Running,
}

impl Faulty {
    fn start(switches: &[&str]) -> Self {
        let lab = Lab::new();
        let rig = lab.synthetic_rig(50.0, switches);
        let up = lab.start(&["up", &rig.display().to_string(), "--quiet"]);
        Self { lab, up }
    }

    /// Framesets of about two seconds, once all stages run.
    fn framesets(&self, watch: &mut Watch) -> Vec<Frameset> {
        watch.stages();
        let mut seen = Vec::new();
        until("a hundred framesets", || {
            seen.extend(watch.framesets());
            (seen.len() >= 100).then_some(())
        });
        seen
    }
}

fn count(framesets: &[Frameset], verdict: Verdict) -> usize {
    framesets.iter().filter(|f| f.verdict == verdict.code()).count()
}
