use std::{fmt, str::FromStr};

/// What can go wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The stream endpoint halts before the frame.
    Stall,
    /// The leader is not sent.
    LoseLeader,
    /// The trailer is not sent.
    LoseTrailer,
    /// Half of the payload is not sent.
    ShortPayload,
    /// Bytes of an extra packet follow the payload.
    LongPayload,
    /// The trailer names another block.
    WrongBlock,
    /// The leader names another pixel format.
    WrongFormat,
    /// The leader names another size.
    WrongSize,
    /// The leader begins with another magic.
    WrongLeader,
    /// The trailer says that data were discarded (0xA100).
    Discarded,
    /// The trailer says that data overran (0xA101).
    Overrun,
    /// The frame is not sent, and its block id is missing.
    Skip,
    /// The device is unplugged after the frame.
    Unplug,
    /// The trigger is not noticed: neither a frame nor a block id comes of it.
    MissTrigger,
    /// The acknowledge is not sent.
    LoseAck,
    /// The acknowledge comes this many ms late.
    LateAck(u32),
    /// An acknowledge of an old command comes first.
    StaleAck,
    /// A pending acknowledge asks for three times this many ms, the answer comes after them.
    PendingAck(u32),
    /// The control endpoint stalls instead of answering.
    StallControl,
}

const NAMES: [(&str, Fault); 19] = [
    ("stall", Fault::Stall),
    ("lose-leader", Fault::LoseLeader),
    ("lose-trailer", Fault::LoseTrailer),
    ("short-payload", Fault::ShortPayload),
    ("long-payload", Fault::LongPayload),
    ("wrong-block", Fault::WrongBlock),
    ("wrong-format", Fault::WrongFormat),
    ("wrong-size", Fault::WrongSize),
    ("wrong-leader", Fault::WrongLeader),
    ("discarded", Fault::Discarded),
    ("overrun", Fault::Overrun),
    ("skip", Fault::Skip),
    ("unplug", Fault::Unplug),
    ("miss-trigger", Fault::MissTrigger),
    ("lose-ack", Fault::LoseAck),
    ("late-ack", Fault::LateAck(300)),
    ("stale-ack", Fault::StaleAck),
    ("pending-ack", Fault::PendingAck(300)),
    ("stall-control", Fault::StallControl),
];

/// What faults strike, and are counted by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Victim {
    /// A frame that is to be sent.
    Frame,
    /// A command on the control endpoint.
    Command,
    /// A trigger impulse, by a line or by software.
    Trigger,
}

impl Fault {
    /// What it strikes.
    pub const fn victim(self) -> Victim {
        match self {
            Self::LoseAck | Self::LateAck(_) | Self::StaleAck | Self::PendingAck(_) | Self::StallControl => {
                Victim::Command
            }
            Self::MissTrigger => Victim::Trigger,
            _ => Victim::Frame,
        }
    }
}

/// When a fault strikes: frames, commands and triggers are counted from the moment the plan was set, from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaultRule {
    /// What.
    pub fault: Fault,
    /// At which frame, command or trigger first.
    pub at: u64,
    /// Then again after this many; 0 = never.
    pub every: u64,
}

/// The faults of one camera. Written as `lose-trailer@10`, `stall@20+30` (at 20, 50, 80, …),
/// separated by blanks.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FaultPlan {
    /// The rules.
    pub rules: Vec<FaultRule>,
}

/// A plan that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FaultError(String);

impl fmt::Display for FaultError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "fault {:?} is not of the form name@count or name@count+every, with a name of ", self.0)?;
        NAMES.iter().try_for_each(|(name, _)| write!(f, "{name} "))
    }
}

impl std::error::Error for FaultError {}

impl FromStr for FaultPlan {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let rule = |word: &str| {
            let (name, when) = word.split_once('@')?;
            let (at, every) = when.split_once('+').unwrap_or((when, "0"));
            let (_, fault) = NAMES.into_iter().find(|(n, _)| *n == name)?;
            Some(FaultRule { fault, at: at.parse().ok()?, every: every.parse().ok()? })
        };
        let rules = text
            .split_whitespace()
            .map(|word| rule(word).ok_or_else(|| FaultError(word.to_owned())))
            .collect::<Result<_, _>>()?;
        Ok(Self { rules })
    }
}

impl FaultPlan {
    /// The fault that strikes the `count`-th of its kind of victim.
    pub fn strikes(&self, victim: Victim, count: u64) -> Option<Fault> {
        self.rules
            .iter()
            .find(|rule| {
                rule.fault.victim() == victim
                    && (count == rule.at
                        || (rule.every > 0
                            && count > rule.at
                            && (count - rule.at).is_multiple_of(rule.every)))
            })
            .map(|rule| rule.fault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_are_read_and_strike_when_they_say() {
        let plan: FaultPlan = "stall@3+4 lose-ack@2 miss-trigger@4".parse().expect("a plan");
        let frames: Vec<u64> = (1..12).filter(|n| plan.strikes(Victim::Frame, *n).is_some()).collect();
        assert_eq!(frames, [3, 7, 11]);
        assert_eq!(plan.strikes(Victim::Command, 2), Some(Fault::LoseAck));
        assert_eq!(plan.strikes(Victim::Command, 3), None);
        assert_eq!(plan.strikes(Victim::Trigger, 4), Some(Fault::MissTrigger));
        assert!("explode@1".parse::<FaultPlan>().is_err());
    }
}
