//! How services are opened, and iceoryx2's refusals translated into what a person can act on.

use iceoryx2::{
    port::{publisher::PublisherCreateError, subscriber::SubscriberCreateError},
    prelude::ServiceName,
    service::{
        builder::{
            event::{EventOpenError, EventOpenOrCreateError},
            publish_subscribe::{PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError},
        },
        port_factory::{event, publish_subscribe},
    },
};

use super::{Bus, BusError, Limits, Service};
use crate::wire::{FrameHeader, MAX_CAMERAS, Message, WIRE_VERSION};

/// Processes that may use one service: every stage, a segmenter per camera, and tools.
pub(super) const MAX_NODES: usize = 2 * MAX_CAMERAS + 16;

/// What is being opened, for error messages.
#[derive(Debug, Clone)]
pub(super) struct Opening {
    pub(super) service: String,
    pub(super) limits: Limits,
    writer: &'static str,
}

impl Opening {
    pub(super) fn new(service: &str, limits: &Limits, writer: &'static str) -> Self {
        Self { service: service.to_owned(), limits: *limits, writer }
    }

    pub(super) fn name(&self) -> Result<ServiceName, BusError> {
        self.service.as_str().try_into().map_err(|e| self.failed("naming it", e))
    }

    pub(super) fn failed(&self, doing: &'static str, cause: impl std::fmt::Debug) -> BusError {
        BusError::Service { service: self.service.clone(), doing, cause: format!("{cause:?}") }
    }

    pub(super) fn wire_version(&self) -> BusError {
        BusError::WireVersion { service: self.service.clone(), ours: WIRE_VERSION }
    }

    pub(super) fn too_many(&self, what: &'static str, limit: usize) -> BusError {
        BusError::TooMany { service: self.service.clone(), what, limit }
    }

    pub(super) fn no_memory(&self, needed_bytes: usize, cause: impl std::fmt::Debug) -> BusError {
        BusError::NoMemory {
            service: self.service.clone(),
            needed_mb: needed_bytes as f64 / 1e6,
            free_mb: free_shared_memory() as f64 / 1e6,
            cause: format!("{cause:?}"),
        }
    }

    fn open_error(&self, error: PublishSubscribeOpenOrCreateError) -> BusError {
        use PublishSubscribeOpenError as Open;
        use PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError as Opening;
        match error {
            Opening(
                Open::IncompatibleAttributes
                | Open::IncompatibleTypes
                | Open::IncompatibleOverflowBehavior
                | Open::DoesNotSupportRequestedMinBufferSize
                | Open::DoesNotSupportRequestedMinHistorySize
                | Open::DoesNotSupportRequestedMinSubscriberBorrowedSamples
                | Open::DoesNotSupportRequestedAmountOfPublishers
                | Open::DoesNotSupportRequestedAmountOfSubscribers
                | Open::DoesNotSupportRequestedAmountOfNodes
                | Open::VersionMismatch,
            ) => self.wire_version(),
            Opening(Open::ExceedsMaxNumberOfNodes) => self.too_many("process", MAX_NODES),
            other => self.failed("opening it", other),
        }
    }

    pub(super) fn publisher_error(&self, error: PublisherCreateError, needed_bytes: usize) -> BusError {
        match error {
            PublisherCreateError::ExceedsMaxSupportedPublishers if self.limits.writers == 1 => {
                BusError::SecondWriter { service: self.service.clone(), writer: self.writer }
            }
            PublisherCreateError::ExceedsMaxSupportedPublishers => {
                self.too_many("writer", self.limits.writers)
            }
            PublisherCreateError::UnableToCreateDataSegment => self.no_memory(needed_bytes, error),
            other => self.failed("opening its writing end", other),
        }
    }

    pub(super) fn subscriber_error(&self, error: SubscriberCreateError) -> BusError {
        match error {
            SubscriberCreateError::ExceedsMaxSupportedSubscribers => {
                self.too_many("reader", self.limits.readers)
            }
            other => self.failed("opening a reading end", other),
        }
    }
}

/// Bytes free in /dev/shm; 0 where that cannot be told.
pub(super) fn free_shared_memory() -> u64 {
    nix::sys::statvfs::statvfs("/dev/shm").map_or(0, |s| s.blocks_available() * s.fragment_size())
}

pub(super) fn messages<T: Message>(
    bus: &Bus,
    opening: &Opening,
) -> Result<publish_subscribe::PortFactory<Service, T, ()>, BusError> {
    let l = &opening.limits;
    bus.node
        .service_builder(&opening.name()?)
        .publish_subscribe::<T>()
        .max_publishers(l.writers)
        .max_subscribers(l.readers)
        .subscriber_max_buffer_size(l.queue)
        .subscriber_max_borrowed_samples(l.borrowed)
        .history_size(0)
        .enable_safe_overflow(true)
        .max_nodes(MAX_NODES)
        .open_or_create_with_attributes(&bus.version_wanted())
        .map_err(|e| opening.open_error(e))
}

pub(super) fn frames(
    bus: &Bus,
    opening: &Opening,
) -> Result<publish_subscribe::PortFactory<Service, [u8], FrameHeader>, BusError> {
    let l = &opening.limits;
    bus.node
        .service_builder(&opening.name()?)
        .publish_subscribe::<[u8]>()
        .user_header::<FrameHeader>()
        .max_publishers(l.writers)
        .max_subscribers(l.readers)
        .subscriber_max_buffer_size(l.queue)
        .subscriber_max_borrowed_samples(l.borrowed)
        .history_size(0)
        .enable_safe_overflow(true)
        .max_nodes(MAX_NODES)
        .open_or_create_with_attributes(&bus.version_wanted())
        .map_err(|e| opening.open_error(e))
}

pub(super) fn events(bus: &Bus, opening: &Opening) -> Result<event::PortFactory<Service>, BusError> {
    bus.node
        .service_builder(&opening.name()?)
        .event()
        .max_notifiers(opening.limits.writers)
        .max_listeners(opening.limits.readers)
        .max_nodes(MAX_NODES)
        .open_or_create_with_attributes(&bus.version_wanted())
        .map_err(|e| match e {
            EventOpenOrCreateError::EventOpenError(
                EventOpenError::IncompatibleAttributes
                | EventOpenError::DoesNotSupportRequestedAmountOfNotifiers
                | EventOpenError::DoesNotSupportRequestedAmountOfListeners
                | EventOpenError::DoesNotSupportRequestedAmountOfNodes,
            ) => opening.wire_version(),
            other => opening.failed("opening its event", other),
        })
}
