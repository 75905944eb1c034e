use crate::wire::FrameHeader;

/// Counts at a reader the messages it lost, by gaps in the writer's sequence. A new session of the
/// writer starts over.
#[derive(Debug, Clone, Copy, Default)]
pub struct SequenceGaps {
    /// Session and sequence number of the newest message.
    last: Option<(u64, u64)>,
    lost: u64,
}

impl SequenceGaps {
    /// Nothing seen yet: what was published before the first message does not count as lost.
    pub const fn new() -> Self {
        Self { last: None, lost: 0 }
    }

    /// Takes note of a message; returns how many were lost just before it.
    pub fn see(&mut self, session: u64, sequence: u64) -> u64 {
        let gap = match self.last {
            None => 0,
            Some((of, last)) if of == session => sequence.saturating_sub(last + 1),
            // A new writer counts from 1; this reader was there, so what came before is a loss.
            Some(_) => sequence.saturating_sub(1),
        };
        self.last = Some((session, sequence));
        self.lost += gap;
        gap
    }

    /// As [`Self::see`], for a frame.
    pub fn see_frame(&mut self, header: &FrameHeader) -> u64 {
        self.see(header.session, header.sequence)
    }

    /// All that were lost so far.
    pub const fn lost(&self) -> u64 {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_losses_but_not_what_came_before_the_reader() {
        let mut gaps = SequenceGaps::new();
        assert_eq!(gaps.see(7, 100), 0);
        assert_eq!(gaps.see(7, 101), 0);
        assert_eq!(gaps.see(7, 105), 3);
        assert_eq!(gaps.see(8, 1), 0, "the writer was restarted");
        assert_eq!(gaps.see(9, 3), 2);
        assert_eq!(gaps.lost(), 5);
    }
}
