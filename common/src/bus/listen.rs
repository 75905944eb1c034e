use std::{os::fd::BorrowedFd, time::Duration};

use iceoryx2::{
    port::{
        listener::{Listener, ListenerWaitError},
        notifier::Notifier,
    },
    prelude::FileDescriptorBased,
};
use nix::{
    errno::Errno,
    poll::{PollFd, PollFlags, PollTimeout, poll},
};

use super::{
    Bus, BusError, Service,
    service::{self, Opening},
};
use crate::wire::MAX_CAMERAS;

/// A file descriptor that is readable while a message may wait.
pub type EventFd<'a> = BorrowedFd<'a>;

/// A reading end that can be waited for together with others.
pub trait Listen {
    /// What is polled.
    fn event_fd(&self) -> EventFd<'_>;

    /// Forgets wake-ups up to now; to be called before the queue is read.
    ///
    /// # Errors
    /// [`BusError::Service`].
    fn clear(&self) -> Result<(), BusError>;
}

/// Most reading ends that [`wait_any`] takes: three of every camera's, and the rig's.
const MAX_WAITED: usize = 3 * MAX_CAMERAS + 8;

/// Waits until a message may be there on any of `listeners`, or `timeout` has passed. Then all their
/// queues are to be read. Allocates nothing.
///
/// # Errors
/// [`BusError::Service`].
///
/// # Panics
/// With more than 56 listeners.
pub fn wait_any(listeners: &[&dyn Listen], timeout: Duration) -> Result<(), BusError> {
    assert!((1..=MAX_WAITED).contains(&listeners.len()), "{} listeners", listeners.len());
    let first = listeners[0].event_fd();
    let mut fds = [const { None }; MAX_WAITED];
    for (fd, listener) in fds.iter_mut().zip(listeners) {
        *fd = Some(PollFd::new(listener.event_fd(), PollFlags::POLLIN));
    }
    let mut polled: [PollFd<'_>; MAX_WAITED] =
        std::array::from_fn(|i| fds[i].take().unwrap_or_else(|| PollFd::new(first, PollFlags::empty())));
    let polled = &mut polled[..listeners.len()];
    // Rounded up: a wait of 0.4 ms must not become a busy loop.
    let millis = timeout.as_micros().div_ceil(1000);
    let timeout = PollTimeout::try_from(millis).unwrap_or(PollTimeout::MAX);
    match poll(polled, timeout) {
        // A signal: the caller looks at its flag.
        Ok(_) | Err(Errno::EINTR) => {}
        Err(e) => {
            return Err(BusError::Service {
                service: "events".into(),
                doing: "polling",
                cause: e.to_string(),
            });
        }
    }
    for (fd, listener) in polled.iter().zip(listeners) {
        if fd.any() == Some(true) {
            listener.clear()?;
        }
    }
    Ok(())
}

/// Wakes readers.
#[derive(Debug)]
pub(super) struct Signal(Notifier<Service>);

impl Signal {
    pub(super) fn open(bus: &Bus, opening: &Opening) -> Result<Self, BusError> {
        let notifier = service::events(bus, opening)?
            .notifier_builder()
            .create()
            .map_err(|e| opening.failed("opening its event's writing end", e))?;
        Ok(Self(notifier))
    }

    pub(super) fn wake(&self) {
        // A reader whose event queue is full has been woken already, and one that has died is cleaned
        // up elsewhere: neither is this writer's failure.
        let _ = self.0.notify();
    }
}

/// Is woken.
#[derive(Debug)]
pub(super) struct Waker {
    listener: Listener<Service>,
    service: String,
}

impl Waker {
    pub(super) fn open(bus: &Bus, opening: &Opening) -> Result<Self, BusError> {
        let listener = service::events(bus, opening)?
            .listener_builder()
            .create()
            .map_err(|e| opening.failed("opening its event's reading end", e))?;
        Ok(Self { listener, service: opening.service.clone() })
    }

    pub(super) fn wait(&self, timeout: Duration) -> Result<(), BusError> {
        match self.listener.timed_wait(|_| {}, timeout) {
            // A signal: the caller looks at its flag.
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
            Err(e) => Err(self.failed(&e)),
        }
    }

    pub(super) fn clear(&self) -> Result<(), BusError> {
        self.listener.try_wait(|_| {}).map(|_| ()).map_err(|e| self.failed(&e))
    }

    pub(super) fn event_fd(&self) -> EventFd<'_> {
        // SAFETY: the descriptor belongs to the listener, which lives as long as the borrow of self, and
        // iceoryx2 does not change it during the listener's life.
        unsafe { BorrowedFd::borrow_raw(self.listener.file_descriptor().native_handle()) }
    }

    fn failed(&self, cause: &impl std::fmt::Debug) -> BusError {
        BusError::Service { service: self.service.clone(), doing: "waiting", cause: format!("{cause:?}") }
    }
}
