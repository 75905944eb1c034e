//! Triangulation: from what the cameras saw at one trigger to the ball's position.
//!
//! - [`Method`] is a way to compute a point; [`all_methods`] lists the eight.
//! - [`Triangulator`] associates candidates across cameras, rejects what does not fit, remembers the track
//!   and what does not move, and gives a [`BallPosition`](netcord_common::wire::BallPosition) for each
//!   trigger, or the reason why there is none.
//! - [`Matcher`] gathers messages by their trigger and says when a trigger is ready; it knows no clock.
//! - [`live`] runs both on the bus.
//!
//! How a position is chosen: candidates of different cameras that agree on a point, within their
//! covariances and the slack of the calibration, form a subset. Among the subsets, one that moves goes
//! before one at rest; then the one with most evidence is taken, where each view that agrees counts most, less
//! where its place is uncertain; then the scores of the candidates, their sizes against those of a ball there,
//! whether their paths during the exposure are those of one motion, and the track's prediction of place and
//! velocity. Where the search windows of all cameras hold a ball and agree, the position is given without waiting
//! for the rest of the frame.

mod appearance;
#[cfg(test)]
mod association_tests;
mod camera;
pub mod comparison;
mod consensus;
mod estimate;
mod evidence;
pub mod live;
mod matcher;
#[cfg(test)]
mod matcher_tests;
mod memory;
mod methods;
mod options;
#[cfg(test)]
mod testing;
mod triangulator;
mod variance;
mod watch;
#[cfg(test)]
mod watch_tests;

pub use camera::{Observation, PosedCamera};
pub use estimate::Estimate;
pub use matcher::Matcher;
pub use methods::{
    DltLs, DltSvd, Method, Midpoint, Reprojection, Robust, RtFirst, RtSecond, RtSymmetric, all_methods,
    method,
};
pub use options::{CALIBRATION_SLACK_PX, TriangulateOptions};
pub use triangulator::Triangulator;
pub use watch::RigWatch;
