//! Processes that are started, watched, restarted and stopped in order: what `netcord up` is made of.
//!
//! One thread waits for everything at once with poll(2): each child's end (pidfd), its readiness
//! (systemd's notification protocol) and its output. A [`Supervisor`] must live on the thread that lives
//! as long as its process does: the kernel ends the children when the thread that started them ends.

mod backoff;
mod child;
mod pidfd;
mod ready;
mod supervise;

pub use backoff::Backoff;
pub use child::{Launch, LaunchError};
pub use supervise::{ChildStatus, Happening, Phase, Supervisor};
