use crate::FaultPlan;

/// Which instant of the exposure the camera stamps frames with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StampAt {
    /// Its start.
    #[default]
    Start,
    /// Its end, where the read-out begins.
    End,
}

/// Speed of the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LinkSpeed {
    /// 480 Mb/s.
    High,
    /// 5 Gb/s.
    #[default]
    Super,
}

impl LinkSpeed {
    /// Bytes of a bulk packet.
    pub const fn packet(self) -> usize {
        match self {
            Self::High => 512,
            Self::Super => 1024,
        }
    }
}

/// What the emulated camera is.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraConfig {
    /// Serial number, part of the GUID.
    pub serial: String,
    /// USB vendor and product.
    pub usb_id: (u16, u16),
    /// Sensor size, px.
    pub sensor: (u32, u32),
    /// PFNC code of the format after power-on.
    pub pixel_format: u32,
    /// Whether its interfaces are of the class of USB3 Vision; else they are its maker's own.
    pub is_vision: bool,
    /// Whether it offers formats of more than 8 bits only.
    pub deep_only: bool,
    /// Alignment of transfers, as a logarithm.
    pub alignment_log2: u8,
    /// Whether stacked reads are offered.
    pub stacked: bool,
    /// Device clock at emulator time 0, ns.
    pub clock_offset_ns: u64,
    /// How much the device clock is fast.
    pub clock_ppm: f64,
    /// Which instant frames are stamped with.
    pub stamp_at: StampAt,
    /// From the end of the exposure to the frame being in the device's memory, ns.
    pub readout_ns: u64,
    /// Frames that the device's memory holds.
    pub frame_memory: usize,
    /// Speed of the link.
    pub speed: LinkSpeed,
    /// Whether a dead process left the stream switched on.
    pub left_enabled: bool,
    /// What goes wrong, and when.
    pub faults: FaultPlan,
}

impl CameraConfig {
    /// Alignment of transfers in force, as a logarithm: at most a packet of the link.
    pub fn alignment(&self) -> u8 {
        self.alignment_log2.min(u8::try_from(self.speed.packet().ilog2()).unwrap_or(u8::MAX))
    }
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            serial: "0001".into(),
            usb_id: (0x1209, 0xE301),
            sensor: (1920, 1200),
            pixel_format: 0x0108_0009,
            is_vision: true,
            deep_only: false,
            alignment_log2: 10,
            stacked: true,
            clock_offset_ns: 5_000_000_000,
            clock_ppm: 20.0,
            stamp_at: StampAt::Start,
            readout_ns: 1_000_000,
            frame_memory: 3,
            speed: LinkSpeed::Super,
            left_enabled: false,
            faults: FaultPlan::default(),
        }
    }
}
