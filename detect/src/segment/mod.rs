//! From a raw mosaic to boxes around what may be the ball.

pub mod kernel;
mod background;
mod blobs;
mod fit;
mod lanes;
pub mod live;
mod noise;
mod patch;
mod sphere;
mod sweep;
