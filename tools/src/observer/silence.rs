use std::{collections::BTreeMap, fmt, time::Duration};

use netcord_common::wire::Health;

use super::totals::Totals;

/// A stage that is at work by its own word, and lets nothing of what comes in pass.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Silence {
    /// The stage.
    pub stage: Stage,
    /// Its process id.
    pub pid: u32,
    /// How long it has been so.
    pub lasted: Duration,
    /// Messages that came out of the stage before it meanwhile.
    pub missed: u64,
    /// What the process has counted meanwhile, by counter.
    pub counted: Vec<(String, u64)>,
}

/// A stage that can fall silent: what it passes on can be told from the counters on `rig/health`. A ball need not be
/// in sight: frames without one give detections, and triggers without one give positions, as messages that say so.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// The segmenter of a camera.
    Segment(String),
    /// The triangulator.
    Triangulate,
    /// The predictor.
    Predict,
}

impl Stage {
    /// The service that it publishes on.
    pub fn output(&self) -> String {
        match self {
            Self::Segment(camera) => format!("camera/{camera}/detections"),
            Self::Triangulate => "ball/position".into(),
            Self::Predict => "ball/trajectory".into(),
        }
    }

    /// What it waits for.
    pub fn input(&self) -> String {
        match self {
            Self::Segment(camera) => format!("camera/{camera}/frame"),
            Self::Triangulate => "camera/…/detections and rig/frameset".into(),
            Self::Predict => "ball/position".into(),
        }
    }

    /// The stage that this one waits for.
    const fn source(&self) -> &'static str {
        match self {
            Self::Segment(_) => "capture",
            Self::Triangulate => "segment",
            Self::Predict => "triangulate",
        }
    }

    /// The stages that a process serves, by its counters.
    fn all_of(health: &Health) -> Vec<Self> {
        let process = health.process.as_str();
        match process.split(':').next().unwrap_or(process) {
            "segment" => {
                let cameras =
                    health.counters().iter().filter_map(|c| c.name.as_str().strip_suffix(FRAMES_SEARCHED));
                cameras.map(|camera| Self::Segment(camera.to_owned())).collect()
            }
            "triangulate" => vec![Self::Triangulate],
            "predict" => vec![Self::Predict],
            _ => Vec::new(),
        }
    }
}

const FRAMES_SEARCHED: &str = "/frames_searched";

/// Told of the processes' counters, finds stages that are silent while their input flows.
#[derive(Debug, Default)]
pub struct SilenceWatch {
    totals: Totals,
    stages: BTreeMap<Stage, Watched>,
}

#[derive(Debug)]
struct Watched {
    /// As it calls itself on `rig/health`.
    process: String,
    pid: u32,
    /// Since when something has come in and nothing gone out.
    since_ns: u64,
    /// Totals of when it was last seen to pass something on, or to become ready: in, out, and the process's counters.
    received: u64,
    passed: u64,
    counted: BTreeMap<String, u64>,
    told: bool,
}

/// Counters come once a second, and a loaded machine may keep a stage waiting for some of those.
const PATIENCE: Duration = Duration::from_secs(5);

/// Fewer messages than this may still be on their way at a rate of a few a second.
const FEWEST: u64 = 5;

impl SilenceWatch {
    /// Takes in a process's counters.
    pub fn see(&mut self, health: &Health) {
        self.totals.see(health);
        for stage in Stage::all_of(health) {
            let process = health.process.as_str().to_owned();
            let watched = self.stages.entry(stage).or_insert_with(|| Watched {
                process: process.clone(),
                pid: health.pid,
                since_ns: health.now_ns,
                received: 0,
                passed: 0,
                counted: BTreeMap::new(),
                told: false,
            });
            (watched.process, watched.pid) = (process, health.pid);
        }
    }

    /// The stages that have become silent. Each is told of once, until it has passed something on again;
    /// `is_ready` knows which processes are at work.
    pub fn look(&mut self, now_ns: u64, is_ready: impl Fn(u32) -> bool) -> Vec<Silence> {
        let mut silent = Vec::new();
        for (stage, watched) in &mut self.stages {
            let received = received(&self.totals, stage);
            let passed = passed(&self.totals, stage, &watched.process);
            // A frame that is being searched counts as passed until it is refused.
            if passed > watched.passed + 1 || !is_ready(watched.pid) {
                watched.since_ns = now_ns;
                (watched.received, watched.passed) = (received, passed);
                watched.counted = counted(&self.totals, &watched.process);
                watched.told = false;
                continue;
            }
            let missed = received.saturating_sub(watched.received);
            if missed == 0 {
                // It is no silence to wait for what does not come.
                watched.since_ns = now_ns;
            }
            let lasted = Duration::from_nanos(now_ns.saturating_sub(watched.since_ns));
            if !watched.told && lasted >= PATIENCE && missed >= FEWEST {
                watched.told = true;
                let before = |name: &str| watched.counted.get(name).copied().unwrap_or(0);
                let grown = counted(&self.totals, &watched.process).into_iter();
                let grown = grown.map(|(name, total)| (total - before(&name), name));
                silent.push(Silence {
                    stage: stage.clone(),
                    pid: watched.pid,
                    lasted,
                    missed,
                    counted: grown.filter(|(n, _)| *n > 0).map(|(n, name)| (name, n)).collect(),
                });
            }
        }
        silent
    }
}

/// What has come out of the stage before.
fn received(totals: &Totals, stage: &Stage) -> u64 {
    match stage {
        Stage::Segment(camera) => totals.of("capture", &format!("{camera}/frames_published")),
        // Frames that are refused give no message.
        Stage::Triangulate => {
            let counters = || totals.grown().filter(|(name, _)| name.starts_with("segment"));
            let sum =
                |ending| counters().filter(|(name, _)| name.ends_with(ending)).map(|(_, n)| n).sum::<u64>();
            sum(FRAMES_SEARCHED).saturating_sub(sum("/frames_refused"))
        }
        Stage::Predict => passed(totals, &Stage::Triangulate, "triangulate"),
    }
}

/// What a stage has let pass.
fn passed(totals: &Totals, stage: &Stage, process: &str) -> u64 {
    let of = |counter: &str| totals.of(process, counter);
    match stage {
        Stage::Segment(camera) => {
            of(&format!("{camera}{FRAMES_SEARCHED}")).saturating_sub(of(&format!("{camera}/frames_refused")))
        }
        Stage::Triangulate => of("positions") + of("triggers_without_position"),
        Stage::Predict => of("positions"),
    }
}

fn counted(totals: &Totals, process: &str) -> BTreeMap<String, u64> {
    let own =
        totals.grown().filter_map(|(name, n)| Some((name.strip_prefix(process)?.strip_prefix('/')?, n)));
    own.filter(|(name, _)| *name != "allocations").map(|(name, n)| (name.to_owned(), n)).collect()
}

impl fmt::Display for Silence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { stage, lasted, missed, counted, .. } = self;
        write!(
            f,
            "ready, but nothing has been published on {} for {} s, in which {} published {missed} messages; it waits \
             for {}; it has counted ",
            stage.output(),
            lasted.as_secs(),
            stage.source(),
            stage.input()
        )?;
        if counted.is_empty() {
            return f.write_str("nothing meanwhile: it hangs, or does not get them");
        }
        let counted: Vec<String> = counted.iter().map(|(name, n)| format!("{name} +{n}")).collect();
        write!(f, "{} meanwhile", counted.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use netcord_common::wire::{Counter, Text};

    use super::*;

    /// A rig of one camera, a second after the other.
    #[derive(Default)]
    struct Rig {
        watch: SilenceWatch,
        second: u64,
    }

    impl Rig {
        fn says(&mut self, process: &str, counters: &[(&str, u64)]) {
            let mut health = Health {
                process: Text::new(process),
                pid: process.len() as u32,
                now_ns: self.second * 1_000_000_000,
                count: counters.len() as u32,
                ..Health::default()
            };
            for (slot, (name, value)) in health.counters.iter_mut().zip(counters) {
                *slot = Counter { name: Text::new(name), value: *value };
            }
            self.watch.see(&health);
        }

        /// Totals of frames, searched, refused, judged and predicted.
        fn goes_on(&mut self, [frames, searched, refused, judged, predicted]: [u64; 5]) -> Vec<Silence> {
            self.second += 1;
            self.says("capture", &[("left/frames_published", frames)]);
            self.says("segment", &[("left/frames_searched", searched), ("left/frames_refused", refused)]);
            // Nobody ever sees a ball here.
            self.says("triangulate", &[("positions", 0), ("triggers_without_position", judged)]);
            self.says("predict", &[("positions", predicted), ("trajectories", 0)]);
            self.watch.look(self.second * 1_000_000_000, |_| true)
        }
    }

    #[test]
    fn no_ball_in_sight_and_no_frames_are_no_silence() {
        let mut rig = Rig::default();
        for second in 0..60 {
            // Counters of later stages are behind, by up to a second.
            let n = 100 * second;
            assert_eq!(rig.goes_on([n + 100, n + 90, 0, n + 50, n]), []);
        }
        for _ in 0..60 {
            assert_eq!(rig.goes_on([6000, 6000, 0, 6000, 6000]), [], "nothing comes in");
        }
        for few in 0..4 {
            assert_eq!(rig.goes_on([6000 + few, 6000, 0, 6000, 6000]), []);
        }
        for second in 1..20 {
            // After the pause, what comes in is counted before what goes out.
            let n = 6000 + 100 * second;
            assert_eq!(rig.goes_on([n, n - 100, 0, n - 100, n - 100]), []);
        }
    }

    #[test]
    fn a_silent_stage_is_told_of_once_with_what_it_counted() {
        let mut rig = Rig::default();
        let mut told = Vec::new();
        for second in 0..30 {
            told.extend(rig.goes_on([100 * second, 100 * second, 100 * second, 0, 0]));
        }
        assert_eq!(told.len(), 1, "what follows gets nothing, and is not to blame: {told:?}");
        assert_eq!(told[0].stage, Stage::Segment("left".into()));
        let said = told[0].to_string();
        for part in
            ["camera/left/detections", "camera/left/frame", "left/frames_refused +", "capture published"]
        {
            assert!(said.contains(part), "{said}");
        }
        // It comes back, and falls silent anew.
        for second in 30..60 {
            let n = 100 * second;
            let passed = 10 * (second - 29).min(5);
            told.extend(rig.goes_on([n, n, n - passed, passed, passed]));
        }
        assert_eq!(told.len(), 2, "{told:?}");
    }

    #[test]
    fn the_stage_that_holds_up_the_rest_is_named() {
        for (stage, [judged, predicted]) in [(Stage::Triangulate, [0, 0]), (Stage::Predict, [1, 0])] {
            let mut rig = Rig::default();
            let mut told = Vec::new();
            for second in 0..30 {
                let n = 100 * second;
                told.extend(rig.goes_on([n, n, 0, judged * n, predicted * n]));
            }
            let stages: Vec<Stage> = told.iter().map(|silence| silence.stage.clone()).collect();
            assert_eq!(stages, [stage]);
        }
    }

    #[test]
    fn who_is_not_ready_is_not_blamed() {
        let mut rig = Rig::default();
        for second in 0..30 {
            rig.second = second;
            rig.says("capture", &[("left/frames_published", 100 * second)]);
            rig.says("segment", &[("left/frames_searched", 0)]);
            assert_eq!(rig.watch.look(second * 1_000_000_000, |_| false), []);
        }
    }
}
