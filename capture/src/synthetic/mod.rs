//! The synthetic source.
pub mod flight;
