use std::{
    collections::BTreeMap,
    error::Error,
    path::Path,
    time::{Duration, Instant},
};

use netcord_common::{Clock as _, MonotonicClock, Shutdown};
use serde::Serialize;

use super::median;
use crate::{
    observer::Observed,
    terminal::LiveLines,
    trial::{self, Deployment, Setup, TrialError},
};

/// The rates that are tried, in order, until one loses a frame.
pub const LADDER_HZ: [f64; 13] =
    [100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0, 450.0, 500.0, 600.0, 700.0, 850.0, 1000.0];
/// Seconds at each rate.
const RUNG_S: f64 = 10.0;
/// Frames rendered beforehand for each camera.
const POOL: usize = 200;
/// Pairs of runs with and without recording.
pub(super) const PAIRS: usize = 5;
/// How long any recovery may take before it counts as none.
const RECOVERY_PATIENCE: Duration = Duration::from_secs(30);

/// The ladder of rates.
#[derive(Debug, Clone, Serialize)]
pub struct Ladder {
    /// The highest rate with no loss; absent where the lowest had one.
    pub max_rate_hz: Option<f64>,
    /// Frames lost at each rate that was tried, and the rate that was kept.
    pub rungs: Vec<Rung>,
}

/// One rate.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Rung {
    /// Asked for, Hz.
    pub rate_hz: f64,
    /// Kept: triggers answered a second.
    pub kept_hz: Option<f64>,
    /// Frames lost.
    pub lost: u64,
    /// Frame complete → position published, median, ms.
    pub p50_ms: Option<f64>,
    /// 99 %, ms.
    pub p99_ms: Option<f64>,
}

/// Climbs the ladder with two cameras and frames rendered beforehand, until a rate loses a frame.
///
/// # Errors
/// [`TrialError`].
pub fn measure_ladder(stop: &Shutdown, say: &mut dyn FnMut(String)) -> Result<Ladder, TrialError> {
    let mut ladder = Ladder { max_rate_hz: None, rungs: Vec::new() };
    for rate_hz in LADDER_HZ {
        say(format!("highest rate: {RUNG_S} s at {rate_hz} Hz"));
        let setup = Setup { rate_hz, seconds: RUNG_S, prerendered: Some(POOL), ..Setup::default() };
        let report = trial::run(&setup, stop, &mut LiveLines::new(true))?.report;
        let latency = report.latency_ms.frame_to_position;
        let (lost, kept_hz) = (report.frames.lost, report.rate_hz);
        let (p50_ms, p99_ms) = (latency.map(|q| q.p50), latency.map(|q| q.p99));
        ladder.rungs.push(Rung { rate_hz, kept_hz, lost, p50_ms, p99_ms });
        // A source that cannot keep the rate has lost frames too, before they were counted.
        if lost > 0 || kept_hz.is_none_or(|kept| kept < rate_hz * 0.99) {
            break;
        }
        ladder.max_rate_hz = Some(rate_hz);
    }
    Ok(ladder)
}

/// What recording does to the pipeline.
#[derive(Debug, Clone, Serialize)]
pub struct RecordEffect {
    /// By how much recording raises the median over the runs of the p50 of frame → position, as a fraction.
    pub p50_growth: Option<f64>,
    /// The same of the p99.
    pub p99_growth: Option<f64>,
    /// Frames that the pipeline lost in the runs with recording.
    pub lost: u64,
    /// The same in those without.
    pub lost_without: u64,
    /// Frames and messages that are missing in the recordings.
    pub not_recorded: u64,
    /// The pairs, in the order in which they ran.
    pub pairs: Vec<RunPair>,
}

/// One pair of runs: quantiles of frame → position, ms.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct RunPair {
    /// Without what is measured.
    pub without: RunTimes,
    /// With.
    pub with: RunTimes,
}

/// One run.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct RunTimes {
    /// Frames that the pipeline lost.
    pub lost: u64,
    /// Frames and messages that the recorder lost.
    pub not_recorded: u64,
    /// Median.
    pub p50: f64,
    /// 99 %.
    pub p99: f64,
}

impl RecordEffect {
    fn of(pairs: Vec<RunPair>) -> Self {
        let sum = |of: fn(&RunPair) -> u64| pairs.iter().map(of).sum();
        Self {
            p50_growth: growth(&pairs, |run| run.p50),
            p99_growth: growth(&pairs, |run| run.p99),
            lost: sum(|pair| pair.with.lost),
            lost_without: sum(|pair| pair.without.lost),
            not_recorded: sum(|pair| pair.with.not_recorded),
            pairs,
        }
    }
}

/// Runs interleaved pairs of 10 s at 100 Hz without and with `netcord record` into `folder`, which should lie on
/// tmpfs.
///
/// # Errors
/// [`TrialError`], and a run without a position.
pub fn measure_record_effect(
    folder: &Path,
    stop: &Shutdown,
    say: &mut dyn FnMut(String),
) -> Result<RecordEffect, Box<dyn Error>> {
    let mut run = |record: bool| -> Result<RunTimes, Box<dyn Error>> {
        let file = folder.join(format!("netcord-bench-{}.mcap", std::process::id()));
        let setup = Setup { seconds: 10.0, record: record.then(|| file.clone()), ..Setup::default() };
        let trial = trial::run(&setup, stop, &mut LiveLines::new(true));
        if record {
            // 460 MB a second: it must not pile up. One that was never begun is not there.
            let _ = std::fs::remove_file(&file);
        }
        let report = trial?.report;
        let by_recorder = report.frames.lost_by_reason.iter().filter(|(name, _)| name.starts_with("record/"));
        let not_recorded = by_recorder.map(|(_, count)| count).sum();
        let q = report.latency_ms.frame_to_position.ok_or("a run without a position")?;
        Ok(RunTimes { lost: report.frames.lost, not_recorded, p50: q.p50, p99: q.p99 })
    };
    let pairs = interleaved(&mut run, &mut |n| say(format!("effect of recording: pair {n} of {PAIRS}")))?;
    Ok(RecordEffect::of(pairs))
}

/// Growth of the median over the runs, as a fraction.
pub(super) fn growth(pairs: &[RunPair], of: fn(&RunTimes) -> f64) -> Option<f64> {
    let over =
        |run: fn(&RunPair) -> &RunTimes| median(&pairs.iter().map(|pair| of(run(pair))).collect::<Vec<_>>());
    Some(over(|pair| &pair.with)? / over(|pair| &pair.without)? - 1.0)
}

/// Pairs of runs, without and with what `run` is told to do; `say` is told each pair's number.
pub(super) fn interleaved(
    run: &mut dyn FnMut(bool) -> Result<RunTimes, Box<dyn Error>>,
    say: &mut dyn FnMut(usize),
) -> Result<Vec<RunPair>, Box<dyn Error>> {
    let mut pairs = Vec::new();
    for n in 1..=PAIRS {
        say(n);
        // The order changes from pair to pair, so that a drift of the machine favours neither.
        let (without, with) = if n % 2 == 1 {
            let without = run(false)?;
            (without, run(true)?)
        } else {
            let with = run(true)?;
            (run(false)?, with)
        };
        pairs.push(RunPair { without, with });
    }
    Ok(pairs)
}

/// How long the rig was without results after each process was killed.
#[derive(Debug, Clone, Serialize)]
pub struct Recovery {
    /// Median over the kills of each stage: kill -9 → first result from a frame exposed after it, ms.
    pub kill_to_position_ms: BTreeMap<&'static str, Option<f64>>,
    /// Processes that were restarted although another one was killed.
    pub others_restarted: u64,
}

/// Kills of each process.
const KILLS: usize = 5;

/// Kills each process several times under `up` and measures how long it takes until positions flow again
/// (of predict: trajectories).
///
/// # Errors
/// [`TrialError`].
pub fn measure_recovery(stop: &Shutdown, say: &mut dyn FnMut(String)) -> Result<Recovery, TrialError> {
    let setup = Setup { scene: trial::Scene::Clean, ..Setup::default() };
    kill_each(&mut Deployment::start(&setup)?, stop, say)
}

fn kill_each(
    deployment: &mut Deployment,
    stop: &Shutdown,
    say: &mut dyn FnMut(String),
) -> Result<Recovery, TrialError> {
    deployment.wait_until_ready(stop, &mut |_| {})?;
    let mut times: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
    let mut others_restarted = 0;
    for n in 1..=KILLS {
        for stage in ["capture", "segment", "triangulate", "predict"] {
            say(format!("recovery: {stage} is killed, {n} of {KILLS}"));
            // Its health, and a while of undisturbed work, come first.
            deployment.run_for(Duration::from_millis(1500), stop)?;
            let before = deployment.pids().clone();
            let Some(pid) = before.get(stage).and_then(|pid| i32::try_from(*pid).ok()) else { continue };
            let killed_ns = MonotonicClock.now().as_ns();
            let _ =
                nix::sys::signal::kill(nix::unistd::Pid::from_raw(pid), nix::sys::signal::Signal::SIGKILL);
            let since = Instant::now();
            let mut result_ns = None;
            while result_ns.is_none() && since.elapsed() < RECOVERY_PATIENCE {
                deployment.step(stop, &mut |seen| {
                    let stamps = match seen {
                        Observed::Position(p) if stage != "predict" && p.is_present() => &p.stamps,
                        Observed::Trajectory(t) if stage == "predict" => &t.stamps,
                        _ => return,
                    };
                    if stamps.mid_exposure_host_ns > killed_ns && result_ns.is_none() {
                        result_ns = Some(stamps.predict_published_ns.max(stamps.triangulate_published_ns));
                    }
                })?;
            }
            if let Some(result_ns) = result_ns {
                times.entry(stage).or_default().push((result_ns - killed_ns) as f64 * 1e-6);
            }
            deployment.run_for(Duration::from_millis(1500), stop)?;
            let after = deployment.pids();
            others_restarted +=
                before.iter().filter(|(name, pid)| *name != stage && after.get(*name) != Some(pid)).count()
                    as u64;
        }
    }
    let kill_to_position_ms = ["capture", "segment", "triangulate", "predict"]
        .map(|stage| (stage, times.get(stage).and_then(|t| median(t))));
    Ok(Recovery { kill_to_position_ms: kill_to_position_ms.into(), others_restarted })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_effect_of_recording_is_that_on_the_medians_whatever_one_bad_run_says() {
        let run = |p50: f64, p99: f64, lost: u64| RunTimes { lost, not_recorded: lost * 2, p50, p99 };
        let pair = |without: f64, with: f64| RunPair {
            without: run(without, 2.0 * without, 0),
            with: run(with, 4.0 * without, 1),
        };
        let pairs = vec![pair(1.0, 1.1), pair(1.0, 1.1), pair(50.0, 1.2), pair(1.0, 1.1), pair(0.9, 40.0)];
        let effect = RecordEffect::of(pairs);
        assert!((effect.p50_growth.expect("pairs") - 0.1).abs() < 1e-12);
        assert!((effect.p99_growth.expect("pairs") - 1.0).abs() < 1e-12);
        assert_eq!((effect.lost, effect.lost_without, effect.not_recorded), (5, 0, 10));
        assert_eq!(RecordEffect::of(Vec::new()).p50_growth, None);
    }
}
