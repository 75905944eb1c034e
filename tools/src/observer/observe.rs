use std::time::Duration;

use netcord_common::{
    bus::{Bus, BusError, Subscriber, Topic},
    rig::Rig,
    wire::{BallPosition, BallTrajectory, BallTruth, Detections, Frameset, Health},
};

/// One message seen.
#[derive(Debug, Clone, Copy)]
pub enum Observed<'a> {
    /// A verdict on a trigger.
    Frameset(&'a Frameset),
    /// What a segmenter found.
    Detections(&'a Detections),
    /// A position, or the reason why there is none.
    Position(&'a BallPosition),
    /// A trajectory.
    Trajectory(&'a BallTrajectory),
    /// A process's counters.
    Health(&'a Health),
    /// What is true; never from an [`Observer`], since the truth travels in a domain of its own.
    Truth(&'a BallTruth),
}

/// Reading ends of all small messages of a rig; frames are left alone.
#[derive(Debug)]
pub struct Observer {
    framesets: Subscriber<Frameset>,
    detections: Vec<Subscriber<Detections>>,
    positions: Subscriber<BallPosition>,
    trajectories: Subscriber<BallTrajectory>,
    health: Subscriber<Health>,
    interval: Duration,
}

impl Observer {
    /// Opens the reading ends.
    ///
    /// # Errors
    /// As [`Bus::subscriber`].
    pub fn attach(bus: &Bus, rig: &Rig) -> Result<Self, BusError> {
        // A queue holds 32 messages, and a segmenter sends up to two a trigger: read after at most 8.
        let interval = Duration::from_secs_f64(8.0 / rig.rate_hz)
            .clamp(Duration::from_millis(1), Duration::from_millis(50));
        Ok(Self {
            framesets: bus.subscriber(&Topic::frameset())?,
            detections: rig
                .cameras
                .iter()
                .map(|c| bus.subscriber(&Topic::detections(&c.name)))
                .collect::<Result<_, _>>()?,
            positions: bus.subscriber(&Topic::position())?,
            trajectories: bus.subscriber(&Topic::trajectory())?,
            health: bus.subscriber(&Topic::health())?,
            interval,
        })
    }

    /// How often [`Self::drain`] must be called for nothing to be missed.
    pub const fn interval(&self) -> Duration {
        self.interval
    }

    /// Hands over all messages that wait: for each trigger frameset, detections and position come in an
    /// order that is not told.
    ///
    /// # Errors
    /// As [`Subscriber::receive`].
    pub fn drain(&mut self, on: &mut dyn FnMut(Observed<'_>)) -> Result<(), BusError> {
        while let Some(frameset) = self.framesets.receive()? {
            on(Observed::Frameset(&frameset));
        }
        for detections in &self.detections {
            while let Some(detections) = detections.receive()? {
                on(Observed::Detections(&detections));
            }
        }
        while let Some(position) = self.positions.receive()? {
            on(Observed::Position(&position));
        }
        while let Some(trajectory) = self.trajectories.receive()? {
            on(Observed::Trajectory(&trajectory));
        }
        while let Some(health) = self.health.receive()? {
            on(Observed::Health(&health));
        }
        Ok(())
    }
}
