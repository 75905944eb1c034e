//! What was learnt, to be looked at.

use std::ops::Range;

use netcord_common::rig::ColourKind;
use netcord_detect::segment::learn::{CellLabel, LabelledFrame, Lesson};
use plotters::{
    chart::ChartBuilder,
    coord::Shift,
    drawing::{DrawingArea, DrawingAreaErrorKind},
    element::{Circle, PathElement, Rectangle, Text},
    prelude::DrawingBackend,
    series::LineSeries,
    style::{Color as _, RGBColor, TRANSPARENT, WHITE},
};

use super::frames::Frame;
use crate::plot::{FONT, Painter};

/// Of the whole picture, px.
pub(super) const SIZE: (u32, u32) = (1500, 1050);

const INK: RGBColor = RGBColor(40, 44, 52);
const BALL: RGBColor = RGBColor(214, 93, 14);
const OTHER: RGBColor = RGBColor(120, 140, 165);
const REGION: RGBColor = RGBColor(206, 232, 206);
const LOST: RGBColor = RGBColor(220, 30, 40);
const FALSE: RGBColor = RGBColor(190, 40, 200);

/// Most crops that are shown, and cells along a side of each.
const CROPS: usize = 25;
const CROP_CELLS: usize = 34;
/// Height of the line under a crop, and what is left free beside it, px.
const NAME: u32 = 18;
const GAP: u32 = 8;
/// Mean width of a letter of that line, px.
const LETTER: u32 = 6;
/// Dots of each kind in the chart.
const DOTS: usize = 4000;

/// A marked ball with what is around it.
#[derive(Debug, Clone)]
pub(super) struct MarkedBall {
    name: String,
    /// Row by row, `CROP_CELLS` in each; none outside the image.
    cells: Vec<Option<([f64; 3], CellLabel)>>,
}

impl MarkedBall {
    /// Of a frame's labels.
    pub(super) fn of(frame: &Frame, labelled: &LabelledFrame) -> Vec<Self> {
        // There is little room: without the folders.
        let name = frame.name.rsplit('/').next().unwrap_or(&frame.name);
        let (columns, rows) = labelled.size;
        let crop = |ball: &Vec<usize>| {
            let n = ball.len().max(1);
            let middle = |at: &dyn Fn(usize) -> usize| ball.iter().map(|i| at(*i)).sum::<usize>() / n;
            let (x, y) = (middle(&|i| i % columns), middle(&|i| i / columns));
            let half = CROP_CELLS / 2;
            (0..CROP_CELLS * CROP_CELLS)
                .map(|n| {
                    let x = (x + n % CROP_CELLS).checked_sub(half).filter(|x| *x < columns)?;
                    let y = (y + n / CROP_CELLS).checked_sub(half).filter(|y| *y < rows)?;
                    let i = y * columns + x;
                    Some((labelled.rgb(i), labelled.labels[i]))
                })
                .collect()
        };
        labelled
            .balls
            .iter()
            .map(|(_, ball)| Self { name: name.replace(" of camera ", ", "), cells: crop(ball) })
            .collect()
    }
}

/// A lesson, to be drawn.
pub(super) struct LessonPlot {
    cameras: String,
    lesson: Lesson,
    balls: Vec<MarkedBall>,
}

impl LessonPlot {
    pub(super) fn new(cameras: &str, lesson: Lesson, balls: &[MarkedBall]) -> Self {
        Self { cameras: cameras.to_owned(), lesson, balls: balls.to_vec() }
    }

    fn passes(&self, rgb: &[f64; 3]) -> bool {
        self.lesson
            .colour
            .tests()
            .iter()
            .all(|test| test.weights.iter().zip(rgb).map(|(w, level)| w * level).sum::<f64>() > test.bound)
    }

    /// ln R / G and ln B / G; of grey cells the level and nothing.
    fn place(&self, rgb: &[f64; 3]) -> (f64, f64) {
        let [r, g, b] = rgb.map(|level| (level.max(0.0) + 1.0).ln());
        if self.lesson.colour.kind == ColourKind::Grey { (rgb[1], 0.0) } else { (r - g, b - g) }
    }

    /// What of the plane is shown: where nearly all cells lie, and the surroundings of the ball's colour in any case.
    fn spread(&self, ball: (f64, f64)) -> (Range<f64>, Range<f64>) {
        let places: Vec<(f64, f64)> = [CellLabel::Ball, CellLabel::Other]
            .iter()
            .flat_map(|l| self.cells(*l))
            .map(|c| self.place(&c))
            .collect();
        let span = |middle: f64, pick: fn(&(f64, f64)) -> f64| {
            let mut values: Vec<f64> = places.iter().map(pick).collect();
            values.sort_by(f64::total_cmp);
            let rank =
                |share: f64| values.get((share * values.len() as f64) as usize).copied().unwrap_or(middle);
            let (low, high) = (rank(0.002).min(middle - 0.5), rank(0.998).max(middle + 0.5));
            let rim = 0.05 * (high - low);
            low - rim..high + rim
        };
        (span(ball.0, |p| p.0), span(ball.1, |p| p.1))
    }

    fn cells(&self, wanted: CellLabel) -> impl Iterator<Item = [f64; 3]> + '_ {
        let all = self.balls.iter().flat_map(|ball| ball.cells.iter().flatten());
        all.filter(move |(_, label)| *label == wanted).map(|(rgb, _)| *rgb)
    }

    /// Colours of the ball and of what is around it, over the region that passes at the ball's brightness.
    fn colours<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        let grey = self.lesson.colour.kind == ColourKind::Grey;
        let [m0, m1, level] = self.lesson.colour.mean;
        let (xs, ys) = if grey { (0.0..256.0, -1.0..1.0) } else { self.spread((m0, m1)) };
        let title = format!("{}: colours around the marked balls, and the region learnt", self.cameras);
        let mut chart = ChartBuilder::on(area)
            .caption(title, (FONT, 18))
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(52)
            .build_cartesian_2d(xs.clone(), ys.clone())?;
        let (wide, high) = (120, 120);
        let step = ((xs.end - xs.start) / f64::from(wide), (ys.end - ys.start) / f64::from(high));
        let inside = (0..wide * high).filter_map(|n| {
            let (x, y) = (xs.start + f64::from(n % wide) * step.0, ys.start + f64::from(n / wide) * step.1);
            let g = level.exp();
            let rgb = if grey { [x; 3] } else { [g * x.exp(), g, g * y.exp()] };
            self.passes(&rgb).then_some([(x, y), (x + step.0, y + step.1)])
        });
        let inside = inside.collect::<Vec<_>>();
        chart.draw_series(inside.into_iter().map(|corners| Rectangle::new(corners, REGION.filled())))?;
        let labels = if grey { ("level, DN", "") } else { ("ln R / G", "ln B / G") };
        chart
            .configure_mesh()
            .disable_mesh()
            .x_desc(labels.0)
            .y_desc(labels.1)
            .label_style((FONT, 13))
            .draw()?;
        for (label, colour, lift) in [(CellLabel::Other, OTHER, -0.3), (CellLabel::Ball, BALL, 0.3)] {
            let count = self.cells(label).count();
            let dots = self.cells(label).step_by(count / DOTS + 1).enumerate().map(|(n, rgb)| {
                let (x, y) = self.place(&rgb);
                // Grey levels are spread, so that they are seen.
                let y = if grey { lift + 0.25 * ((n % 17) as f64 / 17.0 - 0.5) } else { y };
                (x, y)
            });
            // A dot beyond the edge would be drawn on it.
            let dots = dots.filter(|(x, y)| xs.contains(x) && ys.contains(y)).collect::<Vec<_>>();
            chart.draw_series(dots.into_iter().map(|at| Circle::new(at, 2, colour.mix(0.6).filled())))?;
        }
        Ok(())
    }

    /// What is kept against what is let through.
    fn roc<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        let separation = &self.lesson.separation;
        let (kept, through) = (separation.confusion.kept(), separation.confusion.let_through());
        let of = if separation.held_out { "frames not learnt from" } else { "the one marked frame" };
        let title = format!(
            "{of}: {:.1} % kept, {:.2} % let through, area {:.4}",
            100.0 * kept,
            100.0 * through,
            separation.area
        );
        let most = (4.0 * through).clamp(0.01, 1.0);
        let mut chart = ChartBuilder::on(area)
            .caption(title, (FONT, 18))
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..most, 0.0..1.02)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .x_desc("share of other cells let through")
            .y_desc("share of the ball's cells kept")
            .label_style((FONT, 13))
            .draw()?;
        let points = separation.roc.iter().map(|p| (p.let_through, p.kept)).filter(|p| p.0 <= most);
        chart.draw_series(LineSeries::new(points, BALL.stroke_width(2)))?;
        chart.draw_series([Circle::new((through.min(most), kept), 5, INK.filled())])?;
        Ok(())
    }

    /// The marked balls, with the outline of their cells, and of the cells that pass.
    fn crops<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        let (title, panels) = area.split_vertically(28);
        let text = "marked balls: their cells (orange outline), those of them that are stopped (red), others that pass \
                    (magenta)";
        title.draw(&Text::new(text, (12, 6), (FONT, 16)))?;
        let step = self.balls.len().div_ceil(CROPS).max(1);
        let shown: Vec<&MarkedBall> = self.balls.iter().step_by(step).collect();
        let (columns, crop) = layout(shown.len(), panels.dim_in_pixel());
        for (place, ball) in shown.iter().enumerate() {
            let corner = [place % columns * (crop + GAP) as usize, place / columns * (crop + NAME) as usize];
            let [left, top] = corner.map(|v| v as i32);
            // Cells differ by a pixel where the crop's side is no multiple of theirs.
            let edge = |n: usize| (n * crop as usize / CROP_CELLS) as i32;
            let corner = |column: usize, row: usize| (left + edge(column), top + edge(row));
            let at = |n: usize| {
                let (column, row) = (n % CROP_CELLS, n / CROP_CELLS);
                [corner(column, row), corner(column + 1, row + 1)]
            };
            let cells = ball.cells.iter().enumerate().filter_map(|(n, cell)| Some((n, (*cell)?)));
            for (n, (rgb, label)) in cells {
                let shown = rgb.map(|level| (255.0 * (level / 255.0).clamp(0.0, 1.0).powf(0.8)) as u8);
                let colour = match (label, self.passes(&rgb)) {
                    (CellLabel::Ball, false) => LOST,
                    (CellLabel::Other, true) => FALSE,
                    _ => RGBColor(shown[0], shown[1], shown[2]),
                };
                // What is filled ends before its second corner.
                panels.draw(&Rectangle::new(at(n), colour.filled()))?;
            }
            let is_ball =
                |n: usize| ball.cells.get(n).copied().flatten().is_some_and(|(_, l)| l == CellLabel::Ball);
            for n in (0..ball.cells.len()).filter(|n| is_ball(*n)) {
                let [(x, y), (right, bottom)] = at(n);
                let column = n % CROP_CELLS;
                let edges = [
                    (column > 0 && !is_ball(n - 1), [(x, y), (x, bottom)]),
                    (column + 1 < CROP_CELLS && !is_ball(n + 1), [(right, y), (right, bottom)]),
                    (n >= CROP_CELLS && !is_ball(n - CROP_CELLS), [(x, y), (right, y)]),
                    (!is_ball(n + CROP_CELLS), [(x, bottom), (right, bottom)]),
                ];
                for (_, line) in edges.into_iter().filter(|(is_edge, _)| *is_edge) {
                    panels.draw(&PathElement::new(line.to_vec(), BALL.stroke_width(2)))?;
                }
            }
            let name: String = ball.name.chars().take((crop / LETTER) as usize).collect();
            panels.draw(&Text::new(name, (left, top + crop as i32 + 2), (FONT, 12)))?;
        }
        Ok(())
    }
}

/// How many crops stand side by side, and the side of each, px: as large as so many can be on an area of this size.
fn layout(crops: usize, (width, height): (u32, u32)) -> (usize, u32) {
    let side = |columns: usize| {
        let rows = crops.div_ceil(columns).max(1) as u32;
        let (across, down) = (width / columns as u32, height / rows);
        across.saturating_sub(GAP).min(down.saturating_sub(NAME))
    };
    let all = (1..=crops.max(1)).map(|columns| (columns, side(columns)));
    // Of two that are as large, the one with fewer columns.
    all.rev().max_by_key(|(_, side)| *side).unwrap_or((1, 0))
}

type Painted<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

impl Painter for LessonPlot {
    fn paint<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Painted<B> {
        area.fill(&WHITE)?;
        let (left, right) = area.split_horizontally(560);
        let (upper, lower) = left.split_vertically(600);
        self.colours(&upper)?;
        self.roc(&lower)?;
        self.crops(&right)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crops_fill_the_area_however_many_there_are() {
        for crops in 1..=CROPS {
            let (columns, side) = layout(crops, (940, 1022));
            let rows = crops.div_ceil(columns) as u32;
            assert!(columns as u32 * (side + GAP) <= 940 && rows * (side + NAME) <= 1022, "{crops}");
            let larger = side + 1;
            for others in 1..=crops {
                let rows = crops.div_ceil(others) as u32;
                let fit = others as u32 * (larger + GAP) <= 940 && rows * (larger + NAME) <= 1022;
                assert!(!fit, "{crops} crops fit {others} a row with a side of {larger} px");
            }
        }
        assert_eq!(layout(CROPS, (940, 1022)).0, 5);
    }
}
