//! Orderly shutdown: SIGINT and SIGTERM set one flag, which loops look at.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
};

use signal_hook::consts::{SIGINT, SIGTERM};

use crate::time::{Clock as _, MonotonicClock};

/// Signals this close together are one request: `timeout` and terminals send theirs to a process and to its
/// group, so that it comes twice.
const SAME_REQUEST_NS: u64 = 500_000_000;

/// The flag. Cheap to clone.
#[derive(Debug, Clone, Default)]
pub struct Shutdown(Arc<AtomicBool>);

impl Shutdown {
    /// A flag that only [`Self::request`] sets: for tests and for work inside one process.
    pub fn new() -> Self {
        Self::default()
    }

    /// A flag that SIGINT and SIGTERM set. A second signal, half a second later or more, ends the process at
    /// once, so that a person is never stuck.
    ///
    /// # Errors
    /// When the handlers cannot be installed.
    pub fn on_signals() -> io::Result<Self> {
        let flag = Self::new();
        for signal in [SIGINT, SIGTERM] {
            let flag = flag.clone();
            let first_ns = AtomicU64::new(0);
            // SAFETY: the action only reads the clock, touches atomics and perhaps ends the process with _exit:
            // all async-signal-safe.
            unsafe {
                signal_hook::low_level::register(signal, move || {
                    let now_ns = MonotonicClock.now().as_ns();
                    // Relaxed: nothing else is published by the instant of the first signal.
                    match first_ns.compare_exchange(0, now_ns, Ordering::Relaxed, Ordering::Relaxed) {
                        Err(first) if now_ns - first > SAME_REQUEST_NS => {
                            signal_hook::low_level::exit(128 + signal);
                        }
                        _ => flag.request(),
                    }
                })?;
            }
        }
        Ok(flag)
    }

    /// Asks for the end.
    pub fn request(&self) {
        // Release, with the Acquire of is_requested: what was written before the request is seen after it.
        self.0.store(true, Ordering::Release);
    }

    /// Whether the end has been asked for.
    pub fn is_requested(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clones_share_the_flag() {
        let flag = Shutdown::new();
        let other = flag.clone();
        assert!(!other.is_requested());
        flag.request();
        assert!(other.is_requested());
    }
}
