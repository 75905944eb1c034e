//! Acknowledges, as the answers to each kind of command.
#![no_main]

use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use netcord_fuzz::{
    Stamp,
    usb::gencp::{Command, Exchange, Next, Patience, Retry, parse_ack},
};

fuzz_target!(|bytes: &[u8]| {
    let _ = parse_ack(bytes);
    let items = [(0x1000, 4), (0x2000, 8)];
    let commands = [
        Command::Read { address: 0x1CC, length: 4 },
        Command::Write { address: 8, data: &[1, 2, 3, 4] },
        Command::ReadStacked(&items),
    ];
    for command in &commands {
        let mut exchange = Exchange::new(command, 0, Patience::default(), Retry::Allowed);
        let mut now = Stamp::from_ns(1);
        exchange.sent(now);
        // Packets of 16 to 79 bytes, one after the other, until it is done or gives up.
        for packet in bytes.chunks(16 + usize::from(bytes.first().copied().unwrap_or(0) & 63)) {
            match exchange.next() {
                Next::Done => break,
                Next::Send => exchange.sent(now),
                Next::Receive { .. } => {
                    if exchange.received(packet, now).is_err() {
                        break;
                    }
                }
            }
            now = Stamp::from_ns(now.as_ns() + Duration::from_millis(1).as_nanos() as u64);
        }
    }
});
