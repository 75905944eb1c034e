//! Finding boards in pictures.

mod chess;
mod crossing;
mod detector;
mod fiducial;
mod lattice;
mod luma;
mod markers;
mod neighbours;
mod normal;
mod pattern_fit;
mod quads;
mod saddle;

use nalgebra::Vector2;

pub(crate) use detector::convex_hull;
pub use detector::{Absence, BoardView, Detector};
pub use luma::Luma;
pub use markers::Marker;
pub(crate) use normal::normal_distribution;
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
    /// The corners that calibration uses. A picture of 1920 × 1200 takes some 50 ms; an ArUco grid, of which each
    /// marker is fitted as a whole, up to half a second on one core.
    Final,
}
