//! The process `netcord predict`: bus in, bus out.

use std::{sync::Arc, time::Duration};

use netcord_common::{
    Clock, Counters, HealthReporter, MonotonicClock, Shutdown,
    bus::{Bus, BusError, SequenceGaps, Topic},
    realtime,
    rig::Rig,
    wire::{ProcessState, TrajectoryOutcome},
};

use super::{PredictOptions, Predictor};

/// How long the loop waits before it looks at the shutdown flag again; also how late counters may be.
const PATIENCE: Duration = Duration::from_millis(50);

/// A position takes a tenth of a millisecond or two, and comes before the rest of a frame that is searched.
const TURN: Duration = Duration::from_micros(200);

/// Reads `ball/position` and writes `ball/trajectory` and the cameras' search windows until `stop` is
/// requested. `on_ready` is called once, when all ends are open. No allocation, file access or log line
/// per position.
///
/// # Errors
/// [`BusError`] when an end cannot be opened or used.
pub fn run(
    bus: &Bus,
    rig: &Rig,
    options: PredictOptions,
    stop: &Shutdown,
    counters: &Arc<Counters>,
    on_ready: impl FnOnce(),
) -> Result<(), BusError> {
    let clock = MonotonicClock;
    let positions = bus.subscriber(&Topic::position())?;
    let trajectories = bus.publisher(&Topic::trajectory())?;
    let windows = rig
        .cameras
        .iter()
        .map(|camera| bus.publisher(&Topic::window(&camera.name)))
        .collect::<Result<Vec<_>, _>>()?;
    let [received, lost, late, predicted, present] =
        ["positions", "lost_overflow", "late", "trajectories", "windows"].map(|name| counters.register(name));
    let mut health = HealthReporter::open(bus, "predict", counters)?;
    let mut predictor = Predictor::new(rig, options);
    let mut gaps = SequenceGaps::new();
    let mut newest_ns = 0;
    realtime::take_short_turns(TURN);
    counters.set_state(ProcessState::Running);
    health.publish(clock.now().as_ns())?;
    on_ready();

    while !stop.is_requested() {
        positions.wait(PATIENCE)?;
        while let Some(position) = positions.receive()? {
            let start_ns = clock.now().as_ns();
            received.up();
            lost.add(gaps.see(0, position.sequence));
            let late_before = predictor.late();
            let mut trajectory = *predictor.update(&position);
            late.add(predictor.late() - late_before);
            trajectory.stamps.predict_start_ns = start_ns;
            trajectory.stamps.predict_published_ns = clock.now().as_ns();
            trajectories.send(&trajectory)?;
            predicted.add(u64::from(trajectory.outcome == TrajectoryOutcome::InFlight.code()));

            // Windows are for the trigger after the newest, whatever came late.
            let t_ns = position.stamps.mid_exposure_ns;
            if t_ns < newest_ns || positions.has_message() {
                continue;
            }
            newest_ns = t_ns;
            for (window, publisher) in predictor.windows(t_ns + rig.interval_ns()).zip(&windows) {
                publisher.send(&window)?;
                present.add(u64::from(window.present));
            }
        }
        health.tick(clock.now().as_ns())?;
    }
    counters.set_state(ProcessState::Stopping);
    health.publish(clock.now().as_ns())
}
