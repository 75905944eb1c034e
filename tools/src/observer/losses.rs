use std::collections::BTreeMap;

use netcord_common::wire::{Detections, Frameset, Health, MAX_CAMERAS, Verdict};
use serde::Serialize;

use super::totals::Totals;

/// Frames published and lost since the observation began.
#[derive(Debug, Clone, Default)]
pub struct Losses {
    published: u64,
    not_published: u64,
    unsynchronised: u64,
    /// Of each camera: the capture session, and the segmenter's count of frames lost when first seen and now.
    segmenter: [Option<Unseen>; MAX_CAMERAS],
    counters: Totals,
}

/// A count of frames that a segmenter has not looked at, which starts over with either process.
#[derive(Debug, Clone, Copy)]
struct Unseen {
    session: u64,
    last: u64,
    lost: u64,
}

impl Losses {
    /// Takes in the verdict on a trigger.
    pub fn frameset(&mut self, frameset: &Frameset) {
        let delivered = u64::from(frameset.delivered.count_ones());
        self.published += delivered;
        self.not_published += u64::from((frameset.expected & !frameset.delivered).count_ones());
        if frameset.verdict == Verdict::Unsynchronised.code() {
            self.unsynchronised += delivered;
        }
    }

    /// Takes in what a segmenter says of the frames that it has not looked at.
    pub fn detections(&mut self, detections: &Detections) {
        let Some(place) = self.segmenter.get_mut(detections.camera as usize) else { return };
        let now = detections.frames_lost;
        match place {
            Some(unseen) => {
                // A new session of capture, or a new segmenter, counts from zero.
                let new = unseen.session != detections.session || now < unseen.last;
                unseen.lost += if new { now } else { now - unseen.last };
                unseen.session = detections.session;
                unseen.last = now;
            }
            None => *place = Some(Unseen { session: detections.session, last: now, lost: 0 }),
        }
    }

    /// Takes in a process's counters.
    pub fn health(&mut self, health: &Health) {
        self.counters.see(health);
    }

    /// What has been counted so far.
    pub fn report(&self) -> FrameReport {
        let unseen: u64 = self.segmenter.iter().flatten().map(|u| u.lost).sum();
        let mut by_reason: BTreeMap<String, u64> = self
            .counters
            .grown()
            .filter(|(name, _)| is_loss(name))
            .map(|(name, total)| (name.to_owned(), total))
            .collect();
        for (reason, count) in [("not_published", self.not_published), ("not_segmented", unseen)] {
            if count > 0 {
                by_reason.insert(reason.into(), count);
            }
        }
        FrameReport {
            published: self.published,
            lost: self.not_published + unseen,
            unsynchronised: self.unsynchronised,
            lost_by_reason: by_reason,
        }
    }
}

/// Whether a counter of `rig/health`, `process/counter` or `process/camera/counter`, counts something that went
/// missing.
fn is_loss(name: &str) -> bool {
    let counter = name.rsplit('/').next().unwrap_or(name);
    let words = ["lost", "late", "dropped", "refused", "unsynchronised", "incomplete"];
    counter.split('_').any(|word| words.contains(&word))
}

/// Frames, by what became of them.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct FrameReport {
    /// Published by capture.
    pub published: u64,
    /// Published and not looked at by the segmenter, or triggered and not published.
    pub lost: u64,
    /// Published, but their trigger's exposures lie further apart than the tolerance.
    pub unsynchronised: u64,
    /// The losses above and the processes' own loss counters, where they are not zero.
    pub lost_by_reason: BTreeMap<String, u64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_counters_of_what_went_missing_are_losses() {
        for loss in ["capture/lost_no_slot", "segment/left/frames_lost", "triangulate/detections_late"] {
            assert!(is_loss(loss), "{loss}");
        }
        for other in ["triangulate/positions", "triangulate/allocations", "capture/framesets_complete"] {
            assert!(!is_loss(other), "{other}");
        }
    }

    fn seen(session: u64, frames_lost: u64) -> Detections {
        Detections { session, frames_lost, ..Detections::default() }
    }

    #[test]
    fn losses_are_counted_from_where_the_observation_began_over_restarts() {
        let mut losses = Losses::default();
        for (session, lost) in [(1, 100), (1, 101), (1, 103), (2, 0), (2, 2), (2, 1)] {
            losses.detections(&seen(session, lost));
        }
        let verdict = Verdict::Incomplete.code();
        losses.frameset(&Frameset { expected: 0b11, delivered: 0b01, verdict, ..Frameset::default() });
        let verdict = Verdict::Unsynchronised.code();
        losses.frameset(&Frameset { expected: 0b11, delivered: 0b11, verdict, ..Frameset::default() });
        let report = losses.report();
        assert_eq!((report.published, report.unsynchronised), (3, 2));
        assert_eq!(report.lost, 1 + (3 + 2 + 1), "one not published; 3 before and 2 + 1 after the restarts");
        assert_eq!(report.lost_by_reason["not_segmented"], 6);
    }
}
