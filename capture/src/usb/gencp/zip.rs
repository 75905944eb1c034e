use miniz_oxide::inflate::decompress_slice_iter_to_slice;
use thiserror::Error;

use crate::usb::bytes::{u16_at, u32_at};

/// Largest description that is unpacked: the largest known ones have 5 MB, and a size that a device
/// claims must not take all memory.
const MOST: usize = 64 << 20;

/// A zip file that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum ZipError {
    /// A part of the file is missing or points outside.
    #[error("the zip file's {0} is missing or damaged")]
    Damaged(&'static str),
    /// Packed with a method other than `stored` and `deflate`.
    #[error("the zip file is packed with method {0}; only stored (0) and deflate (8) are known")]
    Method(u16),
    /// Claims to hold more than is sensible.
    #[error("the zip file claims to hold {0} bytes; at most {MOST} are unpacked")]
    TooLarge(usize),
    /// The unpacked bytes have another check sum.
    #[error("the zip file's content has the check sum {found:#010x} instead of {wanted:#010x}")]
    CheckSum {
        /// In the file.
        wanted: u32,
        /// Computed.
        found: u32,
    },
}

/// Unpacks the first entry of a zip file (APPNOTE 6.3.10, sections 4.3.12 and 4.3.16; the central
/// directory is what counts, as local headers may leave the sizes out).
///
/// # Errors
/// [`ZipError`].
pub fn unzip_single(bytes: &[u8]) -> Result<Vec<u8>, ZipError> {
    const END: [u8; 4] = [0x50, 0x4b, 5, 6];
    let end = bytes.windows(4).rposition(|w| w == END).ok_or(ZipError::Damaged("end record"))?;
    let place = |at| u32_at(bytes, at).and_then(|v| usize::try_from(v).ok());
    let entry = place(end + 16).ok_or(ZipError::Damaged("end record"))?;
    let directory = ZipError::Damaged("directory");
    if u32_at(bytes, entry) != Some(0x0201_4b50) {
        return Err(directory);
    }
    let (Some(method), Some(wanted), Some(packed), Some(size), Some(local)) = (
        u16_at(bytes, entry + 10),
        u32_at(bytes, entry + 16),
        place(entry + 20),
        place(entry + 24),
        place(entry + 42),
    ) else {
        return Err(directory);
    };
    if size > MOST {
        return Err(ZipError::TooLarge(size));
    }
    let local_header = ZipError::Damaged("entry");
    if u32_at(bytes, local) != Some(0x0403_4b50) {
        return Err(local_header);
    }
    let (Some(name), Some(extra)) = (u16_at(bytes, local + 26), u16_at(bytes, local + 28)) else {
        return Err(local_header);
    };
    let start = local + 30 + usize::from(name) + usize::from(extra);
    let data = start
        .checked_add(packed)
        .and_then(|stop| bytes.get(start..stop))
        .ok_or(ZipError::Damaged("content"))?;
    let content = match method {
        0 => data.to_vec(),
        8 => {
            let mut out = vec![0; size];
            let length = decompress_slice_iter_to_slice(&mut out, std::iter::once(data), false, true)
                .map_err(|_| ZipError::Damaged("packed content"))?;
            out.truncate(length);
            out
        }
        other => return Err(ZipError::Method(other)),
    };
    if content.len() != size {
        return Err(ZipError::Damaged("content"));
    }
    let found = crc32(&content);
    if found == wanted { Ok(content) } else { Err(ZipError::CheckSum { wanted, found }) }
}

/// The check sum of zip files (APPNOTE 4.4.7), bit by bit: a description is read once.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| (c >> 1) ^ (0xEDB8_8320 & (c & 1).wrapping_neg()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Made by Python's `zipfile`: one entry `a.xml`, deflated, 40 times `<a/>`.
    const PYTHON: &[u8] = include_bytes!("testdata/python-deflate.zip");

    #[test]
    fn a_file_of_another_program_is_unpacked_and_damage_is_found() {
        assert_eq!(unzip_single(PYTHON).expect("a zip file"), "<a/>".repeat(40).as_bytes());
        for cut in 0..PYTHON.len() {
            // The last two bytes are the length of a comment, which nobody reads.
            assert_eq!(unzip_single(&PYTHON[..cut]).is_err(), cut < PYTHON.len() - 2, "cut to {cut} bytes");
        }
        for bit in 0..PYTHON.len() * 8 {
            let mut bytes = PYTHON.to_vec();
            bytes[bit / 8] ^= 1 << (bit % 8);
            // Whatever is damaged, the content is the right one or refused.
            if let Ok(content) = unzip_single(&bytes) {
                assert_eq!(content, "<a/>".repeat(40).as_bytes());
            }
        }
    }

    #[test]
    fn the_check_sum_is_the_known_one() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }
}
