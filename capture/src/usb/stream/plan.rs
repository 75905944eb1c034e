use thiserror::Error;

use crate::usb::gencp::{Sirm, TransferSizes};

/// What a transfer is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// It brings the leader.
    Leader,
    /// It brings `length` bytes of the frame, from `offset` on.
    Payload {
        /// Place in the frame.
        offset: usize,
        /// Bytes.
        length: usize,
    },
    /// It brings the trailer.
    Trailer,
}

/// How a frame is cut into transfers: one leader, the payload, one trailer, always in this order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FramePlan {
    /// What the device is told.
    pub sizes: TransferSizes,
    /// The transfers in their order.
    pub roles: Vec<Role>,
    /// Bytes of the frame itself.
    pub payload: usize,
    /// Bytes that a slot must have: the transfers' sizes are rounded up to the device's alignment.
    pub slot: usize,
}

/// Demands of a device that cannot be met.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum PlanError {
    /// No frame is empty, and none is as large as this.
    #[error("the camera demands {0} bytes for a frame; 1 byte to 1 GB are possible")]
    Payload(u64),
    /// Leaders and trailers have some dozen bytes.
    #[error("the camera demands {0} bytes for a leader or trailer; at most 64 KB are possible")]
    Packet(u32),
}

impl FramePlan {
    /// Largest transfer: usbfs needs its memory in one piece where a host controller cannot gather it.
    const TRANSFER: u32 = 1 << 20;

    /// The plan for a device's demands, on a stream endpoint with packets of `packet` bytes.
    ///
    /// # Errors
    /// [`PlanError`].
    pub fn new(sirm: &Sirm, packet: u32) -> Result<Self, PlanError> {
        let payload = u32::try_from(sirm.payload).unwrap_or(u32::MAX);
        if payload == 0 || payload > 1 << 30 {
            return Err(PlanError::Payload(sirm.payload));
        }
        let side = sirm.leader.max(sirm.trailer);
        if side > 1 << 16 {
            return Err(PlanError::Packet(side));
        }
        // At least one whole packet of SuperSpeed: a payload that lands here by mistake must not
        // overflow, since that would halt the endpoint.
        let align = sirm.alignment.max(1);
        let side = |bytes: u32| bytes.max(1024).next_multiple_of(align.max(1024));
        // A whole number of packets too, or the device's next packet would overflow a transfer; and not more
        // of them than the payload needs: on a slow link, with packets of 512 bytes, a payload that ends with
        // a whole packet would leave the transfer open, and the trailer would run into it.
        let unit = align.max(packet.max(1));
        let transfer = Self::TRANSFER.max(unit);
        let count = payload / transfer;
        let final1 = (payload % transfer).next_multiple_of(unit);
        let sizes = TransferSizes {
            leader: side(sirm.leader),
            payload: transfer,
            count,
            final1,
            final2: 0,
            trailer: side(sirm.trailer),
        };
        let mut roles = vec![Role::Leader];
        let mut offset = 0;
        let last = (final1 > 0).then_some(final1);
        for length in std::iter::repeat_n(transfer, count as usize).chain(last) {
            roles.push(Role::Payload { offset, length: length as usize });
            offset += length as usize;
        }
        roles.push(Role::Trailer);
        Ok(Self { sizes, roles, payload: payload as usize, slot: offset })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_cover_the_payload_in_aligned_transfers() {
        for (payload, log2, packet) in [
            (1, 0, 1024),
            (1023, 2, 1024),
            (2_304_000, 10, 1024),
            (1 << 20, 10, 1024),
            ((1 << 20) + 1, 12, 512),
            (98_304, 13, 1024),
            (64_000, 9, 512),
        ] {
            let sirm = Sirm { alignment: 1 << log2, enabled: false, payload, leader: 52, trailer: 32 };
            let plan = FramePlan::new(&sirm, packet).expect("possible");
            let s = plan.sizes;
            for size in [s.leader, s.trailer, s.payload, s.final1] {
                assert_eq!(size % (1 << log2), 0, "{payload} {log2}");
                assert_eq!(size % packet, 0, "{payload} {log2}");
            }
            assert!(
                plan.slot as u64 >= payload
                    && plan.slot as u64 - payload < (1_u64 << log2).max(packet.into())
            );
            assert_eq!(plan.slot, (s.payload * s.count + s.final1) as usize);
            let covered: usize = plan
                .roles
                .iter()
                .map(|r| if let Role::Payload { length, .. } = r { *length } else { 0 })
                .sum();
            assert_eq!(covered, plan.slot);
        }
        let sirm = Sirm { alignment: 1024, enabled: false, payload: 0, leader: 52, trailer: 32 };
        assert!(FramePlan::new(&sirm, 1024).is_err());
        assert!(FramePlan::new(&Sirm { payload: u64::MAX, ..sirm }, 1024).is_err());
        assert!(FramePlan::new(&Sirm { payload: 5, leader: 1 << 20, ..sirm }, 1024).is_err());
    }
}
