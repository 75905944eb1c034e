use netcord_common::wire::{BallPosition, BallTrajectory, LandingKind};
use plotters::{
    coord::Shift,
    drawing::{DrawingArea, DrawingAreaErrorKind},
    prelude::*,
};

use super::content::Content;
use crate::plot::{FONT, Painter};

type Failed<B> = DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>;

/// Half the table's width and length, and the net's height (ITTF Laws 2.1 and 2.2), m.
const HALF_WIDTH: f64 = 0.7625;
const HALF_LENGTH: f64 = 1.37;
const NET_HEIGHT: f64 = 0.1525;
/// Half the width of the net with its posts, m.
const HALF_NET: f64 = 0.915;

/// The table's surroundings that are shown at most, m from its centre.
const FURTHEST: f64 = 3.0;

/// Positions from so long before until so long after a drawn prediction are those to compare it with, ns.
const BEFORE_NS: u64 = 300_000_000;
const AFTER_NS: u64 = 1_000_000_000;

const FOUND: RGBColor = RGBColor(230, 110, 20);
const TRUE: RGBColor = RGBColor(90, 90, 90);
const PREDICTED: RGBColor = RGBColor(20, 110, 220);
const LANDING: RGBColor = RGBColor(210, 20, 70);

/// Three views of the scene, and the errors over time.
pub(super) struct Drawing<'a> {
    pub(super) content: &'a Content,
    pub(super) predictions: &'a [&'a BallTrajectory],
}

/// From a point of the table frame, m, to a point of the picture's plane, m.
#[derive(Clone, Copy)]
enum View {
    Above,
    Side,
    Perspective,
}

impl View {
    fn title(self) -> &'static str {
        match self {
            Self::Above => "from above",
            Self::Side => "from the side",
            Self::Perspective => "in perspective",
        }
    }

    fn project(self, [x, y, z]: [f64; 3]) -> (f64, f64) {
        match self {
            Self::Above => (y, -x),
            Self::Side => (y, z),
            Self::Perspective => {
                // An eye 5 m from the table's centre, to the side, behind one end and above.
                let (eye, back) = ([3.2, -3.2, 2.2], (3.2_f64 * 3.2 * 2.0 + 2.2 * 2.2).sqrt());
                let forward = eye.map(|e| -e / back);
                let across = (forward[0].powi(2) + forward[1].powi(2)).sqrt();
                let right = [forward[1] / across, -forward[0] / across, 0.0];
                let up = [
                    right[1] * forward[2],
                    -right[0] * forward[2],
                    right[0] * forward[1] - right[1] * forward[0],
                ];
                let seen = [x - eye[0], y - eye[1], z - eye[2]];
                let dot = |a: [f64; 3]| a[0] * seen[0] + a[1] * seen[1] + a[2] * seen[2];
                let depth = dot(forward).max(0.1);
                (back * dot(right) / depth, back * dot(up) / depth)
            }
        }
    }

    /// What stands along the two axes, m.
    fn axes(self) -> (&'static str, &'static str) {
        match self {
            Self::Above => ("y, along the table (m)", "x (m)"),
            Self::Side => ("y, along the table (m)", "z (m)"),
            Self::Perspective => ("", ""),
        }
    }

    /// The table frame's coordinate that belongs to one of the picture's upper axis.
    fn upper(self, value: f64) -> f64 {
        if matches!(self, Self::Above) { -value } else { value }
    }

    /// What of the plane is shown at least.
    fn frame(self) -> [(f64, f64); 2] {
        match self {
            Self::Above => [(-1.9, -1.0), (1.9, 1.0)],
            Self::Side => [(-1.9, -0.3), (1.9, 1.0)],
            Self::Perspective => [(-1.9, -0.9), (1.9, 1.1)],
        }
    }
}

impl Painter for Drawing<'_> {
    fn paint<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), Failed<B>> {
        area.fill(&WHITE)?;
        let (upper, lower) = if self.content.truth.is_empty() {
            (area.clone(), None)
        } else {
            let (upper, lower) = area.split_vertically(1000);
            (upper, Some(lower))
        };
        let parts = upper.split_evenly((2, 2));
        self.view(&parts[0], View::Above)?;
        self.view(&parts[1], View::Perspective)?;
        self.view(&parts[2], View::Side)?;
        self.legend(&parts[3])?;
        match lower {
            Some(lower) => self.errors(&lower),
            None => Ok(()),
        }
    }
}

impl Drawing<'_> {
    fn view<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, view: View) -> Result<(), Failed<B>> {
        // Beside what was predicted, the rest is only there to be compared with.
        let solid = |p: &BallPosition| {
            let near = |t: &&BallTrajectory| {
                let (at, since) = (p.stamps.mid_exposure_ns, t.stamps.mid_exposure_ns);
                at + BEFORE_NS > since && at < since + AFTER_NS
            };
            self.predictions.iter().any(near)
        };
        let found =
            self.content.positions.iter().map(|p| (view.project(p.position_m), solid(p))).collect::<Vec<_>>();
        let truth = self.content.truth.values().map(|p| view.project(*p)).collect::<Vec<_>>();
        let paths = self.predictions.iter().map(|prediction| {
            let start = std::iter::once((prediction.position_m, 1.0));
            let path = start.chain(prediction.path().iter().map(|p| (p.position_m, p.confidence)));
            path.map(|(p, sure)| (view.project(p), sure)).collect::<Vec<_>>()
        });
        let paths = paths.collect::<Vec<_>>();
        let predicted = paths.iter().flatten().map(|(p, _)| *p);
        let found_places = || found.iter().map(|(p, _)| *p);
        let all = || found_places().chain(truth.iter().copied()).chain(predicted.clone()).chain(view.frame());
        let span = |pick: fn((f64, f64)) -> f64| {
            let values = || all().map(pick);
            let (low, high) = (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
            // A wild outlier must not make the rest a dot.
            (low.max(-FURTHEST) - 0.05)..(high.min(FURTHEST) + 0.05)
        };
        let (across, up) = (span(|p| p.0), span(|p| p.1));
        // A line beyond the edge would be drawn along it.
        let is_shown = |p: &(f64, f64)| across.contains(&p.0) && up.contains(&p.1);
        let mut chart = ChartBuilder::on(area)
            .caption(view.title(), (FONT, 20))
            .margin(12)
            .set_label_area_size(LabelAreaPosition::Left, 56)
            .set_label_area_size(LabelAreaPosition::Bottom, 40)
            .build_cartesian_2d(across.clone(), up.clone())?;
        if !matches!(view, View::Perspective) {
            let (below, beside) = view.axes();
            chart
                .configure_mesh()
                .light_line_style(TRANSPARENT)
                .label_style((FONT, 14))
                .x_label_formatter(&|v| tick(*v))
                .y_label_formatter(&|v| tick(view.upper(*v)))
                .x_desc(below)
                .y_desc(beside)
                .draw()?;
        }
        for outline in outlines() {
            let line = outline.iter().map(|p| view.project(*p));
            chart.draw_series(LineSeries::new(line, BLACK.mix(0.6).stroke_width(2)))?;
        }
        let truth = truth.iter().filter(|p| is_shown(p));
        chart.draw_series(truth.map(|p| Circle::new(*p, 2, TRUE.mix(0.7).filled())))?;
        for pale in [true, false] {
            let found = found.iter().filter(|(p, solid)| is_shown(p) && *solid != pale);
            let colour = FOUND.mix(if pale { 0.2 } else { 1.0 });
            chart.draw_series(found.map(|(p, _)| Circle::new(*p, 2, colour.filled())))?;
        }
        for (number, (prediction, path)) in (1..).zip(self.predictions.iter().zip(&paths)) {
            for pair in path.windows(2).filter(|pair| pair.iter().all(|(p, _)| is_shown(p))) {
                let shade = PREDICTED.mix(0.15 + 0.85 * pair[1].1.clamp(0.0, 1.0)).stroke_width(3);
                chart.draw_series(LineSeries::new([pair[0].0, pair[1].0], shade))?;
            }
            chart.draw_series(
                path.iter().take(1).map(|(p, _)| Circle::new(*p, 5, PREDICTED.stroke_width(2))),
            )?;
            chart.draw_series(path.iter().take(1).filter(|(p, _)| is_shown(p)).map(|(p, _)| {
                EmptyElement::at(*p)
                    + Text::new(number.to_string(), (7, -20), (FONT, 18).into_font().color(&PREDICTED))
            }))?;
            if prediction.landing.kind != LandingKind::None.code() {
                let [x, y] = prediction.landing.position_m;
                let at = view.project([x, y, 0.0]);
                let cross = is_shown(&at).then(|| Cross::new(at, 6, LANDING.stroke_width(2)));
                chart.draw_series(cross)?;
            }
        }
        Ok(())
    }

    /// What the signs mean, and what came of the predictions.
    fn legend<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), Failed<B>> {
        let text = |words: &str, y: i32| Text::new(words.to_owned(), (78, y - 9), (FONT, 18));
        area.draw(&Circle::new((60, 40), 4, FOUND.filled()))?;
        area.draw(&text("measured; pale where no drawn prediction is near in time", 40))?;
        let mut y = 70;
        if !self.content.truth.is_empty() {
            area.draw(&Circle::new((60, y), 4, TRUE.filled()))?;
            area.draw(&text("truth", y))?;
            y += 30;
        }
        area.draw(&PathElement::new([(48, y), (72, y)], PREDICTED.stroke_width(3)))?;
        area.draw(&text("predicted from the ring on, paler where less sure", y))?;
        y += 30;
        area.draw(&Cross::new((60, y), 6, LANDING.stroke_width(2)))?;
        area.draw(&text("where it was predicted to come down", y))?;
        y += 44;
        for (number, prediction) in (1..).zip(self.predictions) {
            let line = self.outcome(number, prediction);
            area.draw(&Text::new(line, (48, y - 9), (FONT, 17).into_font().color(&PREDICTED)))?;
            y += 28;
        }
        Ok(())
    }

    /// One prediction in words: when, and how far it was off.
    fn outcome(&self, number: u32, prediction: &BallTrajectory) -> String {
        let at_s = self.content.seconds(prediction.stamps.mid_exposure_ns);
        let off = self.content.prediction_errors(prediction).into_iter();
        let off = off.map(|(ms, mm)| format!("{mm:.0} mm after {ms} ms")).collect::<Vec<_>>().join(", ");
        let off = if off.is_empty() { String::new() } else { format!(", off by {off}") };
        format!("{number}: made at {at_s:.2} s{off}")
    }

    fn errors<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), Failed<B>> {
        let errors = self.content.errors();
        let last_s = errors.last().map_or(1.0, |(t, _)| t.max(0.1));
        let quantiles = self.content.error_quantiles();
        let top = quantiles.map_or(1.0, |(_, p95)| (2.0 * p95).max(1.0));
        let beyond = errors.iter().filter(|(_, e)| *e > top).count();
        let beyond = if beyond > 0 { format!("; {beyond} beyond the scale") } else { String::new() };
        let title = match quantiles {
            Some((median, p95)) => {
                format!("measured against the truth (mm): median {median:.2}, 95 % {p95:.2}{beyond}")
            }
            None => "measured against the truth: no position is of an instant that has one".to_owned(),
        };
        let mut chart = ChartBuilder::on(area)
            .caption(title, (FONT, 20))
            .margin(12)
            .set_label_area_size(LabelAreaPosition::Left, 40)
            .set_label_area_size(LabelAreaPosition::Bottom, 28)
            .build_cartesian_2d(0.0..last_s, 0.0..top)?;
        chart.configure_mesh().light_line_style(TRANSPARENT).x_desc("s").label_style((FONT, 14)).draw()?;
        chart.draw_series(
            errors.iter().filter(|(_, e)| *e <= top).map(|p| Circle::new(*p, 2, FOUND.filled())),
        )?;
        Ok(())
    }
}

/// A coordinate at an axis.
fn tick(value: f64) -> String {
    // Not −0.0.
    format!("{:.1}", if value.abs() < 0.05 { 0.0 } else { value })
}

/// Table, centre line and net.
fn outlines() -> [Vec<[f64; 3]>; 3] {
    let (x, y) = (HALF_WIDTH, HALF_LENGTH);
    let flat = |points: &[(f64, f64)]| points.iter().map(|(x, y)| [*x, *y, 0.0]).collect::<Vec<_>>();
    [
        flat(&[(-x, -y), (x, -y), (x, y), (-x, y), (-x, -y)]),
        flat(&[(0.0, -y), (0.0, y)]),
        [
            (-HALF_NET, 0.0),
            (HALF_NET, 0.0),
            (HALF_NET, NET_HEIGHT),
            (-HALF_NET, NET_HEIGHT),
            (-HALF_NET, 0.0),
        ]
        .map(|(x, z)| [x, 0.0, z])
        .to_vec(),
    ]
}
