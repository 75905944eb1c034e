use netcord_common::{
    rig::Rig,
    wire::{BallPosition, Detections, Frameset, MAX_CAMERAS, NoPosition, Scope, Verdict},
};

use super::{TriangulateOptions, Triangulator};

/// Triggers that are gathered at a time: at 100 Hz, 80 ms.
const SLOTS: usize = 8;
/// A camera that is alone waits for another by this much at least, however fast the rig.
const LEAST_PATIENCE_NS: u64 = 5_000_000;

/// Gathers the messages of each trigger, and triangulates it when it is ready: at once when the search
/// windows of all cameras agree, else when all cameras that deliver have looked at their whole frames, or
/// when waiting for the last of them has lasted too long. Gives at most one position for each trigger, in
/// the order of the triggers. Knows no clock: time is an argument. Allocates nothing after it was made.
#[derive(Debug)]
pub struct Matcher {
    triangulator: Triangulator,
    slots: Vec<Slot>,
    cameras: u32,
    /// Patience where two cameras suffice for a position, and where one is alone.
    patience_ns: [u64; 2],
    /// The newest trigger that has been decided.
    decided: u64,
    /// The newest trigger of which each camera has sent its full detections.
    newest: [u64; MAX_CAMERAS],
    counts: MatcherCounts,
}

/// What became of the messages.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct MatcherCounts {
    /// Messages of triggers that had been decided, or of a camera that the rig does not know.
    pub late: u64,
    /// Triggers decided without all cameras that should have delivered.
    pub incomplete: u64,
    /// Triggers whose exposures did not belong together.
    pub unsynchronised: u64,
    /// Positions given from search windows alone.
    pub from_windows: u64,
}

#[derive(Debug)]
struct Slot {
    /// `None`: it is free.
    trigger_id: Option<u64>,
    full: Vec<Detections>,
    window: Vec<Detections>,
    /// Bit i: `full[i]` holds.
    has_full: u32,
    /// Bit i: `window[i]` holds.
    has_window: u32,
    /// Bit i: camera i will deliver nothing.
    missing: u32,
    unsynchronised: bool,
    windows_tried: bool,
    published: bool,
    last_arrival_ns: u64,
}

impl Slot {
    fn new(cameras: usize) -> Self {
        Self {
            trigger_id: None,
            full: vec![Detections::default(); cameras],
            window: vec![Detections::default(); cameras],
            has_full: 0,
            has_window: 0,
            missing: 0,
            unsynchronised: false,
            windows_tried: false,
            published: false,
            last_arrival_ns: 0,
        }
    }

    fn begin(&mut self, trigger_id: u64, now_ns: u64) {
        self.trigger_id = Some(trigger_id);
        (self.has_full, self.has_window, self.missing) = (0, 0, 0);
        (self.unsynchronised, self.windows_tried, self.published) = (false, false, false);
        self.last_arrival_ns = now_ns;
    }

    /// The cameras of which anything is there.
    const fn seen(&self) -> u32 {
        self.has_full | self.has_window
    }

    /// When waiting for the other cameras has lasted long enough.
    const fn due_ns(&self, [enough, alone]: [u64; 2]) -> u64 {
        self.last_arrival_ns.saturating_add(if self.seen().count_ones() > 1 { enough } else { alone })
    }

    /// The newest message of each camera in `full`, and of those in `window` that have no other.
    fn with_messages<R>(&self, full: u32, window: u32, use_them: impl FnOnce(&[&Detections]) -> R) -> R {
        let mut messages: [&Detections; MAX_CAMERAS] = [&self.full[0]; MAX_CAMERAS];
        let mut count = 0;
        for camera in 0..self.full.len() {
            let bit = 1 << camera;
            if full & bit != 0 {
                messages[count] = &self.full[camera];
            } else if window & bit != 0 {
                messages[count] = &self.window[camera];
            } else {
                continue;
            }
            count += 1;
        }
        use_them(&messages[..count])
    }
}

impl Matcher {
    /// A matcher for a rig.
    pub fn new(rig: &Rig, options: &TriangulateOptions) -> Self {
        Self {
            triangulator: Triangulator::new(rig, options),
            slots: (0..SLOTS).map(|_| Slot::new(rig.cameras.len())).collect(),
            cameras: rig.camera_mask(),
            // A position that comes late is better than none; one that the others can give need not wait as long.
            patience_ns: options.patience_ns.map_or_else(
                || [rig.interval_ns() / 2, rig.interval_ns().max(LEAST_PATIENCE_NS)],
                |told| [told; 2],
            ),
            decided: 0,
            newest: [0; MAX_CAMERAS],
            counts: MatcherCounts::default(),
        }
    }

    /// The triangulator, for its watch over the rig.
    pub const fn triangulator(&self) -> &Triangulator {
        &self.triangulator
    }

    /// What became of the messages so far.
    pub const fn counts(&self) -> MatcherCounts {
        self.counts
    }

    /// Takes a camera's detections, which arrived at `now_ns`.
    pub fn offer(&mut self, detections: &Detections, now_ns: u64) {
        let camera = detections.camera as usize;
        if camera >= MAX_CAMERAS || self.cameras & (1 << camera) == 0 {
            self.counts.late += 1;
            return;
        }
        let is_full = detections.scope == Scope::Full.code();
        if is_full {
            self.newest[camera] = self.newest[camera].max(detections.trigger_id);
        }
        let Some(slot) = self.slot(detections.trigger_id, now_ns) else {
            self.counts.late += 1;
            return;
        };
        let slot = &mut self.slots[slot];
        slot.last_arrival_ns = now_ns;
        if is_full {
            slot.full[camera] = *detections;
            slot.has_full |= 1 << camera;
        } else {
            slot.window[camera] = *detections;
            slot.has_window |= 1 << camera;
        }
    }

    /// Takes capture's verdict on a trigger.
    pub fn offer_frameset(&mut self, frameset: &Frameset, now_ns: u64) {
        let Some(slot) = self.slot(frameset.trigger_id, now_ns) else { return };
        let slot = &mut self.slots[slot];
        slot.missing |= frameset.expected & !frameset.delivered;
        slot.unsynchronised |= frameset.verdict == Verdict::Unsynchronised.code();
    }

    /// The slot of a trigger; `None` when it has been decided and let go.
    fn slot(&mut self, trigger_id: u64, now_ns: u64) -> Option<usize> {
        if let Some(i) = self.slots.iter().position(|s| s.trigger_id == Some(trigger_id)) {
            return Some(i);
        }
        if trigger_id <= self.decided {
            return None;
        }
        let free = self.slots.iter().position(|s| s.trigger_id.is_none());
        // All in use: one that has been decided only waits to be looked around in, and one of which only
        // capture's verdict is there has no segmenter behind it.
        let i = free.or_else(|| {
            let spare = self.slots.iter().enumerate().filter(|(_, s)| s.published || s.seen() == 0);
            spare.min_by_key(|(_, s)| s.trigger_id).map(|(i, _)| i)
        })?;
        self.slots[i].begin(trigger_id, now_ns);
        Some(i)
    }

    /// The next position that is ready at `now_ns`; to be called until it gives `None`.
    pub fn next(&mut self, now_ns: u64) -> Option<BallPosition> {
        loop {
            self.look_around();
            let waiting = self.slots.iter().enumerate().filter(|(_, s)| !s.published);
            let (trigger_id, i) = waiting.filter_map(|(i, s)| Some((s.trigger_id?, i))).min()?;
            let Some(position) = self.decide(i, trigger_id, now_ns) else {
                // It waits, and so do later ones: positions come in the order of their triggers.
                return None;
            };
            self.decided = trigger_id;
            if let Some(position) = position {
                return Some(position);
            }
        }
    }

    /// When [`Self::next`] will have something to give although nothing arrives, if ever.
    pub fn deadline_ns(&self) -> Option<u64> {
        let waiting = self.slots.iter().filter(|s| s.trigger_id.is_some() && !s.published && s.seen() != 0);
        waiting.map(|s| s.due_ns(self.patience_ns)).min()
    }

    /// Decides the trigger, which has slot `i`: `None` while it waits, `Some(None)` when there is nothing to say.
    fn decide(&mut self, i: usize, trigger_id: u64, now_ns: u64) -> Option<Option<BallPosition>> {
        let slot = &mut self.slots[i];
        let passed =
            (0..MAX_CAMERAS).filter(|c| self.newest[*c] > trigger_id).fold(0_u32, |bits, c| bits | 1 << c);
        let expected = self.cameras & !slot.missing & !(passed & !slot.has_full);
        let due = slot.seen() != 0 && now_ns >= slot.due_ns(self.patience_ns);
        let forced = slot.unsynchronised && self.cameras.count_ones() == 2;
        let complete = slot.has_full & expected == expected;
        let windows = slot.has_window != 0 && slot.seen() & self.cameras == self.cameras;
        if windows && !complete && !slot.windows_tried && !forced {
            slot.windows_tried = true;
            // A full search that is there already replaces its camera's window.
            let triangulator = &mut self.triangulator;
            let (full, window) = (slot.has_full, slot.has_window);
            let position = slot.with_messages(full, window, |d| triangulator.process_windows(d));
            if let Some(mut position) = position {
                position.stamps.triangulate_start_ns = now_ns;
                slot.published = true;
                self.counts.from_windows += 1;
                return Some(Some(position));
            }
        }
        if !(complete || due) {
            return None;
        }
        let seen = slot.seen();
        if seen == 0 {
            // A verdict of capture's and no detection: the segmenters have nothing to say of it.
            slot.trigger_id = None;
            return Some(None);
        }
        self.counts.incomplete += u64::from(seen & self.cameras != self.cameras);
        let triangulator = &mut self.triangulator;
        let mut position = slot.with_messages(slot.has_full, slot.has_window, |d| {
            if forced {
                triangulator.without_position(d, NoPosition::NotSynchronised)
            } else {
                triangulator.process(d)
            }
        });
        position.stamps.triangulate_start_ns = now_ns;
        self.counts.unsynchronised += u64::from(position.reason == NoPosition::NotSynchronised.code());
        slot.trigger_id = None;
        Some(Some(position))
    }

    /// Learns from the full searches of triggers that were decided by their windows, and lets them go.
    fn look_around(&mut self) {
        for slot in &mut self.slots {
            let Some(trigger_id) = slot.trigger_id.filter(|_| slot.published) else { continue };
            if slot.has_full & self.cameras == self.cameras {
                let triangulator = &mut self.triangulator;
                slot.with_messages(slot.has_full, 0, |d| triangulator.look_around(d));
                (slot.trigger_id, slot.published) = (None, false);
            } else if self.newest.iter().any(|n| *n > trigger_id + 2) {
                (slot.trigger_id, slot.published) = (None, false);
            }
        }
    }
}
