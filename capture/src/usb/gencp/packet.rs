use thiserror::Error;

use super::Status;
use crate::usb::bytes::{u16_at, u32_at, u64_at};

/// Bytes of the header of every command, acknowledge and event.
pub const HEADER: usize = 12;

/// "U3VC": begins commands and acknowledges.
const CONTROL_MAGIC: u32 = 0x4356_3355;
/// "U3VE": begins events.
const EVENT_MAGIC: u32 = 0x4556_3355;
/// Bit 14 of the flags: an acknowledge is wanted.
const WANT_ACK: u16 = 0x4000;

const READ_MEM: u16 = 0x0800;
const WRITE_MEM: u16 = 0x0802;
const PENDING_ACK: u16 = 0x0805;
const READ_STACKED: u16 = 0x0806;
const WRITE_STACKED: u16 = 0x0808;
const EVENT: u16 = 0x0C00;

/// A command to a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command<'a> {
    /// Read `length` bytes from `address`.
    Read {
        /// Where.
        address: u64,
        /// How many bytes.
        length: u16,
    },
    /// Write `data` to `address`.
    Write {
        /// Where.
        address: u64,
        /// What.
        data: &'a [u8],
    },
    /// Several reads (address, length) in one packet; only for cameras that offer it.
    ReadStacked(&'a [(u64, u16)]),
    /// Several writes in one packet; only for cameras that offer it.
    WriteStacked(&'a [(u64, &'a [u8])]),
}

impl Command<'_> {
    const fn code(&self) -> u16 {
        match self {
            Self::Read { .. } => READ_MEM,
            Self::Write { .. } => WRITE_MEM,
            Self::ReadStacked(_) => READ_STACKED,
            Self::WriteStacked(_) => WRITE_STACKED,
        }
    }

    /// The code that the acknowledge of this command has.
    pub const fn ack_code(&self) -> u16 {
        self.code() + 1
    }

    /// Bytes of data that the acknowledge of a read brings.
    pub fn expected_data(&self) -> usize {
        match self {
            Self::Read { length, .. } => usize::from(*length),
            Self::ReadStacked(items) => items.iter().map(|(_, length)| usize::from(*length)).sum(),
            Self::Write { .. } | Self::WriteStacked(_) => 0,
        }
    }

    /// The packet, written over `out`.
    pub fn encode(&self, request_id: u16, out: &mut Vec<u8>) {
        out.clear();
        out.extend_from_slice(&CONTROL_MAGIC.to_le_bytes());
        out.extend_from_slice(&WANT_ACK.to_le_bytes());
        out.extend_from_slice(&self.code().to_le_bytes());
        out.extend_from_slice(&[0; 2]);
        out.extend_from_slice(&request_id.to_le_bytes());
        let read = |out: &mut Vec<u8>, address: u64, length: u16| {
            out.extend_from_slice(&address.to_le_bytes());
            out.extend_from_slice(&[0; 2]);
            out.extend_from_slice(&length.to_le_bytes());
        };
        match self {
            Self::Read { address, length } => read(out, *address, *length),
            Self::ReadStacked(items) => {
                items.iter().for_each(|(address, length)| read(out, *address, *length));
            }
            Self::Write { address, data } => {
                out.extend_from_slice(&address.to_le_bytes());
                out.extend_from_slice(data);
            }
            Self::WriteStacked(items) => {
                for (address, data) in *items {
                    out.extend_from_slice(&address.to_le_bytes());
                    out.extend_from_slice(&[0; 2]);
                    out.extend_from_slice(&u16::try_from(data.len()).unwrap_or(u16::MAX).to_le_bytes());
                    out.extend_from_slice(data);
                }
            }
        }
        let length = u16::try_from(out.len() - HEADER).unwrap_or(u16::MAX);
        out[8..10].copy_from_slice(&length.to_le_bytes());
    }
}

/// A packet that is not what the protocol says.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum PacketError {
    /// Shorter than its header, or than the header says.
    #[error("a packet of {found} bytes where its header needs {needed}")]
    Truncated {
        /// Bytes needed.
        needed: usize,
        /// Bytes there.
        found: usize,
    },
    /// Begins with something else.
    #[error("a packet that begins with {found:#010x} instead of {wanted:#010x}")]
    Magic {
        /// What it begins with.
        found: u32,
        /// What it should begin with.
        wanted: u32,
    },
    /// A code that cannot stand here.
    #[error("a packet with the unexpected command code {0:#06x}")]
    Code(u16),
}

/// An acknowledge, borrowed from the bytes received.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ack<'a> {
    /// How the command ended.
    pub status: Status,
    /// The acknowledge's command code.
    pub code: u16,
    /// Which command it answers.
    pub request_id: u16,
    /// Its data.
    pub data: &'a [u8],
}

impl Ack<'_> {
    /// For a pending acknowledge: how long the device asks to be waited for.
    pub fn pending_ms(&self) -> Option<u16> {
        if self.code == PENDING_ACK { u16_at(self.data, 2) } else { None }
    }
}

/// Reads an acknowledge. Bytes after what the header announces are ignored, as some cameras pad.
///
/// # Errors
/// [`PacketError`] for everything that is not one.
pub fn parse_ack(bytes: &[u8]) -> Result<Ack<'_>, PacketError> {
    let short = |needed| PacketError::Truncated { needed, found: bytes.len() };
    let magic = u32_at(bytes, 0).ok_or(short(HEADER))?;
    if magic != CONTROL_MAGIC {
        return Err(PacketError::Magic { found: magic, wanted: CONTROL_MAGIC });
    }
    let field = |at| u16_at(bytes, at).ok_or(short(HEADER));
    let (status, code, length, request_id) = (field(4)?, field(6)?, usize::from(field(8)?), field(10)?);
    if !matches!(code, 0x0801 | 0x0803 | PENDING_ACK | 0x0807 | 0x0809) {
        return Err(PacketError::Code(code));
    }
    let data = bytes.get(HEADER..HEADER + length).ok_or(short(HEADER + length))?;
    Ok(Ack { status: Status::from_code(status), code, request_id, data })
}

/// One event of a camera's event endpoint, such as the end of an exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Event<'a> {
    /// Which event; the camera's description names it.
    pub id: u16,
    /// The camera's clock, in its ticks.
    pub timestamp: u64,
    /// Further data of the event.
    pub data: &'a [u8],
}

/// Reads an event packet, which holds one event (size 0) or several, each with its size.
///
/// # Errors
/// [`PacketError`] for everything that is not one.
pub fn parse_event(bytes: &[u8]) -> Result<Vec<Event<'_>>, PacketError> {
    const FIXED: usize = 12;
    let short = |needed| PacketError::Truncated { needed, found: bytes.len() };
    let magic = u32_at(bytes, 0).ok_or(short(HEADER))?;
    if magic != EVENT_MAGIC {
        return Err(PacketError::Magic { found: magic, wanted: EVENT_MAGIC });
    }
    let code = u16_at(bytes, 6).ok_or(short(HEADER))?;
    if code != EVENT {
        return Err(PacketError::Code(code));
    }
    let length = usize::from(u16_at(bytes, 8).ok_or(short(HEADER))?);
    let mut rest = bytes.get(HEADER..HEADER + length).ok_or(short(HEADER + length))?;
    let mut events = Vec::new();
    while !rest.is_empty() {
        let (Some(size), Some(id), Some(timestamp)) = (u16_at(rest, 0), u16_at(rest, 2), u64_at(rest, 4))
        else {
            return Err(PacketError::Truncated { needed: FIXED, found: rest.len() });
        };
        // Size 0 means a single event that takes all that is there.
        let size = if size == 0 { rest.len() } else { usize::from(size) };
        if size < FIXED || size > rest.len() {
            return Err(PacketError::Truncated { needed: size.max(FIXED), found: rest.len() });
        }
        events.push(Event { id, timestamp, data: &rest[FIXED..size] });
        rest = &rest[size..];
    }
    Ok(events)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_have_the_bytes_of_the_standard() {
        let mut out = Vec::new();
        Command::Read { address: 0x0102_0304_0506_0708, length: 64 }.encode(7, &mut out);
        let wanted =
            [0x55, 0x33, 0x56, 0x43, 0, 0x40, 0, 8, 12, 0, 7, 0, 8, 7, 6, 5, 4, 3, 2, 1, 0, 0, 64, 0];
        assert_eq!(out, wanted);
        Command::Write { address: 1, data: &[9, 8] }.encode(0x1234, &mut out);
        assert_eq!(out[6..], [2, 8, 10, 0, 0x34, 0x12, 1, 0, 0, 0, 0, 0, 0, 0, 9, 8]);
    }

    #[test]
    fn acknowledges_shorter_than_they_say_are_refused() {
        let mut ack = vec![0x55, 0x33, 0x56, 0x43, 0x03, 0x80, 1, 8, 2, 0, 5, 0, 0xaa, 0xbb, 0xcc];
        let parsed = parse_ack(&ack).expect("an acknowledge");
        assert_eq!((parsed.status, parsed.request_id), (Status::INVALID_ADDRESS, 5));
        assert_eq!(parsed.data, [0xaa, 0xbb], "the padding is cut off");
        for length in 0..14 {
            assert!(parse_ack(&ack[..length]).is_err(), "{length} bytes");
        }
        ack[0] = 0;
        assert!(matches!(parse_ack(&ack), Err(PacketError::Magic { .. })));
    }

    #[test]
    fn a_packet_may_hold_several_events() {
        let event = |size: u16, id: u16, data: &[u8]| {
            let mut b = Vec::new();
            b.extend(size.to_le_bytes());
            b.extend(id.to_le_bytes());
            b.extend(77_u64.to_le_bytes());
            b.extend(data);
            b
        };
        let packet = |scd: &[u8]| {
            let mut b = vec![0x55, 0x33, 0x56, 0x45, 0, 0, 0, 0x0c];
            b.extend(u16::try_from(scd.len()).expect("short").to_le_bytes());
            b.extend([1, 0]);
            b.extend(scd);
            b
        };
        let two = packet(&[event(14, 1, &[5, 6]), event(12, 2, &[])].concat());
        let events = parse_event(&two).expect("two events");
        assert_eq!(
            (events[0].id, events[0].data, events[1].id, events[1].timestamp),
            (1, &[5, 6][..], 2, 77)
        );
        assert_eq!(parse_event(&packet(&event(0, 3, &[1, 2, 3]))).expect("one")[0].data, [1, 2, 3]);
        assert!(parse_event(&packet(&event(5, 3, &[]))).is_err(), "a size below its own header");
        assert!(parse_event(&packet(&event(60, 3, &[]))).is_err());
    }
}
