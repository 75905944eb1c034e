//! Pixel formats by their GenICam PFNC codes, and the colour that each pixel of a mosaic sees.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use thiserror::Error;

/// The colour that one pixel of a mosaic measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Channel {
    /// Behind a red filter.
    Red,
    /// Behind a green filter.
    Green,
    /// Behind a blue filter.
    Blue,
    /// Without a filter.
    Luma,
}

/// An 8-bit format of raw frames. The name gives the first two pixels of the first row, as PFNC
/// (Pixel Format Naming Convention 2.4) does; OpenCV calls the same mosaics differently.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum PixelFormat {
    /// Grey.
    Mono8 = 0x0108_0001,
    /// First row G R G R, second B G B G.
    BayerGR8 = 0x0108_0008,
    /// First row R G R G, second G B G B.
    BayerRG8 = 0x0108_0009,
    /// First row G B G B, second R G R G.
    BayerGB8 = 0x0108_000A,
    /// First row B G B G, second G R G R.
    BayerBG8 = 0x0108_000B,
}

/// A pixel format that frames cannot have.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("pixel format {0} is not supported; supported are Mono8, BayerRG8, BayerBG8, BayerGB8 and BayerGR8")]
pub struct PixelFormatError(String);

impl PixelFormat {
    /// All supported formats.
    pub const ALL: [Self; 5] = [Self::Mono8, Self::BayerGR8, Self::BayerRG8, Self::BayerGB8, Self::BayerBG8];

    /// The PFNC code.
    pub const fn pfnc(self) -> u32 {
        self as u32
    }

    /// The format of a PFNC code.
    ///
    /// # Errors
    /// [`PixelFormatError`] for every other code.
    pub fn from_pfnc(code: u32) -> Result<Self, PixelFormatError> {
        Self::ALL
            .into_iter()
            .find(|f| f.pfnc() == code)
            .ok_or_else(|| PixelFormatError(format!("with PFNC code {code:#010x}")))
    }

    /// The PFNC name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mono8 => "Mono8",
            Self::BayerGR8 => "BayerGR8",
            Self::BayerRG8 => "BayerRG8",
            Self::BayerGB8 => "BayerGB8",
            Self::BayerBG8 => "BayerBG8",
        }
    }

    /// The `encoding` of `foxglove.RawImage` and of ROS images.
    pub const fn encoding(self) -> &'static str {
        match self {
            Self::Mono8 => "mono8",
            Self::BayerGR8 => "bayer_grbg8",
            Self::BayerRG8 => "bayer_rggb8",
            Self::BayerGB8 => "bayer_gbrg8",
            Self::BayerBG8 => "bayer_bggr8",
        }
    }

    /// The format that `encoding` names.
    ///
    /// # Errors
    /// [`PixelFormatError`] for every other encoding.
    pub fn from_encoding(encoding: &str) -> Result<Self, PixelFormatError> {
        Self::ALL
            .into_iter()
            .find(|f| f.encoding() == encoding)
            .ok_or_else(|| PixelFormatError(format!("{encoding:?}")))
    }

    /// The place (x, y), each 0 or 1, of the red pixel in the 2 × 2 cell; `None` for grey.
    pub const fn red_at(self) -> Option<(usize, usize)> {
        match self {
            Self::Mono8 => None,
            Self::BayerRG8 => Some((0, 0)),
            Self::BayerGR8 => Some((1, 0)),
            Self::BayerGB8 => Some((0, 1)),
            Self::BayerBG8 => Some((1, 1)),
        }
    }

    /// What the pixel in column `x` and row `y` measures.
    pub const fn channel_at(self, x: usize, y: usize) -> Channel {
        let Some((rx, ry)) = self.red_at() else { return Channel::Luma };
        match ((x ^ rx) & 1, (y ^ ry) & 1) {
            (0, 0) => Channel::Red,
            (1, 1) => Channel::Blue,
            _ => Channel::Green,
        }
    }
}

impl fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for PixelFormat {
    type Err = PixelFormatError;

    fn from_str(name: &str) -> Result<Self, PixelFormatError> {
        Self::ALL.into_iter().find(|f| f.name() == name).ok_or_else(|| PixelFormatError(format!("{name:?}")))
    }
}

impl Serialize for PixelFormat {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for PixelFormat {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_give_the_first_two_pixels_of_the_first_row() {
        for format in PixelFormat::ALL {
            let letter = |x, y| match format.channel_at(x, y) {
                Channel::Red => 'R',
                Channel::Green => 'G',
                Channel::Blue => 'B',
                Channel::Luma => 'L',
            };
            if format == PixelFormat::Mono8 {
                assert_eq!(letter(3, 4), 'L');
                continue;
            }
            let row = format!("Bayer{}{}8", letter(0, 0), letter(1, 0));
            assert_eq!(row, format.name());
            let cell = [letter(0, 0), letter(1, 0), letter(0, 1), letter(1, 1)].iter().collect::<String>();
            assert_eq!(format!("bayer_{}8", cell.to_lowercase()), format.encoding());
            assert_eq!(letter(0, 0), letter(6, 8));
        }
    }

    #[test]
    fn codes_names_and_encodings_round_trip_and_others_are_named_in_the_error() {
        for format in PixelFormat::ALL {
            assert_eq!(PixelFormat::from_pfnc(format.pfnc()), Ok(format));
            assert_eq!(PixelFormat::from_encoding(format.encoding()), Ok(format));
            assert_eq!(format.name().parse(), Ok(format));
        }
        let error = PixelFormat::from_encoding("rgb8").expect_err("not raw");
        assert!(error.to_string().contains("rgb8"));
    }
}
