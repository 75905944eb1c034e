use std::collections::BTreeMap;

use netcord_common::{
    bus::{Bus, Subscriber, Topic},
    wire::{BallPosition, Frameset, Health},
};

use crate::until;

/// Sees a domain's positions, framesets and health.
#[derive(Debug)]
pub struct Watch {
    positions: Subscriber<BallPosition>,
    framesets: Subscriber<Frameset>,
    health: Subscriber<Health>,
    latest: BTreeMap<String, Health>,
}

impl Watch {
    /// From now on.
    ///
    /// # Panics
    /// When the domain refuses.
    pub fn attach(bus: &Bus) -> Self {
        Self {
            positions: bus.subscriber(&Topic::position()).expect("positions can be read"),
            framesets: bus.subscriber(&Topic::frameset()).expect("framesets can be read"),
            health: bus.subscriber(&Topic::health()).expect("health can be read"),
            latest: BTreeMap::new(),
        }
    }

    /// The messages of `ball/position` that wait.
    pub fn positions(&self) -> Vec<BallPosition> {
        std::iter::from_fn(|| self.positions.receive().expect("readable")).collect()
    }

    /// The framesets that wait.
    pub fn framesets(&self) -> Vec<Frameset> {
        std::iter::from_fn(|| self.framesets.receive().expect("readable")).collect()
    }

    /// The newest health message of every process seen so far.
    pub fn health(&mut self) -> &BTreeMap<String, Health> {
        while let Some(health) = self.health.receive().expect("readable") {
            self.latest.insert(health.process.as_str().to_owned(), health);
        }
        &self.latest
    }

    /// Process ids of the four stages, once all have said who they are.
    pub fn stages(&mut self) -> BTreeMap<String, u32> {
        until("health of all stages", || {
            let health = self.health();
            let stages = ["capture", "segment", "triangulate", "predict"];
            stages.iter().map(|s| Some(((*s).to_owned(), health.get(*s)?.pid))).collect()
        })
    }

    /// The value of a process's counter, summed over those whose name ends so.
    pub fn counter(&mut self, process: &str, ending: &str) -> u64 {
        self.health().get(process).map_or(0, |health| {
            health.counters().iter().filter(|c| c.name.as_str().ends_with(ending)).map(|c| c.value).sum()
        })
    }

    /// Waits for a position of the ball that was published at or after `from_ns`.
    pub fn position_after(&self, from_ns: u64) -> BallPosition {
        until("a position of the ball", || {
            self.positions()
                .into_iter()
                .find(|p| p.is_present() && p.stamps.triangulate_published_ns >= from_ns)
        })
    }
}
