//! The guided session: from a live preview through gathering, processing and review to a saved calibration.
//!
//! [`Session`] is a state machine without cameras, clock, files or browser in it: whoever drives it shows it
//! [`Shot`]s, does what its [`Verdict`]s say, solves its [`Problem`] where there is time for that, and hands the
//! [`Outcome`] back. [`SessionFolder`] keeps on disk what was gathered, so that a session that is killed goes on.

mod advice;
mod aims;
mod batch;
mod blur;
mod carried;
mod error;
mod files;
mod folder;
mod guidance;
mod heat;
mod judging;
mod kept;
mod machine;
mod problem;
mod setup;
mod shot;
mod status;
mod stillness;
mod table;
mod tally;
#[cfg(test)]
mod tests;
mod verdict;

pub use advice::{Advice, Place, Tilt};
pub use aims::{Aim, Aims, CameraAims};
pub use batch::Offered;
pub use blur::blur_px;
pub use error::SessionError;
pub use files::FolderError;
pub use folder::SessionFolder;
pub use heat::HeatMap;
pub use kept::{KeptShot, KeptView, Mark};
pub use machine::{Phase, Session};
pub use problem::{Outcome, Problem, ProblemError, Solved};
pub use setup::{SessionCamera, Setup, Solver, TableKnown, Task};
pub use shot::{Shot, Sight};
pub use status::{CameraStatus, KeptStatus, Status};
pub use stillness::Stillness;
pub use table::{MARKS_VIEW, TableOutcome};
pub use tally::Tally;
pub use verdict::{Reason, Verdict};
