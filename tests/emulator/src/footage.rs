//! Pictures from a file, so that the cameras see one scene: `NCFOOTAG`, then cameras, frames, width and
//! height as u32 (little-endian), then the frames of 8-bit pixels, all of camera 0 first.

use std::{
    fs::File,
    io::{self, Read, Write},
    os::unix::fs::FileExt,
    path::Path,
    sync::{Arc, Mutex, PoisonError},
};

use crate::{ImageSource, Shot};

const MAGIC: &[u8; 8] = b"NCFOOTAG";
const HEAD: u64 = 24;

/// Exposures that lie this near show the same frame, ns.
const TOGETHER_NS: u64 = 2_000_000;

/// The size of footage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FootageSize {
    /// Cameras.
    pub cameras: u32,
    /// Frames of each.
    pub frames: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Begins a file of footage; the frames follow as they are.
///
/// # Errors
/// Those of writing.
pub fn begin(out: &mut impl Write, size: FootageSize) -> io::Result<()> {
    out.write_all(MAGIC)?;
    [size.cameras, size.frames, size.width, size.height]
        .iter()
        .try_for_each(|field| out.write_all(&field.to_le_bytes()))
}

/// What all cameras see. Camera 0 leads: its block n shows frame n, round and round, and another camera
/// that exposes at the same instant shows the same frame.
#[derive(Debug, Clone)]
pub struct Footage {
    file: Arc<File>,
    size: FootageSize,
    leader: Arc<Mutex<Option<Shot>>>,
}

impl Footage {
    /// Opens a file.
    ///
    /// # Errors
    /// Those of reading, and `InvalidData` for another kind of file, or one that is too short.
    pub fn open(path: &Path) -> io::Result<Self> {
        let mut file = File::open(path)?;
        let mut head = [0; HEAD as usize];
        file.read_exact(&mut head)?;
        let field = |n: usize| {
            head.get(8 + 4 * n..12 + 4 * n).and_then(|b| b.try_into().ok()).map_or(0, u32::from_le_bytes)
        };
        let size = FootageSize { cameras: field(0), frames: field(1), width: field(2), height: field(3) };
        let bytes = [size.cameras, size.frames, size.width, size.height]
            .iter()
            .try_fold(1_u64, |product, factor| product.checked_mul((*factor).into()));
        if &head[..8] != MAGIC
            || bytes.is_none_or(|b| b == 0 || file.metadata().is_ok_and(|m| m.len() < HEAD + b))
        {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "it is not footage, or not all of it"));
        }
        Ok(Self { file: Arc::new(file), size, leader: Arc::new(Mutex::new(None)) })
    }

    /// Its size.
    pub const fn size(&self) -> FootageSize {
        self.size
    }

    /// What camera `index` sees.
    pub fn images(&self, index: u32) -> Box<dyn ImageSource> {
        Box::new(FootageImages { footage: self.clone(), camera: index % self.size.cameras })
    }
}

struct FootageImages {
    footage: Footage,
    camera: u32,
}

impl ImageSource for FootageImages {
    fn picture(&mut self, shot: &Shot) -> Vec<u8> {
        let Footage { file, size, leader } = &self.footage;
        let block = {
            let mut leader = leader.lock().unwrap_or_else(PoisonError::into_inner);
            if self.camera == 0 {
                *leader = Some(*shot);
            }
            leader
                .filter(|l| l.mid_ns.abs_diff(shot.mid_ns) < TOGETHER_NS)
                .map_or(shot.block, |leader| leader.block)
        };
        let frame = u64::from(self.camera) * u64::from(size.frames) + block % u64::from(size.frames);
        let (x, y, width, height) = shot.region;
        let mut picture = vec![0; width as usize * height as usize];
        // A region beyond the footage stays black.
        let seen = size.width.saturating_sub(x).min(width) as usize;
        let rows = size.height.saturating_sub(y).min(height);
        for (row, out) in picture.chunks_mut((width as usize).max(1)).take(rows as usize).enumerate() {
            let line = frame * u64::from(size.height) + u64::from(y) + row as u64;
            let at = HEAD + line * u64::from(size.width) + u64::from(x);
            // What cannot be read stays black too: a camera does not fail for its picture.
            let _ = file.read_exact_at(&mut out[..seen], at);
        }
        picture
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_show_the_leaders_frame_and_their_own_region_of_it() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let path = file.path();
        let size = FootageSize { cameras: 2, frames: 3, width: 4, height: 2 };
        let mut bytes = Vec::new();
        begin(&mut bytes, size).expect("memory");
        bytes.extend(0..48_u8);
        std::fs::write(path, &bytes).expect("written");
        let footage = Footage::open(path).expect("footage");
        let shot =
            |block, mid_ns, region| Shot { block, mid_ns, exposure_ns: 1, region, pixel_format: 0x0108_0009 };
        let (mut left, mut right) = (footage.images(0), footage.images(1));
        assert_eq!(left.picture(&shot(4, 10_000_000, (0, 0, 4, 2))), (8..16).collect::<Vec<u8>>());
        // The right camera counts otherwise, but exposes with the left one.
        assert_eq!(right.picture(&shot(0, 10_300_000, (2, 1, 2, 1))), [38, 39]);
        assert_eq!(right.picture(&shot(0, 90_000_000, (0, 0, 2, 1))), [24, 25]);
        std::fs::write(path, &bytes[..60]).expect("written");
        assert!(Footage::open(path).is_err());
    }
}
