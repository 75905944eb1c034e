//! Pictures of boards with exact truth: rendered through a distorted camera, blurred, with noise.

use nalgebra::{Rotation3, Vector2, Vector3};
use netcord_calib::{board::CalibrationBoard, detect::Luma};
use netcord_common::{
    camera::{CameraModel, Distortion},
    geometry::{Board, Camera, Transform},
};
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// Width and height of the pictures, px.
pub const SIZE: (usize, usize) = (1920, 1200);

/// How a picture is spoilt.
pub struct Look {
    /// Width of the blur, px.
    pub blur_px: f64,
    /// Standard deviation of the noise, grey levels.
    pub noise: f64,
    /// Level of black.
    pub black: f64,
    /// Level of white.
    pub white: f64,
}

/// Sharp, bright, little noise.
pub const CLEAN: Look = Look { blur_px: 0.7, noise: 2.0, black: 40.0, white: 210.0 };
/// Blurred, flat, noisy, with a gradient of light.
pub const HARD: Look = Look { blur_px: 1.6, noise: 7.0, black: 70.0, white: 150.0 };

/// A wide camera of 1920 × 1200 px.
pub fn lens() -> CameraModel {
    let lens = Distortion::from_array([-0.097_151, 0.067_889, -0.000_716, 0.000_305, -0.003_636]);
    CameraModel::new((1920, 1200), (1100.0, 1100.0), (984.0, 603.0), lens).expect("valid")
}

/// A picture of the board at `pose`: nine samples a pixel, blurred by a Gaussian, with noise and (when
/// hard) a gradient of light.
pub fn render(
    board: &CalibrationBoard,
    model: &CameraModel,
    pose: &Transform<Camera, Board>,
    look: &Look,
    seed: u64,
) -> Luma {
    let board_from_camera = pose.inverse();
    let origin = board_from_camera.translation;
    let rows: Vec<Vec<f32>> = (0..SIZE.1)
        .into_par_iter()
        .map(|y| {
            let ray = |x: f64, y: f64| model.undistort(&Vector2::new(x, y)).unwrap_or_else(Vector2::zeros);
            (0..SIZE.0)
                .map(|x| {
                    let (fx, fy) = (x as f64, y as f64);
                    let n = ray(fx, fy);
                    let (right, down) = (ray(fx + 1.0, fy) - n, ray(fx, fy + 1.0) - n);
                    let mut sum = 0.0;
                    for (sx, sy) in
                        (-1..=1).flat_map(|j| (-1..=1).map(move |i| (f64::from(i) / 3.0, f64::from(j) / 3.0)))
                    {
                        let at = n + right * sx + down * sy;
                        let way = board_from_camera.rotation * Vector3::new(at.x, at.y, 1.0);
                        let far = -origin.z / way.z;
                        let hit = origin + way * far;
                        let white = if far > 0.0 { board.is_white(&hit.xy(), 0.02) } else { None };
                        sum += white.map_or(0.45, |w| f64::from(u8::from(w)));
                    }
                    (look.black + (look.white - look.black) * sum / 9.0) as f32
                })
                .collect()
        })
        .collect();
    let reach = (4.0 * look.blur_px).ceil() as i32;
    let kernel: Vec<f32> =
        (-reach..=reach).map(|i| (-0.5 * (f64::from(i) / look.blur_px).powi(2)).exp() as f32).collect();
    let total: f32 = kernel.iter().sum();
    let clamp = |i: i32, n: usize| i.clamp(0, n as i32 - 1) as usize;
    let across: Vec<Vec<f32>> = rows
        .par_iter()
        .map(|row| {
            let tap = |x: usize, k: usize| row[clamp(x as i32 + k as i32 - reach, SIZE.0)];
            (0..SIZE.0)
                .map(|x| kernel.iter().enumerate().map(|(k, w)| w * tap(x, k)).sum::<f32>() / total)
                .collect()
        })
        .collect();
    let noise = Normal::new(0.0, look.noise).expect("positive");
    let data: Vec<u8> = (0..SIZE.1)
        .into_par_iter()
        .flat_map_iter(|y| {
            let mut random = Pcg64Mcg::seed_from_u64(seed * 10_000 + y as u64);
            let tap = |x: usize, k: usize| across[clamp(y as i32 + k as i32 - reach, SIZE.1)][x];
            (0..SIZE.0)
                .map(|x| {
                    let v: f32 = kernel.iter().enumerate().map(|(k, w)| w * tap(x, k)).sum::<f32>() / total;
                    let light = if look.noise > 5.0 { 0.8 + 0.4 * x as f64 / SIZE.0 as f64 } else { 1.0 };
                    (f64::from(v) * light + noise.sample(&mut random)).round().clamp(0.0, 255.0) as u8
                })
                .collect::<Vec<_>>()
        })
        .collect();
    Luma::new(SIZE.0, SIZE.1, data).expect("fits")
}

/// The pose of picture `seed` of `pictures`: tilted by 0° to 60°, a little off the middle.
pub fn pose(board: &CalibrationBoard, seed: u64, pictures: u64) -> Transform<Camera, Board> {
    let (low, high) = board.extent();
    let middle = (low + high) / 2.0;
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let tilt = 60f64.to_radians() * seed as f64 / (pictures - 1) as f64;
    let axis: f64 = random.random_range(0.0..std::f64::consts::TAU);
    let turn = Rotation3::new(Vector3::new(axis.cos(), axis.sin(), 0.0) * tilt)
        * Rotation3::new(Vector3::z() * random.random_range(-0.6..0.6));
    let centre = Vector3::new(random.random_range(-0.06..0.06), random.random_range(-0.04..0.04), 0.55);
    Transform::new(turn, centre - turn * Vector3::new(middle.x, middle.y, 0.0))
}
