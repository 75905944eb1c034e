//! Calibration boards: what is printed on them, where their corners are, and sheets to print.

mod definition;
mod dictionary;
mod pdf;
mod sheet;
mod svg;

pub use definition::{BoardError, CalibrationBoard, Pattern, PlacedMarker};
pub use dictionary::{Dictionary, DictionaryError, Reading};
pub use pdf::to_pdf;
pub use sheet::{Rectangle, Sheet, Text};
pub use svg::to_svg;
