use netcord_common::{Count, Counters};

use crate::{LossReason, usb::stream::FrameLoss};

/// What is counted of the cameras together, beside what the sink counts of each: a process has 64
/// counters, and a rig up to 16 cameras.
#[derive(Debug, Clone)]
pub(super) struct CameraCounts {
    losses: [Count; GROUPS.len()],
    /// Restarts of the stream.
    pub(super) restarts: Count,
    /// Times that the camera was opened.
    pub(super) opened: Count,
    /// Frames whose block id and trigger went apart.
    pub(super) slips: Count,
    /// Frames that no trigger precedes.
    pub(super) unmatched: Count,
    /// Frames whose instant is less certain than the rig's tolerance: they may be matched wrongly.
    pub(super) uncertain: Count,
}

/// For the same reason the losses of the stream are counted in groups.
const GROUPS: [&str; 5] = ["stalled", "out_of_step", "bad_frame", "skipped", "restarted"];

const fn group(loss: FrameLoss) -> usize {
    match loss {
        FrameLoss::Stalled | FrameLoss::TransferFailed => 0,
        FrameLoss::LeaderLost | FrameLoss::TrailerLost | FrameLoss::TrailerGarbled => 1,
        FrameLoss::LeaderGarbled
        | FrameLoss::WrongBlock
        | FrameLoss::ShortPayload
        | FrameLoss::DeviceDiscarded
        | FrameLoss::WrongFormat
        | FrameLoss::WrongSize => 2,
        FrameLoss::Skipped => 3,
        FrameLoss::Restarted => 4,
    }
}

impl CameraCounts {
    pub(super) fn new(counters: &Counters) -> Self {
        let count = |what: &str| counters.register(&format!("usb_{what}"));
        Self {
            losses: GROUPS.map(count),
            restarts: count("restarts"),
            opened: count("opened"),
            slips: count("slips"),
            unmatched: count("unmatched"),
            uncertain: count("uncertain"),
        }
    }

    pub(super) fn lost(&self, loss: FrameLoss, count: u64) {
        self.losses[group(loss)].add(count);
    }
}

/// The reason that the sink counts.
pub(super) const fn reason(loss: FrameLoss) -> LossReason {
    match loss {
        FrameLoss::ShortPayload | FrameLoss::LeaderLost | FrameLoss::TrailerLost => LossReason::Truncated,
        FrameLoss::Skipped | FrameLoss::Restarted => LossReason::Dropped,
        _ => LossReason::DeviceError,
    }
}
