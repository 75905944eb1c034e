use netcord_common::{Clock, MonotonicClock, Shutdown};
use nix::{
    sys::time::{TimeSpec, TimeValLike as _},
    time::{ClockId, ClockNanosleepFlags, clock_nanosleep},
};

/// How long a shutdown may go unnoticed, ns.
const LOOK_UP_NS: u64 = 50_000_000;

/// Sleeps until `deadline_ns` of CLOCK_MONOTONIC; false when `stop` was requested before. Deadlines are
/// absolute, so that no oversleep adds to the next.
pub fn sleep_until(deadline_ns: u64, stop: &Shutdown) -> bool {
    loop {
        if stop.is_requested() {
            return false;
        }
        let now = MonotonicClock.now().as_ns();
        if now >= deadline_ns {
            return true;
        }
        let until = deadline_ns.min(now + LOOK_UP_NS);
        let at = TimeSpec::nanoseconds(until.cast_signed());
        // An interruption by a signal only leads to another look.
        let _ = clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &at);
    }
}

/// Asks the kernel to wake this thread on time: ordinary threads may be woken 50 µs late to save power.
pub fn wake_precisely() {
    // Refused only by kernels that know no timer slack: then wake-ups are what they are.
    let _ = nix::sys::prctl::set_timerslack(1);
}
