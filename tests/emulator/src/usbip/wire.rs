//! The protocol's bytes, all big-endian.

use std::io::{self, Read, Write};

use crate::{CameraConfig, LinkSpeed};

pub(super) const VERSION: u16 = 0x0111;
pub(super) const REQ_DEVLIST: u16 = 0x8005;
pub(super) const REP_DEVLIST: u16 = 0x0005;
pub(super) const REQ_IMPORT: u16 = 0x8003;
pub(super) const REP_IMPORT: u16 = 0x0003;

pub(super) const EPIPE: i32 = -32;
pub(super) const EOVERFLOW: i32 = -75;
pub(super) const ECONNRESET: i32 = -104;

/// What the kernel asks for.
#[derive(Debug)]
pub(super) enum Request {
    Submit { seqnum: u32, input: bool, endpoint: u32, length: usize, setup: [u8; 8], data: Vec<u8> },
    Unlink { seqnum: u32, victim: u32 },
}

fn word(head: &[u8], at: usize) -> u32 {
    head.get(at..at + 4).and_then(|b| b.try_into().ok()).map_or(0, u32::from_be_bytes)
}

pub(super) fn read_request(stream: &mut impl Read) -> io::Result<Request> {
    let mut head = [0; 48];
    stream.read_exact(&mut head)?;
    let seqnum = word(&head, 4);
    match word(&head, 0) {
        1 => {
            let input = word(&head, 12) == 1;
            let length = word(&head, 24) as usize;
            let mut setup = [0; 8];
            setup.copy_from_slice(&head[40..48]);
            let mut data = vec![0; if input { 0 } else { length }];
            stream.read_exact(&mut data)?;
            Ok(Request::Submit { seqnum, input, endpoint: word(&head, 16), length, setup, data })
        }
        2 => Ok(Request::Unlink { seqnum, victim: word(&head, 20) }),
        other => Err(io::Error::new(io::ErrorKind::InvalidData, format!("command {other}"))),
    }
}

/// The end of a URB: RET_SUBMIT.
pub(super) fn submit_reply(
    stream: &mut impl Write,
    seqnum: u32,
    status: i32,
    actual: usize,
    data: &[u8],
) -> io::Result<()> {
    let mut head = [0; 48];
    head[..4].copy_from_slice(&3_u32.to_be_bytes());
    head[4..8].copy_from_slice(&seqnum.to_be_bytes());
    head[20..24].copy_from_slice(&status.to_be_bytes());
    head[24..28].copy_from_slice(&u32::try_from(actual).unwrap_or(u32::MAX).to_be_bytes());
    stream.write_all(&head)?;
    stream.write_all(data)
}

/// RET_UNLINK.
pub(super) fn unlink_reply(stream: &mut impl Write, seqnum: u32, status: i32) -> io::Result<()> {
    let mut head = [0; 48];
    head[..4].copy_from_slice(&4_u32.to_be_bytes());
    head[4..8].copy_from_slice(&seqnum.to_be_bytes());
    head[20..24].copy_from_slice(&status.to_be_bytes());
    stream.write_all(&head)
}

pub(super) fn operation_head(code: u16, status: u32) -> Vec<u8> {
    let mut out = Vec::new();
    out.extend(VERSION.to_be_bytes());
    out.extend(code.to_be_bytes());
    out.extend(status.to_be_bytes());
    out
}

/// The bus id of a camera.
pub(super) fn bus_id(index: usize) -> String {
    format!("1-{}", index + 1)
}

/// The 312 bytes that describe a device.
pub(super) fn device_record(index: usize, config: &CameraConfig) -> Vec<u8> {
    let mut out = format!("/sys/devices/emulated/usb1/{}", bus_id(index)).into_bytes();
    out.resize(256, 0);
    out.extend(bus_id(index).into_bytes());
    out.resize(288, 0);
    // Speeds as in linux/usb/ch9.h: 3 high, 5 super.
    let speed = if config.speed == LinkSpeed::Super { 5_u32 } else { 3 };
    let number = u32::try_from(index).unwrap_or(0) + 2;
    for field in [1, number, speed] {
        out.extend(field.to_be_bytes());
    }
    for field in [config.usb_id.0, config.usb_id.1, 0x0100] {
        out.extend(field.to_be_bytes());
    }
    // Class, configuration, number of configurations and interfaces.
    out.extend([0xEF, 2, 1, 1, 1, 2]);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_have_the_protocols_size() {
        assert_eq!(device_record(0, &CameraConfig::default()).len(), 312);
        let mut reply = Vec::new();
        submit_reply(&mut reply, 7, EPIPE, 3, b"abc").expect("memory");
        assert_eq!((reply.len(), word(&reply, 20).cast_signed(), word(&reply, 24)), (51, -32, 3));
    }
}
