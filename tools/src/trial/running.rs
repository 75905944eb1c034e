use std::{
    collections::BTreeMap,
    path::PathBuf,
    time::{Duration, Instant},
};

use netcord_common::{
    Clock as _, MonotonicClock, Shutdown,
    bus::SequenceGaps,
    wire::{BallPosition, BallTrajectory, Detections, Frameset, Health},
};

use super::{
    Deployment, Judged, Setup, TrialError, TrialReport, cpu::CpuUse, example_rig, foresight::Foresight,
    judge::Judge, plots::write_plots, view::TableView,
};
use crate::{
    observer::{Latencies, Losses, Observed, Tally},
    plot::PlotError,
    terminal::LiveLines,
};

/// A trial that was carried out.
#[derive(Debug)]
pub struct Trial {
    /// What it came to.
    pub report: TrialReport,
    rows: Vec<Judged>,
    /// Frame complete → position published, of every position.
    latencies_ms: Vec<f64>,
}

impl Trial {
    /// Writes the plots where [`super::plot_paths`] says.
    ///
    /// # Errors
    /// [`PlotError`] when one cannot be written.
    pub fn write_plots(&self, paths: &[PathBuf; 3]) -> Result<(), PlotError> {
        write_plots(paths, &self.rows, &self.latencies_ms)
    }
}

/// How long after the last judged exposure its messages may still come.
const LAST_MESSAGES: Duration = Duration::from_millis(500);
/// How often the live view is drawn.
const DRAW: Duration = Duration::from_millis(100);

/// Runs a trial: starts `netcord up` in a fresh domain, observes, stops it, judges. Nothing of the domain
/// stays. To be called on the process's main thread (see [`Deployment`]).
///
/// # Errors
/// [`TrialError`].
pub fn run(setup: &Setup, stop: &Shutdown, live: &mut LiveLines) -> Result<Trial, TrialError> {
    let mut deployment = Deployment::start(setup)?;
    let log = observe(setup, &mut deployment, stop, live);
    let said = deployment.stop();
    live.draw(&[]);
    let mut trial = log?.judge(setup)?;
    if let (Some(file), Some(said)) = (&setup.record, said.filter(|said| !said.is_empty())) {
        trial.report.missed.push(format!("the recording {} is not whole: {said}", file.display()));
    }
    Ok(trial)
}

/// Everything seen, judged when all is over.
#[derive(Debug, Default)]
struct Log {
    judge: Judge,
    foresight: Foresight,
    framesets: Vec<Frameset>,
    detections: Vec<Detections>,
    positions: Vec<BallPosition>,
    trajectories: Vec<BallTrajectory>,
    health: Vec<Health>,
    /// Exposures from here to before `to_ns` are judged.
    from_ns: u64,
    to_ns: u64,
    cpu: BTreeMap<String, f64>,
}

fn observe(
    setup: &Setup,
    deployment: &mut Deployment,
    stop: &Shutdown,
    live: &mut LiveLines,
) -> Result<Log, TrialError> {
    let (mut log, mut view, mut tally) = (Log::default(), TableView::default(), Tally::default());
    live.draw(&["starting the processes".into()]);
    deployment.wait_until_ready(stop, &mut |seen| log.take(&seen))?;
    log.from_ns = MonotonicClock.now().after(Duration::from_secs_f64(setup.warm_up_s)).as_ns();
    log.to_ns = log.from_ns + (setup.seconds * 1e9) as u64;
    let mut cpu_before = None;
    let mut drawn = Instant::now();
    loop {
        let now_ns = MonotonicClock.now().as_ns();
        let measuring = now_ns >= log.from_ns;
        deployment.step(stop, &mut |seen| {
            log.take(&seen);
            view.see(&seen);
            if measuring {
                tally.see(&seen);
            }
        })?;
        if measuring && cpu_before.is_none() {
            cpu_before = Some(CpuUse::now(deployment.pids()));
        }
        if let Some(before) = cpu_before.as_ref().filter(|_| now_ns >= log.to_ns && log.cpu.is_empty()) {
            log.cpu = CpuUse::now(deployment.pids()).share_since(before);
        }
        if Duration::from_nanos(now_ns.saturating_sub(log.to_ns)) >= LAST_MESSAGES {
            return Ok(log);
        }
        if live.is_seen() && drawn.elapsed() >= DRAW {
            drawn = Instant::now();
            live.draw(&live_lines(&log, now_ns, &view, &tally));
        }
    }
}

fn live_lines(log: &Log, now: u64, view: &TableView, tally: &Tally) -> Vec<String> {
    let seconds = |from: u64, to: u64| to.saturating_sub(from) as f64 * 1e-9;
    let headline = if now < log.from_ns {
        format!("warming up, {:.0} s to go", seconds(now, log.from_ns))
    } else {
        format!("measuring, {:.0} s to go", seconds(now, log.to_ns))
    };
    let mut lines = vec![headline];
    lines.extend(view.lines());
    lines.extend(tally.lines());
    lines
}

impl Log {
    fn take(&mut self, seen: &Observed<'_>) {
        match seen {
            Observed::Truth(truth) => {
                self.judge.truth(truth);
                self.foresight.truth(truth);
            }
            Observed::Frameset(frameset) => self.framesets.push(**frameset),
            Observed::Detections(detections) => self.detections.push(**detections),
            Observed::Position(position) => {
                self.judge.position(position);
                self.positions.push(**position);
            }
            Observed::Trajectory(trajectory) => {
                self.foresight.trajectory(trajectory);
                self.trajectories.push(**trajectory);
            }
            Observed::Health(health) => self.health.push(**health),
        }
    }

    fn judge(self, setup: &Setup) -> Result<Trial, TrialError> {
        let (first, last) = self.judge.triggers_between(self.from_ns, self.to_ns).ok_or_else(|| {
            TrialError::Setup(
                "capture published no truth while it was observed: was it the synthetic source?".into(),
            )
        })?;
        let judged = first..=last;
        let (rows, score) = self.judge.judge(first, last);
        let mut latencies = Latencies::default();
        let mut gaps = SequenceGaps::new();
        let mut unobserved = 0;
        let mut latencies_ms = Vec::new();
        let (mut begin_ns, mut end_ns, mut answered) = (u64::MAX, 0, 0_u64);
        for position in &self.positions {
            let gap = gaps.see(0, position.sequence);
            if judged.contains(&position.trigger_id) {
                unobserved += gap;
                latencies.position(position);
                if position.is_present() {
                    let s = &position.stamps;
                    latencies_ms
                        .push(s.triangulate_published_ns.saturating_sub(s.frame_complete_ns) as f64 * 1e-6);
                }
                begin_ns = begin_ns.min(position.stamps.mid_exposure_host_ns);
                end_ns = end_ns.max(position.stamps.mid_exposure_host_ns);
                answered += 1;
            }
        }
        for trajectory in self.trajectories.iter().filter(|t| judged.contains(&t.trigger_id)) {
            latencies.trajectory(trajectory);
        }
        let plane_y_m = example_rig(setup.cameras)?.hitting_plane.y_m;
        let mut report = TrialReport {
            score,
            hitting_plane_error: self.foresight.hitting_errors(plane_y_m, self.from_ns, self.to_ns),
            landing_error: self.foresight.landing_errors(self.from_ns, self.to_ns),
            latency_ms: latencies.report(),
            frames: self.losses(first, last).report(),
            rate_hz: (answered > 1).then(|| (answered - 1) as f64 / (end_ns - begin_ns) as f64 * 1e9),
            cpu_share: self.cpu,
            unobserved,
            setup: setup.into(),
            missed: Vec::new(),
        };
        report.judge_marks();
        Ok(Trial { report, rows, latencies_ms })
    }

    fn losses(&self, first: u64, last: u64) -> Losses {
        let mut losses = Losses::default();
        let judged = first..=last;
        for frameset in self.framesets.iter().filter(|f| judged.contains(&f.trigger_id)) {
            losses.frameset(frameset);
        }
        // The last message before the judged range says where the counts stood.
        let mut before: BTreeMap<u32, &Detections> = BTreeMap::new();
        for detections in self.detections.iter().filter(|d| d.trigger_id < first) {
            before.insert(detections.camera, detections);
        }
        let inside = self.detections.iter().filter(|d| judged.contains(&d.trigger_id));
        for detections in before.into_values().chain(inside) {
            losses.detections(detections);
        }
        let end_ns = self.to_ns;
        for health in self.health.iter().filter(|h| (self.from_ns..=end_ns).contains(&h.now_ns)) {
            losses.health(health);
        }
        losses
    }
}
