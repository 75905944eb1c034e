use sha1::{Digest, Sha1};
use thiserror::Error;

use super::{Memory, MemoryError, ZipError, read_u64, unzip_single};
use crate::usb::bytes::{u32_at, u64_at};

/// Bytes of one entry (GenCP 5.4).
const ENTRY: usize = 64;
/// Devices have one to three entries; more than this is not read.
const MOST_ENTRIES: u64 = 32;
/// Largest description file: known ones have up to 4 MB unpacked. A kilobyte takes a round trip, so that a
/// damaged size must not make the driver read for minutes.
const MOST_BYTES: u64 = 8 << 20;

/// A file that the device holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ManifestEntry {
    /// Version of the file: major, minor, subminor.
    pub version: (u8, u8, u16),
    /// Whether it describes the device (and not buffers).
    pub is_device: bool,
    /// Whether it is packed.
    pub is_zip: bool,
    /// Where it lies.
    pub address: u64,
    /// Bytes.
    pub size: u64,
    /// SHA-1 of the file as it lies there; `None` where the device gives none.
    pub hash: Option<[u8; 20]>,
}

/// The list of the device's description files.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Manifest {
    /// In the device's order.
    pub entries: Vec<ManifestEntry>,
}

/// Why a camera's description could not be had.
#[derive(Debug, Error)]
pub enum DescriptionError {
    /// The device could not be read.
    #[error("the camera's description cannot be read")]
    Memory(#[from] MemoryError),
    /// There is none.
    #[error("the camera's manifest has {entries} entries, and none describes the device")]
    NoEntry {
        /// How many there are.
        entries: usize,
    },
    /// A size that cannot be right.
    #[error("the camera claims a description of {size} bytes; at most {MOST_BYTES} are read")]
    Size {
        /// What it claims.
        size: u64,
    },
    /// The bytes are not those that the manifest promises.
    #[error(
        "the camera's description has another SHA-1 than its manifest says: it was read wrongly, or is damaged"
    )]
    Hash,
    /// It is packed, and cannot be unpacked.
    #[error("the camera's description cannot be unpacked")]
    Zip(#[from] ZipError),
    /// It is not text.
    #[error("the camera's description is not UTF-8 text (byte {at})")]
    Text {
        /// Where.
        at: usize,
    },
}

impl Manifest {
    /// Reads the entries' bytes, those after the count.
    pub fn parse(bytes: &[u8]) -> Self {
        let entries = bytes
            .chunks_exact(ENTRY)
            .filter_map(|entry| {
                let (version, info) = (u32_at(entry, 0)?, u32_at(entry, 4)?);
                let hash: [u8; 20] = entry.get(24..44)?.try_into().ok()?;
                let [low, high, minor, major] = version.to_le_bytes();
                Some(ManifestEntry {
                    version: (major, minor, u16::from_le_bytes([low, high])),
                    is_device: info & 7 == 0,
                    is_zip: (info >> 10) & 0x3f == 1,
                    address: u64_at(entry, 8)?,
                    size: u64_at(entry, 16)?,
                    hash: (hash != [0; 20]).then_some(hash),
                })
            })
            .collect();
        Self { entries }
    }

    /// Reads the manifest at `address`.
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn read(memory: &mut (impl Memory + ?Sized), address: u64) -> Result<Self, MemoryError> {
        let count = read_u64(memory, address)?.min(MOST_ENTRIES);
        let mut bytes = vec![0; ENTRY * usize::try_from(count).unwrap_or(0)];
        memory.read(address.wrapping_add(8), &mut bytes)?;
        Ok(Self::parse(&bytes))
    }

    /// The newest description of the device; of equals the first.
    pub fn device(&self) -> Option<&ManifestEntry> {
        self.entries.iter().filter(|e| e.is_device).rev().max_by_key(|e| e.version)
    }
}

/// Reads, checks and unpacks the newest description of the device.
///
/// # Errors
/// [`DescriptionError`].
pub fn read_description(
    memory: &mut (impl Memory + ?Sized),
    manifest: u64,
) -> Result<String, DescriptionError> {
    let manifest = Manifest::read(memory, manifest)?;
    let entry = manifest.device().ok_or(DescriptionError::NoEntry { entries: manifest.entries.len() })?;
    if entry.size > MOST_BYTES {
        return Err(DescriptionError::Size { size: entry.size });
    }
    let mut bytes =
        vec![0; usize::try_from(entry.size).map_err(|_| DescriptionError::Size { size: entry.size })?];
    memory.read(entry.address, &mut bytes)?;
    if entry.hash.is_some_and(|hash| Sha1::digest(&bytes).as_slice() != hash) {
        return Err(DescriptionError::Hash);
    }
    let text = if entry.is_zip { unzip_single(&bytes)? } else { bytes };
    String::from_utf8(text).map_err(|e| DescriptionError::Text { at: e.utf8_error().valid_up_to() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_device_entry_counts() {
        let entry = |major: u8, info: u32, address: u64| {
            let mut b = vec![3, 0, 2, major];
            b.extend(info.to_le_bytes());
            b.extend(address.to_le_bytes());
            b.extend(9_u64.to_le_bytes());
            b.extend([0; 40]);
            b
        };
        let bytes = [entry(1, 0, 100), entry(3, 1, 200), entry(2, 1 << 10, 300), entry(2, 0, 400)].concat();
        let manifest = Manifest::parse(&bytes);
        let newest = manifest.device().expect("there are three");
        assert_eq!((newest.address, newest.is_zip, newest.version), (300, true, (2, 2, 3)));
        assert_eq!(newest.hash, None);
        assert_eq!(Manifest::parse(&bytes[..63]).device(), None);
    }
}
