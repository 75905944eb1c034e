use std::path::Path;

use plotters::{
    chart::ChartBuilder,
    coord::{Shift, combinators::IntoLogRange},
    drawing::{DrawingArea, DrawingAreaErrorKind},
    element::{EmptyElement, PathElement, Polygon, Text},
    prelude::{BindKeyPoints, DrawingBackend},
    series::LineSeries,
    style::{Color as _, RGBColor, WHITE},
};

use super::{CALIBRATIONS_PX, NOISES_PX, Report, Row, camera_counts};
use crate::plot::{self, FONT, Painter, PlotError, log_ticks};

const INK: RGBColor = RGBColor(40, 44, 52);

/// A method's colour and its mark, of which no two have the same shape: corners about its middle, px.
struct Sign {
    method: &'static str,
    colour: RGBColor,
    corners: &'static [(i32, i32)],
}

/// In the order of the design's table.
const SIGNS: [Sign; 8] = [
    Sign {
        method: "dlt-svd",
        colour: RGBColor(31, 119, 180),
        corners: &[(-5, -5), (5, -5), (5, 5), (-5, 5)],
    },
    Sign { method: "dlt-ls", colour: RGBColor(23, 190, 207), corners: &[(0, -7), (7, 0), (0, 7), (-7, 0)] },
    Sign { method: "midpoint", colour: RGBColor(148, 103, 189), corners: &[(0, -7), (6, 5), (-6, 5)] },
    Sign { method: "rt-first", colour: RGBColor(188, 189, 34), corners: &[(-5, -6), (7, 0), (-5, 6)] },
    Sign { method: "rt-second", colour: RGBColor(140, 86, 75), corners: &[(5, -6), (5, 6), (-7, 0)] },
    Sign {
        method: "rt-symmetric",
        colour: RGBColor(227, 119, 194),
        corners: &[(-7, -5), (0, 0), (7, -5), (7, 5), (0, 0), (-7, 5)],
    },
    Sign { method: "reprojection", colour: RGBColor(44, 160, 44), corners: &[(-6, -5), (6, -5), (0, 7)] },
    Sign {
        method: "robust",
        colour: RGBColor(214, 39, 40),
        corners: &[
            (-2, -7),
            (2, -7),
            (2, -2),
            (7, -2),
            (7, 2),
            (2, 2),
            (2, 7),
            (-2, 7),
            (-2, 2),
            (-7, 2),
            (-7, -2),
            (-2, -2),
        ],
    },
];

/// Height of the legend above all panels, and of each row of them, px.
const LEGEND: u32 = 44;
const ROW: u32 = 430;

/// The part of a group's width that its marks take.
const SPREAD: f64 = 0.8;

/// Draws the error over noise and over calibration error, one row for each number of cameras. Most methods agree to
/// a few per mille: the marks of one setting stand side by side, so that none hides another.
pub(super) fn draw(path: &Path, report: &Report) -> Result<(), PlotError> {
    let rows = u32::try_from(camera_counts(report).len()).unwrap_or(1);
    plot::draw(path, (1300, LEGEND + ROW * rows), &ComparisonPlot { report })
}

struct ComparisonPlot<'a> {
    report: &'a Report,
}

type Painted<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

impl Painter for ComparisonPlot<'_> {
    fn paint<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        area.fill(&WHITE)?;
        let (above, below) = area.split_vertically(LEGEND);
        legend(&above)?;
        let counts = camera_counts(self.report);
        for (cameras, row) in counts.iter().zip(below.split_evenly((counts.len(), 1))) {
            let panels = row.split_evenly((1, 2));
            let of: Vec<&Row> = self.report.summary.iter().filter(|r| r.cameras == *cameras).collect();
            let title = format!("{cameras} cameras, calibration exact");
            let noise = of.iter().copied().filter(|r| r.calibration_px == CALIBRATIONS_PX[0]);
            panel(
                &panels[0],
                (&title, "noise of the observations, px"),
                &NOISES_PX,
                noise.map(|r| (r, r.noise_px)),
            )?;
            let title = format!("{cameras} cameras, noise {} px", NOISES_PX[1]);
            let calibration = of.iter().copied().filter(|r| r.noise_px == NOISES_PX[1]);
            panel(
                &panels[1],
                (&title, "calibration error, px"),
                &CALIBRATIONS_PX,
                calibration.map(|r| (r, r.calibration_px)),
            )?;
        }
        Ok(())
    }
}

/// All methods with their marks, in one line.
fn legend<B: DrawingBackend>(area: &DrawingArea<B, Shift>) -> Painted<B> {
    let (width, height) = area.dim_in_pixel();
    let step = width as i32 / SIGNS.len() as i32;
    let y = height as i32 / 2;
    for (place, sign) in (0..).zip(&SIGNS) {
        let x = 30 + place * step;
        area.draw(&(EmptyElement::at((x, y)) + Polygon::new(sign.corners.to_vec(), sign.colour.filled())))?;
        area.draw(&Text::new(sign.method, (x + 14, y - 9), (FONT, 17)))?;
    }
    Ok(())
}

/// One group of marks for each of `settings`, `rows` saying which each belongs to.
fn panel<'a, B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    (title, axis): (&str, &str),
    settings: &[f64],
    rows: impl Iterator<Item = (&'a Row, f64)>,
) -> Painted<B> {
    let rows: Vec<_> = rows.collect();
    let values = || rows.iter().filter_map(|(r, _)| r.rms_mm);
    let low = values().fold(f64::INFINITY, f64::min).min(1.0) * 0.8;
    // A method that fails would squeeze all others into a line.
    let high = values().fold(0.0, f64::max).clamp(10.0 * low, 500.0) * 1.25;
    let edge = settings.len() as f64 - 0.5;
    let borders: Vec<f64> = (0..=settings.len()).map(|i| i as f64 - 0.5).collect();
    let mut chart = ChartBuilder::on(area)
        .caption(title, (FONT, 20))
        .margin(12)
        .x_label_area_size(38)
        .y_label_area_size(60)
        .build_cartesian_2d(-0.5..edge, (low..high).log_scale().with_key_points(log_ticks(low, high)))?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .x_desc(axis)
        .x_labels(settings.len())
        .x_label_formatter(&|x| {
            // Between two groups there is nothing.
            let setting = settings.get(x.round() as usize).filter(|_| (x - x.round()).abs() < 1e-6);
            setting.map_or_else(String::new, |px| if *px == 0.0 { "none".into() } else { format!("{px}") })
        })
        .y_label_formatter(&|y| format!("{y}"))
        .y_desc("RMS error, mm")
        .label_style((FONT, 15))
        .light_line_style(INK.mix(0.03))
        .bold_line_style(INK.mix(0.08))
        .draw()?;
    chart.draw_series(
        borders.iter().map(|x| PathElement::new([(*x, low), (*x, high)], INK.mix(0.15).stroke_width(1))),
    )?;
    // Methods for two views have no place among more.
    let drawn: Vec<&Sign> = SIGNS.iter().filter(|s| rows.iter().any(|(r, _)| r.method == s.method)).collect();
    for (place, sign) in drawn.iter().enumerate() {
        let aside = SPREAD * ((place as f64 + 0.5) / drawn.len() as f64 - 0.5);
        let points = rows.iter().filter(|(r, _)| r.method == sign.method).filter_map(|(r, at)| {
            let group = settings.iter().position(|setting| setting == at)?;
            Some((group as f64 + aside, r.rms_mm?.clamp(low, high)))
        });
        let points: Vec<(f64, f64)> = points.collect();
        chart.draw_series(LineSeries::new(points.iter().copied(), sign.colour.mix(0.25).stroke_width(1)))?;
        chart.draw_series(
            points
                .iter()
                .map(|at| EmptyElement::at(*at) + Polygon::new(sign.corners.to_vec(), sign.colour.filled())),
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use netcord_detect::triangulate::all_methods;

    use super::*;

    #[test]
    fn every_method_has_a_mark_of_its_own() {
        let methods = all_methods().map(|method| method.code().name());
        assert_eq!(SIGNS.each_ref().map(|sign| sign.method), methods);
        for (i, sign) in SIGNS.iter().enumerate() {
            for other in &SIGNS[..i] {
                assert!(sign.corners != other.corners && sign.colour != other.colour, "{}", sign.method);
            }
        }
    }

    fn row(method: &'static str, noise_px: f64, calibration_px: f64) -> Row {
        let rms_mm = Some(1.0 + noise_px);
        Row { method, cameras: 2, noise_px, calibration_px, rms_mm, bias_mm: None, p95_mm: None, found: 1.0 }
    }

    #[test]
    fn methods_of_equal_error_are_all_seen() {
        let settings = NOISES_PX.iter().flat_map(|n| CALIBRATIONS_PX.iter().map(move |c| (*n, *c)));
        let summary: Vec<Row> =
            settings.flat_map(|(n, c)| SIGNS.iter().map(move |sign| row(sign.method, n, c))).collect();
        let report = Report { rigs: Vec::new(), summary, time: Vec::new(), cells: Vec::new() };
        let picture =
            plot::rasterised((1300, LEGEND + ROW), &ComparisonPlot { report: &report }).expect("drawn");
        let pixels = picture.into_bytes();
        let groups = NOISES_PX.len() + CALIBRATIONS_PX.len();
        for sign in &SIGNS {
            let RGBColor(r, g, b) = sign.colour;
            let below = pixels.chunks_exact(3).skip(1300 * LEGEND as usize);
            let seen = below.filter(|p| **p == [r, g, b]).count();
            // The smallest mark covers 60 px.
            assert!(seen > 40 * groups, "{}: {seen} px in {groups} groups", sign.method);
        }
    }
}
