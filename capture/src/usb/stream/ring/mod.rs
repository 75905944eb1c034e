use super::{Assembler, Expected, FramePlan, Role, Step, TransferEnd};

/// The frames in flight: each has a buffer for its payload, and two small ones for leader and trailer.
/// `B` is a loaned slot of shared memory, or plain memory in tests.
#[derive(Debug)]
pub struct Ring<B> {
    plan: FramePlan,
    assembler: Assembler,
    units: Vec<Unit<B>>,
}

#[derive(Debug)]
struct Unit<B> {
    buffer: B,
    leader: Box<[u8]>,
    trailer: Box<[u8]>,
}

impl<B: AsMut<[u8]>> Ring<B> {
    /// A ring whose frames in flight are `buffers`, each of at least [`FramePlan::slot`] bytes; `None`
    /// where one is smaller.
    pub fn new(plan: FramePlan, expected: Expected, buffers: Vec<B>) -> Option<Self> {
        let parts = plan.roles.len() - 2;
        let mut units = Vec::with_capacity(buffers.len());
        for mut buffer in buffers {
            if buffer.as_mut().len() < plan.slot {
                return None;
            }
            units.push(Unit {
                buffer,
                leader: vec![0; plan.sizes.leader as usize].into(),
                trailer: vec![0; plan.sizes.trailer as usize].into(),
            });
        }
        Some(Self { assembler: Assembler::new(expected, parts), plan, units })
    }

    /// Frames in flight.
    pub fn depth(&self) -> usize {
        self.units.len()
    }

    /// Transfers of one frame.
    pub fn parts(&self) -> usize {
        self.plan.roles.len()
    }

    /// How frames are cut.
    pub const fn plan(&self) -> &FramePlan {
        &self.plan
    }

    /// The memory of a transfer.
    pub fn memory(&mut self, unit: usize, part: usize) -> &mut [u8] {
        let Unit { buffer, leader, trailer } = &mut self.units[unit];
        match self.plan.roles[part] {
            Role::Leader => leader,
            Role::Trailer => trailer,
            Role::Payload { offset, length } => &mut buffer.as_mut()[offset..offset + length],
        }
    }

    /// A transfer is over: `received` bytes are in its memory.
    pub fn complete(&mut self, unit: usize, part: usize, end: TransferEnd, received: usize) -> Step {
        let role = self.plan.roles[part];
        let Unit { leader, trailer, .. } = &self.units[unit];
        let bytes: &[u8] = match role {
            Role::Leader => &leader[..received.min(leader.len())],
            Role::Trailer => &trailer[..received.min(trailer.len())],
            Role::Payload { .. } => &[],
        };
        self.assembler.transfer(role, part.saturating_sub(1), end, bytes, received)
    }

    /// The judge of the stream.
    pub const fn assembler(&mut self) -> &mut Assembler {
        &mut self.assembler
    }

    /// A unit's buffer, to be read or replaced while none of its transfers is in flight.
    pub fn buffer(&mut self, unit: usize) -> &mut B {
        &mut self.units[unit].buffer
    }
}

#[cfg(test)]
mod tests;
