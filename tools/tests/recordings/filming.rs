//! Recordings of a ball in flight before a plain background, seen by the example rig with a quarter of its pixels.

use std::path::Path;

use netcord_capture::recording::{
    RawImage, RecordedTruth, RecordingWriter, Schema, WriterOptions, calibration_message, camera_topic,
    transform_message,
};
use netcord_common::{
    Channel, PixelFormat,
    camera::CameraModel,
    geometry::Point,
    rig::{Rig, RigCamera},
};

/// Time between images, and of the first, ns.
const INTERVAL_NS: u64 = 10_000_000;
const FIRST_NS: u64 = 1_700_000_000_000_000_000;
/// Images before the ball comes.
const EMPTY: u64 = 4;
/// The example rig's images are divided by this, to keep the test short.
const SHRINK: u32 = 2;

/// How a film is written, mistakes included.
#[derive(Debug, Clone)]
pub struct Shot {
    /// The mosaic.
    pub format: PixelFormat,
    /// Images that are missing: camera and number.
    pub dropped: Vec<(usize, u64)>,
    /// Whether calibrations are written.
    pub calibrated: bool,
    /// What the truth that is written is off by, m.
    pub truth_off_m: [f64; 3],
    /// What is done to the message of the right camera's third image.
    pub spoil: fn(&mut RawImage),
}

impl Default for Shot {
    fn default() -> Self {
        Self {
            format: PixelFormat::BayerRG8,
            dropped: Vec::new(),
            calibrated: true,
            truth_off_m: [0.0; 3],
            spoil: |_| {},
        }
    }
}

/// What is filmed.
pub struct Film {
    rig: Rig,
    images: u64,
}

impl Film {
    pub fn new(images: u64) -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-2cam.toml");
        let mut rig = Rig::load(&file).expect("the example is valid");
        for camera in &mut rig.cameras {
            let m = &camera.model;
            let scale = f64::from(SHRINK);
            let centre = |c: f64| (c + 0.5) / scale - 0.5;
            camera.model = CameraModel::new(
                (m.width / SHRINK, m.height / SHRINK),
                (m.fx / scale, m.fy / scale),
                (centre(m.cx), centre(m.cy)),
                m.distortion,
            )
            .expect("valid");
        }
        Self { rig, images }
    }

    /// Where the ball is at an image's stamp, m.
    pub fn ball_at(&self, t_ns: u64) -> Option<[f64; 3]> {
        let n = (t_ns - FIRST_NS) / INTERVAL_NS;
        ((t_ns - FIRST_NS).is_multiple_of(INTERVAL_NS) && (EMPTY..self.images).contains(&n)).then(|| {
            let s = n as f64 * 0.01;
            [0.1 + 0.5 * s, -0.9 + 3.5 * s, 0.35 + 1.6 * s - 4.9 * s * s]
        })
    }

    pub fn write(&self, path: &Path, shot: &Shot) {
        let mut writer = RecordingWriter::<Vec<u8>>::create(path, WriterOptions::default()).expect("created");
        let schema = |name: &str, encoding: &str| Schema {
            name: name.into(),
            encoding: String::new(),
            data: Vec::new(),
            message_encoding: encoding.into(),
        };
        let images = self.rig.cameras.iter().map(|camera| {
            writer.channel(&camera_topic(&camera.name, "image"), &schema("foxglove.RawImage", "protobuf"))
        });
        let images = images.collect::<Vec<_>>();
        let transforms = writer.channel("/tf", &schema("foxglove.FrameTransform", "protobuf"));
        let truth = writer.channel("/truth/ball", &schema("", "json"));
        for camera in &self.rig.cameras {
            let name = camera.name.as_str();
            let topic = camera_topic(&camera.name, "calibration");
            let channel = writer.channel(&topic, &schema("foxglove.CameraCalibration", "protobuf"));
            if shot.calibrated {
                let message = bytes(&calibration_message(FIRST_NS, name, &camera.model));
                writer.write(channel, FIRST_NS, &message, None).expect("written");
            }
            let message = bytes(&transform_message(FIRST_NS, "table", name, &camera.camera_from_world));
            writer.write(transforms, FIRST_NS, &message, None).expect("written");
        }
        for n in 0..self.images {
            let t_ns = FIRST_NS + n * INTERVAL_NS;
            let ball = self.ball_at(t_ns);
            if let Some(position_m) = ball {
                let position_m: [f64; 3] = std::array::from_fn(|i| position_m[i] + shot.truth_off_m[i]);
                let row = serde_json::json!({"t_ns": t_ns, "position_m": position_m});
                serde_json::from_value::<RecordedTruth>(row.clone()).expect("as the reader wants it");
                writer.write(truth, t_ns, row.to_string().as_bytes(), None).expect("written");
            }
            for (place, camera) in self.rig.cameras.iter().enumerate() {
                if shot.dropped.contains(&(place, n)) {
                    continue;
                }
                let pixels = picture(camera, shot.format, ball, n);
                let mut image = RawImage {
                    timestamp_ns: t_ns,
                    frame_id: camera.name.to_string(),
                    width: camera.model.width,
                    height: camera.model.height,
                    step: camera.model.width,
                    format: shot.format,
                    data: 0..pixels.len(),
                };
                if place == 1 && n == 3 {
                    (shot.spoil)(&mut image);
                }
                writer.write(images[place], t_ns, &image.head(), Some(pixels)).expect("written");
            }
        }
        writer.finish().expect("written");
    }
}

fn bytes<T: foxglove::Encode>(message: &T) -> Vec<u8> {
    let mut out = Vec::new();
    message.encode(&mut out).unwrap_or_else(|e| panic!("{e}"));
    out
}

/// A disc with soft edges before grey noise.
fn picture(camera: &RigCamera, format: PixelFormat, ball: Option<[f64; 3]>, n: u64) -> Vec<u8> {
    let (width, height) = (camera.model.width as usize, camera.model.height as usize);
    let disc = ball.and_then(|[x, y, z]| {
        let at = &camera.camera_from_world * Point::new(x, y, z);
        Some((camera.model.project(&at)?, camera.model.fx * 0.02 / at.coords.norm()))
    });
    let mut state = n.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut pixels = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            // Xorshift (Marsaglia 2003): noise enough, and the same everywhere.
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            let background = 48.0 + (state % 5) as f64;
            let colour = match format.channel_at(x, y) {
                Channel::Red => 230.0,
                Channel::Green => 120.0,
                Channel::Blue => 30.0,
                Channel::Luma => 220.0,
            };
            let covered = disc.map_or(0.0, |(centre, radius)| {
                let off = (x as f64 - centre.x).hypot(y as f64 - centre.y);
                (radius + 0.5 - off).clamp(0.0, 1.0)
            });
            pixels.push((background + (colour - background) * covered) as u8);
        }
    }
    pixels
}
