//! The description (XML), and every feature of it read and set on registers of the fuzzer's own.
#![no_main]

use libfuzzer_sys::fuzz_target;
use netcord_fuzz::{Registers, usb::genapi::GenApi};

fuzz_target!(|bytes: &[u8]| {
    // What follows a zero byte is what the registers hold.
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    let (text, registers) = bytes.split_at(end);
    let Ok(mut api) = GenApi::load(&String::from_utf8_lossy(text)) else { return };
    let mut memory = Registers(registers);
    for (_, names) in api.features().into_iter().take(8) {
        for name in names.iter().take(16) {
            let _ = api.info(&mut memory, name);
            let _ = api.get(&mut memory, name);
            let _ = api.get_float(&mut memory, name);
            let _ = api.set(&mut memory, name, "1");
            let _ = api.execute(&mut memory, name);
        }
    }
});
