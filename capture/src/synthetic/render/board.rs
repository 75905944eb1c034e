use nalgebra::{Matrix3, Vector2, Vector3};
use netcord_common::{
    board::CalibrationBoard,
    camera::CameraModel,
    geometry::{Board, Camera, Point, Transform, World},
};

use super::{Canvas, Exposure, Rect, View, hash};
use crate::synthetic::scene::{CarriedBoard, Light, Scene};

/// Samples of a pixel along each direction, where the board's pattern changes inside it.
const SAMPLES: usize = 8;
/// Instants of the exposure that the samples are spread over.
const INSTANTS: usize = 8;
/// Reflectance of the sheet's white and black, and of its back.
const WHITE: f32 = 0.82;
const BLACK: f32 = 0.05;
const BACK: f32 = 0.42;
/// A board that moves less than this in an exposure, px, stands still.
const STILL_PX: f64 = 0.01;

/// A board as one camera sees it in one exposure.
pub struct BoardImage<'a> {
    carried: &'a CarriedBoard,
    back: Option<CalibrationBoard>,
    /// From a ray (x, y, 1) to the board's plane, u/w, v/w, with w the inverse depth; at each instant.
    plane_from_ray: Vec<Matrix3<f64>>,
    /// Levels of white, black and the back in each channel, full light, DN.
    levels: [[f32; 4]; 3],
    front: bool,
    /// Offsets of samples from the pixel's middle, px: quantiles of pixel and lens blur together.
    quantiles: [f64; 256],
    /// Pixels that it may touch.
    pub rect: Rect,
}

/// What a board gives to a pixel.
#[derive(Debug, Clone, Copy)]
pub struct BoardShare {
    /// Share of the pixel that it covers, 0–1.
    pub coverage: f32,
    /// Light of that share in full light, DN.
    pub light: f32,
    /// Depth, m.
    pub depth_m: f64,
}

/// The ray of a pixel, and how it changes to the next pixel along x and y.
#[derive(Debug, Clone, Copy)]
pub struct RayField {
    /// Undistorted normalised coordinates.
    pub at: Vector2<f64>,
    /// Their change over a pixel in x.
    pub by_x: Vector2<f64>,
    /// Their change over a pixel in y.
    pub by_y: Vector2<f64>,
}

impl<'a> BoardImage<'a> {
    /// The board in the exposure of `length_s` about `mid_s`; `None` when it is out of sight.
    pub fn new(
        scene: &'a Scene,
        carried: &'a CarriedBoard,
        model: &CameraModel,
        camera_from_world: &Transform<Camera, World>,
        (mid_s, length_s): (f64, f64),
    ) -> Option<Self> {
        let pose = |share: f64| camera_from_world * &carried.at(mid_s + (share - 0.5) * length_s);
        let ends = [pose(0.0), pose(0.5), pose(1.0)];
        let outlines: Vec<Vec<Vector2<f64>>> =
            ends.iter().map(|p| outline(carried, model, p)).collect::<Option<_>>()?;
        let mut low = Vector2::repeat(f64::INFINITY);
        let mut high = -low;
        for p in outlines.iter().flatten() {
            (low, high) = (low.inf(p), high.sup(p));
        }
        let blur = scene.blur_px;
        let rim = 2.0 + 4.0 * blur;
        let rect = Rect::around(
            ((low.x + high.x) / 2.0, (low.y + high.y) / 2.0),
            ((high.x - low.x) / 2.0 + rim, (high.y - low.y) / 2.0 + rim),
        );
        let moved = outlines[0].iter().zip(&outlines[2]).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        let instants = if moved < STILL_PX { 1 } else { INSTANTS };
        let plane_from_ray = (0..instants)
            .map(|k| plane_from_ray(&pose((k as f64 + 0.5) / instants as f64)))
            .collect::<Option<Vec<_>>>()?;
        let middle = &ends[1];
        let (extent_low, extent_high) = carried.board.extent();
        let centre = (extent_low + extent_high) / 2.0;
        let to_board = middle * Point::<Board>::new(centre.x, centre.y, 0.0);
        let normal = middle.rotation * Vector3::z();
        let front = normal.dot(&to_board.coords) > 0.0;
        let facing = if front { -normal } else { normal };
        let facing = camera_from_world.rotation.inverse_transform_vector(&facing);
        let light: &Light = scene.room.light();
        let irradiance = light.on(&facing) as f32;
        let levels = [WHITE, BLACK, BACK].map(|reflectance| {
            std::array::from_fn(|channel| scene.level(&[reflectance * irradiance; 3], channel))
        });
        Some(Self {
            back: carried.board.back(),
            carried,
            plane_from_ray,
            levels,
            front,
            quantiles: quantiles(blur),
            rect,
        })
    }

    /// What the board gives to pixel (x, y) with this ray behind the filter `channel`.
    pub fn pixel(&self, x: usize, y: usize, ray: &RayField, channel: usize) -> Option<BoardShare> {
        let reach = self.quantiles[255].abs();
        let first = self.plane_from_ray.first()?;
        let last = self.plane_from_ray.last()?;
        let depth_m = 1.0 / (first * Vector3::new(ray.at.x, ray.at.y, 1.0)).z;
        // Alike at nine places and both ends of the exposure: alike everywhere between.
        let mut alike: Option<Option<usize>> = None;
        let mut same = true;
        'all: for plane in [first, last] {
            for (dx, dy) in (-1..=1).flat_map(|j| (-1..=1).map(move |i| (f64::from(i), f64::from(j)))) {
                let kind = self.kind(plane, ray, dx * reach, dy * reach);
                if *alike.get_or_insert(kind) != kind {
                    same = false;
                    break 'all;
                }
            }
        }
        if same {
            let kind = alike??;
            return Some(BoardShare { coverage: 1.0, light: self.levels[kind][channel], depth_m });
        }
        let (mut covered, mut light) = (0_u32, 0.0);
        let mut random = hash((y as u64) << 32 | x as u64);
        for j in 0..SAMPLES {
            for i in 0..SAMPLES {
                random = random.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
                let share = |bits: u64| (bits & 0xffff) as f64 / 65_536.0;
                let offset = |k: usize, r: f64| {
                    let place = (k as f64 + r) / SAMPLES as f64 * 256.0 - 0.5;
                    let low = (place.max(0.0) as usize).min(254);
                    let part = place - low as f64;
                    self.quantiles[low] + part * (self.quantiles[low + 1] - self.quantiles[low])
                };
                let instant = (i + 3 * j) % self.plane_from_ray.len();
                let (dx, dy) = (offset(i, share(random >> 20)), offset(j, share(random >> 40)));
                if let Some(kind) = self.kind(&self.plane_from_ray[instant], ray, dx, dy) {
                    covered += 1;
                    light += self.levels[kind][channel];
                }
            }
        }
        (covered > 0).then(|| BoardShare {
            coverage: covered as f32 / (SAMPLES * SAMPLES) as f32,
            light: light / covered as f32,
            depth_m,
        })
    }

    /// Which of the levels lies `dx`, `dy` px from a pixel's middle; `None` beside the board.
    fn kind(&self, plane: &Matrix3<f64>, ray: &RayField, dx: f64, dy: f64) -> Option<usize> {
        let n = ray.at + ray.by_x * dx + ray.by_y * dy;
        let hit = plane * Vector3::new(n.x, n.y, 1.0);
        // Where the lens has no inverse no light comes from anywhere.
        if hit.z.is_nan() || hit.z <= 0.0 {
            return None;
        }
        let at = hit.xy() / hit.z;
        if self.front {
            return self.carried.board.is_white(&at, self.carried.margin_m).map(|white| usize::from(!white));
        }
        let (low, high) = self.carried.board.extent();
        let margin = self.carried.margin_m;
        let inside = at.x > low.x - margin
            && at.y > low.y - margin
            && at.x < high.x + margin
            && at.y < high.y + margin;
        match &self.back {
            Some(back) => {
                let mirrored = Vector2::new(low.x + high.x - at.x, at.y);
                back.is_white(&mirrored, margin).map(|white| usize::from(!white))
            }
            None => inside.then_some(2),
        }
    }
}

/// Paints a board onto the canvas, over what is there.
pub fn paint_board(
    (scene, carried): (&Scene, &CarriedBoard),
    view: &mut View,
    exposure: &Exposure,
    canvas: &mut Canvas,
    gain: f32,
) {
    let times = (exposure.mid_s, exposure.length_s);
    let Some(image) = BoardImage::new(scene, carried, &view.model, &view.camera_from_world, times) else {
        return;
    };
    canvas.open(&image.rect, &view.backdrop.means, gain);
    let Rect { x0, y0, x1, y1 } = image.rect;
    view.rays.make_known(&Rect { x0: x0 - 1, y0: y0 - 1, x1: x1 + 1, y1: y1 + 1 });
    let (columns, rows) = image.rect.within(view.grid.width, view.grid.height);
    for y in rows {
        for x in columns.clone() {
            let channel = view.channel(x, y);
            let Some(share) = image.pixel(x, y, &view.rays.field(x, y), channel) else { continue };
            if !view.backdrop.hides(x, y, share.depth_m) {
                let mean = canvas.mean_mut(x, y);
                *mean = *mean * (1.0 - share.coverage) + share.light * share.coverage * gain;
            }
        }
    }
}

/// The inverse of [r₁ r₂ t]: a board's point (u, v) is seen along r₁ u + r₂ v + t.
fn plane_from_ray(pose: &Transform<Camera, Board>) -> Option<Matrix3<f64>> {
    let r = pose.rotation.matrix();
    Matrix3::from_columns(&[r.column(0).into(), r.column(1).into(), pose.translation]).try_inverse()
}

/// Images of points along the sheet's rim: of those that have one; `None` where none has.
fn outline(
    carried: &CarriedBoard,
    model: &CameraModel,
    pose: &Transform<Camera, Board>,
) -> Option<Vec<Vector2<f64>>> {
    const PER_SIDE: usize = 12;
    let (low, high) = carried.board.extent();
    let (low, high) = (low - Vector2::repeat(carried.margin_m), high + Vector2::repeat(carried.margin_m));
    let corners = [low, Vector2::new(high.x, low.y), high, Vector2::new(low.x, high.y)];
    let mut all = Vec::with_capacity(4 * PER_SIDE);
    let mut beyond = false;
    for side in 0..4 {
        for k in 0..PER_SIDE {
            let at = corners[side].lerp(&corners[(side + 1) % 4], k as f64 / PER_SIDE as f64);
            match model.project(&(pose * Point::new(at.x, at.y, 0.0))) {
                Some(pixel) => all.push(pixel),
                None => beyond = true,
            }
        }
    }
    if all.is_empty() {
        return None;
    }
    if beyond {
        // A part lies beyond what the lens can show: the image's own corners bound the rest.
        all.push(Vector2::zeros());
        all.push(Vector2::new(f64::from(model.width), f64::from(model.height)));
        all.resize(4 * PER_SIDE + 2, Vector2::zeros());
    }
    Some(all)
}

/// Quantiles, at (k + ½)/256, of the sum of a pixel's width (even over −½ … ½) and a Gaussian of σ px.
fn quantiles(sigma: f64) -> [f64; 256] {
    const STEPS: usize = 2000;
    let reach = 0.5 + 4.5 * sigma;
    let at = |k: usize| reach * (2.0 * (k as f64 + 0.5) / STEPS as f64 - 1.0);
    // Density of the sum: the Gaussian's distribution function between the pixel's ends, by its midpoints.
    let density: Vec<f64> = (0..STEPS)
        .map(|k| {
            (0..32)
                .map(|i| {
                    let inside = (f64::from(i) + 0.5) / 32.0 - 0.5;
                    (-0.5 * ((at(k) - inside) / sigma.max(1e-3)).powi(2)).exp()
                })
                .sum()
        })
        .collect();
    let total: f64 = density.iter().sum();
    let mut found = [0.0; 256];
    let (mut sum, mut k) = (0.0, 0);
    for (i, quantile) in found.iter_mut().enumerate() {
        let wanted = (i as f64 + 0.5) / 256.0 * total;
        while k + 1 < STEPS && sum + density[k] < wanted {
            sum += density[k];
            k += 1;
        }
        let part = ((wanted - sum) / density[k].max(1e-300)).clamp(0.0, 1.0);
        *quantile = at(k) + (part - 0.5) * 2.0 * reach / STEPS as f64;
    }
    found
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::synthetic::{
        render::{Exposure, FrameRenderer},
        scene::{Preset, SceneOptions},
        test_rig,
    };

    #[test]
    fn quantiles_are_those_of_a_blurred_pixel() {
        for sigma in [0.4, 0.75] {
            let q = quantiles(sigma);
            assert!((q[127] + q[128]).abs() < 1e-3);
            let variance = q.iter().map(|v| v * v).sum::<f64>() / 256.0;
            assert!((variance - (1.0 / 12.0 + sigma * sigma)).abs() < 0.01, "{sigma}: {variance}");
        }
    }

    /// The image of a corner is a saddle: along its two diagonals white on one side and black on the other,
    /// which a parabola through the levels around it shows to be centred on the truth.
    #[test]
    fn a_chessboards_corners_are_painted_where_the_camera_model_puts_them() {
        let mut rig = test_rig();
        rig.cameras[0].pixel_format = netcord_common::PixelFormat::Mono8;
        let options = SceneOptions {
            preset: Preset::Clean,
            seed: 1,
            board: Some("chessboard:5x4:60mm".to_owned()),
            ..SceneOptions::default()
        };
        let scene = Arc::new(Scene::new(&rig, &options).expect("valid"));
        let carried = scene.board.as_ref().expect("carried");
        let camera = &rig.cameras[0];
        let mut renderer = FrameRenderer::new(&scene, camera);
        let (width, height) = renderer.size();
        let mut frame = vec![0; width * height];
        let (mut checked, mut worst) = (0, 0.0_f64);
        for stop in 0..15 {
            let mid_s = 0.4 + 1.5 * f64::from(stop);
            renderer.render(&Exposure { frame: 1, mid_s, length_s: 0.001 }, &mut frame);
            let camera_from_board = &camera.camera_from_world * &carried.at(mid_s);
            if (camera_from_board.rotation * Vector3::z()).dot(&camera_from_board.translation) < 0.0 {
                continue; // Its back.
            }
            for corner in carried.board.corners() {
                let Some(truth) = camera.model.project(&(&camera_from_board * Point::from(corner))) else {
                    continue;
                };
                if truth.x < 8.0 || truth.y < 8.0 || truth.x > 632.0 || truth.y > 392.0 {
                    continue;
                }
                // Weighted least squares of a + bx + cy + dx² + exy + fy² over 7 × 7 pixels.
                let (cx, cy) = (truth.x.round() as i64, truth.y.round() as i64);
                let mut normal = nalgebra::Matrix6::<f64>::zeros();
                let mut rhs = nalgebra::Vector6::<f64>::zeros();
                for (i, j) in (-3..=3_i64).flat_map(|j| (-3..=3_i64).map(move |i| (i, j))) {
                    let v = f64::from(frame[(cy + j) as usize * width + (cx + i) as usize]);
                    let (x, y) = ((cx + i) as f64 - truth.x, (cy + j) as f64 - truth.y);
                    let weight = (-(x * x + y * y) / 8.0).exp();
                    let row = nalgebra::Vector6::new(1.0, x, y, x * x, x * y, y * y);
                    normal += row * row.transpose() * weight;
                    rhs += row * v * weight;
                }
                let p = normal.try_inverse().expect("regular") * rhs;
                let hessian = nalgebra::Matrix2::new(2.0 * p[3], p[4], p[4], 2.0 * p[5]);
                assert!(hessian.determinant() < 0.0, "a saddle at {truth}");
                let off = -(hessian.try_inverse().expect("regular") * Vector2::new(p[1], p[2]));
                worst = worst.max(off.norm());
                checked += 1;
            }
        }
        assert!(checked >= 150, "{checked} corners");
        assert!(worst < 0.35, "a corner is off by {worst} px");
    }
}
