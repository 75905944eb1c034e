//! The camera's GenApi description, and the zip file in which it is delivered.

use miniz_oxide::deflate::compress_to_vec;
use sha1::{Digest, Sha1};

use crate::registers::at;

/// The node forms are spread on purpose: plain and masked registers, converters, formulas, indexed
/// addresses, both byte orders, so that a reader meets each of them.
const TEMPLATE: &str = include_str!("description.xml");

/// The description with its addresses; `deep_only` leaves out formats of 8 bits.
pub(crate) fn description(deep_only: bool) -> String {
    let text = with_addresses();
    if !deep_only {
        return text;
    }
    const ENTRY: &str = "<EnumEntry Name=\"";
    text.split(ENTRY)
        .enumerate()
        .filter(|(_, entry)| !entry.split('"').next().is_some_and(|n| n.ends_with('8')))
        .map(|(index, entry)| if index == 0 { entry.to_owned() } else { format!("{ENTRY}{entry}") })
        .collect()
}

fn with_addresses() -> String {
    let addresses: [(&str, u64); 32] = [
        ("WIDTH", at::WIDTH),
        ("HEIGHT", at::HEIGHT),
        ("OFFSET_X", at::OFFSET_X),
        ("OFFSET_Y", at::OFFSET_Y),
        ("PIXEL_FORMAT", at::PIXEL_FORMAT),
        ("PAYLOAD_SIZE", at::PAYLOAD_SIZE),
        ("ACQUISITION_MODE", at::ACQUISITION_MODE),
        ("ACQUISITION_START", at::ACQUISITION_START),
        ("ACQUISITION_STOP", at::ACQUISITION_STOP),
        ("TRIGGER_SELECTOR", at::TRIGGER_SELECTOR),
        ("TRIGGER", at::TRIGGER),
        ("TRIGGER_SOFTWARE", at::TRIGGER_SOFTWARE),
        ("TRIGGER_DELAY", at::TRIGGER_DELAY),
        ("EXPOSURE", at::EXPOSURE),
        ("GAIN", at::GAIN),
        ("FRAME_RATE", at::FRAME_RATE),
        ("FRAME_RATE_ENABLE", at::FRAME_RATE_ENABLE),
        ("LINE_SELECTOR", at::LINE_SELECTOR),
        ("LINE_MODE", at::LINE_MODE),
        ("LINE_SOURCE", at::LINE_SOURCE),
        ("LINE_INVERTER", at::LINE_INVERTER),
        ("TL_PARAMS_LOCKED", at::TL_PARAMS_LOCKED),
        ("TIMESTAMP_LATCH", at::TIMESTAMP_LATCH),
        ("TIMESTAMP_VALUE", at::TIMESTAMP_VALUE),
        ("SENSOR_WIDTH", at::SENSOR_WIDTH),
        ("SENSOR_HEIGHT", at::SENSOR_HEIGHT),
        ("BALANCE_SELECTOR", at::BALANCE_SELECTOR),
        ("BALANCE_RATIO", at::BALANCE_RATIO),
        ("TEMPERATURE", at::TEMPERATURE),
        ("USER_ID", at::USER_ID),
        ("FAULTS", at::FAULTS),
        ("SIRM_INFO", at::SIRM_INFO),
    ];
    addresses.iter().fold(TEMPLATE.to_owned(), |text, (name, address)| {
        text.replace(&format!("@{name}@"), &format!("{address:#x}"))
    })
}

/// A zip file of one deflated entry.
pub(crate) fn zipped(text: &str) -> Vec<u8> {
    const NAME: &[u8] = b"netcord_emulator.xml";
    let packed = compress_to_vec(text.as_bytes(), 6);
    let word = |n: usize| u32::try_from(n).unwrap_or(u32::MAX).to_le_bytes();
    let mut common = Vec::new();
    common.extend([20, 0, 0, 0, 8, 0, 0, 0, 0x21, 0x4a]);
    common.extend(crc32(text.as_bytes()).to_le_bytes());
    common.extend(word(packed.len()));
    common.extend(word(text.len()));
    common.extend([NAME.len() as u8, 0, 0, 0]);
    let mut zip = b"PK\x03\x04".to_vec();
    zip.extend(&common);
    zip.extend(NAME);
    zip.extend(&packed);
    let directory = zip.len();
    zip.extend(b"PK\x01\x02\x14\x00");
    zip.extend(&common);
    zip.extend([0; 14]);
    zip.extend(NAME);
    let size = zip.len() - directory;
    zip.extend(b"PK\x05\x06\0\0\0\0\x01\0\x01\0");
    zip.extend(word(size));
    zip.extend(word(directory));
    zip.extend([0; 2]);
    zip
}

pub(crate) fn sha1(bytes: &[u8]) -> [u8; 20] {
    Sha1::digest(bytes).into()
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| (c >> 1) ^ (0xEDB8_8320 & (c & 1).wrapping_neg()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_address_of_the_description_is_filled_in() {
        let text = description(false);
        assert!(text.contains("BayerRG8") && !description(true).contains("BayerRG8"));
        assert!(description(true).contains("BayerRG12p") && description(true).contains("FaultPlan"));
        assert!(!text.contains('@'), "a place for an address is left: {:?}", text.find('@'));
        let zip = zipped(&text);
        assert!(zip.len() < text.len());
    }
}
