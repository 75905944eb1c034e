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

    /// Seconds from the start, and the error in mm, of each position that has a truth.
    pub(super) fn errors(&self) -> Vec<(f64, f64)> {
        self.positions
            .iter()
            .filter_map(|position| {
                let t_ns = position.stamps.mid_exposure_ns;
                let near = self.truth.range(t_ns.saturating_sub(SAME_NS)..t_ns + SAME_NS);
                let (_, truth) = near.min_by_key(|(t, _)| t.abs_diff(t_ns))?;
                let squares = position.position_m.iter().zip(truth).map(|(a, b)| (a - b).powi(2));
                let error_mm = 1e3 * squares.sum::<f64>().sqrt();
                Some(((t_ns - self.start_ns()) as f64 * 1e-9, error_mm))
            })
            .collect()
    }
}
