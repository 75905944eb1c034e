use netcord_common::{
    rig::CameraIndex,
    wire::{Frameset, MAX_CAMERAS, Verdict},
};

/// Triggers that are under way or remembered at a time. At 1 kHz and a wait of 20 ms 20 are under way;
/// the others are remembered so that a late or duplicate frame is told from a new one.
const REMEMBERED: usize = 128;

/// What the assembler made of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// The first frame of its camera for its trigger, in time.
    InTime,
    /// The verdict on its trigger had been given before it came.
    Late,
    /// Its camera has delivered this trigger before.
    Duplicate,
}

/// What framesets are held against.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FramesetRules {
    /// Bit i: camera i should deliver each trigger.
    pub expected: u32,
    /// Largest difference between the exposures' middles, ns.
    pub tolerance_ns: u64,
    /// How long a trigger's first frame waits for the others before the verdict is given, ns.
    pub wait_ns: u64,
    /// Session of the capture process.
    pub session: u64,
}

/// Gathers the frames of each trigger and gives one verdict on each. Time is an argument; nothing is
/// allocated after it was made.
///
/// A verdict is given as soon as every expected camera has delivered or is known to have lost the
/// trigger, else when the first news of it is older than the wait. Triggers may be finished in another
/// order than they began.
#[derive(Debug)]
pub struct FramesetAssembler {
    rules: FramesetRules,
    /// The place of a trigger is its id modulo the length.
    triggers: Box<[Gathering; REMEMBERED]>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Gathering {
    trigger_id: u64,
    state: State,
    began_ns: u64,
    delivered: u32,
    lost: u32,
    mid_exposure_ns: [u64; MAX_CAMERAS],
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum State {
    #[default]
    Unused,
    Open,
    Decided,
}

impl FramesetAssembler {
    /// An assembler that has seen nothing.
    pub fn new(rules: FramesetRules) -> Self {
        Self { rules, triggers: Box::new([Gathering::default(); REMEMBERED]) }
    }

    /// Takes note of a frame of `camera` whose exposure's middle was at `mid_exposure_ns`.
    pub fn frame(
        &mut self,
        camera: CameraIndex,
        trigger_id: u64,
        mid_exposure_ns: u64,
        now_ns: u64,
        decided: impl FnMut(&Frameset),
    ) -> Arrival {
        self.note(camera, trigger_id, Some(mid_exposure_ns), now_ns, decided)
    }

    /// Takes note that `camera` will not deliver this trigger.
    pub fn lost(
        &mut self,
        camera: CameraIndex,
        trigger_id: u64,
        now_ns: u64,
        decided: impl FnMut(&Frameset),
    ) {
        self.note(camera, trigger_id, None, now_ns, decided);
    }

    /// Gives the verdict on all triggers that have waited long enough.
    pub fn tick(&mut self, now_ns: u64, mut decided: impl FnMut(&Frameset)) {
        let rules = self.rules;
        loop {
            let overdue = self
                .triggers
                .iter_mut()
                .filter(|t| t.state == State::Open && now_ns.saturating_sub(t.began_ns) >= rules.wait_ns)
                .min_by_key(|t| t.trigger_id);
            let Some(trigger) = overdue else { return };
            trigger.decide(&rules, now_ns, &mut decided);
        }
    }

    fn note(
        &mut self,
        camera: CameraIndex,
        trigger_id: u64,
        mid_exposure_ns: Option<u64>,
        now_ns: u64,
        mut decided: impl FnMut(&Frameset),
    ) -> Arrival {
        let rules = self.rules;
        let slot = &mut self.triggers[(trigger_id % REMEMBERED as u64) as usize];
        if slot.state != State::Unused && slot.trigger_id > trigger_id {
            // Its place has been taken by a trigger that is REMEMBERED or more later.
            return Arrival::Late;
        }
        if slot.state == State::Unused || slot.trigger_id < trigger_id {
            if slot.state == State::Open {
                slot.decide(&rules, now_ns, &mut decided);
            }
            *slot = Gathering { trigger_id, state: State::Open, began_ns: now_ns, ..Gathering::default() };
        }
        if slot.delivered & camera.bit() != 0 {
            return Arrival::Duplicate;
        }
        if slot.state == State::Decided {
            if mid_exposure_ns.is_some() {
                slot.delivered |= camera.bit();
            }
            return Arrival::Late;
        }
        match mid_exposure_ns {
            Some(mid) => {
                slot.delivered |= camera.bit();
                slot.mid_exposure_ns[camera.get()] = mid;
            }
            None => slot.lost |= camera.bit(),
        }
        if (slot.delivered | slot.lost) & rules.expected == rules.expected {
            slot.decide(&rules, now_ns, &mut decided);
        }
        Arrival::InTime
    }
}

impl Gathering {
    fn decide(&mut self, rules: &FramesetRules, now_ns: u64, decided: &mut impl FnMut(&Frameset)) {
        self.state = State::Decided;
        let delivered =
            || self.mid_exposure_ns.iter().enumerate().filter(|(i, _)| self.delivered & (1 << i) != 0);
        let first = delivered().map(|(_, mid)| *mid).min().unwrap_or(0);
        let last = delivered().map(|(_, mid)| *mid).max().unwrap_or(0);
        let skew_ns = last - first;
        let verdict = if self.delivered & rules.expected != rules.expected {
            Verdict::Incomplete
        } else if skew_ns > rules.tolerance_ns {
            Verdict::Unsynchronised
        } else {
            Verdict::Complete
        };
        decided(&Frameset {
            trigger_id: self.trigger_id,
            session: rules.session,
            skew_ns,
            tolerance_ns: rules.tolerance_ns,
            decided_ns: now_ns,
            mid_exposure_ns: self.mid_exposure_ns,
            expected: rules.expected,
            delivered: self.delivered,
            verdict: verdict.code(),
            ..Frameset::default()
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn camera(index: usize) -> CameraIndex {
        CameraIndex::new(index).expect("below 16")
    }

    fn assembler() -> FramesetAssembler {
        let rules = FramesetRules { expected: 0b11, tolerance_ns: 5 * MS, wait_ns: 20 * MS, session: 7 };
        FramesetAssembler::new(rules)
    }

    /// What was decided, as (trigger, verdict, delivered, skew).
    type Decided = Vec<(u64, Verdict, u32, u64)>;

    fn into(list: &mut Decided) -> impl FnMut(&Frameset) {
        |f| {
            let verdict = Verdict::from_code(f.verdict).expect("known");
            list.push((f.trigger_id, verdict, f.delivered, f.skew_ns));
        }
    }

    #[test]
    fn a_trigger_is_decided_when_its_last_camera_has_delivered_in_any_order() {
        let (mut a, mut d) = (assembler(), Decided::new());
        assert_eq!(a.frame(camera(1), 11, 110 * MS, 111 * MS, into(&mut d)), Arrival::InTime);
        assert_eq!(a.frame(camera(0), 10, 100 * MS, 112 * MS, into(&mut d)), Arrival::InTime);
        a.frame(camera(0), 11, 112 * MS, 113 * MS, into(&mut d));
        assert_eq!(d, [(11, Verdict::Complete, 0b11, 2 * MS)]);
        a.frame(camera(1), 10, 106 * MS, 114 * MS, into(&mut d));
        assert_eq!(d[1], (10, Verdict::Unsynchronised, 0b11, 6 * MS));
    }

    #[test]
    fn a_missing_camera_ends_the_wait_when_it_is_known_or_when_time_is_up() {
        let (mut a, mut d) = (assembler(), Decided::new());
        a.frame(camera(0), 1, 0, 0, into(&mut d));
        a.lost(camera(1), 1, MS, into(&mut d));
        assert_eq!(d, [(1, Verdict::Incomplete, 0b01, 0)]);
        a.frame(camera(1), 3, 0, 9 * MS, into(&mut d));
        a.frame(camera(1), 2, 0, 10 * MS, into(&mut d));
        a.tick(28 * MS, into(&mut d));
        assert_eq!(d.len(), 1, "neither has waited 20 ms");
        a.tick(30 * MS, into(&mut d));
        assert_eq!(d[1..], [(2, Verdict::Incomplete, 0b10, 0), (3, Verdict::Incomplete, 0b10, 0)]);
        assert_eq!(a.frame(camera(0), 2, 0, 31 * MS, into(&mut d)), Arrival::Late);
        a.tick(1000 * MS, into(&mut d));
        assert_eq!(d.len(), 3, "one verdict a trigger");
    }

    #[test]
    fn the_second_frame_of_a_camera_is_a_duplicate_before_and_after_the_verdict() {
        let (mut a, mut d) = (assembler(), Decided::new());
        a.frame(camera(0), 1, 0, 0, into(&mut d));
        assert_eq!(a.frame(camera(0), 1, 0, 0, into(&mut d)), Arrival::Duplicate);
        a.frame(camera(1), 1, 0, 0, into(&mut d));
        assert_eq!(a.frame(camera(1), 1, 0, 0, into(&mut d)), Arrival::Duplicate);
        assert_eq!(d.len(), 1);
    }

    #[test]
    fn memory_is_bounded_and_what_falls_out_of_it_is_decided_first() {
        let (mut a, mut d) = (assembler(), Decided::new());
        a.frame(camera(0), 5, 0, 0, into(&mut d));
        a.frame(camera(0), 5 + REMEMBERED as u64, 0, MS, into(&mut d));
        assert_eq!(d, [(5, Verdict::Incomplete, 0b01, 0)]);
        assert_eq!(a.frame(camera(1), 5, 0, 2 * MS, into(&mut d)), Arrival::Late);
    }
}
