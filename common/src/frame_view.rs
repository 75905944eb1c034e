use thiserror::Error;

use crate::{pixel::PixelFormat, wire::FrameHeader};

/// A mosaic in memory, borrowed: what segmentation and board detection read.
#[derive(Debug, Clone, Copy)]
pub struct FrameView<'a> {
    bytes: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
    format: PixelFormat,
}

/// Bytes that do not fit the image size they claim.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum FrameViewError {
    /// The format is not one of 8-bit Bayer or Mono8.
    #[error(transparent)]
    Format(#[from] crate::pixel::PixelFormatError),
    /// The rows overlap, or the image is empty.
    #[error("an image of {width} × {height} px cannot have a row step of {stride} bytes")]
    Step {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Bytes from row to row.
        stride: usize,
    },
    /// There are fewer bytes than the size needs.
    #[error(
        "an image of {width} × {height} px with a row step of {stride} needs {needed} bytes, but has {found}"
    )]
    Truncated {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Bytes from row to row.
        stride: usize,
        /// Bytes needed.
        needed: usize,
        /// Bytes found.
        found: usize,
    },
}

impl<'a> FrameView<'a> {
    /// A view of `bytes` as an image.
    ///
    /// # Errors
    /// [`FrameViewError`] when the size, the step and the bytes do not fit.
    pub fn new(
        bytes: &'a [u8],
        (width, height): (usize, usize),
        stride: usize,
        format: PixelFormat,
    ) -> Result<Self, FrameViewError> {
        if stride < width || width == 0 || height == 0 {
            return Err(FrameViewError::Step { width, height, stride });
        }
        let needed = stride
            .checked_mul(height - 1)
            .and_then(|n| n.checked_add(width))
            .ok_or(FrameViewError::Step { width, height, stride })?;
        if bytes.len() < needed {
            return Err(FrameViewError::Truncated { width, height, stride, needed, found: bytes.len() });
        }
        Ok(Self { bytes, width, height, stride, format })
    }

    /// A view of a frame of the bus.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of(header: &FrameHeader, bytes: &'a [u8]) -> Result<Self, FrameViewError> {
        let format = PixelFormat::from_pfnc(header.pixel_format)?;
        Self::new(bytes, (header.width as usize, header.height as usize), header.stride as usize, format)
    }

    /// Columns.
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub const fn height(&self) -> usize {
        self.height
    }

    /// Bytes from one row to the next.
    pub const fn stride(&self) -> usize {
        self.stride
    }

    /// The pixel format.
    pub const fn format(&self) -> PixelFormat {
        self.format
    }

    /// All bytes, padding of rows included.
    pub const fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// The pixels of row `y`.
    pub fn row(&self, y: usize) -> &'a [u8] {
        &self.bytes[y * self.stride..y * self.stride + self.width]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_that_do_not_fit_are_refused_with_what_would() {
        let bytes = vec![0; 19];
        let view =
            FrameView::new(&bytes, (4, 4), 5, PixelFormat::BayerRG8).expect("the last row may end early");
        assert_eq!(view.row(3).len(), 4);
        let error = FrameView::new(&bytes, (5, 4), 5, PixelFormat::Mono8).expect_err("one byte short");
        assert!(error.to_string().contains("needs 20 bytes, but has 19"), "{error}");
        assert!(FrameView::new(&bytes, (6, 2), 5, PixelFormat::Mono8).is_err());
        assert!(FrameView::new(&bytes, (2, usize::MAX), usize::MAX, PixelFormat::Mono8).is_err());
    }
}
