//! Orderly shutdown: SIGINT and SIGTERM set one flag, which loops look at.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use signal_hook::consts::{SIGINT, SIGTERM};

/// The flag. Cheap to clone.
#[derive(Debug, Clone, Default)]
pub struct Shutdown(Arc<AtomicBool>);

impl Shutdown {
    /// A flag that only [`Self::request`] sets: for tests and for work inside one process.
    pub fn new() -> Self {
        Self::default()
    }

    /// A flag that SIGINT and SIGTERM set. A second signal ends the process at once, so that a person
    /// is never stuck.
    ///
    /// # Errors
    /// When the handlers cannot be installed.
    pub fn on_signals() -> io::Result<Self> {
        let flag = Self::new();
        for signal in [SIGINT, SIGTERM] {
            // In this order: the second handler sees the flag only from the second signal on.
            signal_hook::flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&flag.0))?;
            signal_hook::flag::register(signal, Arc::clone(&flag.0))?;
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
