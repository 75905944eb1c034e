use std::time::Duration;

/// How long to wait before a process that ended is started again: not at all the first time, then
/// doubling up to a bound, and from the beginning once it has lived long enough.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Backoff {
    /// Ends in a row, each soon after its start.
    quick_ends: u32,
}

/// The second restart waits this long; each one after it twice as long as the one before.
const FIRST_WAIT: Duration = Duration::from_millis(100);
/// The longest wait: a process that cannot start is tried twelve times a minute.
const LONGEST_WAIT: Duration = Duration::from_secs(5);
/// A process that has lived this long has got over what ended it before.
const LIVED_WELL: Duration = Duration::from_secs(10);

impl Backoff {
    /// Takes note that the process ended after `lifetime`; returns how long to wait.
    pub fn ended(&mut self, lifetime: Duration) -> Duration {
        if lifetime >= LIVED_WELL {
            self.quick_ends = 0;
        }
        let wait = match self.quick_ends {
            0 => Duration::ZERO,
            n => FIRST_WAIT.saturating_mul(1 << (n - 1).min(16)).min(LONGEST_WAIT),
        };
        self.quick_ends = self.quick_ends.saturating_add(1);
        wait
    }

    /// How often in a row the process has ended soon after its start.
    pub const fn quick_ends(&self) -> u32 {
        self.quick_ends
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_grow_to_a_bound_and_start_over_after_a_long_life() {
        let mut backoff = Backoff::default();
        let soon = Duration::from_millis(10);
        let waits: Vec<u128> = (0..9).map(|_| backoff.ended(soon).as_millis()).collect();
        assert_eq!(waits, [0, 100, 200, 400, 800, 1600, 3200, 5000, 5000]);
        assert_eq!(backoff.ended(Duration::from_secs(60)), Duration::ZERO);
        assert_eq!(backoff.quick_ends(), 1);
    }
}
