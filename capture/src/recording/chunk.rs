use std::{borrow::Cow, io::Read as _, ops::Range};

use super::file::Place;

/// A chunk of a recording, still packed (MCAP specification, "Chunk").
#[derive(Debug)]
pub(super) struct Packed {
    at: usize,
    compression: Compression,
    unpacked_bytes: usize,
    crc: u32,
    data: Range<usize>,
    cut_off: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Compression {
    None,
    Zstd,
    Lz4,
}

/// Fields before the compression's name: two times, the unpacked size, and its CRC.
const FIXED: usize = 8 + 8 + 8 + 4;

/// Most that a chunk may unpack to: a damaged size must not take all memory.
const MAX_UNPACKED: u64 = 4 << 30;

/// Memory that is taken on the word of a chunk's head alone.
const BELIEVED: usize = 64 << 20;

impl Packed {
    /// The chunk whose record begins at `at` and whose body is whole.
    pub(super) fn whole(file: &[u8], at: usize, body: &Range<usize>) -> Result<Self, String> {
        let packed = Self::parse(file, at, body.start, body.end)?;
        if packed.data.end > body.end {
            let (said, there) = (packed.data.len(), body.end.saturating_sub(packed.data.start));
            return Err(format!("it says that it holds {said} bytes, but its record has {there}"));
        }
        Ok(packed)
    }

    /// The chunk at `at` of a file that ends in its middle; `None` if that is no chunk, or not even its
    /// head is whole.
    pub(super) fn cut_off(file: &[u8], at: usize) -> Option<Self> {
        if *file.get(at)? != mcap::records::op::CHUNK {
            return None;
        }
        let mut packed = Self::parse(file, at, at + 9, file.len()).ok()?;
        packed.data.end = packed.data.end.min(file.len());
        packed.cut_off = true;
        Some(packed)
    }

    fn parse(file: &[u8], at: usize, start: usize, end: usize) -> Result<Self, String> {
        let body = file.get(start..end).unwrap_or_default();
        let short = || "its head is not whole".to_owned();
        let number = |at: usize| -> Result<u64, String> {
            let bytes = body.get(at..at + 8).ok_or_else(short)?;
            Ok(u64::from_le_bytes(bytes.try_into().expect("8 bytes")))
        };
        let half = |at: usize| -> Result<u32, String> {
            let bytes = body.get(at..at + 4).ok_or_else(short)?;
            Ok(u32::from_le_bytes(bytes.try_into().expect("4 bytes")))
        };
        let unpacked = number(16)?;
        let crc = half(24)?;
        let name_length = half(FIXED)? as usize;
        let name_at = FIXED + 4;
        let name = body.get(name_at..name_at.saturating_add(name_length)).ok_or_else(short)?;
        let compression = match name {
            b"" | b"none" => Compression::None,
            b"zstd" => Compression::Zstd,
            b"lz4" => Compression::Lz4,
            other => {
                let name = String::from_utf8_lossy(other);
                return Err(format!("compression {name:?} is not known; valid are zstd, lz4 and none"));
            }
        };
        let packed = number(name_at + name_length)?;
        let data = start + name_at + name_length + 8;
        if unpacked > MAX_UNPACKED {
            return Err(format!(
                "it says that it unpacks to {unpacked} bytes, more than any recording's chunk"
            ));
        }
        Ok(Self {
            at,
            compression,
            unpacked_bytes: usize::try_from(unpacked).map_err(|e| e.to_string())?,
            crc,
            data: data..data.saturating_add(usize::try_from(packed).map_err(|e| e.to_string())?),
            cut_off: false,
        })
    }

    /// Where the chunk's record begins.
    pub(super) const fn at(&self) -> usize {
        self.at
    }

    pub(super) const fn is_cut_off(&self) -> bool {
        self.cut_off
    }

    /// Where a part of the unpacked bytes lies.
    pub(super) fn place(&self, range: Range<usize>) -> Place {
        match self.compression {
            Compression::None => Place::File(self.data.start + range.start..self.data.start + range.end),
            _ => Place::Chunk { chunk: self.at as u64, range },
        }
    }

    /// The records of the chunk; of one that is cut off, as much as can be unpacked.
    pub(super) fn unpack<'a>(&self, file: &'a [u8]) -> Result<Cow<'a, [u8]>, String> {
        let data = &file[self.data.start.min(file.len())..self.data.end.min(file.len())];
        let read = |source: std::io::Result<Box<dyn std::io::Read + '_>>| -> Result<Vec<u8>, String> {
            let mut unpacked = Vec::with_capacity(self.unpacked_bytes.min(BELIEVED));
            let result = source
                .and_then(|source| source.take(self.unpacked_bytes as u64 + 1).read_to_end(&mut unpacked));
            match result {
                Err(_) if self.cut_off => Ok(unpacked),
                Err(e) => Err(format!("it cannot be unpacked: {e}")),
                Ok(_) => Ok(unpacked),
            }
        };
        let unpacked = match self.compression {
            // Not checked against its CRC: that would read every page of the file, which the visit of
            // an uncompressed recording need not.
            Compression::None => return Ok(Cow::Borrowed(data)),
            Compression::Zstd => {
                read(zstd::Decoder::with_buffer(data).map(|d| Box::new(d) as Box<dyn std::io::Read>))
            }
            Compression::Lz4 => read(lz4::Decoder::new(data).map(|d| Box::new(d) as Box<dyn std::io::Read>)),
        }?;
        if self.cut_off {
            return Ok(Cow::Owned(unpacked));
        }
        if unpacked.len() != self.unpacked_bytes {
            return Err(format!("it unpacks to {} bytes instead of {}", unpacked.len(), self.unpacked_bytes));
        }
        let crc = crc32fast::hash(&unpacked);
        if self.crc != 0 && crc != self.crc {
            return Err(format!("its CRC is {crc:08x}, but {:08x} is written with it", self.crc));
        }
        Ok(Cow::Owned(unpacked))
    }
}
