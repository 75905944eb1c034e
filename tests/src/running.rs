use std::{
    io::{BufRead as _, BufReader, Read},
    os::unix::process::CommandExt as _,
    process::{Child, Command, ExitStatus, Stdio},
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{Receiver, channel},
    },
    thread::{self, JoinHandle},
};

use nix::{
    sys::{
        prctl,
        signal::{Signal, kill},
    },
    unistd::Pid,
};

use crate::{WATCHDOG, until};

/// A process whose output is kept. It is killed when it is dropped.
#[derive(Debug)]
pub struct Running {
    child: Child,
    lines: Receiver<String>,
    errors: Arc<Mutex<String>>,
    readers: Vec<JoinHandle<()>>,
}

/// A process that has ended.
#[derive(Debug)]
pub struct Ended {
    /// Its exit code; `None` when a signal ended it.
    pub code: Option<i32>,
    /// The lines of its standard output that nobody has taken yet.
    pub out: Vec<String>,
    /// All of its standard error.
    pub err: String,
}

impl Running {
    /// Starts it.
    ///
    /// # Panics
    /// When it cannot be started.
    pub fn start(mut command: Command) -> Self {
        // SAFETY: between fork and exec only prctl is called, which is async-signal-safe.
        unsafe {
            // A test that is itself killed leaves no process behind.
            command.pre_exec(|| Ok(prctl::set_pdeathsig(Signal::SIGTERM)?));
        }
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap_or_else(|e| panic!("{command:?} does not start: {e}"));
        let (sender, lines) = channel();
        let out = child.stdout.take().expect("piped");
        let mut err = child.stderr.take().expect("piped");
        let errors = Arc::new(Mutex::new(String::new()));
        let kept = Arc::clone(&errors);
        let readers = vec![
            thread::spawn(move || {
                for line in BufReader::new(out).lines().map_while(Result::ok) {
                    let _ = sender.send(line);
                }
            }),
            thread::spawn(move || {
                let mut buffer = [0; 4096];
                while let Ok(length @ 1..) = err.read(&mut buffer) {
                    let text = String::from_utf8_lossy(&buffer[..length]);
                    kept.lock().unwrap_or_else(PoisonError::into_inner).push_str(&text);
                }
            }),
        ];
        Self { child, lines, errors, readers }
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// The next line of its standard output, within the watchdog's time.
    ///
    /// # Panics
    /// When none comes.
    pub fn line(&self) -> String {
        self.lines
            .recv_timeout(WATCHDOG)
            .unwrap_or_else(|e| panic!("no line: {e}; standard error:\n{}", self.errors()))
    }

    /// What it has written to its standard error so far.
    pub fn errors(&self) -> String {
        self.errors.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: Signal) {
        signal_process(self.pid(), signal);
    }

    /// Whether it still runs.
    pub fn runs(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Asks it to stop, and waits.
    pub fn stop(self) -> Ended {
        self.signal(Signal::SIGTERM);
        self.wait()
    }

    /// Waits for its end.
    ///
    /// # Panics
    /// When it does not end within the watchdog's time.
    pub fn wait(mut self) -> Ended {
        let status: ExitStatus = until("the end of a process", || self.child.try_wait().ok().flatten());
        for reader in self.readers.drain(..) {
            reader.join().expect("readers do not panic");
        }
        Ended { code: status.code(), out: self.lines.try_iter().collect(), err: self.errors() }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sends `signal` to a process by its id.
pub fn signal_process(pid: u32, signal: Signal) {
    let pid = i32::try_from(pid).expect("process ids are small");
    kill(Pid::from_raw(pid), signal).unwrap_or_else(|e| panic!("cannot signal process {pid}: {e}"));
}
