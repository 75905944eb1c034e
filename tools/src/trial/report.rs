use std::collections::BTreeMap;

use serde::Serialize;

use super::{ForesightErrors, Setup, judge::Score};
use crate::observer::{FrameReport, LatencyReport};

/// What a trial came to.
#[derive(Debug, Clone, Serialize)]
pub struct TrialReport {
    /// Tracking, held against the truth.
    #[serde(flatten)]
    pub score: Score,
    /// How far off the predicted place in the hitting plane was.
    pub hitting_plane_error: ForesightErrors,
    /// How far off the predicted landing point was.
    pub landing_error: ForesightErrors,
    /// Latencies of the positions.
    pub latency_ms: LatencyReport,
    /// Frames, by what became of them.
    pub frames: FrameReport,
    /// Triggers a second that got a position or a reason; absent where none did.
    pub rate_hz: Option<f64>,
    /// Share of one processor that each process used.
    pub cpu_share: BTreeMap<String, f64>,
    /// Position messages that this observer missed; they count as not found.
    pub unobserved: u64,
    /// What was run.
    pub setup: SetupReport,
    /// What misses its mark, in sentences; empty: all holds.
    pub missed: Vec<String>,
}

/// What was run.
#[derive(Debug, Clone, Serialize)]
pub struct SetupReport {
    /// Cameras.
    pub cameras: usize,
    /// Exposures a second that were asked for.
    pub rate_hz: f64,
    /// Seconds judged.
    pub seconds: f64,
    /// Seconds before that.
    pub warm_up_s: f64,
    /// Seed.
    pub seed: u64,
    /// Scene.
    pub scene: &'static str,
    /// Frames rendered beforehand; absent where each was rendered in time.
    pub prerendered: Option<usize>,
    /// Whether `netcord record` was attached.
    pub recorded: bool,
}

impl From<&Setup> for SetupReport {
    fn from(setup: &Setup) -> Self {
        Self {
            cameras: setup.cameras,
            rate_hz: setup.rate_hz,
            seconds: setup.seconds,
            warm_up_s: setup.warm_up_s,
            seed: setup.seed,
            scene: setup.scene.name(),
            prerendered: setup.prerendered,
            recorded: setup.record.is_some(),
        }
    }
}

/// The marks: tracking and the time budget.
const MIN_RECALL: f64 = 0.99;
const MAX_MEDIAN_MM: f64 = 2.0;
const MAX_P95_MM: f64 = 6.0;
const MAX_HITTING_MM: f64 = 20.0;
const MAX_P50_MS: f64 = 1.0;
const MAX_P99_MS: f64 = 3.0;
const MAX_P999_MS: f64 = 10.0;
/// Share of the triggers that may fall between the begin of the clock and that of the source.
const MOST_UNTOLD: f64 = 0.01;
/// From the middle of the exposure to the position: the whole budget.
const BUDGET_MS: f64 = 10.0;

impl TrialReport {
    /// Holds the report against the marks.
    pub(super) fn judge_marks(&mut self) {
        let mut missed = Vec::new();
        let mut at_most = |what: &str, value: Option<f64>, most: f64, unit: &str| match value {
            Some(value) if value <= most => {}
            Some(value) => {
                // One less a share is not the share that it should be, in its last digit.
                let most = (most * 1e6).round() / 1e6;
                missed.push(format!("{what} is {value:.2}{unit}; at most {most}{unit} is the mark"))
            }
            None => missed.push(format!("{what} could not be measured")),
        };
        at_most(
            "share of balls not found",
            self.score.recall.map(|r| (1.0 - r) * 100.0),
            (1.0 - MIN_RECALL) * 100.0,
            " %",
        );
        at_most("false positions", Some(self.score.false_positions as f64), 0.0, "");
        at_most("median error", self.score.error_mm.map(|e| e.median), MAX_MEDIAN_MM, " mm");
        at_most("95 % error", self.score.error_mm.map(|e| e.p95), MAX_P95_MM, " mm");
        if self.hitting_plane_error.n > 0 {
            let median = self.hitting_plane_error.median_mm;
            at_most("hitting-plane error 0.3 s ahead, median,", median, MAX_HITTING_MM, " mm");
        }
        // What the source never told of is neither found nor lost: too much of it, and nothing has been shown.
        let expected = self.setup.seconds * self.setup.rate_hz;
        let untold = expected - self.score.triggers as f64;
        at_most("triggers that nothing is known of", Some(untold), (MOST_UNTOLD * expected).max(1.0), "");
        at_most("lost frames", Some(self.frames.lost as f64), 0.0, "");
        at_most("unsynchronised frames", Some(self.frames.unsynchronised as f64), 0.0, "");
        let latency = self.latency_ms.frame_to_position;
        at_most("frame to position, median,", latency.map(|q| q.p50), MAX_P50_MS, " ms");
        at_most("frame to position, 99 %,", latency.map(|q| q.p99), MAX_P99_MS, " ms");
        at_most("frame to position, 99.9 %,", latency.map(|q| q.p999), MAX_P999_MS, " ms");
        let whole = self.latency_ms.exposure_to_position;
        at_most("exposure to position, 99 %,", whole.map(|q| q.p99), BUDGET_MS, " ms");
        self.missed = missed;
    }

    /// The result as lines for a terminal.
    pub fn lines(&self) -> Vec<String> {
        let share = |s: Option<f64>| s.map_or_else(|| "-".into(), |s| format!("{:.2} %", s * 100.0));
        let mut lines = vec![format!(
            "  recall {} of {} findable balls in {} triggers, {} false positions",
            share(self.score.recall),
            self.score.findable,
            self.score.triggers,
            self.score.false_positions
        )];
        if let Some(e) = self.score.error_mm {
            lines.push(format!(
                "  error: median {:.2} mm, 95 % {:.2} mm, RMS {:.2} mm",
                e.median, e.p95, e.rms
            ));
        }
        for (what, q) in [
            ("frame to position", self.latency_ms.frame_to_position),
            ("exposure to position", self.latency_ms.exposure_to_position),
        ] {
            let Some(q) = q else { continue };
            lines.push(format!(
                "  {what}: median {:.2} ms, 99 % {:.2} ms, 99.9 % {:.2} ms, longest {:.2} ms",
                q.p50, q.p99, q.p999, q.max
            ));
        }
        lines.push(format!(
            "  frames: {} published, {} lost, {} unsynchronised",
            self.frames.published, self.frames.lost, self.frames.unsynchronised
        ));
        for (what, e) in [("hitting plane", &self.hitting_plane_error), ("landing", &self.landing_error)] {
            let mm = |v: Option<f64>| v.map_or_else(|| "-".into(), |v| format!("{v:.1} mm"));
            lines.push(format!(
                "  prediction of the {what}, {:.2} s ahead: median {}, 90 % {} ({} events, {} not predicted)",
                e.lead_s,
                mm(e.median_mm),
                mm(e.p90_mm),
                e.n,
                e.missing
            ));
        }
        for (reason, count) in &self.score.without_position {
            lines.push(format!("  not found: {reason} {count}"));
        }
        let cpu: Vec<String> =
            self.cpu_share.iter().map(|(name, share)| format!("{name} {:.0} %", share * 100.0)).collect();
        lines.push(format!("  one processor's share: {}", cpu.join(", ")));
        lines
    }
}
