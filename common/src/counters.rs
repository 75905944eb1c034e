//! Counters: cheap to raise on the hot path, published once a second on `rig/health`.

use std::{
    fmt,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU32, AtomicU64, Ordering},
    },
};

use crate::{
    allocations,
    bus::{Bus, BusError, Publisher, Topic},
    time::{Clock, MonotonicClock},
    wire::{Counter, Health, MAX_COUNTERS, ProcessState, Text},
};

/// One counter of a process, shared by those who raise it.
#[derive(Debug, Clone, Default)]
pub struct Count(Arc<AtomicU64>);

impl Count {
    /// Adds `n`.
    pub fn add(&self, n: u64) {
        // Relaxed: a counter publishes nothing but itself.
        self.0.fetch_add(n, Ordering::Relaxed);
    }

    /// Adds one.
    pub fn up(&self) {
        self.add(1);
    }

    /// Sets what something else counts.
    fn set(&self, n: u64) {
        self.0.store(n, Ordering::Relaxed);
    }

    /// The count so far.
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// All counters of a process by name. Registering one takes a lock; raising it does not.
#[derive(Debug, Default)]
pub struct Counters {
    named: Mutex<Vec<(Text<56>, Count)>>,
    state: AtomicU32,
    on_running: Mutex<OnRunning>,
}

/// Who is told once when the process is ready.
#[derive(Default)]
struct OnRunning(Option<Box<dyn FnOnce() + Send>>);

impl fmt::Debug for OnRunning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("OnRunning").field(&self.0.is_some()).finish()
    }
}

impl Counters {
    /// No counters yet; state `starting`.
    pub fn new() -> Arc<Self> {
        Arc::new(Self::default())
    }

    /// The counter called `name`, such as `left/frames_published`; new at zero where there was none.
    ///
    /// # Panics
    /// When a process registers more than 64: a mistake of the program, not of its input.
    pub fn register(&self, name: &str) -> Count {
        let name = Text::new(name);
        let mut named = self.named.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, count)) = named.iter().find(|(n, _)| *n == name) {
            return count.clone();
        }
        assert!(named.len() < MAX_COUNTERS, "more than {MAX_COUNTERS} counters");
        let count = Count::default();
        named.push((name, count.clone()));
        count
    }

    /// Says what the process is doing.
    pub fn set_state(&self, state: ProcessState) {
        self.state.store(state.code(), Ordering::Relaxed);
        if state == ProcessState::Running {
            let notify = self.on_running.lock().unwrap_or_else(PoisonError::into_inner).0.take();
            if let Some(notify) = notify {
                notify();
            }
        }
    }

    /// Has `notify` called once, when the process first says that it runs: the way to a supervisor.
    pub fn when_running(&self, notify: impl FnOnce() + Send + 'static) {
        self.on_running.lock().unwrap_or_else(PoisonError::into_inner).0 = Some(Box::new(notify));
    }

    /// All counters and their values, in the order of their registration.
    pub fn snapshot(&self) -> Vec<(String, u64)> {
        let named = self.named.lock().unwrap_or_else(PoisonError::into_inner);
        named.iter().map(|(name, count)| (name.as_str().to_owned(), count.get())).collect()
    }

    fn write_to(&self, health: &mut Health) {
        let named = self.named.lock().unwrap_or_else(PoisonError::into_inner);
        for (slot, (name, count)) in health.counters.iter_mut().zip(named.iter()) {
            *slot = Counter { name: *name, value: count.get() };
        }
        health.count = u32::try_from(named.len()).expect("at most 64");
        health.state = self.state.load(Ordering::Relaxed);
    }
}

/// Publishes a process's [`Counters`] on `rig/health`, and among them as `allocations` what
/// [`CountingAllocator`](crate::CountingAllocator) has counted. Allocates nothing after it was made.
#[derive(Debug)]
pub struct HealthReporter {
    publisher: Publisher<Health>,
    counters: Arc<Counters>,
    allocations: Count,
    message: Box<Health>,
    next_ns: u64,
}

/// How often the counters are published.
const INTERVAL_NS: u64 = 1_000_000_000;

impl HealthReporter {
    /// Joins `rig/health` as `process` (a stage's name, `:<camera>` behind it where it serves one).
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn open(bus: &Bus, process: &str, counters: &Arc<Counters>) -> Result<Self, BusError> {
        let now = MonotonicClock.now().as_ns();
        let message = Box::new(Health {
            process: Text::new(process),
            pid: std::process::id(),
            started_ns: now,
            ..Health::default()
        });
        Ok(Self {
            publisher: bus.publisher(&Topic::health())?,
            counters: Arc::clone(counters),
            allocations: counters.register("allocations"),
            message,
            next_ns: 0,
        })
    }

    /// Publishes if a second has passed since the last time; to be called from a stage's loop.
    ///
    /// # Errors
    /// As [`Publisher::send`].
    pub fn tick(&mut self, now_ns: u64) -> Result<(), BusError> {
        if now_ns < self.next_ns {
            return Ok(());
        }
        self.next_ns = now_ns + INTERVAL_NS;
        self.publish(now_ns)
    }

    /// Publishes now: at readiness and at the end, so that no count is missed.
    ///
    /// # Errors
    /// As [`Publisher::send`].
    pub fn publish(&mut self, now_ns: u64) -> Result<(), BusError> {
        self.allocations.set(allocations());
        self.counters.write_to(&mut self.message);
        self.message.now_ns = now_ns;
        self.publisher.send(&self.message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readiness_is_told_once() {
        let (counters, told) = (Counters::new(), Count::default());
        let teller = told.clone();
        counters.when_running(move || teller.up());
        for state in [ProcessState::Starting, ProcessState::Running, ProcessState::Running] {
            counters.set_state(state);
        }
        assert_eq!(told.get(), 1);
    }

    #[test]
    fn a_name_registered_twice_is_one_counter() {
        let counters = Counters::new();
        counters.register("lost").add(2);
        counters.register("lost").up();
        counters.register("seen").up();
        assert_eq!(counters.snapshot(), [("lost".to_owned(), 3), ("seen".to_owned(), 1)]);
        let mut health = Health::default();
        counters.write_to(&mut health);
        assert_eq!(health.counters().len(), 2);
        assert_eq!(health.counters()[0].value, 3);
    }
}
