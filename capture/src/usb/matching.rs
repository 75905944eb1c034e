use std::collections::VecDeque;

use netcord_common::rig::TriggerRole;

/// Gives frames their trigger ids, by their instants and never by their number.
///
/// Triggered cameras expose on the rig's grid of instants: the grid's step that precedes an exposure is
/// its trigger. Free-running cameras have no grid: the first frame of an instant makes a new trigger,
/// and the other cameras' frames join it. A camera that slips by a frame is so re-matched with its next
/// frame; that its block ids and trigger ids no longer go together is counted as a slip.
#[derive(Debug)]
pub struct TriggerMatcher {
    grid: Grid,
    /// The grid before the last change of the rate: its last frames may still be under way.
    previous: Option<Grid>,
    recent: VecDeque<(u64, u64)>,
    cameras: Vec<LastFrame>,
}

/// The rig's instants: trigger `id` is at `origin_ns` + (`id` − `first`) · `interval_ns`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// CLOCK_MONOTONIC of the first trigger.
    pub origin_ns: u64,
    /// Its id.
    pub first: u64,
    /// From trigger to trigger.
    pub interval_ns: u64,
}

impl Grid {
    /// The first trigger that is not before `now`: its id and instant.
    pub const fn next(&self, now_ns: u64) -> (u64, u64) {
        let steps = now_ns.saturating_sub(self.origin_ns).div_ceil(self.interval_ns);
        (self.first + steps, self.origin_ns + steps * self.interval_ns)
    }

    /// The same grid at another rate from trigger `id` on, so that ids only grow.
    pub const fn changed(&self, id: u64, interval_ns: u64) -> Self {
        let at = self.origin_ns + id.saturating_sub(self.first) * self.interval_ns;
        Self { origin_ns: at, first: id, interval_ns }
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct LastFrame {
    seen: Option<(u64, u64)>,
    slips: u64,
}

/// Triggers of free-running cameras that may still be joined.
const RECENT: usize = 64;

/// What a frame turned out to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Matched {
    /// Its trigger.
    pub trigger_id: u64,
    /// Whether block id and trigger id went apart since the camera's last frame.
    pub slipped: bool,
}

impl TriggerMatcher {
    /// A matcher for `cameras` cameras.
    pub fn new(grid: Grid, cameras: usize) -> Self {
        let recent = VecDeque::with_capacity(RECENT);
        Self { grid, previous: None, recent, cameras: vec![LastFrame::default(); cameras] }
    }

    /// The grid.
    pub const fn grid(&self) -> Grid {
        self.grid
    }

    /// Changes the rate from the trigger after `now_ns` on.
    pub const fn set_interval(&mut self, now_ns: u64, interval_ns: u64) {
        let (next, _) = self.grid.next(now_ns);
        self.previous = Some(self.grid);
        self.grid = self.grid.changed(next, interval_ns);
    }

    /// The last trigger that is over at `now_ns` for cameras of `role`; 0 where there was none.
    pub fn passed(&self, role: TriggerRole, now_ns: u64) -> u64 {
        match role {
            TriggerRole::Software | TriggerRole::Hardware => self.grid.next(now_ns).0.saturating_sub(2),
            TriggerRole::FreeRun => self.recent.back().map_or(0, |(id, _)| *id),
        }
    }

    /// Slips of a camera so far.
    pub fn slips(&self, camera: usize) -> u64 {
        self.cameras[camera].slips
    }

    /// A camera's device counts anew: after a restart of its stream.
    pub fn forget(&mut self, camera: usize) {
        self.cameras[camera].seen = None;
    }

    /// The trigger of a frame whose trigger impulse came at about `impulse_ns`. A frame of a triggered
    /// camera that no trigger precedes has none.
    pub fn triggered(&mut self, camera: usize, impulse_ns: u64, block: u64) -> Option<Matched> {
        // The command takes its way: an impulse comes up to three quarters of an interval late, and
        // by the clocks' uncertainty up to a quarter early.
        let before = |previous: &Grid| {
            let early = previous.interval_ns.min(self.grid.interval_ns) / 4;
            impulse_ns + early < self.grid.origin_ns
        };
        let grid = self.previous.filter(before).unwrap_or(self.grid);
        let since = (impulse_ns + grid.interval_ns / 4).checked_sub(grid.origin_ns)?;
        Some(self.note(camera, grid.first + since / grid.interval_ns, block))
    }

    /// The trigger of a free-running camera's frame exposed at `mid_ns`.
    pub fn free_running(&mut self, camera: usize, mid_ns: u64, block: u64) -> Matched {
        let near = |at: u64| at.abs_diff(mid_ns) < self.grid.interval_ns / 2;
        // Of two triggers in reach, the nearer; one that this camera has already is not its own.
        let taken = self.cameras[camera].seen.map_or(0, |(trigger, _)| trigger);
        let joined = self
            .recent
            .iter()
            .filter(|(id, at)| near(*at) && *id > taken)
            .min_by_key(|(_, at)| at.abs_diff(mid_ns))
            .map(|(id, _)| *id);
        let id = joined.unwrap_or_else(|| {
            let newest = self.recent.back().copied();
            let id = newest.map_or(self.grid.first, |(id, at)| {
                let steps = mid_ns.saturating_sub(at).saturating_add(self.grid.interval_ns / 2)
                    / self.grid.interval_ns;
                id + steps.max(1)
            });
            if self.recent.len() == RECENT {
                self.recent.pop_front();
            }
            self.recent.push_back((id, mid_ns));
            id
        });
        self.note(camera, id, block)
    }

    fn note(&mut self, camera: usize, trigger_id: u64, block: u64) -> Matched {
        let last = &mut self.cameras[camera];
        let slipped = last
            .seen
            .is_some_and(|(trigger, seen)| trigger_id.wrapping_sub(trigger) != block.wrapping_sub(seen));
        last.seen = Some((trigger_id, block));
        last.slips += u64::from(slipped);
        Matched { trigger_id, slipped }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;
    const GRID: Grid = Grid { origin_ns: 100 * MS, first: 5000, interval_ns: 10 * MS };

    #[test]
    fn late_commands_and_early_clocks_still_meet_their_trigger() {
        let mut matcher = TriggerMatcher::new(GRID, 2);
        for (block, at) in [100, 110, 127, 128, 140].into_iter().enumerate() {
            let matched = matcher.triggered(0, at * MS, block as u64).expect("after the origin");
            assert_eq!(matched.trigger_id, [5000, 5001, 5002, 5003, 5004][block]);
            assert!(!matched.slipped);
        }
        assert_eq!(matcher.triggered(1, 10 * MS, 0), None);
        assert_eq!(GRID.next(105 * MS), (5001, 110 * MS));
        let slower = GRID.changed(5001, 20 * MS);
        assert_eq!(slower.next(111 * MS), (5002, 130 * MS));
    }

    #[test]
    fn frames_of_triggers_before_a_change_of_the_rate_keep_their_ids() {
        for interval in [3 * MS, 40 * MS] {
            let mut matcher = TriggerMatcher::new(GRID, 1);
            let id = |matcher: &mut TriggerMatcher, at: u64, block| {
                matcher.triggered(0, at, block).expect("after the origin")
            };
            assert_eq!(id(&mut matcher, 110 * MS + 200_000, 0).trigger_id, 5001);
            // Triggered at 120 ms; its frame arrives after the change.
            matcher.set_interval(121 * MS, interval);
            let matched = id(&mut matcher, 120 * MS + 200_000, 1);
            assert_eq!((matched.trigger_id, matched.slipped), (5002, false));
            for n in 0..3 {
                let matched = id(&mut matcher, 130 * MS + n * interval + 200_000, 2 + n);
                assert_eq!((matched.trigger_id, matched.slipped), (5003 + n, false));
            }
        }
    }

    #[test]
    fn a_camera_that_slips_is_matched_again_with_its_next_frame() {
        let mut matcher = TriggerMatcher::new(GRID, 2);
        let mut wrong = 0;
        // Camera 1 misses the impulse of trigger 7; its device does not count it.
        let mut block = 0;
        for n in 0..20 {
            let at = GRID.origin_ns + n * GRID.interval_ns + 200_000;
            let a = matcher.triggered(0, at, n).expect("a trigger");
            if n == 7 {
                continue;
            }
            let b = matcher.triggered(1, at + 100_000, block).expect("a trigger");
            block += 1;
            wrong += u64::from(a.trigger_id != b.trigger_id);
            assert_eq!(b.slipped, n == 8);
        }
        assert_eq!((wrong, matcher.slips(0), matcher.slips(1)), (0, 0, 1));
    }

    #[test]
    fn free_running_cameras_join_each_others_instants_in_any_order() {
        let mut matcher = TriggerMatcher::new(GRID, 3);
        let mut last = 0;
        for n in 0..500_u64 {
            // Rates differ from the rig's; the cameras' phases by up to 3 ms; their order changes.
            let at = GRID.origin_ns + n * 10_050_000;
            let mut order = [0, 1, 2];
            order.rotate_left((n % 3) as usize);
            let ids: Vec<u64> = order
                .iter()
                .map(|c| matcher.free_running(*c, at + [0, 3 * MS, MS][*c], n).trigger_id)
                .collect();
            assert!(ids.iter().all(|id| *id == ids[0]), "{n}: {ids:?}");
            assert!(ids[0] > last);
            last = ids[0];
        }
        // A pause takes its place in the ids.
        let after = matcher.free_running(0, GRID.origin_ns + 499 * 10_050_000 + 100 * MS, 510).trigger_id;
        assert_eq!(after, last + 10);
    }
}
