use image::{GrayImage, Luma, imageops};
use nalgebra::Vector2;
use netcord_common::{
    board::CalibrationBoard,
    camera::CameraModel,
    geometry::{Board, Camera, Transform},
};

/// Takes pictures of boards, by casting rays through a camera: another implementation than the synthetic source's.
#[derive(Debug)]
pub struct Photographer {
    model: CameraModel,
    /// Undistorted normalised coordinates of `FINER` × `FINER` places in each pixel.
    rays: Vec<Option<Vector2<f64>>>,
}

/// Rays along each side of a pixel.
const FINER: u32 = 2;

impl Photographer {
    /// With this camera.
    pub fn new(model: &CameraModel) -> Self {
        let place = |i: u32| (f64::from(i) + 0.5) / f64::from(FINER) - 0.5;
        let (columns, rows) = (model.width * FINER, model.height * FINER);
        let cells = (0..rows).flat_map(|y| (0..columns).map(move |x| Vector2::new(place(x), place(y))));
        Self { model: *model, rays: cells.map(|p| model.undistort(&p)).collect() }
    }

    /// A picture of `board`, with its white margin, before a grey wall; a little blurred, with noise of two grey
    /// levels.
    pub fn picture(
        &self,
        board: &CalibrationBoard,
        camera_from_board: &Transform<Camera, Board>,
    ) -> GrayImage {
        let margin_m = 0.02;
        let inverse = camera_from_board.inverse();
        let origin = inverse.translation;
        let columns = (self.model.width * FINER) as usize;
        let shade = |i: usize| -> f32 {
            let wall = 90.0 + 20.0 * (i % columns) as f32 / columns as f32;
            let Some(n) = self.rays[i] else { return wall };
            let direction = inverse.rotation * nalgebra::Vector3::new(n.x, n.y, 1.0);
            let depth = -origin.z / direction.z;
            if !(depth.is_finite() && depth > 0.0 && direction.z > 0.0) {
                return wall;
            }
            let at = origin + direction * depth;
            match board.is_white(&Vector2::new(at.x, at.y), margin_m) {
                Some(true) => 215.0,
                Some(false) => 35.0,
                None => wall,
            }
        };
        let mut noise = 1u32;
        let mut picture = GrayImage::new(self.model.width, self.model.height);
        for (x, y, pixel) in picture.enumerate_pixels_mut() {
            let cells = (0..FINER * FINER)
                .map(|k| (y * FINER + k / FINER) as usize * columns + (x * FINER + k % FINER) as usize);
            let mean = cells.map(shade).sum::<f32>() / (FINER * FINER) as f32;
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let grain = (noise >> 24) as f32 / 255.0 * 7.0 - 3.5;
            *pixel = Luma([(mean + grain).clamp(0.0, 255.0) as u8]);
        }
        imageops::blur(&picture, 0.6)
    }

    /// Whether all of the board is in the picture, seen from its printed side, and not too much from the side.
    pub fn sees(&self, board: &CalibrationBoard, camera_from_board: &Transform<Camera, Board>) -> bool {
        let (low, high) = board.extent();
        let middle = (low + high) / 2.0;
        let centre = camera_from_board.rotation * nalgebra::Vector3::new(middle.x, middle.y, 0.0)
            + camera_from_board.translation;
        let facing = (camera_from_board.rotation * nalgebra::Vector3::z()).dot(&centre.normalize());
        let corner = |x: f64, y: f64| {
            let at = camera_from_board * netcord_common::geometry::Point::new(x, y, 0.0);
            self.model.project(&at).is_some_and(|p| self.model.contains(&p))
        };
        facing > 0.35
            && [(low.x, low.y), (high.x, low.y), (high.x, high.y), (low.x, high.y)]
                .iter()
                .all(|(x, y)| corner(*x, *y))
    }
}
