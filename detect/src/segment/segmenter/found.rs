use netcord_common::wire::{Detection, SearchWindow};

use super::super::measure::Measured;

/// A candidate with what the message will say of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub item: Detection,
    pub measured: Measured,
    /// How well its colour agrees with the ball's, 0–1.
    pub likeness: f32,
}

impl Found {
    /// Where it is, px.
    pub const fn place(&self) -> [f64; 2] {
        [self.item.u_px, self.item.v_px]
    }

    /// Whether a place lies in its box.
    pub fn covers(&self, [u, v]: [f64; 2]) -> bool {
        let Detection { x0_px, y0_px, x1_px, y1_px, .. } = self.item;
        (x0_px..=x1_px).contains(&u) && (y0_px..=y1_px).contains(&v)
    }

    /// Whether it is where a search window expects the ball, and as large.
    pub fn is_expected(&self, window: &SearchWindow) -> bool {
        let [u, v] = self.place();
        (u - window.u_px).hypot(v - window.v_px) < 0.5 * window.diameter_px
            && self.item.diameter_px < 1.5 * window.diameter_px
    }

    /// Whether both are one thing.
    pub fn is_same(&self, other: &Self) -> bool {
        let reach = 0.35 * (self.item.diameter_px + other.item.diameter_px);
        let ([u, v], [other_u, other_v]) = (self.place(), other.place());
        (u - other_u).hypot(v - other_v) < reach || self.covers(other.place()) || other.covers(self.place())
    }
}
