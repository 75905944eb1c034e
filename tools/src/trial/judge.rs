use std::collections::BTreeMap;

use netcord_common::wire::{BallPosition, BallTruth, MAX_CAMERAS, NoPosition, PositionOutcome};
use serde::Serialize;

/// A position nearer to the truth than this is a position of the ball.
const NEAR_M: f64 = 0.050;
/// A camera sees the ball when at least this share of its image is visible.
const SEEN: f64 = 0.5;
/// A ball that fewer cameras see cannot be triangulated.
const VIEWS: usize = 2;

/// What becomes of one trigger when its result is held against the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Judgement {
    /// A position within 50 mm of the ball; its error in metres.
    Hit(f64),
    /// The ball was to be found and was not.
    Missed,
    /// A position more than 50 mm off, or of no ball.
    False,
    /// Nothing was to be found, and nothing was.
    Nothing,
}

/// One trigger with its truth, its result, and the judgement.
#[derive(Debug, Clone, Copy)]
pub struct Judged {
    /// Middle of the exposure, ns.
    pub t_ns: u64,
    /// Where the ball truly was, m; `None`: nowhere.
    pub truth_m: Option<[f64; 3]>,
    /// Where it was found, m.
    pub found_m: Option<[f64; 3]>,
    /// Whether at least half of it was visible in two views or more.
    pub findable: bool,
    /// The judgement.
    pub judgement: Judgement,
}

/// Collects truth and results, and judges at the end.
#[derive(Debug, Default)]
pub struct Judge {
    truths: BTreeMap<u64, Truth>,
    positions: BTreeMap<u64, Result<[f64; 3], NoPosition>>,
}

#[derive(Debug, Clone, Copy)]
struct Truth {
    t_ns: u64,
    position_m: Option<[f64; 3]>,
    findable: bool,
}

impl Judge {
    /// Takes in what is true of a trigger.
    pub fn truth(&mut self, truth: &BallTruth) {
        let present = truth.present == 1;
        let seen = truth.cameras[..MAX_CAMERAS].iter().filter(|c| c.visible >= SEEN).count();
        let row = Truth {
            t_ns: truth.mid_exposure_ns,
            position_m: present.then_some(truth.position_m),
            findable: present && seen >= VIEWS,
        };
        self.truths.insert(truth.trigger_id, row);
    }

    /// Takes in what was found at a trigger.
    pub fn position(&mut self, position: &BallPosition) {
        let outcome = match position.outcome() {
            PositionOutcome::Position => Ok(position.position_m),
            PositionOutcome::None(reason) => Err(reason),
        };
        self.positions.insert(position.trigger_id, outcome);
    }

    /// The triggers exposed from `from_ns` to before `to_ns`: the first and the last.
    pub(super) fn triggers_between(&self, from_ns: u64, to_ns: u64) -> Option<(u64, u64)> {
        let mut inside =
            self.truths.iter().filter(|(_, t)| (from_ns..to_ns).contains(&t.t_ns)).map(|(id, _)| *id);
        let first = inside.next()?;
        Some((first, inside.next_back().unwrap_or(first)))
    }

    /// Judges the triggers `first` to `last`.
    pub fn judge(&self, first: u64, last: u64) -> (Vec<Judged>, Score) {
        let mut rows = Vec::new();
        let mut without_position: BTreeMap<&'static str, u64> = BTreeMap::new();
        for (id, truth) in self.truths.range(first..=last) {
            let outcome = self.positions.get(id).copied();
            let found_m = outcome.and_then(Result::ok);
            let judgement = judge(truth, found_m);
            if truth.findable && found_m.is_none() {
                let reason = match outcome {
                    Some(Err(reason)) => reason.name(),
                    _ => "NoMessage",
                };
                *without_position.entry(reason).or_default() += 1;
            }
            let Truth { t_ns, position_m: truth_m, findable } = *truth;
            rows.push(Judged { t_ns, truth_m, found_m, findable, judgement });
        }
        let score = Score::of(&rows, without_position);
        (rows, score)
    }
}

fn judge(truth: &Truth, found_m: Option<[f64; 3]>) -> Judgement {
    match (found_m, truth.position_m) {
        (Some(found), Some(ball)) => {
            let error = distance(found, ball);
            if error <= NEAR_M { Judgement::Hit(error) } else { Judgement::False }
        }
        (Some(_), None) => Judgement::False,
        (None, _) if truth.findable => Judgement::Missed,
        (None, _) => Judgement::Nothing,
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// What the judgements come to.
#[derive(Debug, Clone, Serialize)]
pub struct Score {
    /// Of the triggers at which at least half of the ball is visible in two views or more, the share with a
    /// position within 50 mm of the truth; absent where there was no such trigger.
    pub recall: Option<f64>,
    /// Any other position that is more than 50 mm off, or where no ball is.
    pub false_positions: u64,
    /// Errors of the positions within 50 mm of the truth.
    pub error_mm: Option<ErrorMm>,
    /// Triggers judged.
    pub triggers: u64,
    /// Triggers at which the ball was to be found.
    pub findable: u64,
    /// Why findable balls have no position: reason and number.
    pub without_position: BTreeMap<&'static str, u64>,
}

/// Distances from the truth, mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ErrorMm {
    /// Median.
    pub median: f64,
    /// 95 %.
    pub p95: f64,
    /// Root mean square.
    pub rms: f64,
}

impl Score {
    fn of(rows: &[Judged], without_position: BTreeMap<&'static str, u64>) -> Self {
        let findable = rows.iter().filter(|r| r.findable).count();
        let found = rows.iter().filter(|r| r.findable && matches!(r.judgement, Judgement::Hit(_))).count();
        let mut errors: Vec<f64> = rows
            .iter()
            .filter_map(|r| match r.judgement {
                Judgement::Hit(error_m) => Some(error_m * 1e3),
                _ => None,
            })
            .collect();
        Self {
            recall: (findable > 0).then(|| found as f64 / findable as f64),
            false_positions: rows.iter().filter(|r| r.judgement == Judgement::False).count() as u64,
            error_mm: ErrorMm::of(&mut errors),
            triggers: rows.len() as u64,
            findable: findable as u64,
            without_position,
        }
    }
}

impl ErrorMm {
    fn of(errors: &mut [f64]) -> Option<Self> {
        errors.sort_by(f64::total_cmp);
        let last = errors.len().checked_sub(1)?;
        let at = |q: f64| errors[(q * last as f64).round() as usize];
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        Some(Self { median: at(0.5), p95: at(0.95), rms })
    }
}

#[cfg(test)]
mod tests {
    use netcord_common::wire::CameraTruth;

    use super::*;

    fn truth(trigger_id: u64, x: f64, visible: [f64; 2], present: u32) -> BallTruth {
        let mut cameras = [CameraTruth::default(); MAX_CAMERAS];
        for (camera, visible) in cameras.iter_mut().zip(visible) {
            camera.visible = visible;
        }
        let position_m = [x, 0.0, 0.0];
        BallTruth {
            trigger_id,
            mid_exposure_ns: trigger_id * 10,
            position_m,
            present,
            cameras,
            ..BallTruth::default()
        }
    }

    fn found(trigger_id: u64, x: f64) -> BallPosition {
        BallPosition { trigger_id, position_m: [x, 0.0, 0.0], ..BallPosition::default() }
    }

    #[test]
    fn each_case_of_the_definition_is_told_apart() {
        let mut judge = Judge::default();
        judge.truth(&truth(1, 0.0, [1.0, 0.6], 1)); // found, 3 mm off
        judge.position(&found(1, 0.003));
        judge.truth(&truth(2, 0.0, [1.0, 1.0], 1)); // found, 51 mm off
        judge.position(&found(2, 0.051));
        judge.truth(&truth(3, 0.0, [1.0, 1.0], 1)); // not found, with a reason
        judge.position(&BallPosition {
            trigger_id: 3,
            reason: NoPosition::OneView.code(),
            ..BallPosition::default()
        });
        judge.truth(&truth(4, 0.0, [1.0, 0.4], 1)); // hidden in one view, found all the same
        judge.position(&found(4, 0.010));
        judge.truth(&truth(5, 0.0, [1.0, 0.4], 1)); // hidden, not found
        judge.truth(&truth(6, 0.0, [0.0, 0.0], 0)); // no ball, but something found
        judge.position(&found(6, 1.0));
        judge.truth(&truth(7, 0.0, [1.0, 1.0], 1)); // no message at all
        judge.truth(&truth(99, 0.0, [1.0, 1.0], 1)); // outside of the judged range
        assert_eq!(judge.triggers_between(10, 71), Some((1, 7)));
        let (rows, score) = judge.judge(1, 7);
        assert_eq!((score.triggers, score.findable, score.false_positions), (7, 4, 2));
        assert_eq!(score.recall, Some(0.25));
        assert_eq!(score.without_position, BTreeMap::from([("NoMessage", 1), ("OneView", 1)]));
        let errors = score.error_mm.expect("two hits");
        assert!((errors.rms - ((9.0_f64 + 100.0) / 2.0).sqrt()).abs() < 1e-9, "{errors:?}");
        assert_eq!(rows[4].judgement, Judgement::Nothing);
    }
}
