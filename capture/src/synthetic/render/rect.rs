use std::ops::Range;

/// A rectangle of pixels, half open; may lie partly or wholly outside a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rect {
    /// Left edge.
    pub x0: i64,
    /// Top edge.
    pub y0: i64,
    /// Right edge, not inside.
    pub x1: i64,
    /// Bottom edge, not inside.
    pub y1: i64,
}

impl Rect {
    /// The pixels within `half` of `centre`, with their antialiased rims.
    pub fn around(centre: (f64, f64), half: (f64, f64)) -> Self {
        Self {
            x0: (centre.0 - half.0).floor() as i64,
            y0: (centre.1 - half.1).floor() as i64,
            x1: (centre.0 + half.0).ceil() as i64 + 1,
            y1: (centre.1 + half.1).ceil() as i64 + 1,
        }
    }

    /// The smallest rectangle that holds both.
    pub fn hull(&self, other: &Self) -> Self {
        Self {
            x0: self.x0.min(other.x0),
            y0: self.y0.min(other.y0),
            x1: self.x1.max(other.x1),
            y1: self.y1.max(other.y1),
        }
    }

    /// The part inside a frame, as ranges of columns and rows; empty ranges where there is none.
    pub fn within(&self, width: usize, height: usize) -> (Range<usize>, Range<usize>) {
        let clamp = |v: i64, limit: usize| usize::try_from(v.max(0)).unwrap_or(0).min(limit);
        (clamp(self.x0, width)..clamp(self.x1, width), clamp(self.y0, height)..clamp(self.y1, height))
    }
}
