use std::ops::Range;

use super::Rect;

/// Side of a tile, px: what is looked up, opened and restored at a time.
pub const TILE: usize = 16;

/// A frame cut into tiles, numbered row by row; those at its right and lower edge may be smaller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TileGrid {
    /// Columns of pixels.
    pub width: usize,
    /// Rows of pixels.
    pub height: usize,
}

impl TileGrid {
    const fn columns(&self) -> usize {
        self.width.div_ceil(TILE)
    }

    /// How many tiles there are.
    pub const fn count(&self) -> usize {
        self.columns() * self.height.div_ceil(TILE)
    }

    /// The tile of a pixel.
    pub const fn tile_of(&self, x: usize, y: usize) -> u32 {
        (y / TILE * self.columns() + x / TILE) as u32
    }

    /// Columns and rows of the pixels of a tile.
    pub fn pixels(&self, tile: u32) -> (Range<usize>, Range<usize>) {
        let (tx, ty) = (tile as usize % self.columns(), tile as usize / self.columns());
        (tx * TILE..((tx + 1) * TILE).min(self.width), ty * TILE..((ty + 1) * TILE).min(self.height))
    }

    /// The tiles that the part of `rect` inside the frame touches.
    pub fn touched(&self, rect: &Rect) -> impl Iterator<Item = u32> + use<> {
        let (columns, rows) = rect.within(self.width, self.height);
        let range =
            |r: &Range<usize>| if r.is_empty() { 0..0 } else { r.start / TILE..(r.end - 1) / TILE + 1 };
        let (tx, ty) = (range(&columns), range(&rows));
        let across = self.columns();
        ty.flat_map(move |j| tx.clone().map(move |i| (j * across + i) as u32))
    }
}
