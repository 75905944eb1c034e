//! The register memory and where everything lies in it.

/// Addresses of the feature registers, as the description names them.
pub(crate) mod at {
    pub const SBRM: u64 = 0x1_0000;
    pub const SIRM: u64 = 0x2_0000;
    pub const MANIFEST: u64 = 0x4_0000;
    pub const XML: u64 = 0x10_0000;
    pub const FEATURES: u64 = 0x20_0000;

    pub const SIRM_INFO: u64 = SIRM;
    pub const SIRM_CONTROL: u64 = SIRM + 0x04;
    pub const SIRM_REQUIRED_PAYLOAD: u64 = SIRM + 0x08;
    pub const SIRM_REQUIRED_LEADER: u64 = SIRM + 0x10;
    pub const SIRM_REQUIRED_TRAILER: u64 = SIRM + 0x14;
    pub const SIRM_MAX_LEADER: u64 = SIRM + 0x18;
    pub const SIRM_PAYLOAD_SIZE: u64 = SIRM + 0x1C;
    pub const SIRM_PAYLOAD_COUNT: u64 = SIRM + 0x20;
    pub const SIRM_FINAL_1: u64 = SIRM + 0x24;
    pub const SIRM_FINAL_2: u64 = SIRM + 0x28;
    pub const SIRM_MAX_TRAILER: u64 = SIRM + 0x2C;

    pub const CLOCK: u64 = 0x1F0;
    pub const CLOCK_LATCH: u64 = 0x1F8;

    pub const WIDTH: u64 = FEATURES;
    pub const HEIGHT: u64 = FEATURES + 0x04;
    pub const OFFSET_X: u64 = FEATURES + 0x08;
    pub const OFFSET_Y: u64 = FEATURES + 0x0C;
    pub const PIXEL_FORMAT: u64 = FEATURES + 0x10;
    pub const PAYLOAD_SIZE: u64 = FEATURES + 0x14;
    pub const ACQUISITION_MODE: u64 = FEATURES + 0x18;
    pub const ACQUISITION_START: u64 = FEATURES + 0x1C;
    pub const ACQUISITION_STOP: u64 = FEATURES + 0x20;
    pub const TRIGGER_SELECTOR: u64 = FEATURES + 0x24;
    /// Bit 0 mode, bits 4–7 source, bits 8–11 activation: one register for three features.
    pub const TRIGGER: u64 = FEATURES + 0x28;
    pub const TRIGGER_SOFTWARE: u64 = FEATURES + 0x2C;
    /// µs, f64.
    pub const TRIGGER_DELAY: u64 = FEATURES + 0x30;
    /// Units of 0.1 µs, u32.
    pub const EXPOSURE: u64 = FEATURES + 0x38;
    /// Units of 0.01 dB, u32.
    pub const GAIN: u64 = FEATURES + 0x3C;
    /// Hz, f32.
    pub const FRAME_RATE: u64 = FEATURES + 0x40;
    pub const FRAME_RATE_ENABLE: u64 = FEATURES + 0x44;
    pub const LINE_SELECTOR: u64 = FEATURES + 0x48;
    /// One register per line.
    pub const LINE_MODE: u64 = FEATURES + 0x50;
    pub const LINE_SOURCE: u64 = FEATURES + 0x60;
    pub const LINE_INVERTER: u64 = FEATURES + 0x70;
    pub const TL_PARAMS_LOCKED: u64 = FEATURES + 0x80;
    pub const TIMESTAMP_LATCH: u64 = FEATURES + 0x84;
    pub const TIMESTAMP_VALUE: u64 = FEATURES + 0x88;
    pub const SENSOR_WIDTH: u64 = FEATURES + 0x90;
    pub const SENSOR_HEIGHT: u64 = FEATURES + 0x94;
    pub const BALANCE_SELECTOR: u64 = FEATURES + 0x98;
    /// f32 each: red, blue.
    pub const BALANCE_RATIO: u64 = FEATURES + 0xA0;
    /// i32, tenths of a degree, big-endian.
    pub const TEMPERATURE: u64 = FEATURES + 0xA8;
    /// 64 bytes of text.
    pub const USER_ID: u64 = 0x184;
    /// 256 bytes of text: the fault plan.
    pub const FAULTS: u64 = FEATURES + 0x100;
    pub const FAULTS_LENGTH: usize = 0x100;
}

/// Memory in pieces; what lies between them does not exist.
#[derive(Debug, Clone, Default)]
pub(crate) struct Registers {
    pieces: Vec<(u64, Vec<u8>)>,
}

impl Registers {
    pub(crate) fn add(&mut self, base: u64, bytes: Vec<u8>) {
        self.pieces.push((base, bytes));
    }

    fn find(&self, address: u64, length: usize) -> Option<(usize, usize)> {
        self.pieces.iter().enumerate().find_map(|(index, (base, bytes))| {
            let from = usize::try_from(address.checked_sub(*base)?).ok()?;
            (from.checked_add(length)? <= bytes.len()).then_some((index, from))
        })
    }

    pub(crate) fn read(&self, address: u64, length: usize) -> Option<&[u8]> {
        let (piece, from) = self.find(address, length)?;
        Some(&self.pieces[piece].1[from..from + length])
    }

    /// False where the address does not exist.
    pub(crate) fn write(&mut self, address: u64, data: &[u8]) -> bool {
        let Some((piece, from)) = self.find(address, data.len()) else { return false };
        self.pieces[piece].1[from..from + data.len()].copy_from_slice(data);
        true
    }

    /// 0 where the address does not exist.
    pub(crate) fn u32(&self, address: u64) -> u32 {
        self.read(address, 4).and_then(|b| b.try_into().ok()).map_or(0, u32::from_le_bytes)
    }

    pub(crate) fn u64(&self, address: u64) -> u64 {
        self.read(address, 8).and_then(|b| b.try_into().ok()).map_or(0, u64::from_le_bytes)
    }

    pub(crate) fn set_u32(&mut self, address: u64, value: u32) {
        self.write(address, &value.to_le_bytes());
    }

    pub(crate) fn set_u64(&mut self, address: u64, value: u64) {
        self.write(address, &value.to_le_bytes());
    }

    pub(crate) fn f32(&self, address: u64) -> f32 {
        f32::from_bits(self.u32(address))
    }

    pub(crate) fn f64(&self, address: u64) -> f64 {
        f64::from_bits(self.u64(address))
    }

    pub(crate) fn set_text(&mut self, address: u64, text: &str) {
        let mut bytes = text.as_bytes().to_vec();
        bytes.resize(64, 0);
        self.write(address, &bytes);
    }
}
