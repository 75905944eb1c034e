//! Where and how urgently the present thread runs.

use std::time::Duration;

use nix::{
    sched::{CpuSet, sched_setaffinity},
    unistd::Pid,
};
use thiserror::Error;

/// A scheduling wish that the system does not grant.
#[derive(Debug, Error)]
pub enum RealtimeError {
    /// No such processor, or not ours to use.
    #[error("cannot run on the processors {cpus:?}: {cause}; this machine has 0 to {last}")]
    Affinity {
        /// What was asked for.
        cpus: Vec<usize>,
        /// The highest processor of this machine.
        last: usize,
        /// Why.
        cause: nix::Error,
    },
    /// No right to a real-time priority.
    #[error(
        "cannot take the real-time priority {priority}: {cause}; allow it with `ulimit -r 99`, LimitRTPRIO=99 in a \
         systemd unit, or rtprio in /etc/security/limits.conf"
    )]
    Priority {
        /// What was asked for.
        priority: i32,
        /// Why.
        cause: std::io::Error,
    },
}

/// Binds the present thread, and those it starts later, to `cpus`.
///
/// # Errors
/// [`RealtimeError::Affinity`].
pub fn bind_to_cpus(cpus: &[usize]) -> Result<(), RealtimeError> {
    let last = std::thread::available_parallelism().map_or(0, |n| n.get() - 1);
    let failed = |cause| RealtimeError::Affinity { cpus: cpus.to_vec(), last, cause };
    let mut set = CpuSet::new();
    for cpu in cpus {
        set.set(*cpu).map_err(failed)?;
    }
    sched_setaffinity(Pid::from_raw(0), &set).map_err(failed)
}

/// Gives the present thread, and those it starts later, the SCHED_FIFO priority `priority` (1–99).
///
/// # Errors
/// [`RealtimeError::Priority`].
pub fn set_fifo_priority(priority: i32) -> Result<(), RealtimeError> {
    let parameters = libc::sched_param { sched_priority: priority };
    // SAFETY: the call reads one sched_param, which lives until it returns; 0 names the present thread.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
    if result == 0 {
        Ok(())
    } else {
        Err(RealtimeError::Priority { priority, cause: std::io::Error::last_os_error() })
    }
}

/// Lets the present thread, and those it starts later, run only when the stages leave time: for processes
/// that watch. `niceness` is from 1 to 19, the nicest.
///
/// # Errors
/// [`RealtimeError::Priority`].
pub fn step_back(niceness: i32) -> Result<(), RealtimeError> {
    // SAFETY: the call takes plain numbers; 0 names the present thread.
    let result = unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, niceness) };
    if result == 0 {
        Ok(())
    } else {
        Err(RealtimeError::Priority { priority: -niceness, cause: std::io::Error::last_os_error() })
    }
}

/// Lets the present thread, and those it starts later, run only where a processor has nothing else to do: for work
/// that must never take a stage's time, and can wait (SCHED_IDLE, sched(7)). A thread that wakes up takes the
/// processor from it at once.
///
/// # Errors
/// What the system says; it asks for no right.
pub fn give_way() -> std::io::Result<()> {
    let parameters = libc::sched_param { sched_priority: 0 };
    // SAFETY: the call reads one sched_param, which lives until it returns; 0 names the present thread.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_IDLE, &raw const parameters) };
    if result == 0 { Ok(()) } else { Err(std::io::Error::last_os_error()) }
}

/// Asks the scheduler for short turns of the present thread, and so for turns that begin at once: one that is woken
/// for a shorter turn than the running thread's need not wait for the end of that one, which is up to 3 ms away.
/// For threads whose work takes no longer than `turn`, 0.1 to 100 ms. Linux 6.12 and later heed it (EEVDF's custom
/// slice: sched_setattr(2) with `sched_runtime` under SCHED_OTHER); earlier kernels take no notice, and none refuses
/// it: this is a wish, not a right. Nothing changes under a real-time policy.
pub fn take_short_turns(turn: Duration) {
    let mut attributes = std::mem::MaybeUninit::<libc::sched_attr>::zeroed();
    let size = size_of::<libc::sched_attr>();
    // SAFETY: the kernel writes at most `size` bytes to the structure, which lives until the call returns, and all
    // of whose bytes may be zero; 0 names the present thread.
    let mut attributes = unsafe {
        if libc::syscall(libc::SYS_sched_getattr, 0, attributes.as_mut_ptr(), size, 0) != 0 {
            return;
        }
        attributes.assume_init()
    };
    if attributes.sched_policy.cast_signed() != libc::SCHED_OTHER {
        return;
    }
    attributes.sched_runtime = u64::try_from(turn.as_nanos()).unwrap_or(u64::MAX);
    // SAFETY: the call reads one sched_attr, which lives until it returns.
    unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_gives_way_runs_when_nobody_else_does() {
        std::thread::spawn(|| {
            give_way().expect("giving way needs no right");
            // SAFETY: a plain number; 0 names the present thread.
            assert_eq!(unsafe { libc::sched_getscheduler(0) }, libc::SCHED_IDLE);
        })
        .join()
        .expect("no panic");
    }

    #[test]
    fn short_turns_keep_the_niceness() {
        std::thread::spawn(|| {
            step_back(7).expect("stepping back needs no right");
            take_short_turns(Duration::from_micros(100));
            // SAFETY: plain numbers; 0 names the present thread.
            assert_eq!(unsafe { libc::getpriority(libc::PRIO_PROCESS, 0) }, 7);
        })
        .join()
        .expect("no panic");
    }
}
