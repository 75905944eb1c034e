//! Points and rigid transforms that carry their frames of reference in their types.

mod point;
mod transform;

pub use point::Point;
pub use transform::{Transform, TransformError};

/// A frame of reference: a type without values.
pub trait ReferenceFrame: 'static {}

/// The frame of results: the table frame (origin at the centre of the playing surface, x along
/// the 1.525 m width, y along the 2.740 m length, z up) where the rig has a table pose, else the
/// first camera's frame. Messages say which ([`crate::wire::WorldFrame`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum World {}
impl ReferenceFrame for World {}

/// A camera's frame: x right, y down, z forward, origin at the projection centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Camera {}
impl ReferenceFrame for Camera {}

/// A calibration board's frame: origin at its first corner, x along its columns, y along its
/// rows, z away from the viewer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Board {}
impl ReferenceFrame for Board {}
