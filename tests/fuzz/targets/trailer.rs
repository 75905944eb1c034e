//! The trailer alone, and a frame whose trailer the fuzzer makes.
#![no_main]

use libfuzzer_sys::fuzz_target;
use netcord_fuzz::usb::stream::{Assembler, Expected, Role, Step, TransferEnd, parse_trailer};

fuzz_target!(|bytes: &[u8]| {
    let _ = parse_trailer(bytes);
    let expected = Expected { width: 4, height: 2, pixel_format: 0x0108_0009 };
    let mut assembler = Assembler::new(expected, 1);
    let end = TransferEnd::Complete;
    let mut leader = [b"U3VL".as_slice(), &[0; 48]].concat();
    if let Some(block) = bytes.get(8..16) {
        leader[8..16].copy_from_slice(block);
    }
    leader[18] = 1;
    leader[28..32].copy_from_slice(&0x0108_0009_u32.to_le_bytes());
    leader[32] = 4;
    leader[36] = 2;
    for received in [8, 5] {
        let _ = assembler.transfer(Role::Leader, 0, end, &leader, 52);
        let _ = assembler.transfer(Role::Payload { offset: 0, length: 8 }, 0, end, &[], received);
        if let Step::Frame(frame, _) = assembler.transfer(Role::Trailer, 0, end, bytes, bytes.len()) {
            assert!(received == 8 && frame.valid <= 8, "{frame:?} of {received}");
        }
        assembler.settled();
    }
});
