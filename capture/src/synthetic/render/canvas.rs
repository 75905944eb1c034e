use netcord_common::PixelFormat;

use super::rays::TILE;

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
    pub fn within(&self, width: usize, height: usize) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        let clamp = |v: i64, limit: usize| usize::try_from(v.max(0)).unwrap_or(0).min(limit);
        (clamp(self.x0, width)..clamp(self.x1, width), clamp(self.y0, height)..clamp(self.y1, height))
    }
}

/// The mean levels of the pixels that change in a frame, in tiles: opened from the background, painted
/// on, then developed.
#[derive(Debug)]
pub struct Canvas {
    /// Columns of pixels.
    pub width: usize,
    /// Rows of pixels.
    pub height: usize,
    /// Channel (0 red, 1 green, 2 blue, 3 none) at (x & 1, y & 1), as `channels[y & 1][x & 1]`.
    channels: [[usize; 2]; 2],
    /// DN, meaningful in open tiles.
    means: Vec<f32>,
    open: Vec<bool>,
    tiles: Vec<u32>,
    columns: usize,
}

impl Canvas {
    /// A canvas with no tile open.
    pub fn new(width: usize, height: usize, format: PixelFormat) -> Self {
        let columns = width.div_ceil(TILE);
        let count = columns * height.div_ceil(TILE);
        Self {
            width,
            height,
            channels: channels(format),
            means: vec![0.0; width * height],
            open: vec![false; count],
            tiles: Vec::with_capacity(count),
            columns,
        }
    }

    /// Closes all tiles.
    pub fn clear(&mut self) {
        for tile in self.tiles.drain(..) {
            self.open[tile as usize] = false;
        }
    }

    /// Opens the tiles that `rect` touches: new ones begin as the background times `gain`.
    pub fn open(&mut self, rect: &Rect, background: &[u8], gain: f32) {
        let (columns, rows) = rect.within(self.width, self.height);
        if columns.is_empty() || rows.is_empty() {
            return;
        }
        for ty in rows.start / TILE..=(rows.end - 1) / TILE {
            for tx in columns.start / TILE..=(columns.end - 1) / TILE {
                let tile = ty * self.columns + tx;
                if std::mem::replace(&mut self.open[tile], true) {
                    continue;
                }
                self.tiles.push(tile as u32);
                let (xs, ys) = self.pixels(tile as u32);
                for y in ys {
                    let row = y * self.width + xs.start..y * self.width + xs.end;
                    for (mean, base) in self.means[row.clone()].iter_mut().zip(&background[row]) {
                        *mean = f32::from(*base) * gain;
                    }
                }
            }
        }
    }

    /// The open tiles.
    pub fn tiles(&self) -> &[u32] {
        &self.tiles
    }

    /// Columns and rows of the pixels of a tile.
    pub fn pixels(&self, tile: u32) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        let (tx, ty) = (tile as usize % self.columns, tile as usize / self.columns);
        (tx * TILE..((tx + 1) * TILE).min(self.width), ty * TILE..((ty + 1) * TILE).min(self.height))
    }

    /// The means of a row.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.means[y * self.width..(y + 1) * self.width]
    }

    /// The means of a row.
    pub fn row_mut(&mut self, y: usize) -> &mut [f32] {
        &mut self.means[y * self.width..(y + 1) * self.width]
    }

    /// The mean of a pixel.
    pub fn mean_mut(&mut self, x: usize, y: usize) -> &mut f32 {
        &mut self.means[y * self.width + x]
    }

    /// The channel of a pixel, as an index into colours (red, green, blue, luma).
    pub fn channel(&self, x: usize, y: usize) -> usize {
        self.channels[y & 1][x & 1]
    }
}

/// Channel of each place in the 2 × 2 cell, as an index into (red, green, blue, luma).
pub fn channels(format: PixelFormat) -> [[usize; 2]; 2] {
    use netcord_common::Channel;
    let at = |x, y| match format.channel_at(x, y) {
        Channel::Red => 0,
        Channel::Green => 1,
        Channel::Blue => 2,
        Channel::Luma => 3,
    };
    [[at(0, 0), at(1, 0)], [at(0, 1), at(1, 1)]]
}
