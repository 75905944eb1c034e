use nalgebra::Vector2;
use netcord_common::camera::CameraModel;

use super::canvas::Rect;

/// Side of a tile, px: what is looked up, opened and restored at a time.
pub const TILE: usize = 16;

/// For each pixel the undistorted normalised coordinates (x/z, y/z) of its ray, exact to 1e-4 px.
/// A tile is computed when it is first asked for: most of a frame never is.
#[derive(Debug)]
pub struct RayTable {
    model: CameraModel,
    rays: Vec<[f32; 2]>,
    known: Vec<bool>,
    columns: usize,
}

impl RayTable {
    /// A table that knows nothing yet.
    pub fn new(model: &CameraModel) -> Self {
        let (width, height) = (model.width as usize, model.height as usize);
        let columns = width.div_ceil(TILE);
        Self {
            model: *model,
            rays: vec![[0.0; 2]; width * height],
            known: vec![false; columns * height.div_ceil(TILE)],
            columns,
        }
    }

    /// Makes sure of the rays of all pixels of `rect` that lie in the frame.
    pub fn make_known(&mut self, rect: &Rect, width: usize, height: usize) {
        let (columns, rows) = rect.within(width, height);
        if columns.is_empty() || rows.is_empty() {
            return;
        }
        for ty in rows.start / TILE..=(rows.end - 1) / TILE {
            for tx in columns.start / TILE..=(columns.end - 1) / TILE {
                self.make_tile_known(tx, ty);
            }
        }
    }

    fn make_tile_known(&mut self, tx: usize, ty: usize) {
        let tile = ty * self.columns + tx;
        if self.known[tile] {
            return;
        }
        self.known[tile] = true;
        let (width, height) = (self.model.width as usize, self.model.height as usize);
        for y in ty * TILE..((ty + 1) * TILE).min(height) {
            for x in tx * TILE..((tx + 1) * TILE).min(width) {
                let ray = self.model.undistort(&Vector2::new(x as f64, y as f64));
                // Where the lens has no inverse no light comes from anywhere: nothing is ever hit there.
                self.rays[y * width + x] = ray.map_or([f32::NAN; 2], |n| [n.x as f32, n.y as f32]);
            }
        }
    }

    /// The rays of a row, of which only known tiles are filled.
    pub fn row(&self, y: usize) -> &[[f32; 2]] {
        let width = self.model.width as usize;
        &self.rays[y * width..(y + 1) * width]
    }
}
