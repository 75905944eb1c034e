//! The protobuf wire format (protobuf.dev, "Encoding"), as far as recordings need it: reading fields in
//! place, without a copy of a megabyte of pixels, and writing single fields.

use thiserror::Error;

/// Bytes that are no protobuf message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum ProtobufError {
    /// A field reaches past the end.
    #[error("the message ends in the middle of a field, at byte {0}")]
    Truncated(usize),
    /// A tag with a wire type that messages of today do not have.
    #[error("the byte {0} begins no protobuf field")]
    BadTag(usize),
}

/// The value of one field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Value<'a> {
    /// int32, int64, uint32, uint64, bool, enum.
    Varint(u64),
    /// fixed64, double.
    Fixed64(u64),
    /// fixed32, float.
    Fixed32(u32),
    /// string, bytes, messages, packed lists; with their place in the message.
    Bytes { bytes: &'a [u8], at: usize },
}

impl<'a> Value<'a> {
    /// An unsigned number, whichever width it was written in.
    pub(super) fn unsigned(self) -> Option<u64> {
        match self {
            Self::Varint(v) | Self::Fixed64(v) => Some(v),
            Self::Fixed32(v) => Some(u64::from(v)),
            Self::Bytes { .. } => None,
        }
    }

    pub(super) fn bytes(self) -> Option<&'a [u8]> {
        match self {
            Self::Bytes { bytes, .. } => Some(bytes),
            _ => None,
        }
    }
}

/// The fields of one message, in the order in which they stand.
#[derive(Debug, Clone)]
pub(super) struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Fields<'a> {
    pub(super) const fn of(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    fn varint(&mut self) -> Result<u64, ProtobufError> {
        let start = self.at;
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = *self.bytes.get(self.at).ok_or(ProtobufError::Truncated(start))?;
            self.at += 1;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(ProtobufError::BadTag(start))
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], ProtobufError> {
        let end = self.at.checked_add(count).filter(|end| *end <= self.bytes.len());
        let end = end.ok_or(ProtobufError::Truncated(self.at))?;
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn field(&mut self) -> Result<(u32, Value<'a>), ProtobufError> {
        let start = self.at;
        let tag = self.varint()?;
        let number = u32::try_from(tag >> 3).ok().filter(|n| *n > 0).ok_or(ProtobufError::BadTag(start))?;
        let value = match tag & 7 {
            0 => Value::Varint(self.varint()?),
            1 => Value::Fixed64(u64::from_le_bytes(self.take(8)?.try_into().expect("8 bytes"))),
            2 => {
                let length = self.varint()?;
                let length = usize::try_from(length).map_err(|_| ProtobufError::Truncated(start))?;
                let at = self.at;
                Value::Bytes { bytes: self.take(length)?, at }
            }
            5 => Value::Fixed32(u32::from_le_bytes(self.take(4)?.try_into().expect("4 bytes"))),
            _ => return Err(ProtobufError::BadTag(start)),
        };
        Ok((number, value))
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = Result<(u32, Value<'a>), ProtobufError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.at >= self.bytes.len() {
            return None;
        }
        let field = self.field();
        if field.is_err() {
            self.at = self.bytes.len();
        }
        Some(field)
    }
}

pub(super) fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push((value & 0x7f) as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

pub(super) fn put_tag(out: &mut Vec<u8>, number: u32, wire_type: u32) {
    put_varint(out, u64::from(number << 3 | wire_type));
}

pub(super) fn put_unsigned(out: &mut Vec<u8>, number: u32, value: u64) {
    if value != 0 {
        put_tag(out, number, 0);
        put_varint(out, value);
    }
}

pub(super) fn put_fixed32(out: &mut Vec<u8>, number: u32, value: u32) {
    if value != 0 {
        put_tag(out, number, 5);
        out.extend(value.to_le_bytes());
    }
}

pub(super) fn put_double(out: &mut Vec<u8>, number: u32, value: f64) {
    // By bits: −0 is not the default value.
    if value.to_bits() != 0 {
        put_tag(out, number, 1);
        out.extend(value.to_le_bytes());
    }
}

pub(super) fn put_bytes(out: &mut Vec<u8>, number: u32, bytes: &[u8]) {
    put_tag(out, number, 2);
    put_varint(out, bytes.len() as u64);
    out.extend(bytes);
}

/// A field of type `google.protobuf.Timestamp`.
pub(super) fn put_timestamp(out: &mut Vec<u8>, number: u32, ns: u64) {
    let mut inner = Vec::with_capacity(16);
    put_unsigned(&mut inner, 1, ns / 1_000_000_000);
    put_unsigned(&mut inner, 2, ns % 1_000_000_000);
    put_bytes(out, number, &inner);
}

/// The value of a `google.protobuf.Timestamp`, ns; `None` when it lies before 1970 or after 2554.
pub(super) fn timestamp_ns(bytes: &[u8]) -> Result<Option<u64>, ProtobufError> {
    let (mut seconds, mut nanos) = (0, 0);
    for field in Fields::of(bytes) {
        match field? {
            (1, Value::Varint(v)) => seconds = v,
            (2, Value::Varint(v)) => nanos = v,
            _ => {}
        }
    }
    // A negative number is a varint of 64 bits, and fails here.
    Ok(seconds
        .checked_mul(1_000_000_000)
        .filter(|_| nanos < 1_000_000_000)
        .and_then(|s| s.checked_add(nanos)))
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;

    #[test]
    fn what_prost_writes_is_read_and_what_is_written_prost_reads() {
        let calibration = foxglove::messages::CameraCalibration {
            width: 640,
            distortion_model: "plumb_bob".into(),
            d: vec![0.5, -0.25],
            ..Default::default()
        };
        let bytes = calibration.encode_to_vec();
        let fields = Fields::of(&bytes).collect::<Result<Vec<_>, _>>().expect("valid");
        assert_eq!(fields[0], (2, Value::Fixed32(640)));
        assert_eq!(fields[1].1.bytes(), Some(b"plumb_bob".as_slice()));

        let mut out = Vec::new();
        put_timestamp(&mut out, 1, 5_000_000_007);
        put_fixed32(&mut out, 2, 7);
        put_bytes(&mut out, 9, b"left");
        let read = foxglove::messages::CameraCalibration::decode(&*out).expect("valid");
        assert_eq!((read.width, read.frame_id.as_str()), (7, "left"));
        assert_eq!(read.timestamp.map(|t| t.total_nanos()), Some(5_000_000_007));
    }

    #[test]
    fn every_cut_and_every_garbled_byte_is_an_error_or_a_message_but_no_panic() {
        let mut out = Vec::new();
        put_timestamp(&mut out, 1, 5_000_000_007);
        put_bytes(&mut out, 6, &[1; 40]);
        put_double(&mut out, 3, 1.5);
        for end in 0..out.len() {
            let _ = Fields::of(&out[..end]).collect::<Result<Vec<_>, _>>();
        }
        assert!(Fields::of(&out[..out.len() - 1]).any(|f| f.is_err()));
        for at in 0..out.len() {
            for value in 0..=255 {
                let mut garbled = out.clone();
                garbled[at] = value;
                let _ = Fields::of(&garbled).collect::<Result<Vec<_>, _>>();
            }
        }
    }
}
