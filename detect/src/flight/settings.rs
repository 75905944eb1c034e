//! Noise levels of the model, and how far ball and table may differ from the rig file.

use super::{contact::BounceScatter, flow::ModelNoise, tracker::Latitude};

/// What the filter assumes beside the physical constants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tuning {
    /// What the model leaves out.
    pub noise: ModelNoise,
    /// How far ball and table may differ from the rig file.
    pub latitude: Latitude,
}

impl Default for Tuning {
    fn default() -> Self {
        Self {
            noise: ModelNoise {
                acceleration: 0.02,
                spin: 25.0,
                bounce: BounceScatter { normal: 0.015, tangential: 0.08, tangential_floor_m_s: 0.03 },
            },
            latitude: Latitude { drag: 0.15, restitution: 0.03, forgetting: 0.2 },
        }
    }
}

impl Tuning {
    /// Where no table frame is known, gravity's direction is not either: its 9.81 m/s² are noise, over a
    /// tenth of a second.
    pub fn without_table() -> Self {
        let mut tuning = Self::default();
        tuning.noise.acceleration = 10.0;
        tuning
    }
}
