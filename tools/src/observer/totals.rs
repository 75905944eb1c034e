use std::collections::BTreeMap;

use netcord_common::wire::Health;

/// What processes have counted since the observation began, over their restarts.
#[derive(Debug, Clone, Default)]
pub struct Totals {
    /// By process and counter, `process/counter`.
    counters: BTreeMap<String, Counted>,
}

#[derive(Debug, Clone, Copy)]
struct Counted {
    pid: u32,
    last: u64,
    total: u64,
}

impl Totals {
    /// Takes in a process's counters.
    pub fn see(&mut self, health: &Health) {
        for counter in health.counters() {
            let key = format!("{}/{}", health.process, counter.name);
            let value = counter.value;
            let new = Counted { pid: health.pid, last: value, total: 0 };
            let counted = self.counters.entry(key).or_insert(new);
            counted.total +=
                if counted.pid == health.pid { value.saturating_sub(counted.last) } else { value };
            (counted.pid, counted.last) = (health.pid, value);
        }
    }

    /// Each counter that has grown, and by how much.
    pub fn grown(&self) -> impl Iterator<Item = (&str, u64)> {
        let all = self.counters.iter().map(|(name, counted)| (name.as_str(), counted.total));
        all.filter(|(_, total)| *total > 0)
    }

    /// By how much a counter has grown; 0 where nobody counts so.
    pub fn of(&self, process: &str, counter: &str) -> u64 {
        self.counters.get(&format!("{process}/{counter}")).map_or(0, |counted| counted.total)
    }
}

#[cfg(test)]
mod tests {
    use netcord_common::wire::{Counter, Text};

    use super::*;

    #[test]
    fn a_process_that_was_started_again_counts_on() {
        let mut totals = Totals::default();
        for (pid, value) in [(1, 100), (1, 103), (2, 4), (2, 5)] {
            let mut health = Health { process: Text::new("predict"), pid, count: 1, ..Health::default() };
            health.counters[0] = Counter { name: Text::new("positions"), value };
            totals.see(&health);
        }
        assert_eq!(totals.of("predict", "positions"), 3 + 5);
        assert_eq!(totals.of("predict", "late"), 0);
        assert_eq!(totals.grown().collect::<Vec<_>>(), [("predict/positions", 8)]);
    }
}
