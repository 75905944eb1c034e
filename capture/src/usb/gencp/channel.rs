use std::time::Duration;

use netcord_common::Stamp;
use thiserror::Error;

use super::{
    Command, Exchange, ExchangeError, Memory, MemoryError, Next, Patience, Retry, Sbrm, Status,
    packet::HEADER,
};

/// The two control endpoints of a camera.
pub trait ControlPipe {
    /// Sends one packet.
    ///
    /// # Errors
    /// [`PipeError`].
    fn send(&mut self, packet: &[u8], timeout: Duration) -> Result<(), PipeError>;

    /// Receives one packet into `buffer`; gives its length.
    ///
    /// # Errors
    /// [`PipeError`].
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, PipeError>;

    /// Clears a halt of both endpoints.
    ///
    /// # Errors
    /// [`PipeError`].
    fn clear_halt(&mut self) -> Result<(), PipeError>;

    /// The present instant.
    fn now(&self) -> Stamp;
}

/// How an endpoint can fail.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum PipeError {
    /// Nothing came, or could be sent, in time.
    #[error("time-out")]
    TimedOut,
    /// The device refused the transfer.
    #[error("the endpoint is stalled")]
    Stalled,
    /// The device has been unplugged.
    #[error("the camera has been unplugged")]
    Gone,
    /// Anything else of libusb's.
    #[error("USB error: {0}")]
    Usb(String),
}

/// A camera's register memory, through GenCP.
#[derive(Debug)]
pub struct ControlChannel<P> {
    pipe: P,
    last_id: u16,
    patience: Patience,
    max_command: usize,
    max_ack: usize,
    buffer: Vec<u8>,
}

/// Bytes of the address in a write command.
const WRITE_HEAD: usize = 8;

impl<P: ControlPipe> ControlChannel<P> {
    /// A channel with what every camera must accept: packets of 128 bytes, and half a second.
    pub fn new(pipe: P) -> Self {
        Self {
            pipe,
            last_id: 0,
            patience: Patience::default(),
            max_command: 128,
            max_ack: 128,
            // A packet more than asked for must not become an overflow of the transfer.
            buffer: vec![0; 1 << 16],
        }
    }

    /// Takes the packet sizes and the response time that the camera states.
    pub fn adopt(&mut self, sbrm: &Sbrm, response_ms: u32) {
        // Some cameras state 0, others 5 s: neither is a sensible wait for one answer.
        let answer = Duration::from_millis(response_ms.clamp(50, 1000).into());
        self.patience = Patience { answer, ..self.patience };
        self.max_command = usize::try_from(sbrm.max_command).unwrap_or(128).clamp(64, 1 << 16);
        self.max_ack = usize::try_from(sbrm.max_ack).unwrap_or(128).clamp(64, 1 << 16);
    }

    /// The endpoints.
    pub const fn pipe_mut(&mut self) -> &mut P {
        &mut self.pipe
    }

    /// Reads several registers, in one packet where the camera offers it (`stacked`).
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn read_many(&mut self, items: &[(u64, u16)], stacked: bool) -> Result<Vec<Vec<u8>>, MemoryError> {
        let total: usize = items.iter().map(|(_, length)| usize::from(*length)).sum();
        let fits = HEADER + 12 * items.len() <= self.max_command && HEADER + total <= self.max_ack;
        if stacked && fits && items.len() > 1 {
            let (address, length) = (items[0].0, total);
            match self.exchange(&Command::ReadStacked(items), Retry::Allowed) {
                Ok(data) => {
                    let mut rest = data.as_slice();
                    return Ok(items
                        .iter()
                        .map(|(_, length)| {
                            let (item, after) = rest.split_at(usize::from(*length));
                            rest = after;
                            item.to_vec()
                        })
                        .collect());
                }
                // Offered, but not there: the plain way serves as well.
                Err(Failure::Exchange(ExchangeError::Refused(status))) if status.code() == 0x8001 => {}
                Err(failure) => return Err(failure.at("reading", address, length)),
            }
        }
        let mut values = Vec::with_capacity(items.len());
        for (address, length) in items {
            let mut value = vec![0; usize::from(*length)];
            self.read(*address, &mut value)?;
            values.push(value);
        }
        Ok(values)
    }

    fn exchange(&mut self, command: &Command<'_>, retry: Retry) -> Result<Vec<u8>, Failure> {
        let mut exchange = Exchange::new(command, self.last_id, self.patience, retry);
        let mut halts_left = 2;
        let result = loop {
            match exchange.next() {
                Next::Done => break Ok(exchange.data().to_vec()),
                Next::Send => match self.pipe.send(exchange.packet(), self.patience.answer) {
                    Ok(()) => exchange.sent(self.pipe.now()),
                    Err(PipeError::TimedOut) => {
                        exchange.sent(self.pipe.now());
                        if let Err(e) = exchange.timed_out() {
                            break Err(e.into());
                        }
                    }
                    Err(PipeError::Stalled) if halts_left > 0 => {
                        halts_left -= 1;
                        if let Err(e) = self.pipe.clear_halt() {
                            break Err(e.into());
                        }
                    }
                    Err(e) => break Err(e.into()),
                },
                Next::Receive { until } => {
                    let left = until.saturating_since(self.pipe.now());
                    // A time-out of zero would be none at all to libusb.
                    let got = self.pipe.receive(&mut self.buffer, left.max(Duration::from_millis(1)));
                    let step = match got {
                        Ok(length) => exchange.received(&self.buffer[..length], self.pipe.now()),
                        Err(PipeError::TimedOut) => exchange.timed_out(),
                        Err(PipeError::Stalled) if halts_left > 0 => {
                            halts_left -= 1;
                            match self.pipe.clear_halt() {
                                Ok(()) => exchange.timed_out(),
                                Err(e) => break Err(e.into()),
                            }
                        }
                        Err(e) => break Err(e.into()),
                    };
                    if let Err(e) = step {
                        break Err(e.into());
                    }
                }
            }
        };
        self.last_id = exchange.request_id();
        result
    }

    fn write_as(&mut self, address: u64, data: &[u8], retry: Retry) -> Result<(), MemoryError> {
        let most = chunk(self.max_command - HEADER - WRITE_HEAD);
        for (index, part) in data.chunks(most).enumerate() {
            let at = offset(address, index * most, data.len())?;
            self.exchange(&Command::Write { address: at, data: part }, retry)
                .map_err(|e| e.at("writing", at, part.len()))?;
        }
        Ok(())
    }
}

/// Registers are of 4 bytes: a packet ends between two of them.
const fn chunk(bytes: usize) -> usize {
    bytes & !3
}

fn offset(address: u64, by: usize, length: usize) -> Result<u64, MemoryError> {
    u64::try_from(by)
        .ok()
        .and_then(|by| address.checked_add(by))
        .ok_or(MemoryError::Range { address, length })
}

enum Failure {
    Exchange(ExchangeError),
    Pipe(PipeError),
}

impl From<ExchangeError> for Failure {
    fn from(e: ExchangeError) -> Self {
        Self::Exchange(e)
    }
}

impl From<PipeError> for Failure {
    fn from(e: PipeError) -> Self {
        Self::Pipe(e)
    }
}

impl Failure {
    fn at(self, doing: &'static str, address: u64, length: usize) -> MemoryError {
        match self {
            Self::Exchange(cause) => MemoryError::Exchange { doing, address, length, cause },
            Self::Pipe(cause) => MemoryError::Pipe { doing, address, length, cause },
        }
    }
}

impl<P: ControlPipe> Memory for ControlChannel<P> {
    fn read(&mut self, address: u64, out: &mut [u8]) -> Result<(), MemoryError> {
        let most = chunk(self.max_ack - HEADER);
        let length = out.len();
        for (index, part) in out.chunks_mut(most).enumerate() {
            let at = offset(address, index * most, length)?;
            let wanted = u16::try_from(part.len()).map_err(|_| MemoryError::Range { address: at, length })?;
            let data = self
                .exchange(&Command::Read { address: at, length: wanted }, Retry::Allowed)
                .map_err(|e| e.at("reading", at, part.len()))?;
            part.copy_from_slice(&data);
        }
        Ok(())
    }

    fn write(&mut self, address: u64, data: &[u8]) -> Result<(), MemoryError> {
        self.write_as(address, data, Retry::Allowed)
    }

    fn write_once(&mut self, address: u64, data: &[u8]) -> Result<(), MemoryError> {
        self.write_as(address, data, Retry::Never)
    }
}

impl MemoryError {
    /// Whether the camera refused with `status`.
    pub fn is_refusal(&self, status: Status) -> bool {
        matches!(self, Self::Exchange { cause: ExchangeError::Refused(found), .. } if *found == status)
    }
}

#[cfg(test)]
mod tests {
    use netcord_emulator::FaultPlan;

    use super::*;
    use crate::usb::{
        gencp::{Abrm, SirmAddress, TransferSizes, read_description},
        testing::Bench,
    };

    #[test]
    fn every_control_fault_ends_in_the_right_value() {
        for fault in
            ["lose-ack@3", "late-ack@3", "stale-ack@3", "pending-ack@3", "stall-control@3", "lose-ack@2+2"]
        {
            let mut bench = Bench::new();
            let plan: FaultPlan = fault.parse().expect("a plan");
            bench.lock().0.cameras[0].set_faults(plan);
            let before = bench.now();
            let mut channel = bench.channel(0);
            let abrm = Abrm::read(&mut channel).expect(fault);
            assert_eq!(
                (abrm.model.as_str(), abrm.serial.as_str(), abrm.response_ms),
                ("EmulatedU3V", "0001", 100)
            );
            let took = bench.now() - before;
            // A pending acknowledge of 900 ms is not slept out when the answer comes after 300 ms.
            assert!(fault.starts_with("lose-ack@2") || took < 620_000_000, "{fault}: {took} ns");
        }
    }

    #[test]
    fn the_description_arrives_whole_with_any_packet_size() {
        let mut bench = Bench::new();
        let mut channel = bench.channel(0);
        let abrm = Abrm::read(&mut channel).expect("abrm");
        let small = read_description(&mut channel, abrm.manifest).expect("with 128 bytes");
        let sbrm = Sbrm::read(&mut channel, abrm.sbrm).expect("sbrm");
        assert_eq!((sbrm.max_command, sbrm.max_ack, sbrm.speed, sbrm.eirm), (1024, 1024, 8, None));
        channel.adopt(&sbrm, abrm.response_ms);
        assert_eq!(read_description(&mut channel, abrm.manifest).expect("with 1024"), small);
        assert!(small.starts_with("<?xml"));
    }

    #[test]
    fn stacked_reads_give_what_single_ones_do() {
        let items = [(0x1CC, 4), (0x1D0, 8), (0x44, 64)];
        let mut bench = Bench::new();
        let mut channel = bench.channel(0);
        let single = channel.read_many(&items, false).expect("one by one");
        assert_eq!(channel.read_many(&items, true).expect("stacked"), single);
        let config = netcord_emulator::CameraConfig { stacked: false, ..Default::default() };
        let mut bench = Bench::of([config]);
        assert_eq!(bench.channel(0).read_many(&items, true).expect("offered, but not there"), single);
    }

    #[test]
    fn refusals_come_back_as_they_are() {
        let mut bench = Bench::new();
        let mut channel = bench.channel(0);
        let error = channel.read(0xdead_0000, &mut [0; 4]).expect_err("no such address");
        assert!(error.is_refusal(Status::INVALID_ADDRESS), "{error}");
        let sirm = SirmAddress(0x2_0000);
        let odd =
            TransferSizes { leader: 1024, payload: 1000, count: 3000, final1: 0, final2: 0, trailer: 1024 };
        sirm.write_sizes(&mut channel, &odd).expect("written");
        let error = sirm.enable(&mut channel, true).expect_err("not aligned");
        assert!(error.is_refusal(Status::SIZE_NOT_ALIGNED), "{error}");
    }
}
