use std::fmt;

/// What a camera answers to a command, or says in a trailer: GenCP status codes and those that USB3
/// Vision adds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Status(u16);

impl Status {
    /// Done.
    pub const SUCCESS: Self = Self(0);
    /// The address does not exist.
    pub const INVALID_ADDRESS: Self = Self(0x8003);
    /// The register cannot be written now.
    pub const WRITE_PROTECT: Self = Self(0x8004);
    /// The device cannot answer now; ask again.
    pub const BUSY: Self = Self(0x8007);
    /// The stream endpoint is halted.
    pub const STREAM_HALTED: Self = Self(0xA002);
    /// A transfer size is not a multiple of the device's alignment.
    pub const SIZE_NOT_ALIGNED: Self = Self(0xA003);
    /// Trailer: the device threw a part of the image away.
    pub const DATA_DISCARDED: Self = Self(0xA100);
    /// Trailer: the device had more than fitted the transfers.
    pub const DATA_OVERRUN: Self = Self(0xA101);

    /// The status of a code.
    pub const fn from_code(code: u16) -> Self {
        Self(code)
    }

    /// The code as it stands in packets.
    pub const fn code(self) -> u16 {
        self.0
    }

    /// Whether the command was carried out. Bit 15 is the mark of an error.
    pub const fn is_success(self) -> bool {
        self.0 & 0x8000 == 0
    }

    /// The meaning in words.
    pub const fn meaning(self) -> &'static str {
        match self.0 {
            0 => "success",
            0x8001 => "command not implemented",
            0x8002 => "invalid parameter",
            0x8003 => "invalid address",
            0x8004 => "write-protected",
            0x8005 => "bad alignment",
            0x8006 => "access denied",
            0x8007 => "busy",
            0x800B => "time-out inside the device",
            0x800E => "invalid header",
            0x800F => "wrong configuration",
            0x8FFF => "generic error",
            0xA001 => "resend not supported",
            0xA002 => "stream endpoint halted",
            0xA003 => "payload size not aligned",
            0xA004 => "inconsistent stream registers",
            0xA005 => "event endpoint halted",
            0xA100 => "image data discarded",
            0xA101 => "image data overrun",
            // Bits 13 and 14 name the space of the code: 0 GenCP, 1 technology, 2 device.
            code if (code >> 13) & 3 == 2 => "an error of the device's own",
            _ => "unknown",
        }
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:#06x} ({})", self.0, self.meaning())
    }
}
