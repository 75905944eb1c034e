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
        let from = (address % self.0.len().max(1) as u64) as usize;
        let repeated = self.0.iter().cycle().skip(from);
        out.iter_mut().zip(repeated).for_each(|(to, byte)| *to = *byte);
        Ok(())
    }

    fn write(&mut self, _: u64, _: &[u8]) -> Result<(), MemoryError> {
        Ok(())
    }
}
