//! The camera model: pinhole with Brown–Conrady distortion `k1 k2 p1 p2 k3`.

mod model;
mod undistort;

pub use model::{CameraModel, CameraModelError, Distortion, INTRINSICS, Projected};
