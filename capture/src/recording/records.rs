//! MCAP records as bytes (specification at mcap.dev/spec), as far as the writer needs them.

use std::collections::BTreeMap;

use mcap::records::op;

/// Bytes of a record's head: opcode and length.
pub(super) const HEAD: usize = 9;

/// A record under construction; its length is filled in at the end.
pub(super) struct Body<'a> {
    out: &'a mut Vec<u8>,
    start: usize,
}

impl<'a> Body<'a> {
    pub(super) fn begin(out: &'a mut Vec<u8>, opcode: u8) -> Self {
        let start = out.len();
        out.push(opcode);
        out.extend([0; 8]);
        Self { out, start }
    }

    pub(super) fn u8(self, value: u8) -> Self {
        self.out.push(value);
        self
    }

    pub(super) fn u16(self, value: u16) -> Self {
        self.out.extend(value.to_le_bytes());
        self
    }

    pub(super) fn u32(self, value: u32) -> Self {
        self.out.extend(value.to_le_bytes());
        self
    }

    pub(super) fn u64(self, value: u64) -> Self {
        self.out.extend(value.to_le_bytes());
        self
    }

    pub(super) fn raw(self, bytes: &[u8]) -> Self {
        self.out.extend(bytes);
        self
    }

    /// Bytes with their length, 32 bits, before them.
    pub(super) fn bytes(self, bytes: &[u8]) -> Self {
        self.u32(length(bytes.len())).raw(bytes)
    }

    pub(super) fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes())
    }

    pub(super) fn texts(self, map: &BTreeMap<String, String>) -> Self {
        let bytes = map.iter().map(|(k, v)| 8 + k.len() + v.len()).sum();
        map.iter().fold(self.u32(length(bytes)), |body, (k, v)| body.text(k).text(v))
    }

    pub(super) fn numbers(self, map: &BTreeMap<u16, u64>) -> Self {
        map.iter().fold(self.u32(length(10 * map.len())), |body, (k, v)| body.u16(*k).u64(*v))
    }

    /// Fills in the length; `more` bytes follow that are written elsewhere.
    pub(super) fn end(self, more: u64) {
        let there = (self.out.len() - self.start - HEAD) as u64 + more;
        self.out[self.start + 1..self.start + HEAD].copy_from_slice(&there.to_le_bytes());
    }
}

/// Lengths within records have 32 bits; nothing that is written here comes near.
fn length(bytes: usize) -> u32 {
    u32::try_from(bytes).expect("less than 4 GB")
}

/// What the index says of one chunk.
#[derive(Debug, Clone)]
pub(super) struct ChunkIndex {
    pub(super) first_ns: u64,
    pub(super) last_ns: u64,
    pub(super) at: u64,
    pub(super) length: u64,
    pub(super) indexes_at: BTreeMap<u16, u64>,
    pub(super) indexes_length: u64,
    pub(super) records_length: u64,
    pub(super) messages: BTreeMap<u16, u64>,
}

impl ChunkIndex {
    pub(super) fn write(&self, out: &mut Vec<u8>) {
        Body::begin(out, op::CHUNK_INDEX)
            .u64(self.first_ns)
            .u64(self.last_ns)
            .u64(self.at)
            .u64(self.length)
            .numbers(&self.indexes_at)
            .u64(self.indexes_length)
            .text("")
            .u64(self.records_length)
            .u64(self.records_length)
            .end(0);
    }
}
