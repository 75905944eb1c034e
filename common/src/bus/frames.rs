use std::{
    sync::{Mutex, PoisonError},
    time::Duration,
};

use iceoryx2::{
    port::{LoanError, publisher::Publisher as IoxPublisher, subscriber::Subscriber as IoxSubscriber},
    sample::Sample,
    sample_mut::SampleMut,
};

use super::{
    Bus, BusError, Listen, Service, Topic,
    listen::{EventFd, Signal, Waker},
    service::{self, Opening},
};
use crate::wire::FrameHeader;

/// The writing end of `camera/<name>/frame`.
#[derive(Debug)]
pub struct FramePublisher {
    port: IoxPublisher<Service, [u8], FrameHeader>,
    signal: Signal,
    opening: Opening,
    name: String,
    slot_bytes: usize,
    /// Addresses of slots that have been handed out: their pages are there.
    touched: Mutex<Vec<usize>>,
}

/// Slots that must find room when a writer opens: one being filled, one being read, in each of two stages.
const FIRST_SLOTS: usize = 4;

impl FramePublisher {
    /// Opens the writing end, with slots of `slot_bytes` (the frame, and the slack that a device's
    /// transfers need at its end).
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn open(bus: &Bus, topic: &Topic<FrameHeader>, slot_bytes: usize) -> Result<Self, BusError> {
        let opening = Opening::new(topic.name(), topic.limits(), topic.writer());
        // Shared memory is given page by page when it is first written, and a process that writes where none is
        // left is ended by the kernel (SIGBUS): so it is asked before, here and in `loan`.
        if service::free_shared_memory() < (FIRST_SLOTS * slot_bytes) as u64 {
            return Err(
                opening.no_memory(FIRST_SLOTS * slot_bytes, "too little is free for the first frames")
            );
        }
        let factory = service::frames(bus, &opening)?;
        let port = factory
            .publisher_builder()
            .initial_max_slice_len(slot_bytes)
            .max_loaned_samples(topic.limits().loaned)
            .create()
            .map_err(|e| opening.publisher_error(e, topic.limits().slots() * slot_bytes))?;
        let touched = Mutex::new(Vec::with_capacity(topic.limits().slots()));
        let signal = Signal::open(bus, &opening)?;
        Ok(Self { port, signal, opening, name: topic.name().to_owned(), slot_bytes, touched })
    }

    /// Takes a free slot of `bytes` bytes, which hold what an earlier frame left there.
    ///
    /// # Errors
    /// [`BusError::FrameTooLarge`], [`BusError::NoSlot`], [`BusError::NoMemory`] for a slot that has never been
    /// used and finds no room, and [`BusError::Service`].
    pub fn loan(&self, bytes: usize) -> Result<FrameSlot, BusError> {
        let sample = self.port.loan_slice_uninit(bytes).map_err(|e| match e {
            LoanError::ExceedsMaxLoanSize => {
                BusError::FrameTooLarge { service: self.name.clone(), bytes, slot: self.slot_bytes }
            }
            LoanError::ExceedsMaxLoans | LoanError::OutOfMemory => {
                BusError::NoSlot { service: self.name.clone() }
            }
            other => BusError::Service {
                service: self.name.clone(),
                doing: "taking a frame slot",
                cause: format!("{other:?}"),
            },
        })?;
        // SAFETY: every bit pattern is a valid u8, and the slot lies in shared memory, whose pages are
        // zero when they are first touched and hold an earlier frame after that: no byte is ever
        // uninitialised.
        let sample = unsafe { sample.assume_init() };
        self.make_sure_of_room(sample.payload().as_ptr().addr())?;
        Ok(FrameSlot { sample })
    }

    /// Asks, before the slot at `address` is written for the first time, whether its pages can be had.
    fn make_sure_of_room(&self, address: usize) -> Result<(), BusError> {
        let mut touched = self.touched.lock().unwrap_or_else(PoisonError::into_inner);
        if touched.contains(&address) {
            return Ok(());
        }
        if service::free_shared_memory() < self.slot_bytes as u64 {
            return Err(self.opening.no_memory(self.slot_bytes, "a slot is used for the first time"));
        }
        touched.push(address);
        Ok(())
    }

    /// Hands a filled slot to all readers, without copying it, and wakes them.
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn publish(&self, slot: FrameSlot) -> Result<(), BusError> {
        slot.sample.send().map_err(|e| BusError::Service {
            service: self.name.clone(),
            doing: "publishing a frame",
            cause: format!("{e:?}"),
        })?;
        self.signal.wake();
        Ok(())
    }

    /// Bytes of one slot.
    pub const fn slot_bytes(&self) -> usize {
        self.slot_bytes
    }
}

/// A loaned slot for one frame: written in place, then published, or returned by being dropped.
#[derive(Debug)]
pub struct FrameSlot {
    sample: SampleMut<Service, [u8], FrameHeader>,
}

impl FrameSlot {
    /// The mosaic's bytes, row by row.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        self.sample.payload_mut()
    }

    /// The mosaic's bytes, row by row.
    pub fn bytes(&self) -> &[u8] {
        self.sample.payload()
    }

    /// The header.
    pub fn header_mut(&mut self) -> &mut FrameHeader {
        self.sample.user_header_mut()
    }

    /// The header.
    pub fn header(&self) -> &FrameHeader {
        self.sample.user_header()
    }
}

/// A reading end of `camera/<name>/frame`.
#[derive(Debug)]
pub struct FrameSubscriber {
    port: IoxSubscriber<Service, [u8], FrameHeader>,
    waker: Waker,
    name: String,
}

impl FrameSubscriber {
    /// Opens a reading end whose queue holds `queue` frames (at most the topic's limit); one more drops
    /// the oldest.
    ///
    /// # Errors
    /// As [`Bus::subscriber`].
    pub fn open(bus: &Bus, topic: &Topic<FrameHeader>, queue: usize) -> Result<Self, BusError> {
        let opening = Opening::new(topic.name(), topic.limits(), topic.writer());
        let factory = service::frames(bus, &opening)?;
        let port = factory
            .subscriber_builder()
            .buffer_size(queue.clamp(1, topic.limits().queue))
            .create()
            .map_err(|e| opening.subscriber_error(e))?;
        Ok(Self { port, waker: Waker::open(bus, &opening)?, name: topic.name().to_owned() })
    }

    /// The oldest frame that waits, if one does.
    ///
    /// # Errors
    /// [`BusError::Service`], also when more frames are held than the topic's limit.
    pub fn receive(&self) -> Result<Option<Frame>, BusError> {
        self.port.receive().map(|sample| sample.map(|sample| Frame { sample })).map_err(|e| {
            BusError::Service {
                service: self.name.clone(),
                doing: "receiving a frame",
                cause: format!("{e:?}"),
            }
        })
    }

    /// Waits until a frame may be there, or `timeout` has passed.
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn wait(&self, timeout: Duration) -> Result<(), BusError> {
        self.waker.wait(timeout)
    }

    /// Whether a frame waits; costs no system call.
    pub fn has_frame(&self) -> bool {
        self.port.has_samples().unwrap_or(false)
    }
}

impl Listen for FrameSubscriber {
    fn event_fd(&self) -> EventFd<'_> {
        self.waker.event_fd()
    }

    fn clear(&self) -> Result<(), BusError> {
        self.waker.clear()
    }
}

/// A frame in shared memory: read in place, returned by being dropped.
#[derive(Debug)]
pub struct Frame {
    sample: Sample<Service, [u8], FrameHeader>,
}

impl Frame {
    /// The header.
    pub fn header(&self) -> &FrameHeader {
        self.sample.user_header()
    }

    /// The mosaic's bytes, row by row; a slot may hold slack behind the last row.
    pub fn bytes(&self) -> &[u8] {
        self.sample.payload()
    }
}
