//! The protocols.

#[path = "../../../capture/src/usb/bytes.rs"]
mod bytes;
#[path = "../../../capture/src/usb/genapi/mod.rs"]
pub mod genapi;
#[path = "../../../capture/src/usb/gencp/mod.rs"]
pub mod gencp;
#[path = "../../../capture/src/usb/stream/mod.rs"]
pub mod stream;
