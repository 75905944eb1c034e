use std::path::PathBuf;

use thiserror::Error;

use super::{Preset, carried::CarriedBoardError};
use crate::synthetic::flight::RecordedFlightsError;

/// What a scene is made from.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SceneOptions {
    /// How hard it is.
    pub preset: Preset,
    /// Settles everything that the preset leaves open: the same seed gives the same frames.
    pub seed: u64,
    /// A CSV file of flights `t,x,y,z`, or a folder of them, in place of the simulated rally.
    pub flights: Option<PathBuf>,
    /// Length of the exposure, ns, in place of the preset's or the rig's.
    pub exposure_ns: Option<u64>,
    /// A calibration board, as `netcord calib board` takes it, carried through the scene in place of play.
    pub board: Option<String>,
    /// Its way: a CSV file of poses (`t,x,y,z,rx,ry,rz`), in place of a tour before all cameras.
    pub board_path: Option<PathBuf>,
}

/// Why there is no such scene.
#[derive(Debug, Error)]
pub enum SceneError {
    /// The flights cannot be used.
    #[error(transparent)]
    Flights(#[from] RecordedFlightsError),
    /// The ball cannot be played.
    #[error(
        "no stroke brings a ball of {diameter_m} m and 2.7 g over the net and onto the table: the air stops it. Give \
         the rig's [ball] a diameter_m near 0.04, or recorded flights"
    )]
    NoFlight {
        /// The ball's diameter by the rig, m.
        diameter_m: f64,
    },
    /// The board cannot be shown.
    #[error(transparent)]
    Board(#[from] CarriedBoardError),
}
