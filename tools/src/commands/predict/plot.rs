//! The picture beside the report: errors by horizon, and confidence against what held.

use netcord_detect::flight::recorded::{Evaluation, HORIZONS_MS};
use plotters::{
    coord::Shift,
    prelude::{
        BLACK, BLUE, ChartBuilder, Circle, Color as _, DrawingArea, DrawingAreaErrorKind, DrawingBackend,
        LineSeries, PathElement, RED, TRANSPARENT,
    },
};

use super::{evaluate::quantile, reliability::Reliability};
use crate::plot::{FONT, Painter};

/// How far the share that holds may be from the confidence.
const MARK: f64 = 0.05;

/// Errors and confidence of one evaluation.
pub struct ErrorPlot<'a> {
    /// The errors.
    pub errors: &'a Evaluation,
    /// What held of the confidence as it was given.
    pub given: Reliability,
    /// The same with the curve fitted to other recordings.
    pub held_out: Reliability,
}

impl Painter for ErrorPlot<'_> {
    fn paint<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        area.fill(&plotters::style::WHITE)?;
        let halves = area.split_evenly((1, 2));
        let line = |share: f64| {
            HORIZONS_MS.map(|ms| {
                let error = quantile(&mut self.errors.prediction_errors_m(ms), share).unwrap_or(0.0);
                (f64::from(ms), error * 1e3)
            })
        };
        let (median, p90) = (line(0.5), line(0.9));
        let top = p90.iter().map(|p| p.1).fold(10.0, f64::max) * 1.1;
        let mut chart = ChartBuilder::on(&halves[0])
            .caption("prediction error: median (blue), p90 (red)", (FONT, 20))
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(50)
            .build_cartesian_2d(0.0..550.0, 0.0..top)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .x_desc("ms ahead")
            .y_desc("mm")
            .label_style((FONT, 15))
            .draw()?;
        for (points, colour) in [(median, BLUE), (p90, RED)] {
            chart.draw_series(LineSeries::new(points, colour.stroke_width(2)))?;
            chart.draw_series(points.iter().map(|p| Circle::new(*p, 3, colour.filled())))?;
        }

        let mut chart = ChartBuilder::on(&halves[1])
            .caption(
                "hitting point within 40 mm: as given (blue), curve from other flights (red)",
                (FONT, 20),
            )
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(50)
            .build_cartesian_2d(0.0..1.0, 0.0..1.0)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .x_desc("confidence")
            .y_desc("share that held")
            .label_style((FONT, 15))
            .draw()?;
        for off in [-MARK, 0.0, MARK] {
            // Cut at the frame: beyond it a line would be bent.
            let ends = [f64::max(0.0, -off), f64::min(1.0, 1.0 - off)].map(|x| (x, x + off));
            chart.draw_series(LineSeries::new(ends, BLACK.mix(if off == 0.0 { 0.6 } else { 0.2 })))?;
        }
        // Standard errors as bars; the two a little apart.
        for (reliability, colour, aside) in [(&self.given, BLUE, -0.004), (&self.held_out, RED, 0.004)] {
            let at = |confidence: f64| (confidence + aside).clamp(0.0, 1.0);
            chart.draw_series(reliability.0.iter().map(|b| {
                let ends = [b.held - b.standard_error, b.held + b.standard_error].map(|y| y.clamp(0.0, 1.0));
                PathElement::new(ends.map(|y| (at(b.confidence), y)), colour.mix(0.5))
            }))?;
            chart.draw_series(
                reliability.0.iter().map(|b| Circle::new((at(b.confidence), b.held), 4, colour.filled())),
            )?;
        }
        Ok(())
    }
}
