use std::io::Cursor;

use zune_jpeg::{
    JpegDecoder,
    zune_core::{colorspace::ColorSpace, options::DecoderOptions},
};

use super::{Channels, Picture};

/// The first bytes of a PNG file (its specification, 5.2).
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
/// The first bytes of a JPEG file: start of image, and the next marker's first byte (ITU-T T.81, B.1.1).
const JPEG: &[u8] = b"\xff\xd8\xff";
/// What a JPEG file's scans begin with, and what follows the last one: start of scan, end of image (B.1.1.3). In a
/// scan's data neither occurs.
const SCAN: [u8; 2] = [0xff, 0xda];
const END: [u8; 2] = [0xff, 0xd9];
/// No side of a JPEG file can be longer; the decoder's own bound is lower.
const LONGEST_PX: usize = u16::MAX as usize;

pub(super) fn decode(file: &[u8], wanted: Channels) -> Result<Picture, String> {
    if file.starts_with(PNG) {
        png(file, wanted).map_err(|e| e.to_string())?.ok_or_else(|| "the PNG file has no pixels".into())
    } else if file.starts_with(JPEG) {
        jpeg(file, wanted)
    } else {
        Err("it begins neither as PNG nor as JPEG does".into())
    }
}

fn png(file: &[u8], wanted: Channels) -> Result<Option<Picture>, png::DecodingError> {
    let mut decoder = png::Decoder::new(Cursor::new(file));
    // Palettes and fewer bits become 8 bits, 16 become 8.
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info()?;
    let Some(length) = reader.output_buffer_size() else { return Ok(None) };
    let mut bytes = vec![0; length];
    let info = reader.next_frame(&mut bytes)?;
    bytes.truncate(info.buffer_size());
    let colour = |p: &[u8]| match wanted {
        Channels::Grey => [luma([p[0], p[1], p[2]]); 3],
        Channels::Rgb => [p[0], p[1], p[2]],
    };
    let count = wanted.count();
    let grey =
        |step: usize| bytes.iter().step_by(step).flat_map(|v| [*v; 3].into_iter().take(count)).collect();
    let coloured =
        |step: usize| bytes.chunks_exact(step).flat_map(|p| colour(p).into_iter().take(count)).collect();
    // What is transparent is taken as it is, without a background.
    let bytes = match info.color_type {
        png::ColorType::Grayscale => grey(1),
        png::ColorType::GrayscaleAlpha => grey(2),
        png::ColorType::Rgb | png::ColorType::Indexed => coloured(3),
        png::ColorType::Rgba => coloured(4),
    };
    Ok(Picture::new((info.width as usize, info.height as usize), wanted, bytes))
}

/// Rec. 601 with 16 fractional bits.
fn luma([r, g, b]: [u8; 3]) -> u8 {
    let sum = 19_595 * u32::from(r) + 38_470 * u32::from(g) + 7_471 * u32::from(b);
    ((sum + (1 << 15)) >> 16) as u8
}

fn jpeg(file: &[u8], wanted: Channels) -> Result<Picture, String> {
    let out = match wanted {
        Channels::Grey => ColorSpace::Luma,
        Channels::Rgb => ColorSpace::RGB,
    };
    let options = DecoderOptions::default()
        .set_max_width(LONGEST_PX)
        .set_max_height(LONGEST_PX)
        .jpeg_set_out_colorspace(out);
    let mut decoder = JpegDecoder::new_with_options(Cursor::new(file), options);
    let bytes = decoder.decode().map_err(|e| e.to_string())?;
    // The decoder fills with grey what is missing.
    let scan = file.windows(2).rposition(|marker| marker == SCAN).unwrap_or(0);
    if !file[scan..].windows(2).any(|marker| marker == END) {
        return Err("the JPEG file is cut off: its last scan does not end".into());
    }
    let size = decoder.dimensions().ok_or("the JPEG file has no size")?;
    Picture::new(size, wanted, bytes)
        .ok_or_else(|| format!("the JPEG file does not hold {} × {} px of its kind", size.0, size.1))
}
