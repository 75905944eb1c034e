//! Finding boards in pictures.

mod chess;
mod crossing;
mod detector;
mod fiducial;
mod lattice;
mod luma;
mod markers;
mod neighbours;
mod quads;
mod saddle;

use nalgebra::Vector2;

pub(crate) use detector::convex_hull;
pub use detector::{Absence, BoardView, Detector};
pub use luma::Luma;
pub use markers::Marker;
pub use saddle::{Saddle, SaddleFit};

/// A calibration point of a board in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    /// Its place in [`crate::board::CalibrationBoard::corners`].
    pub id: usize,
    /// Where, in px.
    pub at: Vector2<f64>,
}

/// How much work a search may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// Live guidance: large pictures are searched at half size, and an ArUco grid's corners are not
    /// refined.
    Guiding,
    /// The corners that calibration uses.
    Final,
}
