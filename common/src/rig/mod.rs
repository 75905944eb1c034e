//! The rig file `rig.toml`: one file describes a system of cameras, ball, table and processes.
//!
//! [`Rig::load`] parses, checks and resolves it; a [`Rig`] that exists is complete and consistent. An
//! error names file, line and key, and what would be valid. [`RigEdit`] writes calibration results back,
//! keeping comments, into a new file that is renamed over the old one.

mod ball;
mod camera;
mod edit;
mod error;
pub mod exchange;
mod file;
mod flight;
mod learnt;
mod process;
mod resolve;
mod system;
mod wiring;

pub use ball::{Ball, BallColour};
pub use camera::{CameraIndex, ClockDelay, IntrinsicsSigma, RigCamera, TriggerRole};
pub use edit::{CalibrationNote, RigEdit};
pub use error::RigError;
pub use flight::{FlightConstants, HittingPlane};
pub use learnt::{ColourKind, ColourTest, LearningNote, LearntColour, MAX_COLOUR_TESTS};
pub use process::{ProcessSpec, Restart};
pub use system::Rig;
pub use wiring::{StampMeaning, TriggerEdge, Wiring};
