//! Tests that start real processes: the harness.
//!
//! - [`executable`] builds `netcord` from this very tree, so that no test meets a stale one.
//! - A [`Lab`] is a domain and a folder of its own, of which nothing stays.
//! - [`Running`] is a process under a watchdog; it ends with its owner.
//! - [`Page`] asks a calibration session's page; [`Browser`] is Chromium; a [`Photographer`] takes pictures of boards.
//! - [`Lockstep`] is the stages without processes and without a clock.
//! - [`Watch`] sees a domain's messages; [`Copies`] counts large copies inside processes.

mod browser;
mod copies;
mod executable;
mod lab;
mod lockstep;
mod page;
mod photographer;
mod running;
mod watch;

pub use browser::Browser;
pub use copies::{Copies, CopyCount};
pub use executable::executable;
pub use lab::Lab;
pub use lockstep::Lockstep;
pub use page::Page;
pub use photographer::Photographer;
pub use running::{Ended, Running, signal_process};
pub use watch::Watch;

use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

/// How long anything may take before a test fails instead of hanging; far beyond what is expected, since it
/// is no measure of speed.
pub const WATCHDOG: Duration = Duration::from_secs(120);

/// Calls `check` until it gives something.
///
/// # Panics
/// When the watchdog's time is over.
pub fn until<T>(what: &str, mut check: impl FnMut() -> Option<T>) -> T {
    let started = Instant::now();
    loop {
        if let Some(found) = check() {
            return found;
        }
        assert!(started.elapsed() < WATCHDOG, "{what} did not happen within {WATCHDOG:?}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Pipelines at work share two processors at most: tests that start one take turns.
pub fn one_at_a_time() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    // A test that failed has cleaned up after itself.
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}
