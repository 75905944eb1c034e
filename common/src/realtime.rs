//! Where and how urgently the present thread runs.

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
