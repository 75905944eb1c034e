//! What a calibration looks like: where corners were, how they fit, and what is known where.

use std::{
    error::Error,
    path::{Path, PathBuf},
};

use nalgebra::Vector2;
use plotters::{
    chart::{ChartBuilder, ChartContext},
    coord::{Shift, cartesian::Cartesian2d, types::RangedCoordf64},
    drawing::{DrawingArea, DrawingAreaErrorKind},
    element::{Circle, PathElement, Rectangle, Text},
    prelude::DrawingBackend,
    style::{Color as _, IntoFont as _, RGBColor, ShapeStyle, WHITE},
};

use crate::{
    output::{self, OutputError},
    plot::{self, FONT, Painter},
};

const INK: RGBColor = RGBColor(40, 44, 52);
const CORNER: RGBColor = RGBColor(31, 90, 150);
const RESIDUAL: RGBColor = RGBColor(214, 93, 14);

/// Cells of the maps over the image.
const CELLS: (u32, u32) = (16, 10);

/// One camera's calibration, to be drawn.
pub struct CameraPlot {
    /// Its name.
    pub name: String,
    /// Width and height, px.
    pub size: (u32, u32),
    /// Corners with their residuals (observed − predicted), px.
    pub corners: Vec<(Vector2<f64>, Vector2<f64>)>,
    /// Views with their RMS, px.
    pub views: Vec<(String, f64)>,
    /// Places with the standard deviation of a far point's pixel there, px; empty where it is not known.
    pub uncertainty: Vec<(f64, f64, Option<f64>)>,
}

/// Where a camera's picture goes beside `report`: `<its name>-<camera>.png`; `None` beside a pipe.
///
/// # Errors
/// [`OutputError::NoName`].
pub fn path(report: &Path, camera: &str) -> Result<Option<PathBuf>, OutputError> {
    output::beside(report, &format!("-{camera}.png"))
}

/// Where the pictures of all these cameras go beside `report`, before any of them is drawn.
///
/// # Errors
/// [`OutputError::NoName`].
pub fn paths<'a>(
    report: &Path,
    cameras: impl IntoIterator<Item = &'a str>,
) -> Result<Vec<PathBuf>, OutputError> {
    cameras.into_iter().filter_map(|camera| path(report, camera).transpose()).collect()
}

/// Writes one picture a camera beside `report`, where [`path`] says.
pub fn write(report: &Path, cameras: &[CameraPlot]) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    let mut written = Vec::new();
    for camera in cameras {
        if let Some(path) = path(report, &camera.name)? {
            plot::draw(&path, (1500, 1000), camera)?;
            written.push(path);
        }
    }
    Ok(written)
}

type Painted<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;
type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

impl Painter for CameraPlot {
    fn paint<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        area.fill(&WHITE)?;
        let panels = area.split_evenly((2, 2));
        self.coverage(&panels[0])?;
        self.residuals(&panels[1])?;
        self.by_view(&panels[2])?;
        if self.uncertainty.is_empty() { self.cloud(&panels[3]) } else { self.uncertainty(&panels[3]) }
    }
}

impl CameraPlot {
    /// Axes over the image, y down.
    fn image<'a, B: DrawingBackend>(
        &self,
        area: &'a DrawingArea<B, Shift>,
        title: &str,
    ) -> Result<Chart<'a, B>, DrawingAreaErrorKind<B::ErrorType>> {
        let (width, height) = (f64::from(self.size.0), f64::from(self.size.1));
        let mut chart = ChartBuilder::on(area)
            .caption(title, (FONT, 20))
            .margin(14)
            .x_label_area_size(34)
            .y_label_area_size(56)
            .build_cartesian_2d(-0.5..width - 0.5, height - 0.5..-0.5)?;
        chart
            .configure_mesh()
            .disable_mesh()
            .x_desc("u, px")
            .y_desc("v, px")
            .label_style((FONT, 14))
            .draw()?;
        Ok(chart)
    }

    fn cell(&self, column: u32, row: u32) -> [(f64, f64); 2] {
        let (w, h) =
            (f64::from(self.size.0) / f64::from(CELLS.0), f64::from(self.size.1) / f64::from(CELLS.1));
        let at = |c: u32, r: u32| (f64::from(c) * w - 0.5, f64::from(r) * h - 0.5);
        [at(column, row), at(column + 1, row + 1)]
    }

    /// How many corners fell where, with the corners.
    fn coverage<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        let mut counts = vec![0_usize; (CELLS.0 * CELLS.1) as usize];
        for (p, _) in &self.corners {
            let place = |v: f64, size: u32, cells: u32| {
                ((v + 0.5) / f64::from(size) * f64::from(cells)).clamp(0.0, f64::from(cells) - 1.0) as u32
            };
            let (c, r) = (place(p.x, self.size.0, CELLS.0), place(p.y, self.size.1, CELLS.1));
            counts[(r * CELLS.0 + c) as usize] += 1;
        }
        let most = counts.iter().copied().max().unwrap_or(1).max(1);
        let empty = counts.iter().filter(|n| **n == 0).count();
        let share = 100.0 * (1.0 - empty as f64 / counts.len() as f64);
        let title =
            format!("{}: {} corners, {share:.0} % of the image covered", self.name, self.corners.len());
        let mut chart = self.image(area, &title)?;
        let cells = (0..CELLS.1).flat_map(|r| (0..CELLS.0).map(move |c| (c, r)));
        chart.draw_series(cells.zip(&counts).map(|((c, r), n)| {
            let share = (*n as f64 / most as f64).sqrt();
            Rectangle::new(self.cell(c, r), heat(share).filled())
        }))?;
        chart.draw_series(self.corners.iter().map(|(p, _)| Circle::new((p.x, p.y), 1, INK.filled())))?;
        Ok(())
    }

    /// Each residual as a line from its corner.
    fn residuals<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        let mut lengths: Vec<f64> = self.corners.iter().map(|(_, r)| r.norm()).collect();
        lengths.sort_by(f64::total_cmp);
        let median = lengths.get(lengths.len() / 2).copied().unwrap_or(1.0).max(1e-9);
        // The median becomes a fiftieth of the image's width; a round factor is easier to read.
        let wanted = f64::from(self.size.0) / 50.0 / median;
        let round = 10f64.powf(wanted.log10().floor());
        let factor = [5.0, 2.0, 1.0].iter().map(|k| k * round).find(|f| *f <= wanted).unwrap_or(round);
        let mut chart = self.image(area, &format!("residuals, {factor} times their length"))?;
        chart.draw_series(self.corners.iter().map(|(p, r)| {
            let end = p + r * factor;
            PathElement::new(
                [(p.x, p.y), (end.x, end.y)],
                ShapeStyle::from(RESIDUAL.mix(0.8)).stroke_width(1),
            )
        }))?;
        chart.draw_series(self.corners.iter().map(|(p, _)| Circle::new((p.x, p.y), 1, CORNER.filled())))?;
        Ok(())
    }

    fn by_view<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        let count = self.views.len();
        let high = self.views.iter().map(|v| v.1).fold(0.0, f64::max).max(1e-6) * 1.15;
        let squares: f64 = self.corners.iter().map(|(_, r)| r.norm_squared()).sum();
        let rms = (squares / self.corners.len().max(1) as f64).sqrt();
        let mut chart = ChartBuilder::on(area)
            .caption(format!("RMS of each view, px (all: {rms:.3})"), (FONT, 20))
            .margin(14)
            .x_label_area_size(34)
            .y_label_area_size(56)
            .build_cartesian_2d(0.0..count.max(1) as f64, 0.0..high)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_labels(0)
            .y_desc("px")
            .label_style((FONT, 14))
            .light_line_style(INK.mix(0.03))
            .bold_line_style(INK.mix(0.08))
            .draw()?;
        chart.draw_series(self.views.iter().enumerate().map(|(i, (_, rms))| {
            Rectangle::new([(i as f64 + 0.12, 0.0), (i as f64 + 0.88, *rms)], CORNER.mix(0.75).filled())
        }))?;
        // Names stand upright in their bars, as many as there is room for.
        let stride = count.div_ceil(40).max(1);
        let turned = (FONT, 13).into_font().transform(plotters::style::FontTransform::Rotate270).color(&INK);
        chart.draw_series(
            self.views.iter().enumerate().step_by(stride).map(|(i, (name, _))| {
                Text::new(name.clone(), (i as f64 + 0.35, high * 0.02), turned.clone())
            }),
        )?;
        let line = ShapeStyle::from(RESIDUAL).stroke_width(2);
        chart.draw_series([PathElement::new([(0.0, rms), (count as f64, rms)], line)])?;
        Ok(())
    }

    /// What is known of a far point's pixel, with the figures in the cells.
    fn uncertainty<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        let known = || self.uncertainty.iter().filter_map(|(_, _, sd)| *sd);
        let (low, high) = known().fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
        let mut chart = self.image(area, "uncertainty of a projected pixel, px (worst direction)")?;
        let (w, h) =
            (f64::from(self.size.0) / f64::from(CELLS.0), f64::from(self.size.1) / f64::from(CELLS.1));
        let span = (high / low.max(1e-12)).ln().max(1e-9);
        chart.draw_series(self.uncertainty.iter().map(|(u, v, sd)| {
            let cell = [(u - w / 2.0, v - h / 2.0), (u + w / 2.0, v + h / 2.0)];
            let colour = sd.map_or(INK.mix(0.3), |sd| heat((sd / low.max(1e-12)).ln() / span).mix(1.0));
            Rectangle::new(cell, colour.filled())
        }))?;
        let font = (FONT, 13).into_font().color(&INK);
        chart.draw_series(self.uncertainty.iter().filter_map(|(u, v, sd)| {
            let text = match (*sd)? {
                sd if sd < 0.995 => format!("{sd:.2}").trim_start_matches('0').to_owned(),
                sd => format!("{sd:.1}"),
            };
            Some(Text::new(text, (u - w * 0.32, v - h * 0.18), font.clone()))
        }))?;
        Ok(())
    }

    /// All residuals about one point.
    fn cloud<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        let reach = self.corners.iter().map(|(_, r)| r.amax()).fold(0.05, f64::max) * 1.1;
        let mut chart = ChartBuilder::on(area)
            .caption("residuals, px", (FONT, 20))
            .margin(14)
            .x_label_area_size(34)
            .y_label_area_size(56)
            .build_cartesian_2d(-reach..reach, reach..-reach)?;
        chart
            .configure_mesh()
            .label_style((FONT, 14))
            .bold_line_style(INK.mix(0.08))
            .light_line_style(INK.mix(0.03))
            .draw()?;
        chart.draw_series(
            self.corners.iter().map(|(_, r)| Circle::new((r.x, r.y), 2, RESIDUAL.mix(0.6).filled())),
        )?;
        Ok(())
    }
}

/// White over yellow to red, 0–1.
fn heat(share: f64) -> RGBColor {
    let share = share.clamp(0.0, 1.0);
    let level = |from: f64, to: f64, s: f64| (from + (to - from) * s) as u8;
    if share < 0.5 {
        let s = share * 2.0;
        RGBColor(level(255.0, 254.0, s), level(255.0, 217.0, s), level(255.0, 118.0, s))
    } else {
        let s = share * 2.0 - 1.0;
        RGBColor(level(254.0, 227.0, s), level(217.0, 90.0, s), level(118.0, 60.0, s))
    }
}

/// Errors of a rod over the places where it was, seen from above and as they came.
pub struct RodPlot<'a> {
    /// Places (m, in the frame named by `frame`) and errors of length, m.
    pub places: &'a [([f64; 3], f64)],
    /// What the places are counted from.
    pub frame: &'static str,
}

impl Painter for RodPlot<'_> {
    fn paint<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        area.fill(&WHITE)?;
        // A single gross mistake would leave all others pale.
        let mut errors: Vec<f64> = self.places.iter().map(|p| p.1.abs()).collect();
        errors.sort_by(f64::total_cmp);
        let worst = errors.get(errors.len() * 95 / 100).copied().unwrap_or(0.0).max(1e-6);
        let panels = area.split_evenly((1, 2));
        for (panel, (a, b, names)) in panels.iter().zip([(0, 1, ("x, m", "y, m")), (0, 2, ("x, m", "z, m"))])
        {
            let range = |axis: usize| {
                let (low, high) = self
                    .places
                    .iter()
                    .map(|p| p.0[axis])
                    .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
                let rim = 0.05 * (high - low) + 0.01;
                low - rim..high + rim
            };
            let title =
                format!("error of the rod's length, red: {:.1} mm and more ({})", worst * 1e3, self.frame);
            let mut chart = ChartBuilder::on(panel)
                .caption(title, (FONT, 20))
                .margin(14)
                .x_label_area_size(38)
                .y_label_area_size(56)
                .build_cartesian_2d(range(a), range(b))?;
            chart
                .configure_mesh()
                .x_desc(names.0)
                .y_desc(names.1)
                .label_style((FONT, 14))
                .bold_line_style(INK.mix(0.08))
                .light_line_style(INK.mix(0.03))
                .draw()?;
            chart.draw_series(
                self.places
                    .iter()
                    .map(|(p, error)| Circle::new((p[a], p[b]), 5, heat(error.abs() / worst).filled())),
            )?;
            chart
                .draw_series(self.places.iter().map(|(p, _)| Circle::new((p[a], p[b]), 5, INK.mix(0.25))))?;
        }
        Ok(())
    }
}
