use std::{
    collections::{BTreeMap, VecDeque},
    ffi::OsString,
    path::Path,
    time::{Duration, Instant},
};

use netcord_capture::synthetic::truth_domain;
use netcord_common::{
    Clock as _, DomainName, MonotonicClock, Shutdown,
    bus::{Bus, DomainRemains, Subscriber, Topic},
    rig::{Restart, Rig},
    wire::BallTruth,
};

use super::{Setup, TrialError};
use crate::{
    observer::{Observed, Observer},
    supervisor::{Happening, Launch, Supervisor},
};

/// The pipeline at work under `netcord up`, in a fresh domain of which nothing stays, and observed. To be used on
/// the process's main thread (see [`Supervisor`]).
#[derive(Debug)]
pub struct Deployment {
    supervisor: Supervisor,
    words: Words,
    eyes: Option<Eyes>,
    domain: DomainName,
    pids: BTreeMap<String, u32>,
    /// Of the rig file; removed at the end.
    _folder: tempfile::TempDir,
}

/// What sees the domain's messages. It leaves before `up` stops, which removes what is left of the domain.
#[derive(Debug)]
struct Eyes {
    observer: Observer,
    truths: Subscriber<BallTruth>,
    _buses: [Bus; 2],
}

/// What `up` and its children say.
#[derive(Debug, Default)]
struct Words {
    last_lines: VecDeque<String>,
    ready: bool,
    ended: bool,
    ended_badly: bool,
}

/// How long the processes may take to be ready. Frames rendered beforehand take their time.
const READY_PATIENCE: Duration = Duration::from_secs(120);
/// `up` stops up to six processes one after the other.
const STOP_PATIENCE: Duration = Duration::from_secs(20);
/// A recorder may have much to write: `up` itself sees whether it gets on.
const RECORDED_STOP_PATIENCE: Duration = Duration::from_secs(600);
/// Lines kept for the message when something fails.
const LAST_LINES: usize = 20;

impl Deployment {
    /// Starts `netcord up` on what `setup` says.
    ///
    /// # Errors
    /// [`TrialError`].
    pub fn start(setup: &Setup) -> Result<Self, TrialError> {
        // The process id and the clock make it unique on this machine.
        let unique = MonotonicClock.now().as_ns() / 1000;
        let domain = DomainName::new(format!("t{}-{unique:x}", std::process::id()))?;
        let folder = tempfile::Builder::new()
            .prefix("netcord-trial-")
            .tempdir()
            .map_err(|e| TrialError::file(&std::env::temp_dir(), e))?;
        let path = setup.write_rig(folder.path(), &domain)?;
        let eyes = Eyes::open(&Rig::load(&path)?, &domain)?;
        let executable =
            std::env::current_exe().map_err(|e| TrialError::file(Path::new("/proc/self/exe"), e))?;
        let arguments: Vec<OsString> =
            vec!["up".into(), path.into(), "--domain".into(), domain.as_str().into(), "--quiet".into()];
        let supervisor = Supervisor::new(vec![Launch {
            name: "up".into(),
            executable,
            arguments,
            restart: Restart::Never,
            stop_patience: if setup.record.is_some() { RECORDED_STOP_PATIENCE } else { STOP_PATIENCE },
            finishes_writing: false,
        }]);
        let (words, pids) = (Words::default(), BTreeMap::new());
        Ok(Self { supervisor, words, eyes: Some(eyes), domain, pids, _folder: folder })
    }

    /// Waits, at most for as long as nothing is missed, and hands over what has been seen.
    ///
    /// # Errors
    /// [`TrialError::Stopped`], [`TrialError::Processes`] when they ended, and the bus's.
    pub fn step(&mut self, stop: &Shutdown, on: &mut dyn FnMut(Observed<'_>)) -> Result<(), TrialError> {
        let Some(eyes) = &mut self.eyes else { return Err(TrialError::Stopped) };
        let words = &mut self.words;
        self.supervisor
            .step(eyes.observer.interval(), &mut || {}, &mut |happening| words.take(&happening))?;
        if stop.is_requested() {
            return Err(TrialError::Stopped);
        }
        if words.ended {
            return Err(words.failed("ended early"));
        }
        while let Some(truth) = eyes.truths.receive()? {
            on(Observed::Truth(&truth));
        }
        let pids = &mut self.pids;
        eyes.observer.drain(&mut |seen| {
            if let Observed::Health(health) = seen {
                pids.insert(health.process.as_str().to_owned(), health.pid);
            }
            on(seen);
        })?;
        Ok(())
    }

    /// Steps for `duration`.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn run_for(&mut self, duration: Duration, stop: &Shutdown) -> Result<(), TrialError> {
        let until = Instant::now() + duration;
        while Instant::now() < until {
            self.step(stop, &mut |_| {})?;
        }
        Ok(())
    }

    /// Steps until all processes are ready.
    ///
    /// # Errors
    /// As [`Self::step`], and when they do not become ready.
    pub fn wait_until_ready(
        &mut self,
        stop: &Shutdown,
        on: &mut dyn FnMut(Observed<'_>),
    ) -> Result<(), TrialError> {
        let started = Instant::now();
        while !self.words.ready {
            self.step(stop, on)?;
            if started.elapsed() > READY_PATIENCE {
                return Err(self.words.failed("do not become ready"));
            }
        }
        Ok(())
    }

    /// Leaves the domain, and has `up` stop all. Returns what the recorder said where the end was not in order.
    pub fn stop(mut self) -> Option<String> {
        self.end();
        let words = &self.words;
        let of_recorder = words.last_lines.iter().map(|line| line.trim()).filter(|line| {
            ["record: ended", "record: was ended", "record: killed", "record| netcord: "]
                .iter()
                .any(|begin| line.starts_with(begin))
        });
        words.ended_badly.then(|| of_recorder.collect::<Vec<_>>().join("; "))
    }

    /// Leaves the domain, has `up` stop all, and removes what is left where `up` could not.
    fn end(&mut self) {
        if self.eyes.take().is_none() {
            return;
        }
        let words = &mut self.words;
        self.supervisor.stop(&mut |happening| words.take(&happening));
        for domain in [Ok(self.domain.clone()), truth_domain(&self.domain)].into_iter().flatten() {
            let remains = DomainRemains::of(&domain);
            if remains.inhabitants().is_ok_and(|alive| alive.is_empty())
                && let Err(e) = remains.remove()
            {
                tracing::warn!("{e}");
            }
        }
    }

    /// Process ids by the processes' own names, of those that have told their health.
    pub const fn pids(&self) -> &BTreeMap<String, u32> {
        &self.pids
    }
}

impl Drop for Deployment {
    fn drop(&mut self) {
        self.end();
    }
}

impl Eyes {
    fn open(rig: &Rig, domain: &DomainName) -> Result<Self, TrialError> {
        let bus = Bus::join(domain, "trial")?;
        let truth_bus = Bus::join(&truth_domain(domain)?, "trial")?;
        Ok(Self {
            observer: Observer::attach(&bus, rig)?,
            truths: truth_bus.subscriber(&Topic::truth())?,
            _buses: [bus, truth_bus],
        })
    }
}

impl Words {
    fn take(&mut self, happening: &Happening) {
        match happening {
            Happening::Line { line, .. } => {
                if self.last_lines.len() == LAST_LINES {
                    self.last_lines.pop_front();
                }
                self.last_lines.push_back(format!("  {line}"));
            }
            Happening::Ready { .. } => self.ready = true,
            Happening::Ended { well, .. } => (self.ended, self.ended_badly) = (true, !well),
            Happening::Started { .. } | Happening::GivenUp { .. } => {}
        }
    }

    fn failed(&self, what: &'static str) -> TrialError {
        let lines: Vec<String> = self.last_lines.iter().cloned().collect();
        TrialError::Processes { what, last_lines: lines.join("\n") }
    }
}
