//! Learns the ball's colour from frames in which somebody, or a scene's truth, has marked it.
//!
//! [`label`] tells which 2 × 2 cells of a marked frame are the ball and which are not; [`Learner`] gathers them over
//! frames, cuts the ball's colours out of all others by a few planes ([`polytope`]), and says how well that separates
//! the frames that it did not learn from.

mod density;
mod error;
mod label;
mod learner;
mod mark;
mod polytope;
mod separation;
#[cfg(test)]
mod tests;

pub use error::{LearnError, MarkError};
pub use label::{CellLabel, LabelledFrame};
pub use learner::{Learner, Lesson};
pub use mark::Mark;
pub use separation::{Confusion, RocPoint, Separation};
