use std::path::Path;

use plotters::{
    chart::{ChartBuilder, SeriesLabelPosition},
    coord::{Shift, combinators::IntoLogRange},
    drawing::{DrawingArea, DrawingAreaErrorKind},
    element::{Circle, PathElement},
    prelude::DrawingBackend,
    series::LineSeries,
    style::{Color as _, RGBColor, ShapeStyle, WHITE},
};

use super::{CALIBRATIONS_PX, NOISES_PX, Report, Row, camera_counts};
use crate::plot::{self, FONT, Painter, PlotError};

const INK: RGBColor = RGBColor(40, 44, 52);

/// One colour a method, in the order of the design's table.
const COLOURS: [(&str, RGBColor); 8] = [
    ("dlt-svd", RGBColor(31, 119, 180)),
    ("dlt-ls", RGBColor(23, 190, 207)),
    ("midpoint", RGBColor(148, 103, 189)),
    ("rt-first", RGBColor(188, 189, 34)),
    ("rt-second", RGBColor(140, 86, 75)),
    ("rt-symmetric", RGBColor(227, 119, 194)),
    ("reprojection", RGBColor(44, 160, 44)),
    ("robust", RGBColor(214, 39, 40)),
];

/// Draws the error over noise and over calibration error, one row for each number of cameras.
pub(super) fn draw(path: &Path, report: &Report) -> Result<(), PlotError> {
    let rows = u32::try_from(camera_counts(report).len()).unwrap_or(1);
    plot::draw(path, (1300, 430 * rows), &ComparisonPlot { report })
}

struct ComparisonPlot<'a> {
    report: &'a Report,
}

type Painted<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

impl Painter for ComparisonPlot<'_> {
    fn paint<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        area.fill(&WHITE)?;
        let counts = camera_counts(self.report);
        for (cameras, row) in counts.iter().zip(area.split_evenly((counts.len(), 1))) {
            let panels = row.split_evenly((1, 2));
            let of: Vec<&Row> = self.report.summary.iter().filter(|r| r.cameras == *cameras).collect();
            let title = format!("{cameras} cameras, calibration exact");
            let noise = of.iter().copied().filter(|r| r.calibration_px == 0.0).map(|r| (r, r.noise_px));
            panel(&panels[0], &title, "noise of the observations, px", &NOISES_PX, noise)?;
            let title = format!("{cameras} cameras, noise {} px", NOISES_PX[1]);
            // A logarithmic axis has no zero: the exact calibration stands at its left end.
            let shown = |px: f64| if px == 0.0 { 0.1 } else { px };
            let axis: Vec<_> = CALIBRATIONS_PX.iter().map(|px| shown(*px)).collect();
            let calibration = of
                .iter()
                .copied()
                .filter(|r| r.noise_px == NOISES_PX[1])
                .map(|r| (r, shown(r.calibration_px)));
            panel(&panels[1], &title, "calibration error, px (0.1: none)", &axis, calibration)?;
        }
        Ok(())
    }
}

fn panel<'a, B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    axis: &str,
    marks: &[f64],
    rows: impl Iterator<Item = (&'a Row, f64)>,
) -> Painted<B> {
    let rows: Vec<_> = rows.collect();
    let values = || rows.iter().filter_map(|(r, _)| r.rms_mm);
    let low = values().fold(f64::INFINITY, f64::min).min(1.0) * 0.8;
    // A method that fails would squeeze all others into a line.
    let high = values().fold(0.0, f64::max).clamp(10.0 * low, 500.0) * 1.25;
    let ends = (marks[0] * 0.9, marks[marks.len() - 1] * 1.1);
    let mut chart = ChartBuilder::on(area)
        .caption(title, (FONT, 20))
        .margin(12)
        .x_label_area_size(38)
        .y_label_area_size(60)
        .build_cartesian_2d((ends.0..ends.1).log_scale(), (low..high).log_scale())?;
    chart
        .configure_mesh()
        .x_desc(axis)
        // Only what was measured is labelled: a logarithmic axis has more marks than room.
        .x_label_formatter(&|x| {
            let measured = marks.iter().any(|m| (m - x).abs() < 1e-9);
            if measured { format!("{x:.1}") } else { String::new() }
        })
        .y_label_formatter(&|y| format!("{y:.1}"))
        .y_desc("RMS error, mm")
        .label_style((FONT, 15))
        .light_line_style(INK.mix(0.03))
        .bold_line_style(INK.mix(0.08))
        .draw()?;
    for (method, colour) in COLOURS {
        let points: Vec<_> = rows
            .iter()
            .filter(|(r, _)| r.method == method)
            .filter_map(|(r, x)| Some((*x, r.rms_mm?.clamp(low, high))))
            .collect();
        if points.is_empty() {
            continue;
        }
        let style = ShapeStyle::from(colour).stroke_width(2);
        chart.draw_series(points.iter().map(|p| Circle::new(*p, 3, colour.filled())))?;
        chart
            .draw_series(LineSeries::new(points, style))?
            .label(method)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .label_font((FONT, 14))
        .background_style(WHITE.mix(0.8))
        .border_style(INK.mix(0.2))
        .draw()
}
