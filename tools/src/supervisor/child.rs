use std::{
    ffi::OsString,
    io::{self, Read as _},
    os::{
        fd::{AsFd as _, BorrowedFd},
        unix::process::CommandExt as _,
    },
    path::PathBuf,
    process::{Child as Process, ChildStderr, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

use netcord_common::rig::Restart;
use nix::{
    fcntl::{FcntlArg, OFlag, fcntl},
    sys::{
        prctl,
        signal::{Signal, kill},
    },
    unistd::{Pid, getppid},
};
use thiserror::Error;

use super::{pidfd::PidFd, ready::ReadySocket};

/// A process to be started: the executable and how.
#[derive(Debug, Clone)]
pub struct Launch {
    /// What it is called here.
    pub name: String,
    /// The executable.
    pub executable: PathBuf,
    /// Its arguments.
    pub arguments: Vec<OsString>,
    /// What happens when it ends by itself.
    pub restart: Restart,
    /// How long it gets to end in order before it is killed.
    pub stop_patience: Duration,
    /// Whether it has work to finish then: its patience counts anew whenever it has written something.
    pub finishes_writing: bool,
}

/// A process that could not be started.
#[derive(Debug, Error)]
#[error("cannot start {name} ({}): {cause}", executable.display())]
pub struct LaunchError {
    name: String,
    executable: PathBuf,
    #[source]
    cause: io::Error,
}

/// A running child.
#[derive(Debug)]
pub(super) struct Child {
    process: Process,
    ended: PidFd,
    ready: ReadySocket,
    stderr: Option<ChildStderr>,
    unfinished_line: Vec<u8>,
    started: Instant,
}

impl Child {
    pub(super) fn start(launch: &Launch) -> Result<Self, LaunchError> {
        Self::try_start(launch).map_err(|cause| LaunchError {
            name: launch.name.clone(),
            executable: launch.executable.clone(),
            cause,
        })
    }

    fn try_start(launch: &Launch) -> io::Result<Self> {
        let ready = ReadySocket::open()?;
        let parent = Pid::this();
        let mut command = Command::new(&launch.executable);
        command
            .args(&launch.arguments)
            .env("NOTIFY_SOCKET", ready.address())
            .stdin(Stdio::null())
            .stdout(Stdio::inherit())
            .stderr(Stdio::piped())
            // A group of its own: Ctrl-C in the terminal reaches us, and we stop the children in order.
            .process_group(0);
        // SAFETY: between fork and exec only async-signal-safe calls are made: prctl and getppid.
        unsafe {
            command.pre_exec(move || {
                prctl::set_pdeathsig(Signal::SIGTERM)?;
                // The parent may have died before the line above: then no signal would ever come.
                if getppid() == parent { Ok(()) } else { Err(io::ErrorKind::BrokenPipe.into()) }
            });
        }
        let mut process = command.spawn()?;
        let stderr = process.stderr.take();
        if let Some(stderr) = &stderr {
            let flags = OFlag::from_bits_retain(fcntl(stderr, FcntlArg::F_GETFL)?);
            fcntl(stderr, FcntlArg::F_SETFL(flags | OFlag::O_NONBLOCK))?;
        }
        let ended = PidFd::of_child(process.id())?;
        Ok(Self { process, ended, ready, stderr, unfinished_line: Vec::new(), started: Instant::now() })
    }

    pub(super) fn pid(&self) -> u32 {
        self.process.id()
    }

    pub(super) fn lifetime(&self) -> Duration {
        self.started.elapsed()
    }

    /// What to poll: the end, the readiness, the output.
    pub(super) fn descriptors(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        let stderr = self.stderr.as_ref().map(|s| s.as_fd());
        [self.ended.as_fd(), self.ready.as_fd()].into_iter().chain(stderr)
    }

    /// Bytes that it has handed to the system so far, whatever for (proc(5), `wchar`).
    pub(super) fn written_bytes(&self) -> Option<u64> {
        let account = std::fs::read_to_string(format!("/proc/{}/io", self.process.id())).ok()?;
        account.lines().find_map(|line| line.strip_prefix("wchar: ")?.parse().ok())
    }

    pub(super) fn has_become_ready(&self) -> bool {
        self.ready.has_come()
    }

    /// The exit status, once it has ended.
    pub(super) fn exit(&mut self) -> io::Result<Option<ExitStatus>> {
        self.process.try_wait()
    }

    /// Sends a signal. The process has not been waited for, so the id is still its own.
    pub(super) fn signal(&self, signal: Signal) {
        if let Ok(pid) = i32::try_from(self.process.id()) {
            // It may have ended in this very moment.
            let _ = kill(Pid::from_raw(pid), signal);
        }
    }

    /// The lines that it has written since the last look.
    pub(super) fn lines(&mut self, each: &mut dyn FnMut(String)) {
        let Some(stderr) = &mut self.stderr else { return };
        let mut buffer = [0; 4096];
        loop {
            match stderr.read(&mut buffer) {
                Ok(0) => {
                    self.stderr = None;
                    break;
                }
                Ok(length) => {
                    self.unfinished_line.extend_from_slice(&buffer[..length]);
                    while let Some(end) = self.unfinished_line.iter().position(|b| *b == b'\n') {
                        let line: Vec<u8> = self.unfinished_line.drain(..=end).collect();
                        each(String::from_utf8_lossy(&line[..end]).into_owned());
                    }
                }
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => break,
            }
        }
        if self.stderr.is_none() && !self.unfinished_line.is_empty() {
            each(String::from_utf8_lossy(&std::mem::take(&mut self.unfinished_line)).into_owned());
        }
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // Ends with its owner: a process that has been waited for is left alone by both calls.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
