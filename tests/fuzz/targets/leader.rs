//! The leader alone, and a frame whose leader the fuzzer makes.
#![no_main]

use libfuzzer_sys::fuzz_target;
use netcord_fuzz::usb::stream::{Assembler, Expected, Role, Step, TransferEnd, parse_leader};

fuzz_target!(|bytes: &[u8]| {
    let _ = parse_leader(bytes);
    let expected = Expected { width: 4, height: 2, pixel_format: 0x0108_0009 };
    let mut assembler = Assembler::new(expected, 1);
    let end = TransferEnd::Complete;
    let mut trailer = [b"U3VT".as_slice(), &[0; 28]].concat();
    // The trailer agrees with whatever block the leader names.
    if let Some(block) = bytes.get(8..16) {
        trailer[8..16].copy_from_slice(block);
    }
    trailer[20] = 8;
    for _ in 0..2 {
        let _ = assembler.transfer(Role::Leader, 0, end, bytes, bytes.len());
        let _ = assembler.transfer(Role::Payload { offset: 0, length: 8 }, 0, end, &[], 8);
        if let Step::Frame(frame, _) = assembler.transfer(Role::Trailer, 0, end, &trailer, 32) {
            assert!(frame.valid <= 8 && frame.stride * frame.leader.height as usize <= 8, "{frame:?}");
        }
        assembler.settled();
    }
});
