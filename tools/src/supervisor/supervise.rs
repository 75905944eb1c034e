use std::{
    collections::VecDeque,
    os::unix::process::ExitStatusExt as _,
    process::ExitStatus,
    time::{Duration, Instant},
};

use netcord_common::rig::Restart;
use nix::{
    poll::{PollFd, PollFlags, PollTimeout, poll},
    sys::signal::Signal,
};

use super::{Backoff, Launch, LaunchError, child::Child};

/// What a process is doing, as its supervisor sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Its turn to be started has not come.
    Waiting,
    /// Started, not ready.
    Starting,
    /// Ready and at work.
    Running,
    /// Ended; it will be started again.
    BackingOff,
    /// Ended for good.
    Ended,
}

impl Phase {
    /// A word for it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Starting => "starting",
            Self::Running => "running",
            Self::BackingOff => "restarting",
            Self::Ended => "ended",
        }
    }
}

/// One process as it stands.
#[derive(Debug, Clone)]
pub struct ChildStatus<'a> {
    /// Its name.
    pub name: &'a str,
    /// What it is doing.
    pub phase: Phase,
    /// Its process id, while it lives.
    pub pid: Option<u32>,
    /// How often it has been started again.
    pub restarts: u32,
}

/// Something that happened, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Happening {
    /// A process was started.
    Started {
        /// Which.
        name: String,
        /// Its process id.
        pid: u32,
    },
    /// A process said that it is ready.
    Ready {
        /// Which.
        name: String,
        /// Its process id.
        pid: u32,
        /// Time since its start.
        after: Duration,
    },
    /// A process wrote a line to its standard error.
    Line {
        /// Which.
        name: String,
        /// The line.
        line: String,
    },
    /// A process ended.
    Ended {
        /// Which.
        name: String,
        /// The process id that it had.
        pid: u32,
        /// How, in words.
        how: String,
        /// Whether it ended by itself, with exit code 0.
        well: bool,
        /// When it will be started again; `None`: not at all.
        again_in: Option<Duration>,
    },
    /// A process ended again and again before it was ready for the first time: it is given up.
    GivenUp {
        /// Which.
        name: String,
        /// The last lines that it wrote.
        last_lines: Vec<String>,
    },
}

/// Starts processes in order, each when the one before it is ready; restarts those that end; stops all
/// in order.
#[derive(Debug)]
pub struct Supervisor {
    managed: Vec<Managed>,
}

#[derive(Debug)]
struct Managed {
    launch: Launch,
    state: State,
    backoff: Backoff,
    restarts: u32,
    has_been_ready: bool,
    last_lines: VecDeque<String>,
}

#[derive(Debug)]
enum State {
    Waiting,
    Alive { child: Child, ready: bool },
    BackingOff { until: Instant },
    Ended,
}

/// A process that does not say that it is ready within this time no longer holds up those after it: it
/// may be waiting for them.
const READY_PATIENCE: Duration = Duration::from_secs(3);
/// A process that ends this often in a row without ever having been ready has a mistake that no restart
/// cures.
const TRIES: u32 = 4;
/// Lines kept of each process for the message when it is given up.
const LAST_LINES: usize = 8;

impl Supervisor {
    /// Knows what to start; starts nothing yet.
    pub fn new(launches: Vec<Launch>) -> Self {
        let managed = launches
            .into_iter()
            .map(|launch| Managed {
                launch,
                state: State::Waiting,
                backoff: Backoff::default(),
                restarts: 0,
                has_been_ready: false,
                last_lines: VecDeque::new(),
            })
            .collect();
        Self { managed }
    }

    /// Waits at most `timeout` for something to happen and deals with it: readiness, ends, output, and
    /// whatever is due to be started. `reclaim` is called between the end of a process and its restart,
    /// to clean up after the dead one.
    ///
    /// # Errors
    /// [`LaunchError`] when a process cannot be started at all.
    pub fn step(
        &mut self,
        timeout: Duration,
        reclaim: &mut dyn FnMut(),
        on: &mut dyn FnMut(Happening),
    ) -> Result<(), LaunchError> {
        self.start_due(on)?;
        self.wait(timeout);
        for managed in &mut self.managed {
            managed.look(reclaim, on);
        }
        self.start_due(on)
    }

    /// All processes as they stand.
    pub fn statuses(&self) -> impl Iterator<Item = ChildStatus<'_>> {
        self.managed.iter().map(|m| ChildStatus {
            name: &m.launch.name,
            phase: match &m.state {
                State::Waiting => Phase::Waiting,
                State::Alive { ready: false, .. } => Phase::Starting,
                State::Alive { ready: true, .. } => Phase::Running,
                State::BackingOff { .. } => Phase::BackingOff,
                State::Ended => Phase::Ended,
            },
            pid: match &m.state {
                State::Alive { child, .. } => Some(child.pid()),
                _ => None,
            },
            restarts: m.restarts,
        })
    }

    /// Whether every process has said that it is ready.
    pub fn all_ready(&self) -> bool {
        self.managed.iter().all(|m| matches!(m.state, State::Alive { ready: true, .. }))
    }

    /// Whether no process lives, nor will again.
    pub fn all_ended(&self) -> bool {
        self.managed.iter().all(|m| matches!(m.state, State::Ended))
    }

    /// Stops all processes in order, the sources first, so that what is under way still arrives: asks,
    /// waits, and kills what does not end.
    pub fn stop(&mut self, on: &mut dyn FnMut(Happening)) {
        for managed in &mut self.managed {
            managed.stop(on);
        }
    }

    fn start_due(&mut self, on: &mut dyn FnMut(Happening)) -> Result<(), LaunchError> {
        for managed in &mut self.managed {
            let due = match &managed.state {
                State::Waiting => true,
                State::BackingOff { until } => *until <= Instant::now(),
                State::Alive { .. } | State::Ended => false,
            };
            if due {
                managed.start(on)?;
            }
            // Those after it wait for it, but only the first time.
            if let State::Alive { child, ready: false } = &managed.state
                && !managed.has_been_ready
                && child.lifetime() < READY_PATIENCE
            {
                break;
            }
        }
        Ok(())
    }

    fn wait(&self, timeout: Duration) {
        let now = Instant::now();
        let mut timeout = timeout;
        let mut descriptors = Vec::new();
        for managed in &self.managed {
            match &managed.state {
                State::Alive { child, .. } => {
                    descriptors.extend(child.descriptors().map(|fd| PollFd::new(fd, PollFlags::POLLIN)));
                }
                State::BackingOff { until } => timeout = timeout.min(until.saturating_duration_since(now)),
                State::Waiting | State::Ended => {}
            }
        }
        let millis = timeout.as_micros().div_ceil(1000);
        // A signal interrupts it; the caller looks at its flag.
        let _ = poll(&mut descriptors, PollTimeout::try_from(millis).unwrap_or(PollTimeout::MAX));
    }
}

impl Managed {
    fn start(&mut self, on: &mut dyn FnMut(Happening)) -> Result<(), LaunchError> {
        if matches!(self.state, State::BackingOff { .. }) {
            self.restarts += 1;
        }
        let child = Child::start(&self.launch)?;
        on(Happening::Started { name: self.launch.name.clone(), pid: child.pid() });
        self.state = State::Alive { child, ready: false };
        Ok(())
    }

    fn look(&mut self, reclaim: &mut dyn FnMut(), on: &mut dyn FnMut(Happening)) {
        let State::Alive { child, ready } = &mut self.state else { return };
        let name = &self.launch.name;
        if !*ready && child.has_become_ready() {
            *ready = true;
            self.has_been_ready = true;
            on(Happening::Ready { name: name.clone(), pid: child.pid(), after: child.lifetime() });
        }
        let exit = child.exit();
        // After the look at its end, so that a dying process's last words are read.
        forward_lines(child, name, &mut self.last_lines, on);
        let Ok(Some(status)) = exit else { return };
        reclaim();
        let (pid, lifetime) = (child.pid(), child.lifetime());
        let wanted = match self.launch.restart {
            Restart::Always => true,
            Restart::OnFailure => !status.success(),
            Restart::Never => false,
        };
        let wait = self.backoff.ended(lifetime);
        let given_up = wanted && !self.has_been_ready && self.backoff.quick_ends() >= TRIES;
        let again_in = (wanted && !given_up).then_some(wait);
        self.state = match again_in {
            Some(wait) => State::BackingOff { until: Instant::now() + wait },
            None => State::Ended,
        };
        let well = status.success();
        on(Happening::Ended { name: name.clone(), pid, how: in_words(status), well, again_in });
        if given_up {
            let last_lines = self.last_lines.iter().cloned().collect();
            on(Happening::GivenUp { name: name.clone(), last_lines });
        }
    }

    fn stop(&mut self, on: &mut dyn FnMut(Happening)) {
        if let State::Alive { child, .. } = &mut self.state {
            child.signal(Signal::SIGTERM);
            let (mut since, mut written) = (Instant::now(), None);
            loop {
                if self.launch.finishes_writing {
                    // As long as it gets on, it is not stuck.
                    let now = child.written_bytes();
                    if now != written {
                        (since, written) = (Instant::now(), now);
                    }
                }
                match child.exit() {
                    Ok(None) if since.elapsed() < self.launch.stop_patience => {
                        forward_lines(child, &self.launch.name, &mut self.last_lines, on);
                        let mut descriptors: Vec<_> =
                            child.descriptors().map(|fd| PollFd::new(fd, PollFlags::POLLIN)).collect();
                        let _ = poll(&mut descriptors, PollTimeout::from(50_u8));
                    }
                    ended => {
                        forward_lines(child, &self.launch.name, &mut self.last_lines, on);
                        let patience = self.launch.stop_patience;
                        let (how, well) = match ended {
                            // One that was asked before it listened has ended in order too.
                            Ok(Some(status)) => {
                                let asked = status.signal() == Some(Signal::SIGTERM as i32);
                                (in_words(status), status.success() || asked)
                            }
                            _ if self.launch.finishes_writing => (
                                format!("killed: it wrote nothing more for {patience:?}, and did not stop"),
                                false,
                            ),
                            _ => (format!("killed: it did not stop within {patience:?}"), false),
                        };
                        let (name, pid) = (self.launch.name.clone(), child.pid());
                        on(Happening::Ended { name, pid, how, well, again_in: None });
                        break;
                    }
                }
            }
        }
        // Dropping a child that still lives kills it.
        self.state = State::Ended;
    }
}

fn forward_lines(
    child: &mut Child,
    name: &str,
    last_lines: &mut VecDeque<String>,
    on: &mut dyn FnMut(Happening),
) {
    child.lines(&mut |line| {
        if last_lines.len() == LAST_LINES {
            last_lines.pop_front();
        }
        last_lines.push_back(line.clone());
        on(Happening::Line { name: name.to_owned(), line });
    });
}

fn in_words(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(0), _) => "ended".into(),
        (Some(code), _) => format!("ended with exit code {code}"),
        (None, Some(signal)) => {
            let name = Signal::try_from(signal).map_or("an unknown signal", Signal::as_str);
            format!("was ended by {name}")
        }
        (None, None) => "ended".into(),
    }
}

#[cfg(test)]
mod tests {
    use std::{ffi::OsString, path::PathBuf};

    use super::*;

    fn shell(name: &str, script: &str, restart: Restart) -> Launch {
        let arguments = ["-c", script].map(OsString::from).to_vec();
        Launch {
            name: name.into(),
            executable: PathBuf::from("/bin/sh"),
            arguments,
            restart,
            stop_patience: Duration::from_secs(3),
            finishes_writing: false,
        }
    }

    /// Steps until `enough`, and returns all that happened.
    fn until(supervisor: &mut Supervisor, enough: impl Fn(&[Happening]) -> bool) -> Vec<Happening> {
        let (mut happened, watchdog) = (Vec::new(), Instant::now());
        while !enough(&happened) {
            assert!(watchdog.elapsed() < Duration::from_secs(60), "{happened:?}");
            supervisor
                .step(Duration::from_millis(20), &mut || {}, &mut |h| happened.push(h))
                .expect("/bin/sh starts");
        }
        happened
    }

    fn ends(happened: &[Happening]) -> usize {
        happened.iter().filter(|h| matches!(h, Happening::Ended { .. })).count()
    }

    #[test]
    fn one_that_ends_is_started_again_and_others_live_on() {
        let mut supervisor = Supervisor::new(vec![
            shell("once", "exit 0", Restart::OnFailure),
            shell("fails", "echo trouble >&2; exit 3", Restart::Always),
            shell("stays", "exec sleep 1000", Restart::Always),
        ]);
        // Nobody here ever says that it is ready; one that has ended holds up nobody.
        let happened = until(&mut supervisor, |h| ends(h) >= 3);
        assert!(happened.contains(&Happening::Line { name: "fails".into(), line: "trouble".into() }));
        let fails: Vec<_> = happened
            .iter()
            .filter_map(|h| match h {
                Happening::Ended { name, how, again_in, .. } if name == "fails" => {
                    Some((how.as_str(), *again_in))
                }
                _ => None,
            })
            .collect();
        assert_eq!(fails[0], ("ended with exit code 3", Some(Duration::ZERO)));
        let once = supervisor.statuses().next().expect("three").phase;
        assert_eq!(once, Phase::Ended, "it ended well");
        supervisor.stop(&mut |_| {});
        assert!(supervisor.all_ended());
    }

    #[test]
    fn what_never_gets_ready_is_given_up_with_its_last_words() {
        let mut supervisor = Supervisor::new(vec![shell("bad", "echo why >&2; exit 2", Restart::Always)]);
        let happened = until(&mut supervisor, |h| h.iter().any(|h| matches!(h, Happening::GivenUp { .. })));
        let Some(Happening::GivenUp { last_lines, .. }) = happened.last() else { panic!("{happened:?}") };
        assert!(last_lines.contains(&"why".to_owned()));
        assert!(supervisor.all_ended());
    }

    #[test]
    fn one_that_has_to_write_to_the_end_is_waited_for_as_long_as_it_writes() {
        let slow = "trap 'for i in 1 2 3 4 5 6 7 8; do echo part >/dev/null; sleep 0.4; done; exit 0' TERM; echo up >&2; \
                    while :; do sleep 0.01; done";
        for (finishes_writing, how_it_ends) in [(true, "ended"), (false, "killed")] {
            let mut launch = shell("writer", slow, Restart::Never);
            (launch.stop_patience, launch.finishes_writing) = (Duration::from_secs(2), finishes_writing);
            let mut supervisor = Supervisor::new(vec![launch]);
            until(&mut supervisor, |h| h.iter().any(|h| matches!(h, Happening::Line { .. })));
            let mut happened = Vec::new();
            supervisor.stop(&mut |h| happened.push(h));
            let Some(Happening::Ended { how, well, .. }) = happened.last() else { panic!("{happened:?}") };
            assert!(how.starts_with(how_it_ends) && *well == finishes_writing, "{how}");
        }
    }

    #[test]
    fn stopping_asks_before_it_kills() {
        let script = "trap 'echo bye >&2; exit 0' TERM; echo up >&2; while :; do sleep 0.01; done";
        let mut supervisor = Supervisor::new(vec![shell("polite", script, Restart::Always)]);
        until(&mut supervisor, |h| h.iter().any(|h| matches!(h, Happening::Line { .. })));
        let mut happened = Vec::new();
        supervisor.stop(&mut |h| happened.push(h));
        assert!(happened.contains(&Happening::Line { name: "polite".into(), line: "bye".into() }));
        assert!(matches!(happened.last(), Some(Happening::Ended { how, .. }) if how == "ended"));
    }
}
