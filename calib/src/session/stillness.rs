use std::collections::BTreeMap;

use nalgebra::Vector2;

use crate::detect::BoardView;

/// Tells how far a board moves in one camera's picture from one look to the next.
#[derive(Debug, Clone, Default)]
pub struct Stillness {
    before: Option<BTreeMap<usize, Vector2<f64>>>,
}

impl Stillness {
    /// Fewest corners that two looks must share.
    const COMMON: usize = 4;

    /// Takes the next look; says how far the board has moved since the one before, px (the middle over the
    /// corners that both see). `None` when there is nothing to compare with.
    pub fn moved_px(&mut self, board: Option<&BoardView>) -> Option<f64> {
        let now: Option<BTreeMap<_, _>> = board.map(|b| b.corners.iter().map(|c| (c.id, c.at)).collect());
        let moved = self.before.as_ref().zip(now.as_ref()).and_then(|(before, now)| {
            let mut ways: Vec<f64> =
                now.iter().filter_map(|(id, at)| before.get(id).map(|b| (at - b).norm())).collect();
            if ways.len() < Self::COMMON {
                return None;
            }
            let middle = ways.len() / 2;
            Some(*ways.select_nth_unstable_by(middle, f64::total_cmp).1)
        });
        self.before = now;
        moved
    }
}
