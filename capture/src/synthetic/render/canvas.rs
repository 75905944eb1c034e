use super::{Layer, Rect, TileGrid};

/// The mean levels of the pixels of some tiles: opened from the background, painted on, then developed.
#[derive(Debug)]
pub struct Canvas {
    /// The frame.
    pub grid: TileGrid,
    /// DN, meaningful in open tiles.
    means: Vec<f32>,
    open: Vec<bool>,
    tiles: Vec<u32>,
}

impl Canvas {
    /// A canvas with no tile open.
    pub fn new(grid: TileGrid) -> Self {
        Self {
            grid,
            means: vec![0.0; grid.width * grid.height],
            open: vec![false; grid.count()],
            tiles: Vec::with_capacity(grid.count()),
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
        for tile in self.grid.touched(rect) {
            if std::mem::replace(&mut self.open[tile as usize], true) {
                continue;
            }
            self.tiles.push(tile);
            let (xs, ys) = self.grid.pixels(tile);
            for y in ys {
                let row = y * self.grid.width + xs.start..y * self.grid.width + xs.end;
                for (mean, base) in self.means[row.clone()].iter_mut().zip(&background[row]) {
                    *mean = f32::from(*base) * gain;
                }
            }
        }
    }

    /// The open tiles.
    pub fn tiles(&self) -> &[u32] {
        &self.tiles
    }

    /// Whether a tile is open.
    pub fn is_open(&self, tile: u32) -> bool {
        self.open[tile as usize]
    }

    /// Paints a layer over what is on the canvas, as far as its tiles are open.
    pub fn paint(&mut self, layer: &Layer, gain: f32) {
        for tile in &self.tiles {
            let (xs, ys) = self.grid.pixels(*tile);
            for y in layer.rows_among(&xs, &ys) {
                let row = y * self.grid.width + xs.start..y * self.grid.width + xs.end;
                layer.blend(y, xs.clone(), gain, &mut self.means[row]);
            }
        }
    }

    /// The means of a row.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.means[y * self.grid.width..(y + 1) * self.grid.width]
    }

    /// The mean of a pixel.
    pub fn mean_mut(&mut self, x: usize, y: usize) -> &mut f32 {
        &mut self.means[y * self.grid.width + x]
    }
}
