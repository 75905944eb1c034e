use std::sync::Arc;

use crate::{endpoint::DeviceTransfer, fault::Fault, pattern};

/// One exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shot {
    /// The camera's block id.
    pub block: u64,
    /// Emulator's clock at the middle of the exposure, ns.
    pub mid_ns: u64,
    /// Length of the exposure, ns.
    pub exposure_ns: u64,
    /// Region: x, y, width, height, px.
    pub region: (u32, u32, u32, u32),
    /// PFNC code.
    pub pixel_format: u32,
}

/// Where pictures come from.
pub trait ImageSource: Send {
    /// The picture of an exposure: rows without padding.
    fn picture(&mut self, shot: &Shot) -> Vec<u8>;
}

/// The test picture of [`pattern`].
#[derive(Debug, Clone, Copy, Default)]
pub struct PatternImages;

impl ImageSource for PatternImages {
    fn picture(&mut self, shot: &Shot) -> Vec<u8> {
        let (_, _, width, height) = shot.region;
        let bytes = u64::from(width) * u64::from(height) * u64::from((shot.pixel_format >> 16) & 0xff) / 8;
        let row = (bytes / u64::from(height.max(1))).max(1);
        let mut out = vec![0; usize::try_from(bytes).unwrap_or(0)];
        pattern::fill(shot.block, usize::try_from(row).unwrap_or(1), &mut out);
        out
    }
}

/// How the host cut frames into transfers.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Cut {
    pub(crate) payload: usize,
    pub(crate) count: usize,
    pub(crate) final1: usize,
    pub(crate) final2: usize,
}

/// The transfers of one frame, with what `fault` does to them.
pub(crate) fn transfers(
    shot: &Shot,
    stamp: u64,
    picture: Vec<u8>,
    cut: Cut,
    fault: Option<Fault>,
) -> Vec<DeviceTransfer> {
    let mut leader = Vec::with_capacity(52);
    let magic: &[u8] = if fault == Some(Fault::WrongLeader) { b"U3VX" } else { b"U3VL" };
    let (x, y, width, height) = shot.region;
    let format = if fault == Some(Fault::WrongFormat) { 0x0108_0001 } else { shot.pixel_format };
    let height_said = if fault == Some(Fault::WrongSize) { height / 2 } else { height };
    leader.extend(magic);
    leader.extend([0, 0, 52, 0]);
    leader.extend(shot.block.to_le_bytes());
    leader.extend([0, 0, 1, 0]);
    leader.extend(stamp.to_le_bytes());
    for field in [format, width, height_said, x, y, 0] {
        leader.extend(field.to_le_bytes());
    }
    let (status, valid) = match fault {
        Some(Fault::Discarded) => (0xA100_u16, picture.len() / 2),
        Some(Fault::Overrun) => (0xA101, picture.len()),
        Some(Fault::ShortPayload) => (0, picture.len() / 2 - 100),
        _ => (0, picture.len()),
    };
    let block_said = if fault == Some(Fault::WrongBlock) { shot.block + 1000 } else { shot.block };
    let mut trailer = Vec::with_capacity(32);
    trailer.extend(b"U3VT");
    trailer.extend([0, 0, 32, 0]);
    trailer.extend(block_said.to_le_bytes());
    trailer.extend(status.to_le_bytes());
    trailer.extend([0, 0]);
    trailer.extend(u64::try_from(valid).unwrap_or(0).to_le_bytes());
    trailer.extend(height.to_le_bytes());

    let whole = |bytes: Vec<u8>| {
        let length = bytes.len();
        DeviceTransfer::new(Arc::new(bytes), 0..length)
    };
    let mut out = Vec::new();
    if fault != Some(Fault::LoseLeader) {
        out.push(whole(leader));
    }
    let sent = if fault == Some(Fault::ShortPayload) { valid } else { picture.len() };
    let picture = Arc::new(picture);
    let mut from = 0;
    for size in std::iter::repeat_n(cut.payload, cut.count).chain([cut.final1, cut.final2]) {
        let to = (from + size).min(sent);
        if to > from {
            out.push(DeviceTransfer::new(picture.clone(), from..to));
        }
        from = to;
    }
    if fault == Some(Fault::LongPayload) {
        out.push(whole(vec![0xEE; 700]));
    }
    if fault != Some(Fault::LoseTrailer) {
        out.push(whole(trailer));
    }
    out
}
