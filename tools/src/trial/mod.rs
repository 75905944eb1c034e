//! A trial: the whole pipeline as real processes in a fresh domain, on a synthetic rally, judged against
//! the truth. `demo` is one trial; `bench` runs many.

mod cpu;
mod deployment;
mod error;
mod foresight;
mod judge;
mod plots;
mod report;
mod running;
mod setup;
mod view;

pub use deployment::Deployment;
pub use error::TrialError;
pub use foresight::ForesightErrors;
pub use judge::{Judge, Judged, Judgement, Score};
pub use plots::plot_paths;
pub use report::TrialReport;
pub use running::run;
pub use setup::{Scene, Setup, example_rig};
