//! The triangulator on the bus: detections and framesets in, positions out.

use std::{sync::Arc, time::Duration};

use netcord_common::{
    Clock, Count, Counters, HealthReporter, MonotonicClock, Shutdown,
    bus::{Bus, BusError, Listen, SequenceGaps, Topic, wait_any},
    realtime,
    rig::Rig,
    wire::{BallPosition, MAX_CAMERAS, ProcessState},
};

use super::{Matcher, TriangulateOptions, matcher::MatcherCounts};

/// How long the loop sleeps at most, so that it sees a request to stop.
const LONGEST_WAIT: Duration = Duration::from_millis(100);

/// A position takes a few microseconds, and comes before the rest of a frame that another thread searches.
const TURN: Duration = Duration::from_micros(100);

/// Runs the triangulator of a rig until `stop` is requested; `on_ready` is called once, when it listens. Counts on
/// `rig/health` what was lost and why.
///
/// # Errors
/// [`BusError`], also when another triangulator runs in the domain.
pub fn run(
    bus: &Bus,
    rig: &Rig,
    options: &TriangulateOptions,
    stop: &Shutdown,
    counters: &Arc<Counters>,
    on_ready: impl FnOnce(),
) -> Result<(), BusError> {
    let publisher = bus.publisher(&Topic::position())?;
    let framesets = bus.subscriber(&Topic::frameset())?;
    let detections = rig
        .cameras
        .iter()
        .map(|c| bus.subscriber(&Topic::detections(&c.name)))
        .collect::<Result<Vec<_>, _>>()?;
    let mut listeners: Vec<&dyn Listen> = detections.iter().map(|d| d as &dyn Listen).collect();
    listeners.push(&framesets);
    let mut health = HealthReporter::open(bus, "triangulate", counters)?;
    let tally = Tally::register(counters, rig);
    let mut gaps = [SequenceGaps::new(); MAX_CAMERAS];
    let mut matcher = Matcher::new(rig, options);
    let clock = MonotonicClock;
    let mut distrusted = 0;

    realtime::take_short_turns(TURN);
    counters.set_state(ProcessState::Running);
    health.publish(clock.now().as_ns())?;
    on_ready();
    while !stop.is_requested() {
        let now = clock.now().as_ns();
        let wait =
            matcher.deadline_ns().map_or(LONGEST_WAIT, |at| Duration::from_nanos(at.saturating_sub(now)));
        wait_any(&listeners, wait.min(LONGEST_WAIT))?;
        // Positions are given between messages, so that one that is ready never waits behind a queue.
        while let Some(frameset) = framesets.receive()? {
            matcher.offer_frameset(&frameset, clock.now().as_ns());
        }
        let mut some = true;
        while some {
            some = false;
            for (camera, subscriber) in detections.iter().enumerate() {
                let Some(message) = subscriber.receive()? else { continue };
                some = true;
                // A frame gives up to two messages with one sequence number.
                tally.lost[camera].add(gaps[camera].see(message.session, message.sequence));
                matcher.offer(&message, clock.now().as_ns());
            }
            while let Some(mut position) = matcher.next(clock.now().as_ns()) {
                position.stamps.triangulate_published_ns = clock.now().as_ns();
                publisher.send(&position)?;
                tally.see(&position);
            }
        }
        if matcher.triangulator().watch().distrusted() != distrusted {
            distrusted = matcher.triangulator().watch().distrusted();
            report(rig, &matcher, distrusted);
        }
        tally.follow(matcher.counts());
        health.tick(clock.now().as_ns())?;
    }
    counters.set_state(ProcessState::Stopping);
    health.publish(clock.now().as_ns())
}

/// Says once, when it changes, which cameras no longer fit the rig.
fn report(rig: &Rig, matcher: &Matcher, distrusted: u32) {
    for camera in &rig.cameras {
        let i = camera.index.get();
        if distrusted & camera.index.bit() != 0 {
            let pairs = rig.cameras.iter().filter(|o| o.index != camera.index);
            let worst = pairs
                .filter_map(|o| matcher.triangulator().watch().pair(i, o.index.get()))
                .fold(0.0_f64, f64::max);
            tracing::warn!(
                camera = %camera.name,
                "camera {} no longer fits the rig (residual of its worst pair {worst:.1} standard deviations, 0.8 is \
                 expected): it has been knocked or its calibration is old; it is left out while others suffice; \
                 calibrate it again",
                camera.name
            );
        }
    }
    if distrusted == 0 {
        tracing::info!("all cameras fit the rig again");
    }
}

/// Counters that are raised on the way.
struct Tally {
    positions: Count,
    absent: Count,
    lost: Vec<Count>,
    late: Count,
    incomplete: Count,
    unsynchronised: Count,
    from_windows: Count,
    distrusted: Vec<Count>,
}

impl Tally {
    fn register(counters: &Counters, rig: &Rig) -> Self {
        let per_camera = |what: &str| {
            rig.cameras.iter().map(|c| counters.register(&format!("{}/{what}", c.name))).collect::<Vec<_>>()
        };
        Self {
            positions: counters.register("positions"),
            absent: counters.register("triggers_without_position"),
            lost: per_camera("detections_lost"),
            late: counters.register("detections_late"),
            incomplete: counters.register("triggers_incomplete"),
            unsynchronised: counters.register("triggers_unsynchronised"),
            from_windows: counters.register("positions_from_windows"),
            distrusted: per_camera("triggers_distrusted"),
        }
    }

    /// Brings the counters up to what the matcher has counted.
    fn follow(&self, counts: MatcherCounts) {
        let pairs = [
            (&self.late, counts.late),
            (&self.incomplete, counts.incomplete),
            (&self.unsynchronised, counts.unsynchronised),
            (&self.from_windows, counts.from_windows),
        ];
        for (count, value) in pairs {
            count.add(value.saturating_sub(count.get()));
        }
    }

    fn see(&self, position: &BallPosition) {
        if position.is_present() {
            self.positions.up()
        } else {
            self.absent.up()
        }
        for (i, count) in self.distrusted.iter().enumerate() {
            count.add(u64::from(position.distrusted & (1 << i) != 0));
        }
    }
}
