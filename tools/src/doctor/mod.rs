//! What about this machine would break real time, and the cure.

mod checks;
mod finding;

pub use checks::{examine, memory_needed};
pub use finding::{Finding, Grade};
