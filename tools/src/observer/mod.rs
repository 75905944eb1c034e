//! A running rig seen from outside: messages, latencies, losses. Attaching costs the pipeline nothing but
//! the messages' wake-ups.

mod latency;
mod losses;
mod observe;
mod silence;
mod tally;
mod totals;

pub use latency::{Latencies, LatencyReport};
pub use losses::{FrameReport, Losses};
pub use observe::{Observed, Observer};
pub use silence::SilenceWatch;
pub use tally::Tally;
