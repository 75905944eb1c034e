//! Events.
#![no_main]

use libfuzzer_sys::fuzz_target;
use netcord_fuzz::usb::gencp::parse_event;

fuzz_target!(|bytes: &[u8]| {
    let _ = parse_event(bytes);
});
