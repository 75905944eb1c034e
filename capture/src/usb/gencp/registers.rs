use super::{Memory, MemoryError, read_text, read_u32, read_u64};

/// The bootstrap registers that every GenCP device has at address 0 (GenCP 5.2).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Abrm {
    /// Name of the maker.
    pub manufacturer: String,
    /// Name of the model.
    pub model: String,
    /// Version of the device.
    pub version: String,
    /// Serial number.
    pub serial: String,
    /// The name that a user gave.
    pub user_name: String,
    /// What the device can do.
    pub capability: u64,
    /// Longest time until it acknowledges, ms.
    pub response_ms: u32,
    /// Where the manifest lies.
    pub manifest: u64,
    /// Where the technology's registers lie.
    pub sbrm: u64,
    /// Nanoseconds per tick of the device's clock; 0 where it does not say.
    pub tick_ns: u64,
}

impl Abrm {
    const CLOCK: u64 = 0x1F0;
    const LATCH: u64 = 0x1F8;

    /// Reads them.
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn read(memory: &mut (impl Memory + ?Sized)) -> Result<Self, MemoryError> {
        let capability = read_u64(memory, 0x1C4)?;
        Ok(Self {
            manufacturer: read_text(memory, 0x004)?,
            model: read_text(memory, 0x044)?,
            version: read_text(memory, 0x0C4)?,
            serial: read_text(memory, 0x144)?,
            // Bit 0: there is a user-defined name.
            user_name: if capability & 1 != 0 { read_text(memory, 0x184)? } else { String::new() },
            capability,
            response_ms: read_u32(memory, 0x1CC)?,
            manifest: read_u64(memory, 0x1D0)?,
            sbrm: read_u64(memory, 0x1D8)?,
            tick_ns: read_u64(memory, 0x1FC)?,
        })
    }

    /// Whether several registers can be read in one packet (capability bit 13).
    pub const fn stacked(&self) -> bool {
        self.capability & (1 << 13) != 0
    }

    /// Latches the device's clock and reads it, in nanoseconds.
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn read_clock_ns(&self, memory: &mut (impl Memory + ?Sized)) -> Result<u64, MemoryError> {
        memory.write(Self::LATCH, &1_u32.to_le_bytes())?;
        Ok(read_u64(memory, Self::CLOCK)?.wrapping_mul(self.tick_ns.max(1)))
    }
}

/// The registers of USB3 Vision (U3V 4.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sbrm {
    /// What the device can do.
    pub capability: u64,
    /// Longest command, bytes.
    pub max_command: u32,
    /// Longest acknowledge, bytes.
    pub max_ack: u32,
    /// Where the stream's registers lie, if there is a stream.
    pub sirm: Option<u64>,
    /// Where the event endpoint's registers lie, if there is one.
    pub eirm: Option<u64>,
    /// Speed of the link as the device sees it: 1 low, 2 full, 4 high, 8 super, 16 super+.
    pub speed: u32,
}

impl Sbrm {
    /// Reads them from `base`.
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn read(memory: &mut (impl Memory + ?Sized), base: u64) -> Result<Self, MemoryError> {
        let at = |by: u64| base.wrapping_add(by);
        let capability = read_u64(memory, at(0x04))?;
        Ok(Self {
            capability,
            max_command: read_u32(memory, at(0x14))?,
            max_ack: read_u32(memory, at(0x18))?,
            sirm: if capability & 1 != 0 { Some(read_u64(memory, at(0x20))?) } else { None },
            eirm: if capability & 2 != 0 { Some(read_u64(memory, at(0x2C))?) } else { None },
            speed: read_u32(memory, at(0x40))?,
        })
    }
}

/// Where the stream's registers lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SirmAddress(pub u64);

/// What the device demands of the stream's transfers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sirm {
    /// Transfer sizes must be multiples of it; a power of two.
    pub alignment: u32,
    /// Whether the stream runs, as it does after a process died.
    pub enabled: bool,
    /// Bytes of one frame.
    pub payload: u64,
    /// Bytes of a leader.
    pub leader: u32,
    /// Bytes of a trailer.
    pub trailer: u32,
}

/// The six sizes that the host tells the device: how one frame is cut into transfers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TransferSizes {
    /// Longest leader.
    pub leader: u32,
    /// Bytes of one payload transfer.
    pub payload: u32,
    /// How many of those.
    pub count: u32,
    /// Bytes of the transfer after them; 0 = none.
    pub final1: u32,
    /// Bytes of the last one; 0 = none.
    pub final2: u32,
    /// Longest trailer.
    pub trailer: u32,
}

impl SirmAddress {
    const fn at(self, by: u64) -> u64 {
        self.0.wrapping_add(by)
    }

    /// Reads what the device demands now; it changes with the image's size and format.
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn read(self, memory: &mut (impl Memory + ?Sized)) -> Result<Sirm, MemoryError> {
        // Bits 24 to 31: the alignment's logarithm; beyond 2^20 it would be nonsense.
        let alignment = 1_u32 << (read_u32(memory, self.at(0x00))? >> 24).min(20);
        Ok(Sirm {
            alignment,
            enabled: read_u32(memory, self.at(0x04))? & 1 != 0,
            payload: read_u64(memory, self.at(0x08))?,
            leader: read_u32(memory, self.at(0x10))?,
            trailer: read_u32(memory, self.at(0x14))?,
        })
    }

    /// Tells the device how frames are cut; only while the stream is off.
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn write_sizes(
        self,
        memory: &mut (impl Memory + ?Sized),
        sizes: &TransferSizes,
    ) -> Result<(), MemoryError> {
        let registers = [
            (0x18, sizes.leader),
            (0x1C, sizes.payload),
            (0x20, sizes.count),
            (0x24, sizes.final1),
            (0x28, sizes.final2),
            (0x2C, sizes.trailer),
        ];
        registers.into_iter().try_for_each(|(by, value)| memory.write(self.at(by), &value.to_le_bytes()))
    }

    /// Switches the stream on or off.
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn enable(self, memory: &mut (impl Memory + ?Sized), on: bool) -> Result<(), MemoryError> {
        memory.write(self.at(0x04), &u32::from(on).to_le_bytes())
    }
}
