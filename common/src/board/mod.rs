//! Calibration boards: what is printed on them, and where their corners are. Calibration looks for them,
//! the synthetic scene shows them.

mod definition;
mod dictionary;

pub use definition::{BoardError, CalibrationBoard, Pattern, PlacedMarker};
pub use dictionary::{Dictionary, DictionaryError, Reading};
