//! USB3 Vision cameras, through rusb and nothing proprietary.

mod bytes;
pub mod genapi;
pub mod gencp;
pub mod stream;
#[cfg(test)]
mod testing;
