use std::{
    collections::{BTreeMap, VecDeque},
    ffi::OsString,
    io,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use netcord_common::{
    Clock as _, DomainName, MonotonicClock, NameError, Shutdown,
    bus::{Bus, BusError, SequenceGaps, Subscriber, Topic},
    rig::{Restart, Rig, RigError},
    wire::{BallPosition, BallTrajectory, BallTruth, Detections, Frameset, Health},
};
use thiserror::Error;

use super::{Judged, Setup, TrialReport, cpu::CpuUse, judge::Judge, plots::write_plots, view::TableView};
use crate::{
    observer::{Latencies, Losses, Observed, Observer, Tally},
    plot::PlotError,
    supervisor::{Happening, Launch, LaunchError, Supervisor},
    terminal::LiveLines,
};

/// A trial that could not be carried out.
#[derive(Debug, Error)]
pub enum TrialError {
    /// The setup fits no rig.
    #[error("{0}")]
    Setup(String),
    /// A file of the trial cannot be written.
    #[error("cannot write {path}: {cause}")]
    File {
        /// The file.
        path: String,
        /// Why.
        cause: io::Error,
    },
    /// The rig file.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// The domain's name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// `netcord up` cannot be started.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// The processes did not come up, or did not stay up.
    #[error("the processes {what}; their last lines:\n{last_lines}")]
    Processes {
        /// What they did.
        what: &'static str,
        /// What they said.
        last_lines: String,
    },
    /// A person stopped it.
    #[error("stopped before the end")]
    Stopped,
}

impl TrialError {
    pub(super) fn file(path: &Path, cause: io::Error) -> Self {
        Self::File { path: path.display().to_string(), cause }
    }
}

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
    /// Writes the plots beside `report`.
    ///
    /// # Errors
    /// [`PlotError`] when one cannot be written.
    pub fn write_plots(&self, report: &Path) -> Result<Vec<PathBuf>, PlotError> {
        write_plots(report, &self.rows, &self.latencies_ms)
    }
}

/// How long the processes may take to be ready. Frames rendered beforehand take their time.
const READY_PATIENCE: Duration = Duration::from_secs(120);
/// How long after the last judged exposure its messages may still come.
const LAST_MESSAGES: Duration = Duration::from_millis(500);
/// `up` stops up to six processes one after the other.
const UP_STOP_PATIENCE: Duration = Duration::from_secs(20);
/// How often the live view is drawn.
const DRAW: Duration = Duration::from_millis(100);

/// Runs a trial: starts `netcord up` in a fresh domain, observes, stops it, judges. Nothing of the domain
/// stays. To be called on the process's main thread (see [`Supervisor`]).
///
/// # Errors
/// [`TrialError`].
pub fn run(setup: &Setup, stop: &Shutdown, live: &mut LiveLines) -> Result<Trial, TrialError> {
    // The process id and the clock make it unique on this machine.
    let domain =
        DomainName::new(format!("t{}-{:x}", std::process::id(), MonotonicClock.now().as_ns() / 1000))?;
    let folder = tempfile::Builder::new()
        .prefix("netcord-trial-")
        .tempdir()
        .map_err(|e| TrialError::file(&std::env::temp_dir(), e))?;
    let path = setup.write_rig(folder.path(), &domain)?;
    let rig = Rig::load(&path)?;
    let executable = std::env::current_exe().map_err(|e| TrialError::file(Path::new("/proc/self/exe"), e))?;
    let arguments: Vec<OsString> =
        vec!["up".into(), path.into(), "--domain".into(), domain.as_str().into(), "--quiet".into()];
    let mut supervisor = Supervisor::new(vec![Launch {
        name: "up".into(),
        executable,
        arguments,
        restart: Restart::Never,
        stop_patience: UP_STOP_PATIENCE,
    }]);
    let mut last_lines = LastLines::default();
    let log = observe(setup, &rig, &domain, &mut supervisor, &mut last_lines, stop, live);
    // The observer has left the domain: `up` removes what is left of it.
    supervisor.stop(&mut |happening| last_lines.take(&happening));
    live.draw(&[]);
    log?.judge(setup)
}

/// The last lines of all processes, for the message when something fails.
#[derive(Debug, Default)]
struct LastLines {
    lines: VecDeque<String>,
    ready: bool,
    ended: bool,
}

impl LastLines {
    fn take(&mut self, happening: &Happening) {
        match happening {
            Happening::Line { line, .. } => {
                if self.lines.len() == 20 {
                    self.lines.pop_front();
                }
                self.lines.push_back(format!("  {line}"));
            }
            Happening::Ready { .. } => self.ready = true,
            Happening::Ended { .. } => self.ended = true,
            Happening::Started { .. } | Happening::GivenUp { .. } => {}
        }
    }

    fn failed(&self, what: &'static str) -> TrialError {
        let lines: Vec<String> = self.lines.iter().cloned().collect();
        TrialError::Processes { what, last_lines: lines.join("\n") }
    }
}

/// Everything seen, judged when all is over.
struct Log {
    judge: Judge,
    framesets: Vec<Frameset>,
    /// Without their candidates, which would be megabytes a second.
    detections: Vec<Detections>,
    positions: Vec<BallPosition>,
    /// What is left of trajectories: trigger and stamps.
    trajectories: Vec<BallTrajectory>,
    health: Vec<Health>,
    from_ns: u64,
    to_ns: u64,
    cpu: BTreeMap<String, f64>,
}

#[allow(clippy::too_many_lines)] // One after the other: start, warm up, measure.
fn observe(
    setup: &Setup,
    rig: &Rig,
    domain: &DomainName,
    supervisor: &mut Supervisor,
    last_lines: &mut LastLines,
    stop: &Shutdown,
    live: &mut LiveLines,
) -> Result<Log, TrialError> {
    let bus = Bus::join(domain, "trial")?;
    let mut observer = Observer::attach(&bus, rig)?;
    let truth_bus = Bus::join(&crate::commands::listen::truth_domain(domain)?, "trial")?;
    let truths: Subscriber<BallTruth> = truth_bus.subscriber(&Topic::truth())?;
    let mut log = Log {
        judge: Judge::default(),
        framesets: Vec::new(),
        detections: Vec::new(),
        positions: Vec::new(),
        trajectories: Vec::new(),
        health: Vec::new(),
        from_ns: u64::MAX,
        to_ns: u64::MAX,
        cpu: BTreeMap::new(),
    };
    let mut tally = Tally::default();
    let mut view = TableView::default();
    let mut pids: BTreeMap<String, u32> = BTreeMap::new();
    let (started, mut drawn) = (Instant::now(), Instant::now());
    let mut cpu_before = None;
    loop {
        supervisor.step(observer.interval(), &mut || {}, &mut |happening| last_lines.take(&happening))?;
        if stop.is_requested() {
            return Err(TrialError::Stopped);
        }
        if last_lines.ended {
            return Err(last_lines.failed("ended early"));
        }
        let now = MonotonicClock.now();
        if !last_lines.ready {
            if started.elapsed() > READY_PATIENCE {
                return Err(last_lines.failed("do not become ready"));
            }
        } else if log.from_ns == u64::MAX {
            log.from_ns = now.after(Duration::from_secs_f64(setup.warm_up_s)).as_ns();
            log.to_ns = log.from_ns + (setup.seconds * 1e9) as u64;
        }
        let now = now.as_ns();
        while let Some(truth) = truths.receive()? {
            log.judge.truth(&truth);
            view.truth(&truth);
        }
        observer.drain(&mut |seen| {
            if now >= log.from_ns {
                tally.see(&seen);
            }
            match seen {
                Observed::Frameset(f) => log.framesets.push(*f),
                Observed::Detections(d) => log.detections.push(Detections { count: 0, ..*d }),
                Observed::Position(p) => {
                    log.judge.position(p);
                    log.positions.push(*p);
                    view.position(p);
                }
                Observed::Trajectory(t) => log.trajectories.push(*t),
                Observed::Health(h) => {
                    pids.insert(h.process.as_str().to_owned(), h.pid);
                    log.health.push(*h);
                }
            }
        })?;
        if now >= log.from_ns && cpu_before.is_none() {
            cpu_before = Some(CpuUse::now(&pids));
        }
        if now >= log.to_ns && log.cpu.is_empty() {
            log.cpu = cpu_before.as_ref().map(|b| CpuUse::now(&pids).share_since(b)).unwrap_or_default();
        }
        if now.saturating_sub(LAST_MESSAGES.as_nanos() as u64) >= log.to_ns {
            return Ok(log);
        }
        if live.is_seen() && drawn.elapsed() >= DRAW {
            drawn = Instant::now();
            live.draw(&live_lines(&log, now, &view, &tally, last_lines.ready));
        }
    }
}

fn live_lines(log: &Log, now: u64, view: &TableView, tally: &Tally, ready: bool) -> Vec<String> {
    let seconds = |from: u64, to: u64| to.saturating_sub(from) as f64 * 1e-9;
    let headline = if !ready {
        "starting the processes".into()
    } else if now < log.from_ns {
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
        let mut report = TrialReport {
            score,
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
