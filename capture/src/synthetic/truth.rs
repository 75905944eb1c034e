use std::sync::{Mutex, PoisonError};

use netcord_common::{
    DomainName, NameError,
    bus::{Bus, BusError, Publisher, Topic},
    rig::CameraIndex,
    wire::{BallTruth, CameraTruth},
};

/// The domain in which the truth of `domain` travels: `<domain>-truth`.
///
/// # Errors
/// When the name becomes too long.
pub fn truth_domain(domain: &DomainName) -> Result<DomainName, NameError> {
    DomainName::new(format!("{domain}-truth"))
}

/// Triggers whose truth waits for cameras.
const PENDING: usize = 64;

/// Gathers what each camera's thread knows of a trigger, and publishes it when all have spoken.
#[derive(Debug)]
pub struct TruthDesk {
    pending: Mutex<Box<[Pending; PENDING]>>,
    publisher: Publisher<BallTruth>,
    all: u32,
    /// Membership of the truth's domain.
    _bus: Bus,
}

#[derive(Debug, Clone, Copy, Default)]
struct Pending {
    truth: BallTruth,
    spoken: u32,
}

impl TruthDesk {
    /// Opens `truth/ball` beside `domain`; `all` are the bits of the cameras.
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn open(domain: &DomainName, all: u32) -> Result<Self, BusError> {
        let bus = Bus::join(domain, "capture")?;
        let publisher = bus.publisher(&Topic::truth())?;
        Ok(Self { pending: Mutex::new(Box::new([Pending::default(); PENDING])), publisher, all, _bus: bus })
    }

    /// Takes what `camera` knows of a trigger; `truth` is what is true of it in all cameras.
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn add(&self, truth: &BallTruth, camera: CameraIndex, seen: CameraTruth) -> Result<(), BusError> {
        let mut pending = self.pending.lock().unwrap_or_else(PoisonError::into_inner);
        let place = &mut pending[(truth.trigger_id % PENDING as u64) as usize];
        if place.truth.trigger_id != truth.trigger_id {
            *place = Pending { truth: *truth, spoken: 0 };
        }
        place.truth.cameras[camera.get()] = seen;
        place.spoken |= camera.bit();
        if place.spoken == self.all {
            self.publisher.send(&place.truth)?;
        }
        Ok(())
    }
}
