use std::collections::BTreeMap;

use netcord_capture::recording::{Footage, RecordedTruth};
use netcord_common::{
    rig::Rig,
    wire::{BallPosition, PositionOutcome, Stamps, Verdict},
};
use serde::Serialize;

use super::stages::{Exposure, Results, Spent};
use crate::{
    observer::{Latencies, LatencyReport},
    trial::{Judge, Score},
};

/// What a run over a recording came to. But for `latency_ms` nothing in it depends on the machine: the same
/// recording gives the same report.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Report {
    /// Held against `/truth/ball`; absent where the recording has none.
    #[serde(flatten)]
    pub(super) score: Option<Score>,
    /// Computing time on this machine: of segment, the camera that took longest; of triangulate and predict;
    /// and segment and triangulate together as `frame_to_position`. There is no capture, and no exposure to count
    /// from: these are null.
    pub(super) latency_ms: LatencyReport,
    /// All of the recording.
    pub(super) triggers_processed: u64,
    pub(super) positions: u64,
    /// Why the other triggers have none.
    pub(super) reasons: BTreeMap<String, u64>,
    pub(super) frames: Frames,
    /// Triggers a second in the recording.
    pub(super) rate_hz: Option<f64>,
    pub(super) cameras: Vec<String>,
    /// Frames missing in triggers between the first and the last, in whose midst recording may have begun and ended.
    #[serde(skip)]
    pub(super) missing_inside: u64,
    /// Whether the recording was whole.
    pub(super) whole: bool,
}

#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct Frames {
    /// In the recording, and looked at.
    pub(super) published: u64,
    /// Missing in triggers that other cameras delivered.
    pub(super) lost: u64,
    /// Of triggers whose exposures lie further apart than the tolerance.
    pub(super) unsynchronised: u64,
}

/// Counts results as they come.
pub(super) struct Tally {
    report: Report,
    rig: Rig,
    truth: BTreeMap<u64, RecordedTruth>,
    judge: Judge,
    latencies: Latencies,
    /// Frames missing in the trigger seen last, but for the first trigger.
    missing_here: u64,
    /// The first and the last trigger that has a truth.
    judged: Option<(u64, u64)>,
}

impl Tally {
    pub(super) fn new(rig: &Rig, footage: &Footage, interval_ns: Option<u64>) -> Self {
        Self {
            report: Report {
                score: None,
                latency_ms: Latencies::default().report(),
                triggers_processed: 0,
                positions: 0,
                reasons: BTreeMap::new(),
                frames: Frames::default(),
                rate_hz: interval_ns.map(|ns| 1e9 / ns as f64),
                cameras: rig.cameras.iter().map(|c| c.name.to_string()).collect(),
                missing_inside: 0,
                whole: footage.ending == netcord_capture::recording::Ending::Whole,
            },
            rig: rig.clone(),
            truth: footage.truth.iter().map(|truth| (truth.t_ns, truth.clone())).collect(),
            judge: Judge::default(),
            latencies: Latencies::default(),
            missing_here: 0,
            judged: None,
        }
    }

    pub(super) fn see(&mut self, exposure: &Exposure, results: &Results) {
        let report = &mut self.report;
        let there = exposure.frames.iter().flatten().count() as u64;
        let missing = exposure.frames.len() as u64 - there;
        let is_first = report.triggers_processed == 0;
        report.missing_inside +=
            std::mem::replace(&mut self.missing_here, if is_first { 0 } else { missing });
        report.triggers_processed += 1;
        report.frames.published += there;
        report.frames.lost += missing;
        if results.verdict == Verdict::Unsynchronised {
            report.frames.unsynchronised += there;
        }
        match results.position.as_ref().map(|p| p.outcome()) {
            Some(PositionOutcome::Position) => report.positions += 1,
            Some(PositionOutcome::None(reason)) => {
                *report.reasons.entry(reason.name().to_owned()).or_default() += 1;
            }
            None => {}
        }
        if results.position.as_ref().is_some_and(BallPosition::is_present) {
            self.latencies.spans_of(&computing_times(&results.spent));
        }
        self.judge(exposure, results);
    }

    fn judge(&mut self, exposure: &Exposure, results: &Results) {
        let stamps = exposure.frames.iter().flatten().map(|f| f.header.stamps.mid_exposure_ns);
        let Some(t_ns) = stamps.min() else { return };
        let id = exposure.trigger.id;
        // The truth is of the trigger's instant, from which each exposure may lie a little off.
        let slack = self.rig.tolerance_ns;
        let near = self.truth.range(t_ns.saturating_sub(slack)..=t_ns.saturating_add(slack));
        let Some((_, truth)) = near.min_by_key(|(t, _)| t.abs_diff(t_ns)) else { return };
        self.judge.truth(&truth.on_bus(id, &self.rig));
        if let Some(position) = &results.position {
            self.judge.position(position);
        }
        self.judged = Some((self.judged.map_or(id, |(first, _)| first), id));
    }

    pub(super) fn report(mut self) -> Report {
        self.report.latency_ms = self.latencies.report();
        self.report.score = self.judged.map(|(first, last)| self.judge.judge(first, last).1);
        self.report
    }
}

/// As a message would carry them whose frame was complete at once and whose stages never waited.
fn computing_times(spent: &Spent) -> Stamps {
    // Any instant but zero, which stands for "not reached".
    const COMPLETE_NS: u64 = 1;
    let segment_published_ns = COMPLETE_NS + spent.segment;
    let triangulate_published_ns = segment_published_ns + spent.triangulate;
    Stamps {
        frame_complete_ns: COMPLETE_NS,
        frame_published_ns: COMPLETE_NS,
        segment_published_ns,
        triangulate_published_ns,
        predict_published_ns: triangulate_published_ns + spent.predict,
        ..Stamps::default()
    }
}

impl Report {
    /// For the person at the terminal.
    pub(super) fn print(&self) {
        println!(
            "{} triggers, {} positions; {} frames, {} missing, {} unsynchronised",
            self.triggers_processed,
            self.positions,
            self.frames.published,
            self.frames.lost,
            self.frames.unsynchronised
        );
        if let Some(score) = &self.score {
            let recall = score.recall.map_or("-".into(), |recall| format!("{:.2} %", recall * 100.0));
            println!(
                "  recall {recall} of {} findable balls, {} false positions",
                score.findable, score.false_positions
            );
            if let Some(error) = score.error_mm {
                println!(
                    "  error: median {:.2} mm, 95 % {:.2} mm, RMS {:.2} mm",
                    error.median, error.p95, error.rms
                );
            }
        }
        for (reason, count) in &self.reasons {
            println!("  {count} triggers without a position: {reason}");
        }
    }
}
