//! The stream of frames: how one frame is cut into transfers, and how transfers become frames again,
//! without I/O.

mod assembly;
mod packets;
mod plan;
mod ring;

pub use assembly::{Assembler, Expected, FrameLoss, ReceivedFrame, Step, TransferEnd};
pub use packets::{Leader, StreamPacketError, Trailer, parse_leader, parse_trailer};
pub use plan::{FramePlan, PlanError, Role};
pub use ring::Ring;
