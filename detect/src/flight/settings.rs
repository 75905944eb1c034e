//! Noise levels of the model, and how far ball and table may differ from the rig file.

use super::{contact::BounceScatter, flow::ModelNoise, habits::Latitude};

/// What the filter assumes beside the physical constants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tuning {
    /// What the model leaves out.
    pub noise: ModelNoise,
    /// How far ball and table may differ from the rig file.
    pub latitude: Latitude,
}

/// Found by coordinate descent on the prediction errors of either half of the real flights at hand (by a hash of
/// their names), each checked on the other; these are between the two, with a last look at all.
impl Default for Tuning {
    fn default() -> Self {
        Self {
            noise: ModelNoise {
                acceleration: 0.05,
                spin: 155.0,
                bounce: BounceScatter { normal: 0.014, tangential: 0.09, tangential_floor_m_s: 0.012 },
            },
            latitude: Latitude {
                drag: 0.052,
                restitution: 0.02,
                slant_m_s2: 0.2,
                friction: 0.25,
                forgetting: 0.14,
            },
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
