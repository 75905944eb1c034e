//! Plots as PNG or SVG, with a font that the executable brings along.

use std::{path::Path, sync::Once};

use netcord_common::picture::{Channels, Effort, Picture};
use plotters::{
    backend::{BitMapBackend, SVGBackend},
    coord::Shift,
    drawing::{DrawingArea, DrawingAreaErrorKind, IntoDrawingArea},
    prelude::DrawingBackend,
    style::{FontStyle, register_font},
};
use thiserror::Error;

use crate::output::{Output, Plan};

/// The font family that all plots use.
pub const FONT: &str = "sans-serif";

/// A plot that could not be made.
#[derive(Debug, Error)]
#[error("cannot write the plot {path}: {cause}")]
pub struct PlotError {
    path: String,
    cause: String,
}

/// Makes [`FONT`] known to plotters.
pub fn register_fonts() {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| {
        // It fails only on bytes that are no font.
        let _ = register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT);
        let _ = register_font(FONT, FontStyle::Bold, epaint_default_fonts::UBUNTU_LIGHT);
    });
}

/// Draws `painter`'s plot of `size` pixels into `path`: SVG when it ends so, else PNG.
///
/// # Errors
/// [`PlotError`] when the file cannot be written or the plot cannot be drawn.
pub fn draw<P: Painter>(path: &Path, size: (u32, u32), painter: &P) -> Result<(), PlotError> {
    let output = Plan::default().begin(path);
    let output = output.map_err(|e| PlotError { path: path.display().to_string(), cause: e.to_string() })?;
    draw_into(output, size, painter)
}

/// As [`draw`], into an output that has begun.
///
/// # Errors
/// As [`draw`].
pub fn draw_into<P: Painter>(output: Output, size: (u32, u32), painter: &P) -> Result<(), PlotError> {
    register_fonts();
    let path = output.path().display().to_string();
    let failed = |cause: String| PlotError { path, cause };
    let bytes = if output.path().extension().is_some_and(|e| e == "svg") {
        vector(size, painter).map(String::into_bytes)
    } else {
        rasterised(size, painter).and_then(|picture| picture.to_png(Effort::Small).map_err(|e| e.to_string()))
    };
    bytes.and_then(|bytes| output.write(bytes).map_err(|e| e.to_string())).map_err(failed)
}

fn vector(size: (u32, u32), painter: &impl Painter) -> Result<String, String> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        painter.paint(&area).and_then(|()| area.present()).map_err(|e| e.to_string())?;
    }
    Ok(text)
}

/// The plot as a picture.
///
/// # Errors
/// What the backend reports.
pub fn rasterised<P: Painter>(size: (u32, u32), painter: &P) -> Result<Picture, String> {
    register_fonts();
    let size_px = (size.0 as usize, size.1 as usize);
    let mut pixels = vec![0; size_px.0 * size_px.1 * Channels::Rgb.count()];
    {
        let area = BitMapBackend::with_buffer(&mut pixels, size).into_drawing_area();
        painter.paint(&area).and_then(|()| area.present()).map_err(|e| e.to_string())?;
    }
    Picture::new(size_px, Channels::Rgb, pixels).ok_or_else(|| "it has no pixels".to_owned())
}

/// Round values for a logarithmic axis from `low` to `high`, both above 0: powers of ten, and twice and five times
/// those where fewer than three decades leave room. The library's own ticks are too few on short axes.
pub fn log_ticks(low: f64, high: f64) -> Vec<f64> {
    let steps: &[f64] = if high / low < 1000.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let decades = low.log10().floor() as i32..=high.log10().floor() as i32;
    // Read from its digits, a value is the nearest there is, and prints as them.
    let value = |step: f64, decade: i32| format!("{step}e{decade}").parse().unwrap_or(step);
    let all = decades.flat_map(|decade| steps.iter().map(move |step| value(*step, decade)));
    all.filter(|v| (low..=high).contains(v)).collect()
}

/// Something that can be painted on any backend.
pub trait Painter {
    /// Paints on `area`.
    ///
    /// # Errors
    /// What the backend reports.
    fn paint<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_logarithmic_axis_has_ticks_too() {
        assert_eq!(log_ticks(0.3, 4.0), [0.5, 1.0, 2.0]);
        assert_eq!(log_ticks(0.01, 5.0), [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0]);
        assert_eq!(log_ticks(0.5, 2000.0), [1.0, 10.0, 100.0, 1000.0]);
        assert!(log_ticks(0.25, 0.4).is_empty(), "no round value lies there");
    }
}
