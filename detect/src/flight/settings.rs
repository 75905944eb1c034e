//! Noise levels of the model, and how far ball and table may differ from the rig file.

use super::{contact::BounceScatter, flow::ModelNoise, tracker::Latitude};

/// What the model leaves out of a flight over a known table.
pub const NOISE: ModelNoise = ModelNoise {
    acceleration: 0.02,
    spin: 25.0,
    bounce: BounceScatter { normal: 0.015, tangential: 0.08, tangential_floor_m_s: 0.03 },
};

/// Without a table frame gravity's direction is unknown too: (9.81 m/s²)² over a tenth of a second.
pub const NOISE_WITHOUT_TABLE: ModelNoise = ModelNoise { acceleration: 10.0, ..NOISE };

/// How far balls and tables differ.
pub const LATITUDE: Latitude = Latitude { drag: 0.15, restitution: 0.03, forgetting: 0.2 };
