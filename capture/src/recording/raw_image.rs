use std::ops::Range;

use netcord_common::{FrameView, PixelFormat};

use super::protobuf::{
    Fields, Value, put_bytes, put_fixed32, put_tag, put_timestamp, put_varint, timestamp_ns,
};

/// A `foxglove.RawImage`, its pixels left where they are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RawImage {
    /// Middle of the exposure, ns.
    pub timestamp_ns: u64,
    /// The frame of reference; ours is the camera's name.
    pub frame_id: String,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from one row to the next.
    pub step: u32,
    /// The mosaic.
    pub format: PixelFormat,
    /// Where in the message the pixels are.
    pub data: Range<usize>,
}

/// Field numbers of `foxglove.RawImage`.
mod field {
    pub(super) const TIMESTAMP: u32 = 1;
    pub(super) const WIDTH: u32 = 2;
    pub(super) const HEIGHT: u32 = 3;
    pub(super) const ENCODING: u32 = 4;
    pub(super) const STEP: u32 = 5;
    pub(super) const DATA: u32 = 6;
    pub(super) const FRAME_ID: u32 = 7;
}

impl RawImage {
    /// Reads a message; the sentence of an error says what is wrong with it and what would be right.
    ///
    /// # Errors
    /// When it is no protobuf message, its encoding is not one of a mosaic, or size, step and pixels do
    /// not fit each other.
    pub fn parse(message: &[u8]) -> Result<Self, String> {
        let (mut stamp, mut frame_id, mut encoding) = (None, "", "");
        let (mut width, mut height, mut step, mut pixels) = (0, 0, 0, 0..0);
        let text = |bytes| std::str::from_utf8(bytes).map_err(|_| "a text in it is no UTF-8".to_owned());
        let number = |what: &str, value: Value<'_>| {
            let number = value.unsigned().and_then(|v| u32::try_from(v).ok());
            number.ok_or_else(|| format!("its {what} is no number of 32 bits"))
        };
        for part in Fields::of(message) {
            match part.map_err(|e| format!("it is no foxglove.RawImage: {e}"))? {
                (field::TIMESTAMP, Value::Bytes { bytes, .. }) => {
                    stamp = timestamp_ns(bytes).map_err(|e| format!("its timestamp is damaged: {e}"))?;
                    if stamp.is_none() {
                        return Err("its timestamp lies outside 1970–2554".into());
                    }
                }
                (field::WIDTH, value) => width = number("width", value)?,
                (field::HEIGHT, value) => height = number("height", value)?,
                (field::STEP, value) => step = number("step", value)?,
                (field::ENCODING, Value::Bytes { bytes, .. }) => encoding = text(bytes)?,
                (field::FRAME_ID, Value::Bytes { bytes, .. }) => frame_id = text(bytes)?,
                (field::DATA, Value::Bytes { bytes, at }) => pixels = at..at + bytes.len(),
                _ => {}
            }
        }
        let format = PixelFormat::from_encoding(encoding).map_err(|_| {
            format!(
                "its encoding is {encoding:?}; valid are bayer_rggb8, bayer_bggr8, bayer_gbrg8, bayer_grbg8 and mono8"
            )
        })?;
        FrameView::new(&message[pixels.clone()], (width as usize, height as usize), step as usize, format)
            .map_err(|e| e.to_string())?;
        Ok(Self {
            timestamp_ns: stamp.ok_or("it has no timestamp: the middle of its exposure is needed")?,
            frame_id: frame_id.to_owned(),
            width,
            height,
            step,
            format,
            data: pixels,
        })
    }

    /// All of the message that stands before the pixels, which are to follow: `data.len()` of them.
    pub fn head(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(96);
        put_timestamp(&mut out, field::TIMESTAMP, self.timestamp_ns);
        put_fixed32(&mut out, field::WIDTH, self.width);
        put_fixed32(&mut out, field::HEIGHT, self.height);
        put_bytes(&mut out, field::ENCODING, self.format.encoding().as_bytes());
        put_fixed32(&mut out, field::STEP, self.step);
        put_bytes(&mut out, field::FRAME_ID, self.frame_id.as_bytes());
        put_tag(&mut out, field::DATA, 2);
        put_varint(&mut out, self.data.len() as u64);
        out
    }
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;

    fn message() -> foxglove::messages::RawImage {
        foxglove::messages::RawImage {
            timestamp: Some(foxglove::messages::Timestamp::new(7, 123_456_789)),
            frame_id: "left".into(),
            width: 4,
            height: 3,
            encoding: "bayer_gbrg8".into(),
            step: 6,
            data: (0..18).collect::<Vec<u8>>().into(),
        }
    }

    #[test]
    fn messages_of_another_writer_are_read_in_place_and_ours_are_the_same_to_another_reader() {
        let theirs = message();
        let bytes = theirs.encode_to_vec();
        let image = RawImage::parse(&bytes).expect("valid");
        assert_eq!((image.timestamp_ns, image.step, image.format), (7_123_456_789, 6, PixelFormat::BayerGB8));
        assert_eq!(bytes[image.data.clone()], theirs.data[..]);
        let mut ours = image.head();
        ours.extend(&theirs.data);
        assert_eq!(foxglove::messages::RawImage::decode(&*ours).expect("valid"), theirs);
    }

    #[test]
    fn what_does_not_fit_is_named() {
        type Change = fn(&mut foxglove::messages::RawImage);
        let cases: [(Change, &str); 6] = [
            (|m| m.encoding = "rgb8".into(), "its encoding is \"rgb8\"; valid are bayer_rggb8"),
            (|m| m.step = 3, "step"),
            (|m| m.height = 4, "needs 22 bytes, but has 18"),
            (|m| m.width = 0, "0"),
            (|m| m.timestamp = None, "no timestamp"),
            (|m| m.data = Vec::new().into(), "has 0"),
        ];
        for (change, expected) in cases {
            let mut wrong = message();
            change(&mut wrong);
            let error = RawImage::parse(&wrong.encode_to_vec()).expect_err(expected);
            assert!(error.contains(expected), "{error}");
        }
        let bytes = message().encode_to_vec();
        let pixels = RawImage::parse(&bytes).expect("valid").data;
        for end in 0..pixels.end {
            assert!(RawImage::parse(&bytes[..end]).is_err(), "cut at {end}");
        }
    }
}
