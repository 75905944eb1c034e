//! Calibration boards: what is printed on them, and where their corners are. Calibration looks for them,
//! the synthetic scene shows them.

mod definition;
mod description;
mod dictionary;
mod surface;

pub use definition::{CalibrationBoard, Pattern, PlacedMarker};
pub use description::BoardError;
pub use dictionary::{Dictionary, DictionaryError, Reading};
