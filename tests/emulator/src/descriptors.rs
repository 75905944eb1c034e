//! The USB descriptors of a USB3 Vision device.

use crate::{CameraConfig, LinkSpeed};

/// Endpoint addresses.
pub mod endpoints {
    /// Commands.
    pub const CONTROL_OUT: u8 = 0x01;
    /// Acknowledges. Its number is that of the commands' endpoint: aravis 0.8.26 takes one for both.
    pub const CONTROL_IN: u8 = 0x81;
    /// Frames.
    pub const STREAM_IN: u8 = 0x82;
}

/// All descriptors of one camera.
#[derive(Debug, Clone)]
pub struct Descriptors {
    /// Device descriptor.
    pub device: Vec<u8>,
    /// Configuration with everything in it.
    pub configuration: Vec<u8>,
    /// Binary object store.
    pub bos: Vec<u8>,
    /// Strings from index 1.
    pub strings: Vec<String>,
}

impl Descriptors {
    /// Those of `config`'s camera.
    pub fn new(config: &CameraConfig) -> Self {
        let superspeed = config.speed == LinkSpeed::Super;
        let (vid, pid) = (config.usb_id.0.to_le_bytes(), config.usb_id.1.to_le_bytes());
        let usb: [u8; 2] = if superspeed { [0, 3] } else { [0x10, 2] };
        // A SuperSpeed device gives the logarithm of its packet size on endpoint 0.
        let packet0 = if superspeed { 9 } else { 64 };
        let device = vec![
            18, 1, usb[0], usb[1], 0xEF, 2, 1, packet0, vid[0], vid[1], pid[0], pid[1], 0, 1, 1, 2, 3, 1,
        ];
        let mut body = Vec::new();
        // Interface association: both interfaces are one USB3 Vision function.
        let class = if config.is_vision { [0xEF, 5] } else { [0xFF, 0] };
        body.extend([8, 11, 0, 2, class[0], class[1], 0, 0]);
        let endpoint = |address: u8| {
            let mut e = vec![7, 5, address, 2];
            e.extend(if superspeed { 1024_u16 } else { 512 }.to_le_bytes());
            e.push(0);
            if superspeed {
                // Companion: bursts of 16 packets.
                e.extend([6, 0x30, 15, 0, 0, 0]);
            }
            e
        };
        body.extend([9, 4, 0, 0, 2, class[0], class[1], 0, 0]);
        // U3V device info: GenCP 1.3, U3V 1.2, then indices of strings, then the speeds it knows.
        body.extend([20, 0x24, 1, 3, 0, 1, 0, 2, 0, 1, 0, 4, 1, 2, 5, 6, 7, 3, 0, 0x0c]);
        body.extend(endpoint(endpoints::CONTROL_IN));
        body.extend(endpoint(endpoints::CONTROL_OUT));
        body.extend([9, 4, 1, 0, 1, class[0], class[1], 2, 0]);
        body.extend(endpoint(endpoints::STREAM_IN));
        let total = u16::try_from(9 + body.len()).unwrap_or(u16::MAX).to_le_bytes();
        let mut configuration =
            vec![9, 2, total[0], total[1], 2, 1, 0, 0x80, if superspeed { 112 } else { 250 }];
        configuration.extend(body);
        // BOS: USB 2.0 extension and SuperSpeed capability.
        let bos = vec![5, 15, 22, 0, 2, 7, 16, 2, 2, 0, 0, 0, 10, 16, 3, 0, 0x0c, 0, 2, 10, 0xff, 7];
        let guid = format!("{:04X}{:0>8}", config.usb_id.0, config.serial);
        let strings = ["netcord", "EmulatedU3V", &config.serial, &guid, "Emulated", "1.0", "no real camera"]
            .map(str::to_owned)
            .to_vec();
        Self { device, configuration, bos, strings }
    }

    /// The answer to GET_DESCRIPTOR of `kind` and `index`.
    pub fn get(&self, kind: u8, index: u8) -> Option<Vec<u8>> {
        match (kind, index) {
            (1, 0) => Some(self.device.clone()),
            (2, 0) => Some(self.configuration.clone()),
            (3, 0) => Some(vec![4, 3, 9, 4]),
            (3, index) => {
                let text = self.strings.get(usize::from(index) - 1)?;
                let mut out = vec![0, 3];
                out.extend(text.encode_utf16().flat_map(u16::to_le_bytes));
                out[0] = u8::try_from(out.len()).ok()?;
                Some(out)
            }
            (15, 0) => Some(self.bos.clone()),
            _ => None,
        }
    }
}
