use std::time::Duration;

use iceoryx2::port::{publisher::Publisher as IoxPublisher, subscriber::Subscriber as IoxSubscriber};

use super::{
    Bus, BusError, Listen, Service, Topic,
    listen::{EventFd, Signal, Waker},
    service::{self, Opening},
};
use crate::wire::Message;

/// The writing end of a service of fixed-size messages.
#[derive(Debug)]
pub struct Publisher<T: Message> {
    port: IoxPublisher<Service, T, ()>,
    signal: Signal,
    name: String,
}

impl<T: Message> Publisher<T> {
    pub(super) fn open(bus: &Bus, topic: &Topic<T>) -> Result<Self, BusError> {
        let opening = Opening::new(topic.name(), topic.limits(), topic.writer());
        let factory = service::messages::<T>(bus, &opening)?;
        let port = factory
            .publisher_builder()
            .max_loaned_samples(topic.limits().loaned)
            .create()
            .map_err(|e| opening.publisher_error(e, topic.limits().slots() * size_of::<T>()))?;
        Ok(Self { port, signal: Signal::open(bus, &opening)?, name: topic.name().to_owned() })
    }

    /// Sends a copy of `message` to all readers, and wakes them.
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn send(&self, message: &T) -> Result<(), BusError> {
        let sent = self
            .port
            .loan_uninit()
            .map_err(|e| format!("{e:?}"))
            .and_then(|slot| slot.write_payload(*message).send().map_err(|e| format!("{e:?}")));
        match sent {
            Ok(_) => {
                self.signal.wake();
                Ok(())
            }
            Err(cause) => Err(BusError::Service { service: self.name.clone(), doing: "sending", cause }),
        }
    }
}

/// A reading end of a service of fixed-size messages.
#[derive(Debug)]
pub struct Subscriber<T: Message> {
    port: IoxSubscriber<Service, T, ()>,
    waker: Waker,
    name: String,
}

impl<T: Message> Subscriber<T> {
    pub(super) fn open(bus: &Bus, topic: &Topic<T>) -> Result<Self, BusError> {
        let opening = Opening::new(topic.name(), topic.limits(), topic.writer());
        let factory = service::messages::<T>(bus, &opening)?;
        let port = factory.subscriber_builder().create().map_err(|e| opening.subscriber_error(e))?;
        Ok(Self { port, waker: Waker::open(bus, &opening)?, name: topic.name().to_owned() })
    }

    /// The oldest message that waits, if one does.
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn receive(&self) -> Result<Option<T>, BusError> {
        self.port.receive().map(|sample| sample.map(|s| *s.payload())).map_err(|e| BusError::Service {
            service: self.name.clone(),
            doing: "receiving",
            cause: format!("{e:?}"),
        })
    }

    /// The newest message that waits; older ones are dropped.
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn receive_newest(&self) -> Result<Option<T>, BusError> {
        let mut newest = None;
        while let Some(message) = self.receive()? {
            newest = Some(message);
        }
        Ok(newest)
    }

    /// Waits until a message may be there, or `timeout` has passed.
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn wait(&self, timeout: Duration) -> Result<(), BusError> {
        self.waker.wait(timeout)
    }

    /// Whether a message waits; costs no system call.
    pub fn has_message(&self) -> bool {
        self.port.has_samples().unwrap_or(false)
    }
}

impl<T: Message> Listen for Subscriber<T> {
    fn event_fd(&self) -> EventFd<'_> {
        self.waker.event_fd()
    }

    fn clear(&self) -> Result<(), BusError> {
        self.waker.clear()
    }
}
