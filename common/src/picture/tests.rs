use std::io::Cursor;

use image::{DynamicImage, GrayImage, ImageFormat, RgbImage, RgbaImage};

use super::*;

/// A slope in each channel, in an odd size, as another library would hold it.
fn scene() -> RgbImage {
    RgbImage::from_fn(37, 21, |x, y| image::Rgb([(x * 6) as u8, (y * 11) as u8, ((x + y) * 4) as u8]))
}

fn read(bytes: &[u8], channels: Channels) -> Result<Picture, PictureError> {
    let file = tempfile::NamedTempFile::new().expect("a file");
    fs::write(file.path(), bytes).expect("written");
    Picture::read(file.path(), channels)
}

fn encoded(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).expect("encodes");
    bytes.into_inner()
}

fn rec601(picture: &RgbImage) -> Vec<u8> {
    let luma =
        |p: &image::Rgb<u8>| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2]);
    picture.pixels().map(|p| luma(p).round() as u8).collect()
}

fn largest_difference(a: &[u8], b: &[u8]) -> u8 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
}

#[test]
fn a_png_of_another_library_gives_its_pixels() {
    let rgb = scene();
    let grey = GrayImage::from_fn(5, 3, |x, y| image::Luma([(40 * x + y) as u8]));
    let clear = RgbaImage::from_fn(5, 3, |x, y| image::Rgba([x as u8, y as u8, 9, 128]));
    let deep = DynamicImage::ImageRgb8(rgb.clone()).into_rgb16();

    let png = |picture: DynamicImage| encoded(&picture, ImageFormat::Png);
    let seen = read(&png(rgb.clone().into()), Channels::Rgb).expect("reads");
    assert_eq!((seen.width(), seen.height()), (37, 21));
    assert_eq!(seen.pixel(5, 2), [30, 22, 28]);
    assert_eq!(seen.into_bytes(), rgb.as_raw()[..]);
    assert_eq!(read(&png(deep.into()), Channels::Rgb).expect("reads").into_bytes(), rgb.as_raw()[..]);
    let luma = read(&png(rgb.clone().into()), Channels::Grey).expect("reads").into_bytes();
    assert!(largest_difference(&luma, &rec601(&rgb)) <= 1);
    assert_eq!(
        read(&png(grey.clone().into()), Channels::Grey).expect("reads").into_bytes(),
        grey.as_raw()[..]
    );
    assert_eq!(read(&png(grey.into()), Channels::Rgb).expect("reads").pixel(1, 2), [42; 3]);
    assert_eq!(read(&png(clear.into()), Channels::Rgb).expect("reads").pixel(4, 2), [4, 2, 9]);
}

#[test]
fn a_palette_is_looked_up() {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, 4, 1);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Two);
    encoder.set_palette(vec![255, 0, 0, 0, 255, 0, 0, 0, 255, 10, 20, 30]);
    encoder.write_header().expect("a header").write_image_data(&[0b00_01_10_11]).expect("pixels");
    let bytes = read(&file, Channels::Rgb).expect("reads").into_bytes();
    assert_eq!(bytes, [255, 0, 0, 0, 255, 0, 0, 0, 255, 10, 20, 30]);
}

#[test]
fn a_jpeg_gives_nearly_what_it_was_made_of() {
    let rgb = scene();
    let file = encoded(&rgb.clone().into(), ImageFormat::Jpeg);
    let theirs = image::load_from_memory(&file).expect("decodes").into_rgb8();
    let ours = read(&file, Channels::Rgb).expect("reads");
    assert!(largest_difference(&ours.into_bytes(), theirs.as_raw()) <= 2);
    let luma = read(&file, Channels::Grey).expect("reads").into_bytes();
    assert!(largest_difference(&luma, &rec601(&theirs)) <= 6, "chroma is clipped where the colour is strong");

    let grey = DynamicImage::ImageRgb8(rgb).into_luma8();
    let file = encoded(&grey.clone().into(), ImageFormat::Jpeg);
    let ours = read(&file, Channels::Grey).expect("reads");
    assert!(largest_difference(&ours.into_bytes(), grey.as_raw()) <= 12);
    assert_eq!(read(&file, Channels::Rgb).expect("reads").into_bytes().len(), 37 * 21 * 3);
}

#[test]
fn what_is_written_reads_the_same_elsewhere() {
    let rgb = Picture::rgb_from((7, 5), |x, y| [x as u8, y as u8, 200]);
    let grey = Picture::new((3, 2), Channels::Grey, vec![0, 50, 100, 150, 200, 250]).expect("fits");
    for effort in [Effort::Quick, Effort::Small] {
        let theirs = image::load_from_memory(&rgb.to_png(effort).expect("encodes")).expect("decodes");
        assert_eq!(theirs.into_rgb8().as_raw()[..], rgb.clone().into_bytes());
        let theirs = image::load_from_memory(&grey.to_png(effort).expect("encodes")).expect("decodes");
        assert_eq!(theirs.color(), image::ColorType::L8);
        assert_eq!(theirs.into_luma8().as_raw()[..], grey.clone().into_bytes());
    }
}

#[test]
fn a_file_that_is_no_picture_is_refused_by_name() {
    let message = |bytes: &[u8]| read(bytes, Channels::Rgb).expect_err("refused").to_string();
    assert!(message(b"GIF89a").contains("begins neither as PNG nor as JPEG"));
    assert!(message(b"").contains("begins neither"));
    let png = encoded(&scene().into(), ImageFormat::Png);
    assert!(message(&png[..png.len() / 2]).contains("cannot read the picture /"));
    let jpeg = encoded(&scene().into(), ImageFormat::Jpeg);
    assert!(message(&jpeg[..40]).contains("cannot read the picture /"));
    let absent = Picture::read(Path::new("absent.png"), Channels::Grey).expect_err("absent").to_string();
    assert!(absent.contains("absent.png"), "{absent}");
    assert!(Picture::new((2, 2), Channels::Grey, vec![0; 3]).is_none());
    assert!(Picture::new((0, 2), Channels::Grey, vec![]).is_none());
}
