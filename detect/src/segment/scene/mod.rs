//! Scenes for tests: small, deliberately unlike each other, rendered by brute force.
//!
//! The ball is a shaded sphere, ray-traced through the whole camera model at many sub-pixels and instants of
//! the exposure; it shares no formula with what is tested.

use nalgebra::{Vector2, Vector3};
use netcord_common::{
    Channel, FrameView, PixelFormat,
    camera::CameraModel,
    geometry::{Camera, Point},
    rig::{BallColour, Rig},
    wire::{Detections, FrameHeader, Scope, SearchWindow},
};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

use super::{SegmentOptions, Segmenter};

/// How a scene looks.
#[derive(Debug, Clone)]
pub struct Style {
    pub format: PixelFormat,
    /// Reflectance of the ball.
    pub ball: [f32; 3],
    /// Light that falls from above, by colour, and from all around; DN for a white surface.
    pub lamp: [f32; 3],
    pub ambient: [f32; 3],
    /// A second lamp, low at one side, that shines on the ball only; DN for a white surface.
    pub side: f32,
    /// DN² and DN per DN.
    pub read_noise2: f32,
    pub shot_noise: f32,
    /// Amplitude of the flicker, as a share, and cycles per frame.
    pub flicker: (f32, f32),
    pub backdrop: Backdrop,
}

/// What is behind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backdrop {
    /// One grey.
    Plain,
    /// Squares of random colours.
    Patches,
    /// Fine stripes and a gradient.
    Stripes,
    /// Smooth noise.
    Clouds,
}

impl Style {
    /// Even light, hardly any noise.
    pub fn clean() -> Self {
        Self {
            format: PixelFormat::BayerRG8,
            ball: [0.9, 0.45, 0.12],
            lamp: [130.0; 3],
            ambient: [60.0; 3],
            side: 0.0,
            read_noise2: 0.3,
            shot_noise: 0.0,
            flicker: (0.0, 0.0),
            backdrop: Backdrop::Plain,
        }
    }

    /// Hard light from above, noise, flicker, a busy hall.
    pub fn hall() -> Self {
        Self {
            lamp: [150.0, 160.0, 120.0],
            ambient: [25.0, 27.0, 24.0],
            read_noise2: 2.0,
            shot_noise: 0.05,
            flicker: (0.04, 0.21),
            backdrop: Backdrop::Patches,
            ..Self::clean()
        }
    }

    /// A dim cellar with yellow light and a white ball.
    pub fn cellar() -> Self {
        Self {
            format: PixelFormat::BayerGB8,
            ball: [0.9, 0.9, 0.88],
            lamp: [70.0, 55.0, 30.0],
            ambient: [14.0, 11.0, 7.0],
            side: 0.0,
            read_noise2: 3.0,
            shot_noise: 0.08,
            flicker: (0.0, 0.0),
            backdrop: Backdrop::Clouds,
        }
    }
}

/// A thing in front of the backdrop, or of the ball.
#[derive(Debug, Clone, Copy)]
pub struct Cover {
    /// x0, y0, x1, y1 in px.
    pub area: [f32; 4],
    pub reflectance: [f32; 3],
    pub in_front: bool,
}

/// A renderer with its backdrop.
pub struct Stage {
    pub rig: Rig,
    pub camera: CameraModel,
    pub style: Style,
    size: (usize, usize),
    backdrop: Vec<[f32; 3]>,
    rng: Pcg64Mcg,
    frame: u64,
}

/// Where the ball is, in the camera's frame, m, and how far it moves in the exposure.
#[derive(Debug, Clone, Copy)]
pub struct Flight {
    pub centre: Vector3<f64>,
    pub path: Vector3<f64>,
}

pub const RADIUS_M: f64 = 0.02;
const SUB: usize = 4;

impl Stage {
    /// The example rig's first camera, or a part of it `size` large around the middle.
    pub fn new(style: Style, seed: u64) -> Self {
        Self::sized(style, seed, (640, 400))
    }

    pub fn sized(style: Style, seed: u64, size: (usize, usize)) -> Self {
        Self::with_lens(style, seed, size, 1.0)
    }

    /// As [`Self::sized`], with a lens so many times as long.
    pub fn with_lens(style: Style, seed: u64, size: (usize, usize), times: f64) -> Self {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../common/rigs/example-2cam.toml");
        let mut rig = Rig::load(path.as_ref()).expect("the example rig is valid");
        let p = rig.cameras[0].model.parameters();
        let shift = [(1920 - size.0) as f64 / 2.0, (1200 - size.1) as f64 / 2.0];
        let lens = netcord_common::camera::Distortion::from_array([p[4], p[5], p[6], p[7], p[8]]);
        let camera = CameraModel::new(
            (size.0 as u32, size.1 as u32),
            (times * p[0], times * p[1]),
            (p[2] - shift[0], p[3] - shift[1]),
            lens,
        )
        .expect("valid");
        rig.cameras[0].model = camera;
        rig.cameras[0].pixel_format = style.format;
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let backdrop = backdrop(style.backdrop, size, &mut rng);
        Self { rig, camera, style, size, backdrop, rng, frame: 0 }
    }

    pub fn segmenter(&self, colour: BallColour) -> Segmenter {
        let options = SegmentOptions { colour: Some(colour), ..SegmentOptions::default() };
        Segmenter::new(&self.rig, 0, options).expect("valid")
    }

    /// The flight whose image is at `pixel`, with a diameter of about `diameter` px and a path of `path` px.
    pub fn flight(&self, pixel: [f64; 2], diameter: f64, path: [f64; 2]) -> Flight {
        let at = |u: f64, v: f64| {
            let n = self.camera.undistort(&Vector2::new(u, v)).expect("in view");
            Vector3::new(n.x, n.y, 1.0)
        };
        let depth = 2.0 * RADIUS_M * self.camera.fx / diameter;
        let ahead = at(pixel[0] + 0.5 * path[0], pixel[1] + 0.5 * path[1]) * depth;
        let behind = at(pixel[0] - 0.5 * path[0], pixel[1] - 0.5 * path[1]) * depth;
        Flight { centre: 0.5 * (ahead + behind), path: ahead - behind }
    }

    /// The image of a flight's middle.
    pub fn image(&self, flight: &Flight) -> [f64; 2] {
        let p = self.camera.project(&Point::<Camera>::from(flight.centre)).expect("in view");
        [p.x, p.y]
    }

    /// One frame; `light` scales all light.
    pub fn render(&mut self, flights: &[(Flight, [f32; 3])], covers: &[Cover], light: f32) -> Vec<u8> {
        let (width, height) = self.size;
        let flicker = 1.0
            + self.style.flicker.0 * (std::f32::consts::TAU * self.style.flicker.1 * self.frame as f32).sin();
        self.frame += 1;
        let lit: [f32; 3] =
            std::array::from_fn(|c| (0.5 * self.style.lamp[c] + self.style.ambient[c]) * light * flicker);
        let mut image = self.backdrop.clone();
        for pixel in &mut image {
            for (c, value) in pixel.iter_mut().enumerate() {
                *value *= lit[c];
            }
        }
        let paint = |image: &mut Vec<[f32; 3]>, cover: &Cover| {
            for y in 0..height {
                for x in 0..width {
                    let share = |low: f32, high: f32, at: usize| {
                        let at = at as f32;
                        ((high.min(at + 0.5)) - (low.max(at - 0.5))).clamp(0.0, 1.0)
                    };
                    let [x0, y0, x1, y1] = cover.area;
                    let alpha = share(x0, x1, x) * share(y0, y1, y);
                    let pixel = &mut image[y * width + x];
                    for c in 0..3 {
                        pixel[c] += alpha * (cover.reflectance[c] * lit[c] - pixel[c]);
                    }
                }
            }
        };
        for cover in covers.iter().filter(|c| !c.in_front) {
            paint(&mut image, cover);
        }
        for (flight, reflectance) in flights {
            self.draw(&mut image, flight, reflectance, light * flicker);
        }
        for cover in covers.iter().filter(|c| c.in_front) {
            paint(&mut image, cover);
        }
        let mut out = vec![0; width * height];
        for y in 0..height {
            for x in 0..width {
                let [r, g, b] = image[y * width + x];
                let level = match self.style.format.channel_at(x, y) {
                    Channel::Red => r,
                    Channel::Green => g,
                    Channel::Blue => b,
                    Channel::Luma => 0.3 * r + 0.59 * g + 0.11 * b,
                };
                let sigma = (self.style.read_noise2 + self.style.shot_noise * level).sqrt();
                let normal: f32 = StandardNormal.sample(&mut self.rng);
                out[y * width + x] = (level + sigma * normal).round().clamp(0.0, 255.0) as u8;
            }
        }
        out
    }

    fn draw(&self, image: &mut [[f32; 3]], flight: &Flight, reflectance: &[f32; 3], light: f32) {
        let (width, height) = self.size;
        let ends = [-0.5, 0.5].map(|t| {
            self.camera.project(&Point::<Camera>::from(flight.centre + flight.path * t)).expect("in view")
        });
        let length = (ends[1] - ends[0]).norm();
        let reach = 1.15 * RADIUS_M * self.camera.fx / flight.centre.z
            * (1.0 + (flight.centre.xy().norm() / flight.centre.z).powi(2))
            + 3.0;
        let times = ((length * 2.0).ceil() as usize).clamp(1, 400);
        let low = ends[0].inf(&ends[1]).map(|v| (v - reach).floor().max(0.0) as usize);
        let x_end = ((ends[0].x.max(ends[1].x) + reach).ceil().max(0.0) as usize).min(width);
        let y_end = ((ends[0].y.max(ends[1].y) + reach).ceil().max(0.0) as usize).min(height);
        // The lamp hangs not quite over the table.
        let up =
            self.rig.cameras[0].camera_from_world.rotation * Vector3::new(0.25, -0.3, 1.0_f64).normalize();
        let aside =
            self.rig.cameras[0].camera_from_world.rotation * Vector3::new(-0.9, -0.3, 0.3_f64).normalize();
        for y in low.y..y_end {
            for x in low.x..x_end {
                let here = Vector2::new(x as f64, y as f64);
                let along = ends[1] - ends[0];
                let t = ((here - ends[0]).dot(&along) / along.norm_squared().max(1e-9)).clamp(0.0, 1.0);
                if (here - ends[0] - along * t).norm() > reach {
                    continue;
                }
                let (mut covered, mut sum) = (0.0_f32, [0.0_f32; 3]);
                for i in 0..SUB * SUB {
                    let offset = |k: usize| (k as f64 + 0.5) / SUB as f64 - 0.5;
                    let pixel = Vector2::new(x as f64 + offset(i % SUB), y as f64 + offset(i / SUB));
                    let Some(ray) = self.camera.ray(&pixel) else { continue };
                    // Instants spread differently in every sub-pixel: together they are dense.
                    let n = times.div_ceil(4);
                    for t in 0..n {
                        let phase = ((i * 7 % 16) as f64 + 0.5) / 16.0;
                        let t = (t as f64 + phase) / n as f64 - 0.5;
                        let centre = flight.centre + flight.path * t;
                        let along = ray.dot(&centre);
                        let miss2 = centre.norm_squared() - along * along;
                        if miss2 >= RADIUS_M * RADIUS_M {
                            continue;
                        }
                        let hit = ray * (along - (RADIUS_M * RADIUS_M - miss2).sqrt());
                        let normal = (hit - centre) / RADIUS_M;
                        let direct = normal.dot(&up).max(0.0) as f32;
                        let side = self.style.side * normal.dot(&aside).max(0.0) as f32;
                        let weight = 1.0 / (SUB * SUB * n) as f32;
                        covered += weight;
                        for c in 0..3 {
                            sum[c] += weight
                                * light
                                * reflectance[c]
                                * (self.style.lamp[c] * direct + side + self.style.ambient[c]);
                        }
                    }
                }
                let pixel = &mut image[y * width + x];
                for c in 0..3 {
                    pixel[c] = pixel[c] * (1.0 - covered) + sum[c];
                }
            }
        }
    }

    pub fn header(&self, n: u64) -> FrameHeader {
        FrameHeader {
            trigger_id: n,
            sequence: n,
            session: 1,
            // So long that the longest blur of the tests is that of a ball in play.
            exposure_ns: 10_000_000,
            width: self.size.0 as u32,
            height: self.size.1 as u32,
            stride: self.size.0 as u32,
            pixel_format: self.style.format.pfnc(),
            ..FrameHeader::default()
        }
    }

    pub fn view<'a>(&self, bytes: &'a [u8]) -> FrameView<'a> {
        FrameView::new(bytes, self.size, self.size.0, self.style.format).expect("fits")
    }

    /// Runs a segmenter over a frame; gives the full message.
    pub fn search(
        &self,
        segmenter: &mut Segmenter,
        bytes: &[u8],
        window: Option<&SearchWindow>,
    ) -> Detections {
        let mut full = Detections::default();
        segmenter
            .process(&self.header(self.frame), &self.view(bytes), window, &mut |m| {
                if m.scope == Scope::Full.code() {
                    full = *m;
                }
            })
            .expect("the frame fits");
        full
    }

    /// A segmenter that has seen `n` frames without a ball.
    pub fn warmed(&mut self, colour: BallColour, n: usize) -> Segmenter {
        let mut segmenter = self.segmenter(colour);
        for _ in 0..n {
            let frame = self.render(&[], &[], 1.0);
            self.search(&mut segmenter, &frame, None);
        }
        segmenter
    }
}

fn backdrop(kind: Backdrop, (width, height): (usize, usize), rng: &mut Pcg64Mcg) -> Vec<[f32; 3]> {
    let tile = 24;
    let columns = width.div_ceil(tile) + 2;
    let tiles = (0..columns * (height.div_ceil(tile) + 2))
        .map(|_| std::array::from_fn(|_| rng.random_range(0.08..0.75)))
        .collect::<Vec<[f32; 3]>>();
    (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            match kind {
                Backdrop::Plain => [0.35; 3],
                Backdrop::Patches => tiles[y / tile * columns + x / tile],
                Backdrop::Stripes => {
                    let stripe = if (x / 7 + y / 11) % 2 == 0 { 0.25 } else { 0.4 };
                    let ramp = 0.5 + 0.5 * x as f32 / width as f32;
                    [stripe * ramp, stripe * 0.9 * ramp, stripe * 0.5]
                }
                Backdrop::Clouds => {
                    let at = |dx: usize, dy: usize| tiles[(y / tile + dy) * columns + x / tile + dx];
                    let (fx, fy) = ((x % tile) as f32 / tile as f32, (y % tile) as f32 / tile as f32);
                    std::array::from_fn(|c| {
                        0.5 * ((at(0, 0)[c] * (1.0 - fx) + at(1, 0)[c] * fx) * (1.0 - fy)
                            + (at(0, 1)[c] * (1.0 - fx) + at(1, 1)[c] * fx) * fy)
                    })
                }
            }
        })
        .collect()
}
