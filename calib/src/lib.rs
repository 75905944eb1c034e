//! Calibration: boards, their detection, and the mathematics from corners to a rig.

pub mod solve;
