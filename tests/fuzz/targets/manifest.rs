//! The manifest, and the description that it leads to.
#![no_main]

use libfuzzer_sys::fuzz_target;
use netcord_fuzz::{
    Registers,
    usb::gencp::{Manifest, read_description},
};

fuzz_target!(|bytes: &[u8]| {
    let _ = Manifest::parse(bytes).device();
    let _ = read_description(&mut Registers(bytes), 0);
});
