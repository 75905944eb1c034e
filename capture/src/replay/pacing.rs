use std::{
    str::FromStr,
    time::{Duration, Instant},
};

use netcord_common::{
    Clock, MonotonicClock, Shutdown,
    bus::{Bus, BusError, Subscriber, Topic},
    rig::Rig,
    wire::{Detections, Scope},
};

/// How fast a recording is replayed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pace {
    /// So many times as fast as it was recorded; 1 = as recorded.
    Factor(f64),
    /// As fast as the segmenter has looked at the frames before.
    Readers,
}

impl FromStr for Pace {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "recorded" => Ok(Self::Factor(1.0)),
            "readers" => Ok(Self::Readers),
            number => match number.parse::<f64>() {
                Ok(factor) if factor.is_finite() && factor > 0.0 => Ok(Self::Factor(factor)),
                _ => Err(format!(
                    "pace {text:?} is not known; valid are recorded, readers, or a factor such as 0.5"
                )),
            },
        }
    }
}

/// How long a shutdown may go unnoticed.
const LOOK_UP: Duration = Duration::from_millis(50);

/// Sleeps until `due_ns` of CLOCK_MONOTONIC; false when `stop` was requested before.
pub(super) fn sleep_until(due_ns: u64, stop: &Shutdown) -> bool {
    loop {
        if stop.is_requested() {
            return false;
        }
        let now = MonotonicClock.now().as_ns();
        if now >= due_ns {
            return true;
        }
        std::thread::sleep(Duration::from_nanos(due_ns - now).min(LOOK_UP));
    }
}

/// Frames of one camera that may be on their way to the segmenter. With more, the camera whose segmenter is
/// behind stays behind by as much, and the triangulator does not wait for it; with one, each frame is
/// searched with the window of the last, as in `netcord process`.
const IN_FLIGHT: u64 = 1;

/// With no answer for this long, nobody segments: the frames go on.
const NOBODY: Duration = Duration::from_millis(500);

/// Watches the segmenter's answers, so as not to run ahead of it.
#[derive(Debug)]
pub(super) struct Readers {
    detections: Vec<Subscriber<Detections>>,
    /// The newest trigger that each camera's segmenter has finished.
    finished: Vec<u64>,
}

impl Readers {
    pub(super) fn open(bus: &Bus, rig: &Rig) -> Result<Self, BusError> {
        let detections = rig
            .cameras
            .iter()
            .map(|camera| bus.subscriber(&Topic::detections(&camera.name)))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self { finished: vec![0; detections.len()], detections })
    }

    /// Waits until `camera`'s segmenter has finished the trigger that lies so far back that `trigger_id`
    /// finds place in its queue.
    pub(super) fn make_room(
        &mut self,
        camera: usize,
        trigger_id: u64,
        stop: &Shutdown,
    ) -> Result<(), BusError> {
        let (subscriber, finished) = (&self.detections[camera], &mut self.finished[camera]);
        // Before the first frame there is nothing to be finished.
        if *finished == 0 {
            *finished = trigger_id.saturating_sub(1);
        }
        let until = Instant::now() + NOBODY;
        loop {
            while let Some(message) = subscriber.receive()? {
                if message.scope == Scope::Full.code() {
                    *finished = (*finished).max(message.trigger_id);
                }
            }
            if *finished + IN_FLIGHT >= trigger_id || stop.is_requested() {
                return Ok(());
            }
            if Instant::now() >= until {
                *finished = trigger_id;
                return Ok(());
            }
            subscriber.wait(Duration::from_millis(2))?;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paces_are_named_or_factors() {
        assert_eq!("recorded".parse(), Ok(Pace::Factor(1.0)));
        assert_eq!("readers".parse(), Ok(Pace::Readers));
        assert_eq!("2.5".parse(), Ok(Pace::Factor(2.5)));
        for bad in ["", "fast", "0", "-1", "inf"] {
            assert!(bad.parse::<Pace>().is_err(), "{bad}");
        }
    }
}
