//! `netcord compare --input`: the segmenter on the mosaic, on interpolated frames and at half resolution, over
//! the same rendered frames.

use std::{path::Path, sync::Arc, time::Instant};

use netcord_capture::synthetic::{
    render::{Exposure, FrameRenderer},
    scene::{Preset, Scene, SceneOptions},
};
use netcord_common::{
    FrameView,
    rig::Rig,
    wire::{CameraTruth, Detection, FrameHeader, Scope, Stamps},
};
use netcord_detect::segment::{InputMode, SCORE_THRESHOLD, SegmentOptions, Segmenter};
use plotters::{
    chart::{ChartBuilder, SeriesLabelPosition},
    coord::{Shift, combinators::IntoLogRange},
    drawing::{DrawingArea, DrawingAreaErrorKind},
    element::PathElement,
    prelude::{BindKeyPoints, DrawingBackend},
    series::LineSeries,
    style::{Color as _, RGBColor, ShapeStyle, TRANSPARENT, WHITE},
};
use serde::Serialize;

use crate::plot::{self, FONT, Painter, PlotError, log_ticks};

/// Frames in which background and colour are learnt; they are not judged.
const WARM_UP: u64 = 30;
/// A box whose centre is nearer than this to the ball's is the ball's, px.
const NEAR_PX: f64 = 5.0;
/// Share of the ball that must be visible for it to count.
const SEEN: f64 = 0.5;
/// Where the plot's axis begins and ends, px.
const AXIS_PX: (f64, f64) = (0.01, NEAR_PX);

const COLOURS: [RGBColor; 4] =
    [RGBColor(214, 39, 40), RGBColor(31, 119, 180), RGBColor(44, 160, 44), RGBColor(148, 103, 189)];

/// How one kind of input did in one scene.
#[derive(Debug, Serialize)]
pub(super) struct InputRow {
    scene: &'static str,
    input: &'static str,
    /// Images in which at least half of the ball was visible.
    balls: usize,
    /// Share of them with a box of a score of at least one half within 5 px.
    recall: f64,
    /// Distance of the box's centre from the ball's, px.
    error_px: ErrorPx,
    /// Boxes of a score of at least one half elsewhere, per frame; balls that lie about are among them.
    other_boxes: f64,
    /// Median time for a frame on one core, conversion included, ms.
    ms: f64,
    #[serde(skip)]
    errors_px: Vec<f64>,
}

#[derive(Debug, Serialize)]
struct ErrorPx {
    median: Option<f64>,
    rms: Option<f64>,
    p95: Option<f64>,
}

/// Searches `frames` rendered frames of each camera of `rig` in each scene with each kind of input.
pub(super) fn measure(
    rig: &Rig,
    seed: u64,
    frames: u64,
) -> Result<Vec<InputRow>, Box<dyn std::error::Error>> {
    let mut rows = Vec::new();
    for preset in Preset::ALL {
        let scene = Arc::new(Scene::new(rig, &SceneOptions { preset, seed, ..SceneOptions::default() })?);
        let mut tallies: Vec<Tally> = InputMode::ALL.iter().map(|_| Tally::default()).collect();
        for camera in 0..rig.cameras.len() {
            search_all(rig, camera, &scene, frames, &mut tallies)?;
        }
        rows.extend(
            InputMode::ALL.iter().zip(tallies).map(|(input, tally)| tally.row(preset.name(), *input)),
        );
    }
    Ok(rows)
}

/// One camera's frames, each searched with every kind of input in turn, so that a busy machine costs all alike.
fn search_all(
    rig: &Rig,
    camera: usize,
    scene: &Arc<Scene>,
    frames: u64,
    tallies: &mut [Tally],
) -> Result<(), Box<dyn std::error::Error>> {
    let own = &rig.cameras[camera];
    let size = (own.model.width as usize, own.model.height as usize);
    let mut renderer = FrameRenderer::new(scene, own);
    let mut segmenters = InputMode::ALL
        .iter()
        .map(|input| {
            Segmenter::new(rig, camera, SegmentOptions { input: *input, ..SegmentOptions::default() })
        })
        .collect::<Result<Vec<_>, _>>()?;
    let exposure_ns = scene.exposure_ns.unwrap_or(own.exposure_ns);
    let mut mosaic = vec![0; size.0 * size.1];
    for n in 0..WARM_UP + frames {
        let at_ns = 1_000_000_000 + n * rig.interval_ns();
        let exposure = Exposure { frame: n, mid_s: at_ns as f64 * 1e-9, length_s: exposure_ns as f64 * 1e-9 };
        let truth = renderer.render(&exposure, &mut mosaic);
        let view = FrameView::new(&mosaic, size, size.0, own.pixel_format)?;
        let stamps = Stamps { mid_exposure_ns: at_ns, mid_exposure_host_ns: at_ns, ..Stamps::default() };
        let header =
            FrameHeader { trigger_id: n + 1, sequence: n, exposure_ns, stamps, ..FrameHeader::default() };
        for (segmenter, tally) in segmenters.iter_mut().zip(&mut *tallies) {
            let begun = Instant::now();
            let mut found = Vec::new();
            segmenter.process(&header, &view, None, &mut |detections| {
                if detections.scope == Scope::Full.code() {
                    found.extend_from_slice(detections.items());
                }
            })?;
            if n >= WARM_UP {
                tally.see(&truth, &found, begun.elapsed().as_secs_f64() * 1e3);
            }
        }
    }
    Ok(())
}

#[derive(Debug, Default)]
struct Tally {
    frames: usize,
    balls: usize,
    errors_px: Vec<f64>,
    others: usize,
    times_ms: Vec<f64>,
}

impl Tally {
    fn see(&mut self, truth: &CameraTruth, found: &[Detection], ms: f64) {
        self.frames += 1;
        self.times_ms.push(ms);
        let off = |d: &Detection| (d.u_px - truth.u_px).hypot(d.v_px - truth.v_px);
        let is_ball = |d: &&Detection| truth.visible > 0.0 && off(d) < NEAR_PX;
        let good = || found.iter().filter(|d| d.score >= SCORE_THRESHOLD);
        self.others += good().filter(|d| !is_ball(d)).count();
        if truth.visible >= SEEN {
            self.balls += 1;
            self.errors_px.extend(good().filter(is_ball).map(off).min_by(f64::total_cmp));
        }
    }

    fn row(mut self, scene: &'static str, input: InputMode) -> InputRow {
        self.errors_px.sort_by(f64::total_cmp);
        self.times_ms.sort_by(f64::total_cmp);
        let n = self.errors_px.len();
        let at = |share: f64| self.errors_px.get((share * n as f64) as usize).copied();
        let square = self.errors_px.iter().map(|e| e * e).sum::<f64>() / n as f64;
        InputRow {
            scene,
            input: input.name(),
            balls: self.balls,
            recall: n as f64 / self.balls.max(1) as f64,
            error_px: ErrorPx { median: at(0.5), rms: (n > 0).then(|| square.sqrt()), p95: at(0.95) },
            other_boxes: self.others as f64 / self.frames.max(1) as f64,
            ms: self.times_ms.get(self.times_ms.len() / 2).copied().unwrap_or(0.0),
            errors_px: self.errors_px,
        }
    }
}

/// Prints the rows as a table.
pub(super) fn print(rows: &[InputRow]) {
    println!(
        "scene    input       balls  recall    centre: median / RMS / 95 %, px   other boxes   ms a frame"
    );
    for row in rows {
        let px = |v: Option<f64>| v.map_or_else(|| "-".into(), |v| format!("{v:.3}"));
        let e = &row.error_px;
        let errors = format!("{} / {} / {}", px(e.median), px(e.rms), px(e.p95));
        println!(
            "{:<8} {:<11} {:>5} {:>6.2} %   {errors:>30}   {:>9.2}   {:>10.2}",
            row.scene,
            row.input,
            row.balls,
            100.0 * row.recall,
            row.other_boxes,
            row.ms
        );
    }
}

/// Draws, scene by scene, the share of all balls whose centre was found to within what the axis tells.
pub(super) fn draw(path: &Path, rows: &[InputRow]) -> Result<(), PlotError> {
    let panels = u32::try_from(rows.len() / InputMode::ALL.len()).unwrap_or(1);
    plot::draw(path, (520 * panels, 430), &InputPlot { rows })
}

struct InputPlot<'a> {
    rows: &'a [InputRow],
}

type Painted<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

impl Painter for InputPlot<'_> {
    fn paint<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        area.fill(&WHITE)?;
        let scenes: Vec<_> = self.rows.chunks(InputMode::ALL.len()).collect();
        for (rows, area) in scenes.iter().zip(area.split_evenly((1, scenes.len()))) {
            let mut chart = ChartBuilder::on(&area)
                .caption(format!("scene {}", rows[0].scene), (FONT, 20))
                .margin(12)
                .x_label_area_size(38)
                .y_label_area_size(60)
                .build_cartesian_2d(
                    (AXIS_PX.0..AXIS_PX.1).log_scale().with_key_points(log_ticks(AXIS_PX.0, AXIS_PX.1)),
                    0.0..100.0,
                )?;
            chart
                .configure_mesh()
                .x_desc("error of the centre, px")
                .y_desc("balls found to within it, %")
                .x_label_formatter(&|px| format!("{px}"))
                .y_label_formatter(&|percent| format!("{percent:.0}"))
                .light_line_style(TRANSPARENT)
                .label_style((FONT, 15))
                .draw()?;
            for (row, colour) in rows.iter().zip(COLOURS) {
                let style = ShapeStyle::from(colour).stroke_width(2);
                let share = |n: usize| 100.0 * n as f64 / row.balls.max(1) as f64;
                let steps = row.errors_px.iter().enumerate().map(|(n, e)| (e.max(AXIS_PX.0), share(n + 1)));
                chart
                    .draw_series(LineSeries::new(steps, style))?
                    .label(row.input)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
            }
            chart
                .configure_series_labels()
                // Where the curves are high.
                .position(SeriesLabelPosition::LowerRight)
                .label_font((FONT, 15))
                .background_style(WHITE.mix(0.8))
                .draw()?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_likely_boxes_near_the_ball_are_the_balls() {
        let detection =
            |u_px: f64, score: f64| Detection { u_px, v_px: 100.4, score, ..Detection::default() };
        let mut truth = CameraTruth { u_px: 100.0, v_px: 100.0, visible: 1.0 };
        let mut tally = Tally::default();
        tally.see(&truth, &[detection(300.0, 0.9), detection(100.0, 0.2), detection(100.3, 0.9)], 1.0);
        tally.see(&truth, &[detection(100.0, 0.4)], 3.0);
        truth.visible = 0.3;
        tally.see(&truth, &[detection(100.3, 0.9)], 2.0);
        let row = tally.row("normal", InputMode::Raw);
        assert_eq!((row.balls, row.recall, row.other_boxes, row.ms), (2, 0.5, 1.0 / 3.0, 2.0));
        assert!((row.error_px.median.expect("one ball") - 0.5).abs() < 1e-12, "{:?}", row.error_px);
    }
}
