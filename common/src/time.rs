//! Instants, and the clock that stages are handed instead of reading one themselves.

use std::{
    fmt,
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};

use nix::time::{ClockId, clock_gettime};

/// An instant: nanoseconds of CLOCK_MONOTONIC, or of a recording's own clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Stamp(u64);

impl Stamp {
    /// The instant `ns` nanoseconds after the clock's zero.
    pub const fn from_ns(ns: u64) -> Self {
        Self(ns)
    }

    /// Nanoseconds since the clock's zero.
    pub const fn as_ns(self) -> u64 {
        self.0
    }

    /// Signed seconds from `earlier` to `self`; exact to a nanosecond over 100 days.
    pub fn seconds_since(self, earlier: Stamp) -> f64 {
        self.0.wrapping_sub(earlier.0).cast_signed() as f64 * 1e-9
    }

    /// `self − earlier`, zero where `earlier` is the later one.
    pub fn saturating_since(self, earlier: Stamp) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }

    /// The instant `duration` later.
    pub fn after(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)))
    }
}

impl fmt::Display for Stamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{:09} s", self.0 / 1_000_000_000, self.0 % 1_000_000_000)
    }
}

/// Where "now" comes from. Live processes use [`MonotonicClock`]; `process` and tests use
/// [`ManualClock`], so that the same input gives the same bytes.
pub trait Clock: Send + Sync {
    /// The present instant.
    fn now(&self) -> Stamp;
}

/// The machine's CLOCK_MONOTONIC, shared by all processes.
#[derive(Debug, Clone, Copy, Default)]
pub struct MonotonicClock;

impl Clock for MonotonicClock {
    fn now(&self) -> Stamp {
        let t = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("Linux always has CLOCK_MONOTONIC");
        Stamp(t.tv_sec().cast_unsigned() * 1_000_000_000 + t.tv_nsec().cast_unsigned())
    }
}

/// A clock that stands still until it is set.
#[derive(Debug, Default)]
pub struct ManualClock(AtomicU64);

impl ManualClock {
    /// Moves the clock to `now`.
    pub fn set(&self, now: Stamp) {
        // Relaxed: the instant publishes no other data.
        self.0.store(now.0, Ordering::Relaxed);
    }
}

impl Clock for ManualClock {
    fn now(&self) -> Stamp {
        Stamp(self.0.load(Ordering::Relaxed))
    }
}

/// What must be added to a CLOCK_MONOTONIC stamp to give Unix time, in nanoseconds, as of now.
pub fn unix_minus_monotonic_ns() -> i64 {
    let wall = clock_gettime(ClockId::CLOCK_REALTIME).expect("Linux always has CLOCK_REALTIME");
    let monotonic = MonotonicClock.now();
    (wall.tv_sec() * 1_000_000_000 + wall.tv_nsec()) - monotonic.0.cast_signed()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_have_a_sign_and_keep_nanoseconds() {
        let (a, b) = (Stamp::from_ns(5_000_000_001), Stamp::from_ns(5_000_000_000));
        assert_eq!(a.seconds_since(b), 1e-9);
        assert_eq!(b.seconds_since(a), -1e-9);
        assert_eq!(b.saturating_since(a), Duration::ZERO);
        assert_eq!(b.after(Duration::from_nanos(1)), a);
    }
}
