use serde::Serialize;

/// One point of the curve of what is kept against what is let through (ROC).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RocPoint {
    /// By how far all planes are moved outwards, standard deviations of the ball's colours.
    pub margin: f64,
    /// Share of the ball's cells that pass, 0–1.
    pub kept: f64,
    /// Share of the other cells that pass, 0–1.
    pub let_through: f64,
}

/// What a gate makes of cells whose truth is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Confusion {
    /// Cells of the ball that pass.
    pub ball_passed: u64,
    /// Cells of the ball that do not.
    pub ball_stopped: u64,
    /// Other cells that pass.
    pub other_passed: u64,
    /// Other cells that do not.
    pub other_stopped: u64,
}

impl Confusion {
    /// Share of the ball's cells that pass, 0–1; 0 where there are none.
    #[must_use]
    pub fn kept(&self) -> f64 {
        share(self.ball_passed, self.ball_stopped)
    }

    /// Share of the other cells that pass, 0–1; 0 where there are none.
    #[must_use]
    pub fn let_through(&self) -> f64 {
        share(self.other_passed, self.other_stopped)
    }

    pub(super) fn see(&mut self, is_ball: bool, passes: bool) {
        *match (is_ball, passes) {
            (true, true) => &mut self.ball_passed,
            (true, false) => &mut self.ball_stopped,
            (false, true) => &mut self.other_passed,
            (false, false) => &mut self.other_stopped,
        } += 1;
    }
}

fn share(part: u64, rest: u64) -> f64 {
    if part == 0 { 0.0 } else { part as f64 / (part + rest) as f64 }
}

/// How well a learnt colour tells the ball.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Separation {
    /// Whether it was judged by frames that were not learnt from, each in its turn.
    pub held_out: bool,
    /// Of these frames, at the threshold that was chosen.
    pub confusion: Confusion,
    /// From the narrowest to the widest gate.
    pub roc: Vec<RocPoint>,
    /// Area under that curve: 1 tells all, 0.5 nothing.
    pub area: f64,
}

/// Points of a curve that are kept.
const POINTS: usize = 60;

/// The curve of depths of cells, and the area under it (as Mann and Whitney's statistic).
pub(super) fn curve(ball: &[f64], other: &[f64]) -> (Vec<RocPoint>, f64) {
    let sorted = |depths: &[f64]| {
        let mut depths = depths.to_vec();
        depths.sort_by(f64::total_cmp);
        depths
    };
    let (ball, other) = (sorted(ball), sorted(other));
    let (nb, no) = (ball.len().max(1) as f64, other.len().max(1) as f64);
    let below = |depths: &[f64], x: f64| depths.partition_point(|d| *d < x);
    let up_to = |depths: &[f64], x: f64| depths.partition_point(|d| *d <= x);
    let area =
        ball.iter().map(|d| (below(&other, *d) + up_to(&other, *d)) as f64 / 2.0).sum::<f64>() / (nb * no);
    let place = |i: usize| ball[(i * (ball.len() - 1)) / (POINTS - 1)];
    let mut roc = (0..POINTS)
        .rev()
        .filter(|_| !ball.is_empty())
        .map(|i| {
            let depth = place(i);
            RocPoint {
                margin: -depth,
                kept: (ball.len() - below(&ball, depth)) as f64 / nb,
                let_through: (other.len() - below(&other, depth)) as f64 / no,
            }
        })
        .collect::<Vec<_>>();
    roc.dedup_by(|a, b| a.kept == b.kept && a.let_through == b.let_through);
    (roc, area)
}
