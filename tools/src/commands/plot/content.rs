use std::{collections::BTreeMap, path::Path};

use netcord_capture::recording::{Item, RecordedTruth, RecordingError, RecordingFile, decode};
use netcord_common::wire::{BallPosition, BallTrajectory};

/// What of a recording is drawn.
#[derive(Debug)]
pub(super) struct Content {
    /// By time.
    pub(super) positions: Vec<BallPosition>,
    /// Those with a path, by time.
    trajectories: Vec<BallTrajectory>,
    /// Where a ball truly was, by time.
    pub(super) truth: BTreeMap<u64, [f64; 3]>,
}

/// How many predictions are drawn when nobody chooses.
const PREDICTIONS: usize = 5;

/// A truth and a position belong together when their stamps differ by less: cameras of one trigger may be
/// exposed some microseconds apart.
const SAME_NS: u64 = 2_000_000;

/// A hit is noticed with so many positions.
const NOTICED_AFTER: usize = 3;

/// How far ahead a prediction's error is told, ms.
const OUTCOMES_MS: [u64; 3] = [100, 300, 500];

/// Between truths further apart than this nothing is known, ns.
const LONGEST_STEP_NS: u64 = 50_000_000;

impl Content {
    pub(super) fn read(path: &Path) -> Result<Self, RecordingError> {
        let mut content = Self { positions: Vec::new(), trajectories: Vec::new(), truth: BTreeMap::new() };
        let file = RecordingFile::open(path)?;
        file.visit(&mut |item| {
            let Item::Message(message) = item else { return Ok(()) };
            let wrong = |why: String| RecordingError::Message {
                path: path.to_owned(),
                topic: message.channel.topic.clone(),
                index: message.index,
                why,
            };
            match message.channel.schema_name.as_str() {
                "netcord.BallPosition" => {
                    let position: BallPosition = decode(message.data).map_err(|e| wrong(e.to_string()))?;
                    if position.is_present() {
                        content.positions.push(position);
                    }
                }
                "netcord.BallTrajectory" => {
                    let trajectory: BallTrajectory =
                        decode(message.data).map_err(|e| wrong(e.to_string()))?;
                    if !trajectory.path().is_empty() {
                        content.trajectories.push(trajectory);
                    }
                }
                _ if message.channel.topic == "/truth/ball" => {
                    let truth: RecordedTruth =
                        serde_json::from_slice(message.data).map_err(|e| wrong(e.to_string()))?;
                    if truth.present {
                        content.truth.insert(truth.t_ns, truth.position_m);
                    }
                }
                _ => {}
            }
            Ok(())
        })?;
        content.positions.sort_by_key(|p| p.stamps.mid_exposure_ns);
        content.trajectories.sort_by_key(|t| t.stamps.mid_exposure_ns);
        Ok(content)
    }

    /// When the recording's picture begins, ns.
    pub(super) fn start_ns(&self) -> u64 {
        let position = self.positions.first().map(|p| p.stamps.mid_exposure_ns);
        position.into_iter().chain(self.truth.keys().next().copied()).min().unwrap_or(0)
    }

    /// When the last prediction was made, in seconds after the start.
    pub(super) fn last_prediction_s(&self) -> Option<f64> {
        self.trajectories.last().map(|last| self.seconds(last.stamps.mid_exposure_ns))
    }

    /// The predictions made at the instants `at_s` after the start, or at some that are evenly spread.
    pub(super) fn predictions_at(&self, at_s: &[f64]) -> Vec<&BallTrajectory> {
        let Some(last) = self.trajectories.len().checked_sub(1) else { return Vec::new() };
        if at_s.is_empty() {
            let places = (0..PREDICTIONS).map(|i| (2 * i + 1) * last / (2 * PREDICTIONS));
            let mut places = places.collect::<Vec<_>>();
            places.dedup();
            return places.into_iter().map(|place| &self.trajectories[place]).collect();
        }
        let stamp = |s: &f64| self.start_ns().saturating_add_signed((s * 1e9) as i64);
        at_s.iter()
            .map(stamp)
            .filter_map(|t_ns| {
                self.trajectories.iter().min_by_key(|t| t.stamps.mid_exposure_ns.abs_diff(t_ns))
            })
            .collect()
    }

    /// Until when a prediction can be judged, ns: a hit ends its flight, and is noticed three positions late.
    pub(super) fn judged_until_ns(&self, prediction: &BallTrajectory) -> u64 {
        let made_ns = prediction.stamps.mid_exposure_ns;
        let later =
            |t: &BallTrajectory| t.stamps.mid_exposure_ns > made_ns && t.flight_id != prediction.flight_id;
        let end = self.trajectories.iter().position(later).unwrap_or(self.trajectories.len());
        let last = end.checked_sub(NOTICED_AFTER).and_then(|i| self.trajectories.get(i));
        last.map_or(0, |t| t.stamps.mid_exposure_ns)
    }

    /// Where the ball truly was at an instant between two that are known and near to each other.
    pub(super) fn truth_at(&self, t_ns: u64) -> Option<[f64; 3]> {
        let (before, a) = self.truth.range(..=t_ns).next_back()?;
        let (after, b) = self.truth.range(t_ns..).next()?;
        if after - before > LONGEST_STEP_NS {
            return None;
        }
        let share = if after == before { 0.0 } else { (t_ns - before) as f64 / (after - before) as f64 };
        Some(std::array::from_fn(|i| a[i] + share * (b[i] - a[i])))
    }

    /// An instant in seconds from the start.
    pub(super) fn seconds(&self, t_ns: u64) -> f64 {
        t_ns.saturating_sub(self.start_ns()) as f64 * 1e-9
    }

    /// How far a prediction was off, mm, so many ms ahead; without those of which the truth is not known.
    pub(super) fn prediction_errors(&self, prediction: &BallTrajectory) -> Vec<(u64, f64)> {
        let made_ns = prediction.stamps.mid_exposure_ns;
        let off = |ms: u64| {
            let point = prediction.path().iter().find(|p| p.t_ns >= made_ns + ms * 1_000_000)?;
            if point.t_ns > self.judged_until_ns(prediction) {
                return None;
            }
            Some((ms, distance_mm(&point.position_m, &self.truth_at(point.t_ns)?)))
        };
        OUTCOMES_MS.into_iter().filter_map(off).collect()
    }

    /// Median and 95 % of [`Self::errors`], mm.
    pub(super) fn error_quantiles(&self) -> Option<(f64, f64)> {
        let mut sorted = self.errors().iter().map(|(_, e)| *e).collect::<Vec<_>>();
        sorted.sort_by(f64::total_cmp);
        let at = |q: f64| sorted.get((q * sorted.len().saturating_sub(1) as f64).round() as usize).copied();
        Some((at(0.5)?, at(0.95)?))
    }

    /// Seconds from the start, and the error in mm, of each position that has a truth.
    pub(super) fn errors(&self) -> Vec<(f64, f64)> {
        self.positions
            .iter()
            .filter_map(|position| {
                let t_ns = position.stamps.mid_exposure_ns;
                let near = self.truth.range(t_ns.saturating_sub(SAME_NS)..t_ns + SAME_NS);
                let (_, truth) = near.min_by_key(|(t, _)| t.abs_diff(t_ns))?;
                Some((self.seconds(t_ns), distance_mm(&position.position_m, truth)))
            })
            .collect()
    }
}

fn distance_mm(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    1e3 * a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use netcord_common::wire::{MAX_PATH, PathPoint};

    use super::*;

    const FIRST_NS: u64 = 5_000_000_000;
    const STEP_NS: u64 = 10_000_000;
    /// What all positions and all predictions are off by, m.
    const POSITION_OFF: [f64; 3] = [0.003, 0.0, -0.004];
    const PATH_OFF: [f64; 3] = [0.0, 0.06, 0.08];

    fn ball(t_ns: u64) -> [f64; 3] {
        let t = (t_ns - FIRST_NS) as f64 * 1e-9;
        [0.1 * t, -1.0 + 4.0 * t, 0.3]
    }

    fn off(a: [f64; 3], by: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| a[i] + by[i])
    }

    /// A second of a ball that flies evenly; from `hit` on, trajectories are those of another flight.
    fn content(hit: usize) -> Content {
        let mut content = Content { positions: Vec::new(), trajectories: Vec::new(), truth: BTreeMap::new() };
        for k in 0..100 {
            let t_ns = FIRST_NS + k as u64 * STEP_NS;
            content.truth.insert(t_ns, ball(t_ns));
            let mut position =
                BallPosition { position_m: off(ball(t_ns), POSITION_OFF), ..Default::default() };
            // As cameras of one trigger are: a little apart.
            position.stamps.mid_exposure_ns = t_ns + 1000;
            content.positions.push(position);
            let mut trajectory = BallTrajectory { flight_id: u64::from(k >= hit), ..Default::default() };
            trajectory.stamps.mid_exposure_ns = t_ns;
            trajectory.path_len = MAX_PATH as u32;
            for (i, point) in trajectory.path.iter_mut().enumerate() {
                let at_ns = t_ns + (i as u64 + 1) * 2 * STEP_NS;
                *point = PathPoint { t_ns: at_ns, position_m: off(ball(at_ns), PATH_OFF), ..*point };
            }
            content.trajectories.push(trajectory);
        }
        content
    }

    #[test]
    fn errors_are_what_positions_and_predictions_are_off_by() {
        let content = content(100);
        let errors = content.errors();
        assert_eq!(errors.len(), 100);
        assert!(errors.iter().all(|(_, mm)| (mm - 5.0).abs() < 1e-9), "{errors:?}");
        assert!((errors[99].0 - 0.990_001).abs() < 1e-9, "the errors' instants: {:?}", errors[99]);
        let (median, p95) = content.error_quantiles().expect("a truth");
        assert!((median - 5.0).abs() < 1e-9 && (p95 - 5.0).abs() < 1e-9);
        let [early, late] = content.predictions_at(&[0.2, 0.8])[..] else { panic!("two were asked for") };
        let early = content.prediction_errors(early);
        assert_eq!(early.iter().map(|(ms, _)| *ms).collect::<Vec<_>>(), OUTCOMES_MS);
        assert!(early.iter().all(|(_, mm)| (mm - 100.0).abs() < 1e-9), "{early:?}");
        // The recording ends 0.19 s after the other: its later errors are not known.
        assert_eq!(content.prediction_errors(late).len(), 1);
    }

    #[test]
    fn predictions_are_not_judged_across_a_hit_nor_where_no_truth_is() {
        let mut content = content(60);
        let made = |content: &Content| {
            let before = content.predictions_at(&[0.2])[0];
            content.prediction_errors(before).iter().map(|(ms, _)| *ms).collect::<Vec<_>>()
        };
        assert_eq!(made(&content), [100, 300], "0.5 s later another flight is under way");
        content.truth.retain(|t_ns, _| !(FIRST_NS + 470_000_000..FIRST_NS + 530_000_000).contains(t_ns));
        assert_eq!(made(&content), [100]);
        assert!(content.errors().len() < 100);
        content.truth.clear();
        assert!(content.errors().is_empty() && content.error_quantiles().is_none());
    }
}
