use std::path::{Path, PathBuf};

use plotters::{
    chart::ChartBuilder,
    coord::Shift,
    drawing::{DrawingArea, DrawingAreaErrorKind},
    element::{Circle, PathElement, Rectangle},
    prelude::DrawingBackend,
    series::LineSeries,
    style::{Color as _, RGBColor, ShapeStyle, WHITE},
};

use super::{Judged, Judgement};
use crate::{
    output::{self, OutputError},
    plot::{self, FONT, Painter, PlotError},
};

const INK: RGBColor = RGBColor(40, 44, 52);
const TRUTH: RGBColor = RGBColor(160, 166, 176);
const FOUND: RGBColor = RGBColor(214, 93, 14);
const WRONG: RGBColor = RGBColor(190, 20, 40);
const TABLE: RGBColor = RGBColor(28, 86, 140);

/// Seconds of flight that the trajectory plot shows: more would be a tangle.
const SHOWN_S: f64 = 4.0;
const HALF_LENGTH_M: f64 = 1.37;
const HALF_WIDTH_M: f64 = 0.7625;
const NET_HEIGHT_M: f64 = 0.1525;

/// Where the plots of a trial go beside `report`: `<its name>-trajectory.png`, `-error.png`, `-latency.png`; `None`
/// where the report goes into a pipe.
///
/// # Errors
/// [`OutputError::NoName`].
pub fn plot_paths(report: &Path) -> Result<Option<[PathBuf; 3]>, OutputError> {
    let beside = |what| output::beside(report, what);
    let [trajectory, error, latency] = ["-trajectory.png", "-error.png", "-latency.png"].map(beside);
    Ok(trajectory?
        .zip(error?)
        .zip(latency?)
        .map(|((trajectory, error), latency)| [trajectory, error, latency]))
}

/// Writes the plots of a trial where [`plot_paths`] says.
///
/// # Errors
/// [`PlotError`] when one cannot be written.
pub fn write_plots(paths: &[PathBuf; 3], rows: &[Judged], latencies_ms: &[f64]) -> Result<(), PlotError> {
    plot::draw(&paths[0], (1200, 900), &TrajectoryPlot { rows: last_seconds(rows) })?;
    plot::draw(&paths[1], (1200, 500), &ErrorPlot { rows })?;
    plot::draw(&paths[2], (1200, 500), &LatencyPlot { latencies_ms })
}

fn last_seconds(rows: &[Judged]) -> &[Judged] {
    let Some(last) = rows.last() else { return rows };
    let from = last.t_ns.saturating_sub((SHOWN_S * 1e9) as u64);
    &rows[rows.partition_point(|r| r.t_ns < from)..]
}

type Painted<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

/// From above and from the side.
struct TrajectoryPlot<'a> {
    rows: &'a [Judged],
}

impl Painter for TrajectoryPlot<'_> {
    fn paint<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        area.fill(&WHITE)?;
        let (above, side) = area.split_vertically(520);
        let title =
            format!("The last {SHOWN_S} s from above: truth grey, found orange, more than 50 mm off red");
        let table = [(-HALF_LENGTH_M, -HALF_WIDTH_M), (HALF_LENGTH_M, HALF_WIDTH_M)];
        self.view(
            &above,
            &title,
            ("y, m", "x, m"),
            (-2.2..2.2, -1.1..1.1),
            &|p| (p[1], p[0]),
            table,
            &[(0.0, -HALF_WIDTH_M), (0.0, HALF_WIDTH_M)],
        )?;
        let table = [(-HALF_LENGTH_M, -0.02), (HALF_LENGTH_M, 0.0)];
        self.view(
            &side,
            "From the side",
            ("y, m", "z, m"),
            (-2.2..2.2, -0.3..1.2),
            &|p| (p[1], p[2]),
            table,
            &[(0.0, 0.0), (0.0, NET_HEIGHT_M)],
        )
    }
}

impl TrajectoryPlot<'_> {
    #[allow(clippy::too_many_arguments)] // What tells the two views apart.
    fn view<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        title: &str,
        axes: (&str, &str),
        shown: (std::ops::Range<f64>, std::ops::Range<f64>),
        project: &dyn Fn([f64; 3]) -> (f64, f64),
        table: [(f64, f64); 2],
        net: &[(f64, f64)],
    ) -> Painted<B> {
        let mut chart = ChartBuilder::on(area)
            .caption(title, (FONT, 20))
            .margin(12)
            .x_label_area_size(38)
            .y_label_area_size(52)
            .build_cartesian_2d(shown.0, shown.1)?;
        chart
            .configure_mesh()
            .x_desc(axes.0)
            .y_desc(axes.1)
            .label_style((FONT, 15))
            .light_line_style(INK.mix(0.03))
            .bold_line_style(INK.mix(0.08))
            .draw()?;
        chart.draw_series([Rectangle::new(table, TABLE.mix(0.15).filled())])?;
        chart.draw_series([PathElement::new(net.to_vec(), ShapeStyle::from(TABLE).stroke_width(2))])?;
        for flight in self.rows.split(|r| r.truth_m.is_none()) {
            let truth = flight.iter().filter_map(|r| r.truth_m).map(project);
            chart.draw_series(LineSeries::new(truth, ShapeStyle::from(TRUTH).stroke_width(2)))?;
        }
        chart.draw_series(self.rows.iter().filter_map(|r| {
            let colour = if r.judgement == Judgement::False { WRONG } else { FOUND };
            Some(Circle::new(project(r.found_m?), 2, colour.filled()))
        }))?;
        Ok(())
    }
}

/// The error over time, with what was missed.
struct ErrorPlot<'a> {
    rows: &'a [Judged],
}

impl Painter for ErrorPlot<'_> {
    fn paint<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        area.fill(&WHITE)?;
        let start = self.rows.first().map_or(0, |r| r.t_ns);
        let seconds = |r: &Judged| (r.t_ns - start) as f64 * 1e-9;
        let hits: Vec<(f64, f64)> = self
            .rows
            .iter()
            .filter_map(|r| match r.judgement {
                Judgement::Hit(error_m) => Some((seconds(r), error_m * 1e3)),
                _ => None,
            })
            .collect();
        let end = self.rows.last().map_or(1.0, seconds).max(1e-3);
        let top = hits.iter().map(|h| h.1).fold(4.0_f64, f64::max) * 1.1;
        let mut chart = ChartBuilder::on(area)
            .caption(
                "Distance from the truth; red below: not found, red above: more than 50 mm off",
                (FONT, 20),
            )
            .margin(12)
            .x_label_area_size(38)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..end, 0.0..top)?;
        chart
            .configure_mesh()
            .x_desc("time, s")
            .y_desc("error, mm")
            .label_style((FONT, 15))
            .light_line_style(INK.mix(0.03))
            .bold_line_style(INK.mix(0.08))
            .draw()?;
        chart.draw_series(hits.iter().map(|h| Circle::new(*h, 1, FOUND.filled())))?;
        let ticks = self.rows.iter().filter_map(|r| match r.judgement {
            Judgement::Missed => Some((seconds(r), 0.0, top * 0.03)),
            Judgement::False => Some((seconds(r), top * 0.95, top)),
            _ => None,
        });
        chart.draw_series(ticks.map(|(t, low, high)| PathElement::new([(t, low), (t, high)], WRONG)))?;
        Ok(())
    }
}

/// How often each latency occurred; logarithmic, so that single late ones are seen.
struct LatencyPlot<'a> {
    latencies_ms: &'a [f64],
}

/// Bars of the latency histogram.
const BARS: usize = 120;

impl Painter for LatencyPlot<'_> {
    fn paint<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        area.fill(&WHITE)?;
        let longest = self.latencies_ms.iter().copied().fold(1.0_f64, f64::max) * 1.001;
        let width = longest / BARS as f64;
        let mut counts = [0_u32; BARS];
        for latency in self.latencies_ms {
            counts[((latency / width) as usize).min(BARS - 1)] += 1;
        }
        let most = f64::from(counts.iter().copied().max().unwrap_or(0).max(1));
        let height = |count: u32| f64::from(count).max(0.1).log10();
        let mut chart = ChartBuilder::on(area)
            .caption("Frame complete in memory to position published", (FONT, 20))
            .margin(12)
            .x_label_area_size(38)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..longest, -0.3..most.log10() + 0.2)?;
        chart
            .configure_mesh()
            .x_desc("latency, ms")
            .y_desc("positions")
            .y_label_formatter(&|v| {
                if v.fract() == 0.0 && *v >= 0.0 { format!("{:.0}", 10_f64.powf(*v)) } else { String::new() }
            })
            .label_style((FONT, 15))
            .light_line_style(INK.mix(0.0))
            .bold_line_style(INK.mix(0.08))
            .draw()?;
        chart.draw_series(counts.iter().enumerate().filter(|(_, count)| **count > 0).map(|(i, count)| {
            let left = i as f64 * width;
            Rectangle::new([(left, -0.3), (left + width, height(*count))], TABLE.mix(0.8).filled())
        }))?;
        Ok(())
    }
}
