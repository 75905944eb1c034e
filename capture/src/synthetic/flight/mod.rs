//! How the ball of the scene flies: real physics, or a recorded flight.
//!
//! Deliberately written apart from the predictor's flight model, so that each finds the other's
//! mistakes. Instants are seconds of scene time; lengths are metres in the table frame.

mod air;
mod contact;
mod path;
mod rally;
mod recorded;
mod shot;

pub use air::{Air, BallState};
pub use contact::{
    Contact, FLOOR_Z_M, NET_HALF_WIDTH_M, NET_HEIGHT_M, TABLE_HALF_LENGTH_M, TABLE_HALF_WIDTH_M,
};
pub use rally::{Rally, RallyStyle};
pub use recorded::{RecordedFlights, RecordedFlightsError};

/// A ball at an instant, and which flight it is on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackPoint {
    /// Where it is, how fast, with what spin.
    pub state: BallState,
    /// Counts flights, from one racket to the next, from 1.
    pub flight_id: u64,
}

/// Where the ball is at any instant; the same for the same seed or file, in whatever order it is asked.
pub trait BallTrack: Send + std::fmt::Debug {
    /// The ball at `t_s` seconds of scene time; `None` while there is none in the scene. Asking
    /// forward in time is cheap and allocates nothing once flights of usual length have been seen;
    /// going back more than a flight starts over from the beginning.
    fn at(&mut self, t_s: f64) -> Option<TrackPoint>;
}
