//! What cameras see of a scene, as raw mosaics.
//!
//! A frame is the still backdrop, which is rendered once, and what moves before it, which is painted
//! into tiles of mean levels; both are then developed: brightness, shot and read noise, quantisation.

mod backdrop;
mod board;
mod canvas;
mod frame;
mod layer;
mod noise;
mod outline;
mod rays;

pub use backdrop::Backdrop;
pub use frame::{Exposure, FrameRenderer};
pub use noise::{Developer, SensorNoise, hash};
pub use rays::TILE;
