//! Pictures in files: PNG and JPEG are read, PNG is written. Eight bits a channel, grey or colour.

mod decode;
mod error;

use std::{fs, path::Path};

pub use error::PictureError;

/// A picture in memory: rows from the top, without padding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    size: (usize, usize),
    channels: Channels,
    bytes: Vec<u8>,
}

/// What a pixel of a [`Picture`] holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channels {
    /// One byte: luma after Rec. 601, as JPEG's and OpenCV's.
    Grey,
    /// Three bytes: red, green, blue.
    Rgb,
}

impl Channels {
    /// Bytes a pixel.
    #[must_use]
    pub fn count(self) -> usize {
        match self {
            Self::Grey => 1,
            Self::Rgb => 3,
        }
    }
}

/// How hard [`Picture::to_png`] tries to write few bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// Somebody waits for it.
    Quick,
    /// It is kept or sent.
    Small,
}

impl Picture {
    /// A picture of `size` (columns, rows) px; `None` where `bytes` do not fill it exactly, or it has no pixel.
    #[must_use]
    pub fn new(size: (usize, usize), channels: Channels, bytes: Vec<u8>) -> Option<Self> {
        let needed = size.0.checked_mul(size.1)?.checked_mul(channels.count())?;
        (needed > 0 && needed == bytes.len()).then_some(Self { size, channels, bytes })
    }

    /// A colour picture of `size` px, of which `pixel` tells each (column, row).
    #[must_use]
    pub fn rgb_from(size: (usize, usize), pixel: impl Fn(usize, usize) -> [u8; 3]) -> Self {
        let pixel = &pixel;
        let bytes = (0..size.1).flat_map(|y| (0..size.0).flat_map(move |x| pixel(x, y))).collect();
        Self { size, channels: Channels::Rgb, bytes }
    }

    /// Reads a file as `channels`, whatever it holds; which of the two formats it is, its first bytes tell.
    ///
    /// # Errors
    /// [`PictureError`] names the file and what is wrong with it.
    pub fn read(path: &Path, channels: Channels) -> Result<Self, PictureError> {
        let file = |source| PictureError::Read { path: path.to_owned(), source };
        decode::decode(&fs::read(path).map_err(file)?, channels)
            .map_err(|cause| PictureError::Undecodable { path: path.to_owned(), cause })
    }

    /// Columns, px.
    #[must_use]
    pub fn width(&self) -> usize {
        self.size.0
    }

    /// Rows, px.
    #[must_use]
    pub fn height(&self) -> usize {
        self.size.1
    }

    /// The bytes of pixel (x, y).
    ///
    /// # Panics
    /// Where there is no such pixel.
    #[must_use]
    pub fn pixel(&self, x: usize, y: usize) -> &[u8] {
        let count = self.channels.count();
        let start = (y * self.size.0 + x) * count;
        &self.bytes[start..start + count]
    }

    /// All bytes, row by row.
    #[must_use]
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// The picture as a PNG file.
    ///
    /// # Errors
    /// [`PictureError::Encode`]: larger than PNG allows.
    pub fn to_png(&self, effort: Effort) -> Result<Vec<u8>, PictureError> {
        let colour = match self.channels {
            Channels::Grey => png::ColorType::Grayscale,
            Channels::Rgb => png::ColorType::Rgb,
        };
        let [width, height] = [self.size.0, self.size.1].map(|n| u32::try_from(n).unwrap_or(u32::MAX));
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, width, height);
        encoder.set_color(colour);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(match effort {
            Effort::Quick => png::Compression::Fast,
            Effort::Small => png::Compression::Balanced,
        });
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.bytes)?;
        writer.finish()?;
        Ok(file)
    }

    /// Writes the picture as PNG.
    ///
    /// # Errors
    /// [`PictureError`] names the file.
    pub fn write_png(&self, path: &Path, effort: Effort) -> Result<(), PictureError> {
        fs::write(path, self.to_png(effort)?)
            .map_err(|source| PictureError::Write { path: path.to_owned(), source })
    }
}

#[cfg(test)]
mod tests;
