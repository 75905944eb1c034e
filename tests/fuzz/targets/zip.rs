//! The zip file of a description.
#![no_main]

use libfuzzer_sys::fuzz_target;
use netcord_fuzz::usb::gencp::unzip_single;

fuzz_target!(|bytes: &[u8]| {
    let _ = unzip_single(bytes);
});
