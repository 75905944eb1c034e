use super::options::InputMode;

/// How the pixels that are searched lie in the camera's frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// Searched pixels per pixel of the frame, along each axis: 2 where every pixel has become a cell.
    pub scale: usize,
    /// Whether the four pixels of a cell have one place, its centre.
    pub co_sited: bool,
}

impl Grid {
    /// Of an input mode.
    pub const fn of(input: InputMode) -> Self {
        match input {
            InputMode::Raw => Self { scale: 1, co_sited: false },
            InputMode::Half => Self { scale: 1, co_sited: true },
            InputMode::Bilinear | InputMode::EdgeAware => Self { scale: 2, co_sited: true },
        }
    }

    /// The place in the frame, px, along one axis, of a searched pixel.
    #[inline]
    pub fn place(self, at: usize) -> f64 {
        let at = if self.co_sited { (at & !1) as f64 + 0.5 } else { at as f64 };
        self.frame_px(at)
    }

    /// A coordinate of the searched image in the frame, px.
    #[inline]
    pub fn frame_px(self, at: f64) -> f64 {
        if self.scale == 2 { 0.5 * (at - 0.5) } else { at }
    }

    /// The first searched pixel, along one axis, of the cell at a coordinate of the frame, px; none before the
    /// first.
    #[inline]
    pub fn searched(self, at: f64) -> Option<usize> {
        let at = if self.scale == 2 { 2.0 * at + 0.5 } else { at };
        (at >= 0.0).then_some(at as usize & !1)
    }

    /// The searched pixels whose places may lie from `low` to `high`, of `size`; whole cells.
    pub fn range(self, low: f64, high: f64, size: usize) -> std::ops::Range<usize> {
        let scale = self.scale as f64;
        let first = ((low * scale).floor() - 1.0).clamp(0.0, size as f64) as usize & !1;
        let last = ((high * scale).ceil() + 3.0).clamp(0.0, size as f64) as usize;
        first..last.next_multiple_of(2).min(size)
    }
}
