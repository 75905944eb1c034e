//! Calibration boards: what is printed on them, where their corners are, and sheets to print.

mod pdf;
mod sheet;
mod svg;

pub use netcord_common::board::{
    BoardError, CalibrationBoard, Dictionary, DictionaryError, Pattern, PlacedMarker, Reading,
};
pub use pdf::to_pdf;
pub use sheet::{Rectangle, Sheet, Text};
pub use svg::to_svg;
