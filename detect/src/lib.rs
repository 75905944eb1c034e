//! netcord-detect.

pub mod flight;
pub mod triangulate;
