use thiserror::Error;

use super::{ExchangeError, PipeError};

/// A camera's register memory: what GenApi and the driver read and write.
pub trait Memory {
    /// Reads `out.len()` bytes from `address`.
    ///
    /// # Errors
    /// [`MemoryError`].
    fn read(&mut self, address: u64, out: &mut [u8]) -> Result<(), MemoryError>;

    /// Writes `data` to `address`; may be carried out twice where an acknowledge is lost.
    ///
    /// # Errors
    /// [`MemoryError`].
    fn write(&mut self, address: u64, data: &[u8]) -> Result<(), MemoryError>;

    /// Writes `data` to `address`, at most once.
    ///
    /// # Errors
    /// [`MemoryError`]; whether it was carried out is then not known.
    fn write_once(&mut self, address: u64, data: &[u8]) -> Result<(), MemoryError> {
        self.write(address, data)
    }
}

/// Why registers could not be read or written.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum MemoryError {
    /// The exchange failed.
    #[error("{doing} {length} bytes at {address:#x} failed")]
    Exchange {
        /// `reading` or `writing`.
        doing: &'static str,
        /// Where.
        address: u64,
        /// How many bytes.
        length: usize,
        /// Why.
        #[source]
        cause: ExchangeError,
    },
    /// The control endpoints failed.
    #[error("{doing} {length} bytes at {address:#x} failed on the way")]
    Pipe {
        /// `reading` or `writing`.
        doing: &'static str,
        /// Where.
        address: u64,
        /// How many bytes.
        length: usize,
        /// Why.
        #[source]
        cause: PipeError,
    },
    /// An address beyond the end of the address space.
    #[error("{length} bytes at {address:#x} lie beyond the end of the address space")]
    Range {
        /// Where.
        address: u64,
        /// How many bytes.
        length: usize,
    },
}

impl MemoryError {
    /// Whether the camera has gone.
    pub fn is_gone(&self) -> bool {
        matches!(self, Self::Pipe { cause: PipeError::Gone, .. })
    }
}

/// A little-endian register of 32 bits.
///
/// # Errors
/// [`MemoryError`].
pub fn read_u32(memory: &mut (impl Memory + ?Sized), address: u64) -> Result<u32, MemoryError> {
    let mut bytes = [0; 4];
    memory.read(address, &mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}

/// A little-endian register of 64 bits.
///
/// # Errors
/// [`MemoryError`].
pub fn read_u64(memory: &mut (impl Memory + ?Sized), address: u64) -> Result<u64, MemoryError> {
    let mut bytes = [0; 8];
    memory.read(address, &mut bytes)?;
    Ok(u64::from_le_bytes(bytes))
}

/// A text register of 64 bytes, up to its first zero.
///
/// # Errors
/// [`MemoryError`].
pub fn read_text(memory: &mut (impl Memory + ?Sized), address: u64) -> Result<String, MemoryError> {
    let mut bytes = [0; 64];
    memory.read(address, &mut bytes)?;
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    Ok(String::from_utf8_lossy(&bytes[..end]).into_owned())
}
