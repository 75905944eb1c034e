use thiserror::Error;

use crate::usb::{
    bytes::{u16_at, u32_at, u64_at},
    gencp::Status,
};

/// "U3VL".
pub(super) const LEADER: u32 = 0x4C56_3355;
/// "U3VT".
pub(super) const TRAILER: u32 = 0x5456_3355;

/// What precedes a frame (USB3 Vision 5.4.1 to 5.4.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Leader {
    /// The device's frame counter.
    pub block: u64,
    /// 1 image, 0x4001 image with chunks.
    pub payload_type: u16,
    /// The device's clock, ns or ticks.
    pub timestamp: u64,
    /// PFNC code.
    pub pixel_format: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Bytes between rows.
    pub padding_x: u16,
}

/// What follows a frame (USB3 Vision 5.4.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Trailer {
    /// The device's frame counter.
    pub block: u64,
    /// Whether the frame is whole.
    pub status: Status,
    /// Bytes of payload that count.
    pub valid: u64,
}

/// Bytes that are not a leader, or not a trailer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum StreamPacketError {
    /// It is the other one: a transfer was lost before it.
    #[error("a leader came where a trailer belongs, or the other way round")]
    OtherRole,
    /// It begins with neither magic.
    #[error("neither a leader nor a trailer, but {0:#010x}")]
    Magic(u32),
    /// It is too short.
    #[error("only {0} bytes")]
    Truncated(usize),
    /// It announces something other than an image.
    #[error("a payload of type {0:#06x}, which is no image")]
    PayloadType(u16),
}

fn magic(bytes: &[u8], wanted: u32, other: u32) -> Result<(), StreamPacketError> {
    match u32_at(bytes, 0) {
        Some(found) if found == wanted => Ok(()),
        Some(found) if found == other => Err(StreamPacketError::OtherRole),
        Some(found) => Err(StreamPacketError::Magic(found)),
        None => Err(StreamPacketError::Truncated(bytes.len())),
    }
}

/// Reads a leader of an image.
///
/// # Errors
/// [`StreamPacketError`].
pub fn parse_leader(bytes: &[u8]) -> Result<Leader, StreamPacketError> {
    magic(bytes, LEADER, TRAILER)?;
    let short = StreamPacketError::Truncated(bytes.len());
    let payload_type = u16_at(bytes, 18).ok_or(short)?;
    if !matches!(payload_type, 0x0001 | 0x4001) {
        return Err(StreamPacketError::PayloadType(payload_type));
    }
    let word = |at| u32_at(bytes, at).ok_or(short);
    Ok(Leader {
        block: u64_at(bytes, 8).ok_or(short)?,
        payload_type,
        timestamp: u64_at(bytes, 20).ok_or(short)?,
        pixel_format: word(28)?,
        width: word(32)?,
        height: word(36)?,
        x: word(40)?,
        y: word(44)?,
        padding_x: u16_at(bytes, 48).ok_or(short)?,
    })
}

/// Reads a trailer.
///
/// # Errors
/// [`StreamPacketError`].
pub fn parse_trailer(bytes: &[u8]) -> Result<Trailer, StreamPacketError> {
    magic(bytes, TRAILER, LEADER)?;
    let short = StreamPacketError::Truncated(bytes.len());
    Ok(Trailer {
        block: u64_at(bytes, 8).ok_or(short)?,
        status: Status::from_code(u16_at(bytes, 16).ok_or(short)?),
        valid: u64_at(bytes, 20).ok_or(short)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_cut_anywhere_are_errors_and_swapped_ones_are_known() {
        let mut leader = vec![0; 52];
        leader[..4].copy_from_slice(b"U3VL");
        leader[8] = 7;
        leader[18] = 1;
        leader[32] = 20;
        let parsed = parse_leader(&leader).expect("a leader");
        assert_eq!((parsed.block, parsed.width), (7, 20));
        assert!((0..50).all(|n| parse_leader(&leader[..n]).is_err()));
        assert_eq!(parse_trailer(&leader), Err(StreamPacketError::OtherRole));
        let mut trailer = vec![0; 32];
        trailer[..4].copy_from_slice(b"U3VT");
        trailer[17] = 0xA1;
        assert_eq!(parse_trailer(&trailer).map(|t| t.status), Ok(Status::DATA_DISCARDED));
        assert!((0..28).all(|n| parse_trailer(&trailer[..n]).is_err()));
        assert_eq!(parse_leader(&trailer), Err(StreamPacketError::OtherRole));
    }
}
