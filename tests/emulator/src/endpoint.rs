use std::{collections::VecDeque, ops::Range, sync::Arc};

/// How a URB ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UrbEnd {
    /// Full, or ended by a short packet.
    Done,
    /// The endpoint is halted.
    Stalled,
    /// A packet was longer than what was left of the URB.
    Overflow,
}

/// A URB that is finished.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Completion {
    /// The host's id.
    pub id: u32,
    /// How it ended.
    pub end: UrbEnd,
    /// What it holds.
    pub data: Vec<u8>,
}

/// One transfer of the device: it ends where the device ends it, whatever the host's URBs.
#[derive(Debug, Clone)]
pub struct DeviceTransfer {
    bytes: Arc<Vec<u8>>,
    range: Range<usize>,
}

impl DeviceTransfer {
    /// Transfers `range` of `bytes`.
    pub fn new(bytes: Arc<Vec<u8>>, range: Range<usize>) -> Self {
        Self { bytes, range }
    }
}

#[derive(Debug)]
struct Urb {
    id: u32,
    length: usize,
    filled: Vec<u8>,
}

/// A bulk IN endpoint: the host's URBs meet the device's packets as they do on a wire. A transfer
/// whose length is a multiple of the packet size ends without a zero-length packet, so that a URB
/// larger than it stays open and gets the next transfer too.
#[derive(Debug)]
pub struct InEndpoint {
    packet: usize,
    urbs: VecDeque<Urb>,
    transfers: VecDeque<DeviceTransfer>,
    halted: bool,
}

impl InEndpoint {
    /// An endpoint with packets of `packet` bytes.
    pub fn new(packet: usize) -> Self {
        Self { packet, urbs: VecDeque::new(), transfers: VecDeque::new(), halted: false }
    }

    /// The host offers a URB.
    pub fn submit(&mut self, id: u32, length: usize) {
        self.urbs.push_back(Urb { id, length, filled: Vec::new() });
    }

    /// The host takes a URB back; gives what it holds, if it was still there.
    pub fn unlink(&mut self, id: u32) -> Option<Vec<u8>> {
        let at = self.urbs.iter().position(|urb| urb.id == id)?;
        self.urbs.remove(at).map(|urb| urb.filled)
    }

    /// The device has a transfer to send.
    pub fn push(&mut self, transfer: DeviceTransfer) {
        self.transfers.push_back(transfer);
    }

    /// Transfers that wait.
    pub fn waiting(&self) -> usize {
        self.transfers.len()
    }

    /// URBs that wait.
    pub fn offered(&self) -> usize {
        self.urbs.len()
    }

    /// Halts the endpoint: every URB ends with a stall.
    pub fn halt(&mut self) {
        self.halted = true;
    }

    /// Whether it is halted.
    pub const fn is_halted(&self) -> bool {
        self.halted
    }

    /// Ends the halt.
    pub fn clear_halt(&mut self) {
        self.halted = false;
    }

    /// Throws away what waits to be sent.
    pub fn flush(&mut self) {
        self.transfers.clear();
    }

    /// Moves packets; gives the URBs that are finished.
    pub fn pump(&mut self) -> Vec<Completion> {
        let mut done = Vec::new();
        if self.halted {
            // A halted endpoint ends the URB that runs; the others follow as the host starts them.
            done.extend(self.urbs.drain(..).map(|urb| Completion {
                id: urb.id,
                end: UrbEnd::Stalled,
                data: urb.filled,
            }));
            return done;
        }
        while let (Some(urb), Some(transfer)) = (self.urbs.front_mut(), self.transfers.front_mut()) {
            let left = transfer.range.len();
            let room = urb.length - urb.filled.len();
            // Whole packets that fit, then the short one.
            let whole = left.min(room) / self.packet * self.packet;
            let tail = left - whole;
            let short = tail < self.packet;
            let (take, end) = if short && whole + tail <= room {
                (whole + tail, (tail > 0 || left == 0).then_some(UrbEnd::Done))
            } else if whole == room {
                (whole, None)
            } else {
                (whole, Some(UrbEnd::Overflow))
            };
            let from = transfer.range.start;
            urb.filled.extend_from_slice(&transfer.bytes[from..from + take]);
            transfer.range.start += take;
            let mut end = end;
            if end.is_none() && urb.filled.len() == urb.length {
                end = Some(UrbEnd::Done);
            }
            if end == Some(UrbEnd::Overflow) {
                // The packet that did not fit is gone.
                transfer.range.start = (transfer.range.start + self.packet).min(transfer.range.end);
            }
            if transfer.range.is_empty() {
                self.transfers.pop_front();
            }
            if let (Some(end), Some(urb)) = (end, end.and_then(|_| self.urbs.pop_front())) {
                done.push(Completion { id: urb.id, end, data: urb.filled });
            }
        }
        done
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn endpoint(urbs: &[usize], transfers: &[usize]) -> Vec<(u32, UrbEnd, usize)> {
        let mut e = InEndpoint::new(1024);
        for (id, length) in urbs.iter().enumerate() {
            e.submit(u32::try_from(id).expect("few"), *length);
        }
        for length in transfers {
            e.push(DeviceTransfer::new(Arc::new(vec![0; *length]), 0..*length));
        }
        e.pump().into_iter().map(|c| (c.id, c.end, c.data.len())).collect()
    }

    #[test]
    fn short_packets_end_urbs_and_full_ones_do_not() {
        use UrbEnd::{Done, Overflow};
        assert_eq!(
            endpoint(&[1024, 4096, 1024], &[52, 4096, 32]),
            [(0, Done, 52), (1, Done, 4096), (2, Done, 32)]
        );
        // A transfer shorter by whole packets leaves the URB open: the trailer runs into it.
        assert_eq!(endpoint(&[4096, 1024], &[2048, 32]), [(0, Done, 2080)]);
        // A lost leader shifts all that follows.
        assert_eq!(
            endpoint(&[1024, 4096, 1024], &[4096, 32, 52]),
            [(0, Done, 1024), (1, Done, 3104), (2, Done, 52)]
        );
        // More than fits a URB that is no multiple of the packet.
        assert_eq!(endpoint(&[1500], &[2048]), [(0, Overflow, 1024)]);
        assert_eq!(endpoint(&[100], &[60, 60]), [(0, Done, 60)]);
    }
}
