//! The driver's protocol modules as they are in `capture`, without what else that crate needs: the fuzzer
//! instruments all that is built here, and the whole crate would take it many times as long.

extern crate self as netcord_common;

#[allow(dead_code)]
#[path = "../../../common/src/time.rs"]
mod time;

pub use time::{Clock, MonotonicClock, Stamp};

#[allow(dead_code)]
pub mod usb;

use usb::gencp::{Memory, MemoryError};

/// Registers that hold what the fuzzer wants.
#[derive(Debug)]
pub struct Registers<'a>(pub &'a [u8]);

impl Memory for Registers<'_> {
    fn read(&mut self, address: u64, out: &mut [u8]) -> Result<(), MemoryError> {
        let length = self.0.len().max(1) as u64;
        for (i, byte) in out.iter_mut().enumerate() {
            let at = address.wrapping_add(i as u64) % length;
            *byte = self.0.get(at as usize).copied().unwrap_or(0);
        }
        Ok(())
    }

    fn write(&mut self, _: u64, _: &[u8]) -> Result<(), MemoryError> {
        Ok(())
    }
}
