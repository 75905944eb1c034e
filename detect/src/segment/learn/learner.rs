use netcord_common::{
    FrameView, PixelFormat,
    rig::{ColourKind, LearntColour},
};

use super::{
    CellLabel, Confusion, LabelledFrame, LearnError, Mark, MarkError, RocPoint, Separation,
    error::MOST_LET_THROUGH, polytope::Polytope, separation::curve,
};
use crate::segment::{
    colour::{colour_of, place_of},
    kernel::ColourGate,
};

/// Cells of the ball that are needed.
const LEAST_CELLS: usize = 40;
/// Cells that one ball may give: large ones must not outweigh small ones.
const CELLS_OF_BALL: usize = 250;
/// Other cells that all frames together give; those that share colours with the ball decide.
const OTHER_CELLS: usize = 30_000;
/// Parts into which frames are divided, each to be judged by what the others teach.
const FOLDS: usize = 5;
/// Share of the ball's cells that the threshold keeps, in frames that were not learnt from.
const KEEP: f64 = 0.95;
/// … where no more than this share of the other cells passes.
const FEW: f64 = 0.05;
/// Share of the ball's cells below which a gate loses the ball's outline: what is left has no longer its shape.
const LEAST_KEPT: f64 = 0.5;
/// Area under the curve below which colour hardly tells: of three pairs of cells it would confuse one.
const LEAST_AREA: f64 = 0.7;
/// How far all planes may be moved outwards for that, standard deviations of the ball's colours.
const MOST_MARGIN: f64 = 1.5;

/// Gathers marked frames of cameras that see colours alike.
#[derive(Debug, Default)]
pub struct Learner {
    frames: Vec<Frame>,
}

/// The labelled cells of one frame.
#[derive(Debug)]
struct Frame {
    format: PixelFormat,
    /// Cells of each ball.
    balls: Vec<Vec<[u8; 4]>>,
    diameters: Vec<f64>,
    other: Vec<[u8; 4]>,
}

impl Frame {
    fn rgb(&self, cell: &[u8; 4]) -> [f64; 3] {
        colour_of(self.format, |dx, dy| f32::from(cell[2 * dy + dx])).map(f64::from)
    }
}

/// What was learnt.
#[derive(Debug, Clone, PartialEq)]
pub struct Lesson {
    /// For the rig file.
    pub colour: LearntColour,
    /// How well it tells the ball.
    pub separation: Separation,
    /// Marked frames.
    pub frames: usize,
    /// Marked balls.
    pub balls: usize,
    /// Cells of theirs.
    pub ball_cells: usize,
}

impl Learner {
    /// Nothing gathered yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Learns from a frame of which *all* balls are marked; tells how its cells were labelled.
    ///
    /// # Errors
    /// [`MarkError`]; then nothing was learnt from the frame.
    pub fn see(&mut self, view: &FrameView<'_>, marks: &[Mark]) -> Result<LabelledFrame, MarkError> {
        let labelled = LabelledFrame::new(view, marks)?;
        let cells_of = |ball: &Vec<usize>| thinned(ball, CELLS_OF_BALL).map(|i| labelled.cells[*i]).collect();
        let other =
            (0..labelled.cells.len()).filter(|i| labelled.labels[*i] == CellLabel::Other).collect::<Vec<_>>();
        self.frames.push(Frame {
            format: view.format(),
            balls: labelled.balls.iter().map(|(_, ball)| cells_of(ball)).collect(),
            diameters: labelled.balls.iter().map(|(diameter, _)| *diameter).collect(),
            other: thinned(&other, OTHER_CELLS).map(|i| labelled.cells[*i]).collect(),
        });
        Ok(labelled)
    }

    /// Marked balls so far.
    #[must_use]
    pub fn balls(&self) -> usize {
        self.frames.iter().map(|f| f.balls.len()).sum()
    }

    /// The colour of the balls in all frames.
    ///
    /// # Errors
    /// [`LearnError`]: nothing was marked, too little, or what the ball's colour does not tell apart.
    pub fn learn(&self) -> Result<Lesson, LearnError> {
        let balls = self.balls();
        if balls == 0 {
            return Err(LearnError::NoMark);
        }
        let all = (0..self.frames.len()).collect::<Vec<_>>();
        let (ball, other) = self.colours(&all);
        if ball.len() < LEAST_CELLS {
            return Err(LearnError::TooFewCells { found: ball.len(), needed: LEAST_CELLS });
        }
        let grey = self.frames[0].format == PixelFormat::Mono8;
        let polytope = Polytope::fit(&ball, &other, grey);
        let with_balls =
            all.iter().copied().filter(|i| !self.frames[*i].balls.is_empty()).collect::<Vec<_>>();
        let folds = if with_balls.len() > 1 { FOLDS.min(with_balls.len()) } else { 1 };
        let part_of = |fold: usize| with_balls.iter().copied().skip(fold).step_by(folds).collect::<Vec<_>>();
        let mut judged = Vec::with_capacity(folds);
        for fold in 0..folds {
            let part = part_of(fold);
            let rest = all.iter().copied().filter(|i| folds == 1 || !part.contains(i)).collect::<Vec<_>>();
            let taught = if folds == 1 {
                polytope.clone()
            } else {
                let (ball, other) = self.colours(&rest);
                Polytope::fit(&ball, &other, grey)
            };
            judged.push((part, taught));
        }
        let (mut ball_depths, mut other_depths) = (Vec::new(), Vec::new());
        for (part, taught) in &judged {
            let (ball, other) = self.colours(part);
            ball_depths.extend(ball.iter().map(|c| taught.depth(c)));
            other_depths.extend(other.iter().map(|c| taught.depth(c)));
        }
        let (roc, area) = curve(&ball_depths, &other_depths);
        let margin = margin(&roc);
        let mut confusion = Confusion::default();
        for (part, taught) in &judged {
            let tests = taught.tests(margin);
            for frame in part.iter().map(|i| &self.frames[*i]) {
                let gate = ColourGate::learnt(frame.format, &tests);
                frame.balls.iter().flatten().for_each(|cell| confusion.see(true, gate.passes(*cell)));
                frame.other.iter().for_each(|cell| confusion.see(false, gate.passes(*cell)));
            }
        }
        let (kept, let_through) = (confusion.kept(), confusion.let_through());
        if let_through > MOST_LET_THROUGH || kept < LEAST_KEPT || area < LEAST_AREA {
            return Err(LearnError::NotSeparable { kept, let_through, area });
        }
        let kind = if grey { ColourKind::Grey } else { ColourKind::Mosaic };
        let diameters = || self.frames.iter().flat_map(|f| &f.diameters).copied();
        let diameter = [diameters().fold(f64::INFINITY, f64::min), diameters().fold(0.0, f64::max)];
        Ok(Lesson {
            colour: LearntColour::new(kind, &polytope.tests(margin), statistics(&ball), diameter),
            separation: Separation { held_out: folds > 1, confusion, roc, area },
            frames: with_balls.len(),
            balls,
            ball_cells: ball.len(),
        })
    }

    /// The colours of some frames: of the ball, and others.
    fn colours(&self, frames: &[usize]) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
        let (mut ball, mut other) = (Vec::new(), Vec::new());
        let of_each = (OTHER_CELLS / frames.len().max(1)).max(500);
        for frame in frames.iter().map(|i| &self.frames[*i]) {
            ball.extend(frame.balls.iter().flatten().map(|cell| frame.rgb(cell)));
            other.extend(thinned(&frame.other, of_each).map(|cell| frame.rgb(cell)));
        }
        (ball, other)
    }
}

/// The margin at which enough of the ball is kept; where that lets much through (a shaded side that looks like what is
/// behind it), the one that tells most (Youden 1950).
fn margin(roc: &[RocPoint]) -> f64 {
    let enough = roc.iter().find(|point| point.kept >= KEEP && point.let_through <= FEW);
    let telling =
        |a: &&RocPoint, b: &&RocPoint| (a.kept - a.let_through).total_cmp(&(b.kept - b.let_through));
    let chosen = enough.or_else(|| roc.iter().max_by(telling));
    chosen.map_or(0.0, |point| point.margin.min(MOST_MARGIN))
}

/// At most `most` of some values, spread over them.
fn thinned<T>(values: &[T], most: usize) -> impl Iterator<Item = &T> {
    // An odd step does not follow rows and columns.
    let step = (values.len().div_ceil(most.max(1))).max(1) | 1;
    values.iter().step_by(if values.len() <= most { 1 } else { step })
}

/// Mean and covariance of the logarithms by which likeness is told; with what noise alone spreads.
fn statistics(ball: &[[f64; 3]]) -> ([f64; 3], [f64; 6]) {
    let places = ball.iter().map(|c| place_of(c.map(|x| x as f32)).map(f64::from)).collect::<Vec<_>>();
    let n = places.len() as f64;
    let mean = [0, 1, 2].map(|i| places.iter().map(|p| p[i]).sum::<f64>() / n);
    let of = |i: usize, j: usize| {
        let least = if i == j { LEAST_LOG_SPREAD[i].powi(2) } else { 0.0 };
        places.iter().map(|p| (p[i] - mean[i]) * (p[j] - mean[j])).sum::<f64>() / n + least
    };
    (mean, [of(0, 0), of(0, 1), of(0, 2), of(1, 1), of(1, 2), of(2, 2)])
}

/// Spread of hue and brightness that a few frames do not show.
const LEAST_LOG_SPREAD: [f64; 3] = [0.05, 0.05, 0.15];
