//! `netcord calib board`.

use std::{
    cell::OnceCell,
    error::Error,
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
};

use netcord_calib::board::{CalibrationBoard, Sheet, to_pdf, to_svg};
use plotters::{
    backend::BitMapBackend,
    drawing::IntoDrawingArea,
    prelude::{BLACK, Text},
    style::IntoFont,
};

use crate::{
    exit::{CommandResult, Outcome},
    output, plot,
};

/// Arguments of `netcord calib board`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The board: chessboard:9x6:25mm (inner corners), aruco:5x7:DICT_5X5_250:40mm:10mm (marker, gap) or
    /// charuco:11x8:DICT_5X5_250:30mm:22mm (square, marker); then :inverted, :legacy, :first=ID, or :double=4mm for
    /// a plate so thick with markers on both sides. A dictionary may be a file such as ./own.yml.
    board: String,

    /// The files to write: names ending in .svg, .pdf or .png. The back of a double board is the second page of a PDF,
    /// and a file of its own (NAME-back) otherwise.
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

/// The file of the dictionary that a board's description names, where it names one; it need not be readable.
pub fn dictionary_file(spec: &str) -> Option<PathBuf> {
    let asked = OnceCell::new();
    // Whoever parses it in earnest tells what is wrong with it.
    let _ = CalibrationBoard::parse(spec, |path| {
        let _ = asked.set(PathBuf::from(path));
        Err(String::new())
    });
    asked.into_inner()
}

/// Runs `netcord calib board`.
pub fn run(args: &Args) -> CommandResult {
    let board = parse(&args.board)?;
    let mut files = args.files.clone();
    for file in &args.files {
        // The second page of a PDF is no file of its own.
        if kind_of(file)? != "pdf" && board.back().is_some() {
            files.extend(back_of(file)?);
        }
    }
    output::check(dictionary_file(&args.board), &files)?;
    for file in &args.files {
        let command = format!("netcord calib board {} {}", args.board, file.display());
        let front = Sheet::new(&board, &command);
        let back = board.back().map(|back| Sheet::new(&back, &format!("{command}: the back")));
        let kind = kind_of(file)?;
        let mut sheets: Vec<(PathBuf, Vec<Sheet>)> = vec![(file.clone(), vec![front])];
        match back {
            Some(back) if kind == "pdf" => sheets[0].1.push(back),
            Some(back) => sheets.extend(back_of(file)?.map(|file| (file, vec![back]))),
            None => {}
        }
        for (file, sheets) in sheets {
            let bytes = match kind {
                "svg" => to_svg(&sheets[0]).into_bytes(),
                "pdf" => to_pdf(&sheets),
                _ => to_png(&sheets[0], args.dpi)?,
            };
            output::write(&file, bytes)?;
            let (sheet, pages) = (&sheets[0], if sheets.len() > 1 { ", front and back" } else { "" });
            println!(
                "{}: {} on {:.0} × {:.0} mm{pages}",
                file.display(),
                board,
                sheet.width_mm,
                sheet.height_mm
            );
        }
    }
    Ok(Outcome::Good)
}

/// What a file's name says is to be drawn.
fn kind_of(file: &Path) -> Result<&str, String> {
    let kind = file.extension().and_then(OsStr::to_str).filter(|kind| ["svg", "pdf", "png"].contains(kind));
    kind.ok_or_else(|| format!("{} must end in .svg, .pdf or .png", file.display()))
}

/// Where the back of a double board goes: `b.svg` becomes `b-back.svg`.
fn back_of(file: &Path) -> Result<Option<PathBuf>, Box<dyn Error>> {
    Ok(output::beside(file, &format!("-back.{}", kind_of(file)?))?)
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
    let px = |mm: f64| (mm * scale).round() as i32;
    // Rectangles by hand: whoever rounds other than half-open leaves seams between cells, which detectors trip over.
    for r in &sheet.rectangles {
        let span = |from: f64, length: f64, size: u32| {
            // A line thinner than a pixel is still one pixel wide.
            let (first, last) = (px(from).max(0), px(from + length).max(px(from) + 1).min(size as i32));
            first as usize..last.max(first) as usize
        };
        let columns = span(r.x, r.width, size.0);
        for row in span(r.y, r.height, size.1) {
            let row = row * size.0 as usize * 3;
            pixels[row + 3 * columns.start..row + 3 * columns.end].fill(if r.white { 255 } else { 0 });
        }
    }
    plot::register_fonts();
    {
        let area = BitMapBackend::with_buffer(&mut pixels, size).into_drawing_area();
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
