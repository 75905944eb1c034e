use nalgebra::Vector2;
use netcord_common::camera::CameraModel;

use super::{Rect, TILE, TileGrid, board::RayField};

/// For each pixel the undistorted normalised coordinates (x/z, y/z) of its ray, to 2e-4 px.
/// A tile is computed when it is first asked for: most of a frame never is.
#[derive(Debug)]
pub struct RayTable {
    model: CameraModel,
    rays: Vec<[f32; 2]>,
    known: Vec<bool>,
    grid: TileGrid,
}

impl RayTable {
    /// A table that knows nothing yet.
    pub fn new(model: &CameraModel) -> Self {
        let grid = TileGrid { width: model.width as usize, height: model.height as usize };
        Self {
            model: *model,
            rays: vec![[0.0; 2]; grid.width * grid.height],
            known: vec![false; grid.count()],
            grid,
        }
    }

    /// Makes sure of the rays of all pixels of `rect` that lie in the frame.
    pub fn make_known(&mut self, rect: &Rect) {
        for tile in self.grid.touched(rect) {
            if !std::mem::replace(&mut self.known[tile as usize], true) {
                self.fill(tile);
            }
        }
    }

    fn fill(&mut self, tile: u32) {
        let (xs, ys) = self.grid.pixels(tile);
        // Exact at nine places of the tile; a parabola through three of them, in each direction, is off by
        // its third derivative: below 1e-4 px even at the corners of wide lenses.
        let place = |from: usize, i: usize| from as f64 + (i * TILE) as f64 * 0.5;
        let nodes: [[Option<Vector2<f64>>; 3]; 3] = std::array::from_fn(|j| {
            std::array::from_fn(|i| {
                self.model.undistort(&Vector2::new(place(xs.start, i), place(ys.start, j)))
            })
        });
        let node = |i: usize, j: usize| nodes[j][i];
        let smooth = nodes.iter().flatten().all(Option::is_some);
        let weights = |k: usize| {
            let s = 2.0 * k as f64 / TILE as f64;
            [0.5 * (s - 1.0) * (s - 2.0), s * (2.0 - s), 0.5 * s * (s - 1.0)]
        };
        for y in ys.clone() {
            let down = weights(y - ys.start);
            for x in xs.clone() {
                let ray = if smooth {
                    let across = weights(x - xs.start);
                    let mut sum = Vector2::zeros();
                    for (j, v) in down.iter().enumerate() {
                        for (i, u) in across.iter().enumerate() {
                            sum += node(i, j).unwrap_or_default() * (u * v);
                        }
                    }
                    Some(sum)
                } else {
                    self.model.undistort(&Vector2::new(x as f64, y as f64))
                };
                // Where the lens has no inverse no light comes from anywhere: nothing is ever hit there.
                self.rays[y * self.grid.width + x] = ray.map_or([f32::NAN; 2], |n| [n.x as f32, n.y as f32]);
            }
        }
    }

    /// The ray of a pixel and its change to the next ones, from its neighbours, which must be known.
    pub fn field(&self, x: usize, y: usize) -> RayField {
        let TileGrid { width, height } = self.grid;
        let at = |x: usize, y: usize| {
            let [u, v] = self.rays[y * width + x];
            Vector2::new(f64::from(u), f64::from(v))
        };
        let (left, right) = (x.saturating_sub(1), (x + 1).min(width - 1));
        let (up, down) = (y.saturating_sub(1), (y + 1).min(height - 1));
        RayField {
            at: at(x, y),
            by_x: (at(right, y) - at(left, y)) / (right - left).max(1) as f64,
            by_y: (at(x, down) - at(x, up)) / (down - up).max(1) as f64,
        }
    }

    /// The rays of a row, of which only known tiles are filled.
    pub fn row(&self, y: usize) -> &[[f32; 2]] {
        &self.rays[y * self.grid.width..(y + 1) * self.grid.width]
    }
}

#[cfg(test)]
mod tests {
    use netcord_common::camera::Distortion;

    use super::*;

    #[test]
    fn rays_are_those_of_the_camera_model_everywhere() {
        let lens = Distortion::from_array([-0.097_151, 0.067_889, -0.000_716, 0.000_305, -0.003_636]);
        let model =
            CameraModel::new((1920, 1200), (672.282, 672.689), (984.047, 602.967), lens).expect("valid");
        let mut table = RayTable::new(&model);
        table.make_known(&Rect { x0: -5, y0: -5, x1: 3000, y1: 3000 });
        for y in (0..1200).step_by(37).chain([1199]) {
            for x in (0..1920).step_by(41).chain([1919]) {
                let [nx, ny] = table.row(y)[x];
                let there = model.distort(&Vector2::new(nx.into(), ny.into())).expect("inside");
                let back = Vector2::new(there.x * model.fx + model.cx, there.y * model.fy + model.cy);
                let off = (back - Vector2::new(x as f64, y as f64)).norm();
                assert!(off < 2e-4, "pixel {x}, {y} is off by {off} px");
            }
        }
    }
}
