//! Shows emulated cameras to a Linux machine over USB/IP (kernel documentation `usbip_protocol`), so
//! that its USB stack sees devices like any other.

mod server;
mod wire;

pub use server::Server;
