//! What turns frames into positions and flights: segmentation, triangulation, prediction.

pub mod flight;
pub mod segment;
pub mod triangulate;
