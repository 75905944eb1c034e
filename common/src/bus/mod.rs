//! The bus: iceoryx2 services of one domain. No other module, and no other crate, uses iceoryx2.
//!
//! - A [`Bus`] is a process's membership of one [`DomainName`](crate::DomainName).
//! - [`Topic`]s name the services and state their limits; [`Topic::frames`] is the one whose payload
//!   is a whole frame.
//! - [`Publisher`] / [`Subscriber`] exchange fixed-size messages; [`FramePublisher`] /
//!   [`FrameSubscriber`] exchange mosaics without copying them.
//! - The newest wins: a full queue drops its oldest message. Readers find losses by gaps in the
//!   sequence ([`SequenceGaps`]).

mod control;
mod error;
mod frames;
mod gaps;
mod listen;
mod membership;
mod messages;
mod service;
#[cfg(test)]
mod tests;
mod topic;

pub use control::{ControlClient, ControlServer};
pub use error::BusError;
pub use frames::{Frame, FramePublisher, FrameSlot, FrameSubscriber};
pub use gaps::SequenceGaps;
pub use listen::{Listen, wait_any};
pub use membership::{Bus, DomainRemains};
pub use messages::{Publisher, Subscriber};
pub use topic::{Limits, Topic};

/// All processes use the thread-safe service variant: a slot may be filled by another thread than the
/// one that publishes it.
type Service = iceoryx2::service::ipc_threadsafe::Service;
