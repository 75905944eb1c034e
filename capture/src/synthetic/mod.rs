//! A scene that never ends, rendered into frames: rallies, or recorded flights, in a hall with all that
//! makes a ball hard to find; with the truth, and with faults on demand.

mod faults;
pub mod flight;
mod pool;
pub mod render;
pub mod scene;
mod source;
mod truth;

pub use faults::{Fault, FaultError, FaultKind};
pub use pool::FramePool;
pub use source::{SyntheticError, SyntheticOptions, SyntheticSource};
pub use truth::truth_domain;
