//! `netcord calib board`.

use std::{error::Error, fs, path::PathBuf};

use netcord_calib::board::{CalibrationBoard, Sheet, to_pdf, to_svg};
use plotters::{
    backend::BitMapBackend,
    drawing::IntoDrawingArea,
    prelude::{BLACK, Rectangle, Text, WHITE},
    style::{Color, IntoFont},
};

use crate::{
    exit::{CommandResult, Outcome},
    plot,
};

/// Arguments of `netcord calib board`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The board: chessboard:9x6:25mm (inner corners), aruco:5x7:DICT_5X5_250:40mm:10mm (marker, gap) or
    /// charuco:11x8:DICT_5X5_250:30mm:22mm (square, marker); then :inverted, :legacy, :first=ID. A dictionary
    /// may be a file such as ./own.yml.
    board: String,

    /// The files to write: names ending in .svg, .pdf or .png.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,

    /// Resolution of a PNG, dots per inch.
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(30..=2400))]
    dpi: u32,
}

/// A board's description, a dictionary's file being read from disk.
pub fn parse(spec: &str) -> Result<CalibrationBoard, Box<dyn Error>> {
    Ok(CalibrationBoard::parse(spec, |path| fs::read_to_string(path).map_err(|e| e.to_string()))?)
}

/// Runs `netcord calib board`.
pub fn run(args: &Args) -> CommandResult {
    let board = parse(&args.board)?;
    for file in &args.files {
        let sheet = Sheet::new(&board, &format!("netcord calib board {} {}", args.board, file.display()));
        let bytes = match file.extension().and_then(|e| e.to_str()) {
            Some("svg") => to_svg(&sheet).into_bytes(),
            Some("pdf") => to_pdf(&sheet),
            Some("png") => to_png(&sheet, args.dpi)?,
            _ => return Err(format!("{} must end in .svg, .pdf or .png", file.display()).into()),
        };
        fs::write(file, bytes).map_err(|e| format!("cannot write {}: {e}", file.display()))?;
        println!("{}: {} on {:.0} × {:.0} mm", file.display(), board, sheet.width_mm, sheet.height_mm);
    }
    Ok(Outcome::Good)
}

/// The sheet as PNG with its resolution in it, so that printers keep the scale.
fn to_png(sheet: &Sheet, dpi: u32) -> Result<Vec<u8>, Box<dyn Error>> {
    /// Most pixels along one side: more do not fit into memory on small machines.
    const LARGEST: f64 = 30_000.0;
    let scale = f64::from(dpi) / 25.4;
    let (width, height) = ((sheet.width_mm * scale).round(), (sheet.height_mm * scale).round());
    if width.max(height) > LARGEST {
        return Err(
            format!("a PNG of {width} × {height} px is too large; lower --dpi, or write SVG or PDF").into()
        );
    }
    let size = (width as u32, height as u32);
    let mut pixels = vec![255u8; size.0 as usize * size.1 as usize * 3];
    plot::register_fonts();
    {
        let area = BitMapBackend::with_buffer(&mut pixels, size).into_drawing_area();
        let px = |mm: f64| (mm * scale).round() as i32;
        for r in &sheet.rectangles {
            let corners = [(px(r.x), px(r.y)), (px(r.x + r.width) - 1, px(r.y + r.height) - 1)];
            // A line thinner than a pixel is still one pixel wide.
            let corners = [corners[0], (corners[1].0.max(corners[0].0), corners[1].1.max(corners[0].1))];
            area.draw(&Rectangle::new(corners, if r.white { WHITE.filled() } else { BLACK.filled() }))
                .map_err(|e| e.to_string())?;
        }
        for t in &sheet.texts {
            let font = (plot::FONT, t.size * scale).into_font().color(&BLACK);
            area.draw(&Text::new(t.text.clone(), (px(t.x), px(t.y - t.size)), font))
                .map_err(|e| e.to_string())?;
        }
        area.present().map_err(|e| e.to_string())?;
    }
    let grey: Vec<u8> = pixels.chunks_exact(3).map(|p| p[1]).collect();
    let mut png = Vec::new();
    let mut encoder = png::Encoder::new(&mut png, size.0, size.1);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let per_metre = (scale * 1000.0).round() as u32;
    encoder.set_pixel_dims(Some(png::PixelDimensions {
        xppu: per_metre,
        yppu: per_metre,
        unit: png::Unit::Meter,
    }));
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&grey)?;
    writer.finish()?;
    Ok(png)
}
