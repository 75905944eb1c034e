use std::collections::BTreeMap;

use netcord_capture::recording::Footage;
use netcord_common::{
    rig::Rig,
    wire::{PositionOutcome, Verdict},
};
use serde::Serialize;

use super::stages::{Exposure, Results};

/// What a run over a recording came to. It holds nothing that depends on the machine: the same recording
/// gives the same report.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Report {
    pub(super) triggers: u64,
    pub(super) positions: u64,
    /// Why the other triggers have none.
    pub(super) without_position: BTreeMap<String, u64>,
    pub(super) frames: Frames,
    /// Triggers a second in the recording.
    pub(super) rate_hz: Option<f64>,
    pub(super) cameras: Vec<String>,
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
}

impl Tally {
    pub(super) fn new(rig: &Rig, footage: &Footage, interval_ns: Option<u64>) -> Self {
        Self {
            report: Report {
                triggers: 0,
                positions: 0,
                without_position: BTreeMap::new(),
                frames: Frames::default(),
                rate_hz: interval_ns.map(|ns| 1e9 / ns as f64),
                cameras: rig.cameras.iter().map(|c| c.name.to_string()).collect(),
                whole: footage.ending == netcord_capture::recording::Ending::Whole,
            },
        }
    }

    pub(super) fn see(&mut self, exposure: &Exposure, results: &Results) {
        let report = &mut self.report;
        report.triggers += 1;
        let there = exposure.frames.iter().flatten().count() as u64;
        report.frames.published += there;
        report.frames.lost += exposure.frames.len() as u64 - there;
        if results.verdict == Verdict::Unsynchronised {
            report.frames.unsynchronised += there;
        }
        match results.position.as_ref().map(|p| p.outcome()) {
            Some(PositionOutcome::Position) => report.positions += 1,
            Some(PositionOutcome::None(reason)) => {
                *report.without_position.entry(reason.name().to_owned()).or_default() += 1;
            }
            None => {}
        }
    }

    pub(super) fn report(self) -> Report {
        self.report
    }
}

impl Report {
    /// For the person at the terminal.
    pub(super) fn print(&self) {
        println!(
            "{} triggers, {} positions; {} frames, {} missing, {} unsynchronised",
            self.triggers,
            self.positions,
            self.frames.published,
            self.frames.lost,
            self.frames.unsynchronised
        );
        for (reason, count) in &self.without_position {
            println!("  {count} triggers without a position: {reason}");
        }
    }
}
