//! Flight: from triangulated positions to where the ball is going, and how sure that is.
//!
//! - `physics`: drag, Magnus force and gravity, with derivatives; `contact`: table, net, floor.
//! - `belief`: a state (position, velocity, spin, and what is peculiar to ball and table) with its
//!   covariance; `flow` moves it on through contacts.
//! - `prior`: the spin that strokes have; `bank`: several hypotheses about one flight.
//! - `tracker`: where flights begin and end, outliers, late positions; `beginning`: what shows a new flight.
//! - `habits`: what earlier flights taught of ball and table; `strokes`: with what spin like ones were struck.
//! - `forecast`, `confidence`, `windows`: what follows for the future.
//! - [`Predictor`] puts these behind the messages of the bus; [`live`] is the process around it.

mod bank;
mod beginning;
mod belief;
mod confidence;
mod contact;
mod flow;
mod forecast;
mod habits;
pub mod live;
mod physics;
mod predictor;
mod prior;
pub mod recorded;
mod settings;
mod strokes;
mod tracker;
mod windows;

#[cfg(test)]
mod tests;

pub use contact::BounceScatter;
pub use flow::{ModelNoise, Table};
pub use habits::Latitude;
pub use predictor::{PredictOptions, Predictor};
pub use settings::Tuning;
pub use tracker::Verdict;
