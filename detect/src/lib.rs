//! netcord-detect.

pub mod flight;
