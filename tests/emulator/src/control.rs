//! GenCP from the device's side: a command's bytes in, the acknowledge's bytes out.

use crate::camera::Camera;

const HEADER: usize = 12;

pub(crate) struct Command<'a> {
    pub(crate) code: u16,
    pub(crate) request: u16,
    pub(crate) body: &'a [u8],
}

fn u16_at(b: &[u8], at: usize) -> u16 {
    b.get(at..at + 2).and_then(|s| s.try_into().ok()).map_or(0, u16::from_le_bytes)
}

fn u64_at(b: &[u8], at: usize) -> u64 {
    b.get(at..at + 8).and_then(|s| s.try_into().ok()).map_or(0, u64::from_le_bytes)
}

/// `None` for bytes that are no command: a device does not answer them.
pub(crate) fn parse(packet: &[u8]) -> Option<Command<'_>> {
    if packet.get(..4)? != b"U3VC" {
        return None;
    }
    let length = usize::from(u16_at(packet, 8));
    let body = packet.get(HEADER..HEADER + length)?;
    Some(Command { code: u16_at(packet, 6), request: u16_at(packet, 10), body })
}

pub(crate) fn ack(status: u16, code: u16, request: u16, body: &[u8]) -> Vec<u8> {
    let mut out = b"U3VC".to_vec();
    for field in [status, code, u16::try_from(body.len()).unwrap_or(u16::MAX), request] {
        out.extend(field.to_le_bytes());
    }
    out.extend(body);
    out
}

/// Carries a command out on `camera` at `now`; gives its acknowledge.
pub(crate) fn answer(camera: &mut Camera, command: &Command<'_>, now: u64) -> Vec<u8> {
    let reply = |status: u16, body: &[u8]| ack(status, command.code + 1, command.request, body);
    let body = command.body;
    match command.code {
        0x0800 => match camera.read(u64_at(body, 0), usize::from(u16_at(body, 10))) {
            Ok(data) => reply(0, &data),
            Err(status) => reply(status, &[]),
        },
        0x0802 if body.len() >= 8 => match camera.write(u64_at(body, 0), &body[8..], now) {
            Ok(()) => reply(0, &[0, 0, (body.len() - 8) as u8, ((body.len() - 8) >> 8) as u8]),
            Err(status) => reply(status, &[]),
        },
        0x0806 if camera.offers_stacked() => {
            let mut data = Vec::new();
            for item in body.chunks_exact(12) {
                match camera.read(u64_at(item, 0), usize::from(u16_at(item, 10))) {
                    Ok(part) => data.extend(part),
                    Err(status) => return reply(status, &[]),
                }
            }
            reply(0, &data)
        }
        _ => reply(0x8001, &[]),
    }
}
