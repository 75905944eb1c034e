use super::{
    Leader, Role, StreamPacketError, Trailer,
    packets::{parse_leader, parse_trailer},
};
use crate::usb::gencp::Status;

/// How a transfer ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TransferEnd {
    /// It is full, or a short packet ended it.
    Complete,
    /// The endpoint is halted.
    Stalled,
    /// The device sent more than fitted.
    Overflow,
    /// A transaction failed.
    Failed,
    /// It was taken back.
    Cancelled,
    /// The device has gone.
    Gone,
}

/// Why a frame is lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FrameLoss {
    /// The stream endpoint halted.
    Stalled,
    /// A transfer overflowed or failed.
    TransferFailed,
    /// The leader did not come.
    LeaderLost,
    /// The leader is garbled.
    LeaderGarbled,
    /// The trailer did not come.
    TrailerLost,
    /// The trailer is garbled, or more payload came than announced.
    TrailerGarbled,
    /// Leader and trailer name different blocks.
    WrongBlock,
    /// The payload is shorter than the image.
    ShortPayload,
    /// The trailer says that the device discarded or overran data.
    DeviceDiscarded,
    /// The leader names a pixel format that was not asked for.
    WrongFormat,
    /// The leader names a size that was not asked for.
    WrongSize,
    /// The device counted a frame that it did not send.
    Skipped,
    /// It was under way while the stream was restarted.
    Restarted,
}

impl FrameLoss {
    /// All reasons, in the order of the counters.
    pub const ALL: [Self; 13] = [
        Self::Stalled,
        Self::TransferFailed,
        Self::LeaderLost,
        Self::LeaderGarbled,
        Self::TrailerLost,
        Self::TrailerGarbled,
        Self::WrongBlock,
        Self::ShortPayload,
        Self::DeviceDiscarded,
        Self::WrongFormat,
        Self::WrongSize,
        Self::Skipped,
        Self::Restarted,
    ];

    /// The name that counters and reports use.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stalled => "stalled",
            Self::TransferFailed => "transfer_failed",
            Self::LeaderLost => "leader_lost",
            Self::LeaderGarbled => "leader_garbled",
            Self::TrailerLost => "trailer_lost",
            Self::TrailerGarbled => "trailer_garbled",
            Self::WrongBlock => "wrong_block",
            Self::ShortPayload => "short_payload",
            Self::DeviceDiscarded => "device_discarded",
            Self::WrongFormat => "wrong_format",
            Self::WrongSize => "wrong_size",
            Self::Skipped => "skipped",
            Self::Restarted => "restarted",
        }
    }
}

/// What frames must be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Expected {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// PFNC code that the device was set to.
    pub pixel_format: u32,
}

/// A whole frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReceivedFrame {
    /// What the device says of it.
    pub leader: Leader,
    /// Bytes that count.
    pub valid: usize,
    /// Bytes from row to row.
    pub stride: usize,
}

/// What follows from a transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The frame goes on.
    Continue,
    /// The frame is whole; `skipped` frames before it were counted by the device but did not come.
    Frame(ReceivedFrame, u64),
    /// The frame is lost, but the next leader comes where it belongs.
    Lost(FrameLoss, u64),
    /// The frame is lost, and transfers no longer meet their roles: the stream must be restarted.
    OutOfStep(FrameLoss),
    /// The device has gone.
    Gone,
}

/// Judges the transfers of a stream, in their order. It knows nothing of USB.
///
/// Transfers are queued in the fixed order leader, payload, trailer; a device that leaves one out, or
/// sends one too many, shifts all that follow. Leader and trailer carry magic numbers, so that this is
/// seen at the next of them; what is then in the queue cannot be trusted, and is taken back.
#[derive(Debug)]
pub struct Assembler {
    expected: Expected,
    payload_parts: usize,
    leader: Result<Leader, FrameLoss>,
    received: usize,
    last_block: Option<u64>,
    restarted: bool,
    /// Frames after `last_block` that are counted as lost already.
    counted: u64,
    awaits_trailer: bool,
}

impl Assembler {
    /// An assembler for frames of `payload_parts` payload transfers each.
    pub const fn new(expected: Expected, payload_parts: usize) -> Self {
        Self {
            expected,
            payload_parts,
            leader: Err(FrameLoss::LeaderLost),
            received: 0,
            last_block: None,
            restarted: false,
            counted: 0,
            awaits_trailer: false,
        }
    }

    /// The stream was restarted, after `counted` frames that have been reported lost: what else the
    /// device counted meanwhile is lost by the restart.
    pub const fn restarted(&mut self, counted: u64) {
        self.restarted = true;
        self.counted += counted;
        self.awaits_trailer = false;
    }

    /// Whether a frame's payload is there, and its trailer is to follow at once.
    pub const fn awaits_trailer(&self) -> bool {
        self.awaits_trailer
    }

    /// Which loss the skipped frames of the next step are.
    pub const fn skip_reason(&self) -> FrameLoss {
        if self.restarted { FrameLoss::Restarted } else { FrameLoss::Skipped }
    }

    /// Judges the next transfer: what it was for, how it ended, and the bytes that came (of payload
    /// only their number counts). `part` numbers payload transfers from 0.
    pub fn transfer(
        &mut self,
        role: Role,
        part: usize,
        end: TransferEnd,
        bytes: &[u8],
        received: usize,
    ) -> Step {
        match end {
            TransferEnd::Complete => {}
            TransferEnd::Stalled => return Step::OutOfStep(FrameLoss::Stalled),
            TransferEnd::Overflow | TransferEnd::Failed => return Step::OutOfStep(FrameLoss::TransferFailed),
            TransferEnd::Cancelled => return Step::Continue,
            TransferEnd::Gone => return Step::Gone,
        }
        match role {
            Role::Leader => self.leader(bytes, received),
            Role::Payload { length, .. } => {
                self.received += received;
                // A transfer that ends early before the last one lets the trailer run into the next.
                if received < length && part + 1 < self.payload_parts {
                    return Step::OutOfStep(FrameLoss::ShortPayload);
                }
                self.awaits_trailer = part + 1 == self.payload_parts;
                Step::Continue
            }
            Role::Trailer => self.trailer(bytes),
        }
    }

    fn leader(&mut self, bytes: &[u8], received: usize) -> Step {
        self.received = 0;
        self.leader = match parse_leader(bytes) {
            Ok(leader) => Ok(leader),
            Err(StreamPacketError::OtherRole) => return Step::OutOfStep(FrameLoss::LeaderLost),
            // No leader fills a whole packet: this is payload.
            Err(StreamPacketError::Magic(_)) if received >= 512 => {
                return Step::OutOfStep(FrameLoss::LeaderLost);
            }
            Err(_) => Err(FrameLoss::LeaderGarbled),
        };
        Step::Continue
    }

    fn trailer(&mut self, bytes: &[u8]) -> Step {
        self.awaits_trailer = false;
        let trailer = match parse_trailer(bytes) {
            Ok(trailer) => trailer,
            Err(StreamPacketError::OtherRole) => return Step::OutOfStep(FrameLoss::TrailerLost),
            Err(_) => return Step::OutOfStep(FrameLoss::TrailerGarbled),
        };
        let judged = self.leader.and_then(|leader| self.judge(&leader, &trailer));
        let block = self.leader.map_or(trailer.block, |leader| leader.block);
        let skipped = match self.last_block {
            // A counter that went back began anew with the acquisition.
            Some(last) if block > last => (block - last - 1).saturating_sub(self.counted),
            _ => 0,
        };
        self.last_block = Some(block);
        self.counted = 0;
        self.leader = Err(FrameLoss::LeaderLost);
        match judged {
            Ok(frame) => Step::Frame(frame, skipped),
            Err(loss) => Step::Lost(loss, skipped),
        }
    }

    /// After the skipped frames of a step have been counted.
    pub const fn settled(&mut self) {
        self.restarted = false;
    }

    fn judge(&self, leader: &Leader, trailer: &Trailer) -> Result<ReceivedFrame, FrameLoss> {
        if leader.block != trailer.block {
            return Err(FrameLoss::WrongBlock);
        }
        if matches!(trailer.status, Status::DATA_DISCARDED | Status::DATA_OVERRUN)
            || !trailer.status.is_success()
        {
            return Err(FrameLoss::DeviceDiscarded);
        }
        if leader.pixel_format != self.expected.pixel_format {
            return Err(FrameLoss::WrongFormat);
        }
        if (leader.width, leader.height) != (self.expected.width, self.expected.height) {
            return Err(FrameLoss::WrongSize);
        }
        // PFNC: bits 16 to 23 of a format are its bits per pixel.
        let bits = u64::from((leader.pixel_format >> 16) & 0xff);
        let stride = (u64::from(leader.width) * bits).div_ceil(8) + u64::from(leader.padding_x);
        let needed = stride.saturating_mul(u64::from(leader.height));
        // The trailer says what counts; what came may be more, by the transfers' alignment.
        if trailer.valid < needed || (self.received as u64) < needed {
            return Err(FrameLoss::ShortPayload);
        }
        Ok(ReceivedFrame {
            leader: *leader,
            valid: usize::try_from(trailer.valid).unwrap_or(usize::MAX).min(self.received),
            stride: usize::try_from(stride).unwrap_or(usize::MAX),
        })
    }
}
