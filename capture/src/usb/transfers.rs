//! The one file that talks to libusb's asynchronous interface: transfers straight into the memory of
//! frames in flight.

use std::{
    ffi::c_int,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use rusb::{Context, DeviceHandle, UsbContext, ffi};
use thiserror::Error;

use super::stream::{FrameLoss, ReceivedFrame, Ring, Step, TransferEnd};

/// What becomes of a stream's frames. Called from the event thread, with no lock of libusb's held.
pub trait StreamHandler: Send {
    /// Memory of one frame.
    type Buffer: AsMut<[u8]> + Send;

    /// A frame is whole in `buffer`: puts another in its place, or leaves it for the next frame.
    fn frame(&mut self, frame: &ReceivedFrame, buffer: &mut Self::Buffer);

    /// `count` frames are lost.
    fn lost(&mut self, loss: FrameLoss, count: u64);

    /// The payload of a frame has come: its trailer is to follow at once.
    fn awaits_trailer(&mut self);

    /// The stream has stopped by itself: it is out of step (restart it), or the device has gone.
    fn stopped(&mut self, gone: bool);
}

/// Transfers could not be queued.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum TransferError {
    /// The kernel's limit on memory for USB transfers.
    #[error(
        "the kernel has no memory left for USB transfers (this stream needs {needed_mb:.0} MB): raise it with \
         `echo 1000 > /sys/module/usbcore/parameters/usbfs_memory_mb`"
    )]
    NoMemory {
        /// What this stream needs.
        needed_mb: f64,
    },
    /// Anything else.
    #[error("a transfer cannot be queued: {0}")]
    Refused(rusb::Error),
}

/// The queued transfers of one stream, and the frames that they fill.
///
/// Dropping it takes all transfers back and waits until the kernel has given them up: only then is the
/// frames' memory free.
pub struct Stream<H: StreamHandler> {
    shared: Arc<Shared<H>>,
    /// What each transfer's `user_data` points to; must not move while transfers exist.
    tags: Box<[Tag<H>]>,
    handle: Arc<DeviceHandle<Context>>,
}

struct Tag<H: StreamHandler> {
    shared: *const Shared<H>,
    unit: usize,
    part: usize,
}

struct Shared<H: StreamHandler> {
    state: Mutex<State<H>>,
    drained: Condvar,
}

struct State<H: StreamHandler> {
    ring: Ring<H::Buffer>,
    handler: H,
    /// By unit, then part.
    transfers: Vec<Transfer>,
    outstanding: usize,
    running: bool,
}

/// A libusb transfer, freed when it is dropped.
struct Transfer(*mut ffi::libusb_transfer);

// SAFETY: a transfer may be submitted and cancelled from any thread (libusb's documentation of
// multi-threaded use); its fields are touched only under the lock of `Shared::state`, or by libusb while
// it is in flight.
unsafe impl Send for Transfer {}

impl Drop for Transfer {
    fn drop(&mut self) {
        // SAFETY: it was allocated by libusb_alloc_transfer, and `Stream::drop` frees transfers only when
        // none is in flight.
        unsafe { ffi::libusb_free_transfer(self.0) }
    }
}

impl<H: StreamHandler> Shared<H> {
    fn lock(&self) -> MutexGuard<'_, State<H>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<H: StreamHandler> Stream<H> {
    /// A stream on `endpoint`, not yet queued.
    ///
    /// # Errors
    /// [`TransferError::NoMemory`] when libusb cannot allocate.
    pub fn new(
        handle: Arc<DeviceHandle<Context>>,
        endpoint: u8,
        ring: Ring<H::Buffer>,
        handler: H,
    ) -> Result<Self, TransferError> {
        let (units, parts) = (ring.depth(), ring.parts());
        let state = State { ring, handler, transfers: Vec::new(), outstanding: 0, running: false };
        let shared = Arc::new(Shared { state: Mutex::new(state), drained: Condvar::new() });
        let tags: Box<[Tag<H>]> = (0..units * parts)
            .map(|i| Tag { shared: Arc::as_ptr(&shared), unit: i / parts, part: i % parts })
            .collect();
        {
            let mut state = shared.lock();
            for tag in &tags {
                // SAFETY: allocating has no preconditions; null is checked.
                let raw = unsafe { ffi::libusb_alloc_transfer(0) };
                if raw.is_null() {
                    return Err(TransferError::NoMemory { needed_mb: 0.0 });
                }
                state.transfers.push(Transfer(raw));
                // SAFETY: `raw` is a valid transfer that is not in flight; the tag lives in a boxed slice
                // that the stream keeps until all transfers are freed. Buffer and length are set when it
                // is submitted. Time-out 0: a triggered frame may take any time to come.
                unsafe {
                    (*raw).dev_handle = handle.as_raw();
                    (*raw).endpoint = endpoint;
                    (*raw).transfer_type = ffi::constants::LIBUSB_TRANSFER_TYPE_BULK;
                    (*raw).timeout = 0;
                    (*raw).callback = on_complete::<H>;
                    (*raw).user_data = std::ptr::from_ref(tag).cast_mut().cast();
                }
            }
        }
        Ok(Self { shared, tags, handle })
    }

    /// Queues all transfers.
    ///
    /// # Errors
    /// [`TransferError`]; then none is queued.
    pub fn submit(&self) -> Result<(), TransferError> {
        let result = {
            let mut state = self.shared.lock();
            state.running = true;
            let units = state.ring.depth();
            (0..units).try_for_each(|unit| state.submit(unit))
        };
        if result.is_err() {
            self.drain();
        }
        result
    }

    /// Takes all transfers back, newest first, and waits for the last of them. False when the kernel
    /// does not give them up.
    pub fn drain(&self) -> bool {
        let mut state = self.shared.lock();
        state.running = false;
        for transfer in state.transfers.iter().rev() {
            // SAFETY: the transfer is allocated; cancelling one that is not in flight only gives an error.
            // The callback cannot run meanwhile on this transfer's memory being freed: the stream lives.
            unsafe { ffi::libusb_cancel_transfer(transfer.0) };
        }
        for _ in 0..500 {
            if state.outstanding == 0 {
                return true;
            }
            // The event thread does the work; where there is none, this one does.
            let (next, timeout) = self
                .shared
                .drained
                .wait_timeout(state, Duration::from_millis(5))
                .unwrap_or_else(PoisonError::into_inner);
            state = next;
            if timeout.timed_out() && state.outstanding > 0 {
                drop(state);
                let _ = self.handle.context().handle_events(Some(Duration::from_millis(5)));
                state = self.shared.lock();
            }
        }
        state.outstanding == 0
    }

    /// Ends the stream where the trailer of a frame is still missing and the handler (`unchanged`) knows
    /// of nothing newer; true if so. A trailer that is lost would else be noticed only when the next
    /// frame runs into its place, and that frame would be lost too.
    pub fn end_without_trailer(&self, unchanged: impl FnOnce(&mut H) -> bool) -> bool {
        let mut state = self.shared.lock();
        if !state.running || !state.ring.assembler().awaits_trailer() || !unchanged(&mut state.handler) {
            return false;
        }
        state.running = false;
        state.handler.lost(FrameLoss::TrailerLost, 1);
        true
    }

    /// Works on the stream's judge and handler between two transfers.
    pub fn with<T>(&self, work: impl FnOnce(&mut Ring<H::Buffer>, &mut H) -> T) -> T {
        let mut state = self.shared.lock();
        let State { ring, handler, .. } = &mut *state;
        work(ring, handler)
    }
}

impl<H: StreamHandler> Drop for Stream<H> {
    fn drop(&mut self) {
        if !self.drain() {
            tracing::error!("the kernel does not give USB transfers back: their memory is left to it");
            std::mem::forget(self.shared.clone());
            std::mem::forget(std::mem::take(&mut self.tags));
        }
    }
}

impl<H: StreamHandler> State<H> {
    fn submit(&mut self, unit: usize) -> Result<(), TransferError> {
        for part in 0..self.ring.parts() {
            let place = unit * self.ring.parts() + part;
            let memory = self.ring.memory(unit, part);
            let (pointer, length) = (memory.as_mut_ptr(), memory.len());
            let raw = self.transfers[place].0;
            // SAFETY: the transfer is not in flight: its unit is complete, or was never queued. Its memory
            // belongs to the ring's unit `unit`, whose buffer is exchanged only when none of the unit's
            // transfers is in flight, and lives in the heap or in shared memory: it does not move.
            let code = unsafe {
                (*raw).buffer = pointer;
                (*raw).length = c_int::try_from(length).unwrap_or(c_int::MAX);
                ffi::libusb_submit_transfer(raw)
            };
            if code != 0 {
                let needed = self.ring.plan().slot * self.ring.depth();
                return Err(match code {
                    ffi::constants::LIBUSB_ERROR_NO_MEM => {
                        TransferError::NoMemory { needed_mb: needed as f64 / 1e6 }
                    }
                    ffi::constants::LIBUSB_ERROR_NO_DEVICE => TransferError::Refused(rusb::Error::NoDevice),
                    ffi::constants::LIBUSB_ERROR_IO => TransferError::Refused(rusb::Error::Io),
                    _ => TransferError::Refused(rusb::Error::Other),
                });
            }
            self.outstanding += 1;
        }
        Ok(())
    }

    fn complete(&mut self, unit: usize, part: usize, end: TransferEnd, received: usize) {
        let step = self.ring.complete(unit, part, end, received);
        match step {
            Step::Continue => {
                if self.ring.assembler().awaits_trailer() {
                    self.handler.awaits_trailer();
                }
                return;
            }
            Step::OutOfStep(loss) => {
                self.handler.lost(loss, 1);
                self.running = false;
                self.handler.stopped(false);
                return;
            }
            Step::Gone => {
                self.running = false;
                self.handler.stopped(true);
                return;
            }
            Step::Frame(..) | Step::Lost(..) => {}
        }
        let (Step::Frame(_, skipped) | Step::Lost(_, skipped)) = step else { return };
        if skipped > 0 {
            let reason = self.ring.assembler().skip_reason();
            self.handler.lost(reason, skipped);
        }
        self.ring.assembler().settled();
        match step {
            Step::Frame(frame, _) => self.handler.frame(&frame, self.ring.buffer(unit)),
            Step::Lost(loss, _) => self.handler.lost(loss, 1),
            _ => {}
        }
        if let Err(e) = self.submit(unit) {
            tracing::warn!("{e}");
            self.running = false;
            self.handler.stopped(e == TransferError::Refused(rusb::Error::NoDevice));
        }
    }
}

/// libusb's callback, on the thread that handles events.
extern "system" fn on_complete<H: StreamHandler>(raw: *mut ffi::libusb_transfer) {
    // SAFETY: libusb hands back the transfer that was submitted, which is not in flight any more; its
    // user data is the tag that `Stream::new` set, which lives until all transfers are freed, and so
    // does the shared state that the tag points to.
    let (status, received, tag) =
        unsafe { ((*raw).status, (*raw).actual_length, &*(*raw).user_data.cast::<Tag<H>>()) };
    // SAFETY: see above.
    let shared = unsafe { &*tag.shared };
    let end = match status {
        ffi::constants::LIBUSB_TRANSFER_COMPLETED => TransferEnd::Complete,
        ffi::constants::LIBUSB_TRANSFER_STALL => TransferEnd::Stalled,
        ffi::constants::LIBUSB_TRANSFER_OVERFLOW => TransferEnd::Overflow,
        ffi::constants::LIBUSB_TRANSFER_NO_DEVICE => TransferEnd::Gone,
        ffi::constants::LIBUSB_TRANSFER_CANCELLED => TransferEnd::Cancelled,
        _ => TransferEnd::Failed,
    };
    // A panic must not unwind into C.
    let result = catch_unwind(AssertUnwindSafe(|| {
        let mut state = shared.lock();
        state.outstanding -= 1;
        if state.running {
            state.complete(tag.unit, tag.part, end, usize::try_from(received).unwrap_or(0));
        }
        if state.outstanding == 0 {
            shared.drained.notify_all();
        }
    }));
    if result.is_err() {
        std::process::abort();
    }
}
