//! Rigs and projections for tests: written without the camera model that is under test.

use std::path::Path;

use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};
use netcord_common::{
    camera::{CameraModel, Distortion},
    geometry::Transform,
    rig::Rig,
    wire::{Detection, DetectionFlags, Detections, Scope},
};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::{Observation, PosedCamera};

/// A camera as plain numbers.
#[derive(Debug, Clone)]
pub(crate) struct Plain {
    pub k: [f64; 4],
    pub d: [f64; 5],
    pub r: Matrix3<f64>,
    pub t: Vector3<f64>,
}

impl Plain {
    /// At `centre`, looking at `target`, x level.
    pub fn looking(centre: [f64; 3], target: [f64; 3]) -> Self {
        let (centre, target) = (Vector3::from(centre), Vector3::from(target));
        let z = (target - centre).normalize();
        let x = z.cross(&Vector3::z()).normalize();
        let y = z.cross(&x);
        let r = Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]);
        Self {
            k: [672.28, 672.69, 984.05, 602.97],
            d: [-0.097_151, 0.067_889, -0.000_716, 0.000_305, -0.003_636],
            r,
            t: -(r * centre),
        }
    }

    /// The projection, from the formulas of the design's section 3.
    pub fn pixel(&self, point: &Vector3<f64>) -> Vector2<f64> {
        let p = self.r * point + self.t;
        assert!(p.z > 0.0, "in front");
        let (x, y) = (p.x / p.z, p.y / p.z);
        let [k1, k2, p1, p2, k3] = self.d;
        let r2 = x * x + y * y;
        let radial = 1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3);
        let xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        Vector2::new(self.k[0] * xd + self.k[2], self.k[1] * yd + self.k[3])
    }

    pub fn posed(&self) -> PosedCamera {
        let model = CameraModel::new(
            (1920, 1200),
            (self.k[0], self.k[1]),
            (self.k[2], self.k[3]),
            Distortion::from_array(self.d),
        )
        .expect("valid");
        let rotation = Rotation3::from_matrix_unchecked(self.r);
        PosedCamera::new(model, &Transform::new(rotation, self.t))
    }
}

/// `n` cameras around the table, all looking at its middle from 2 to 3 m.
pub(crate) fn ring(n: usize) -> (Vec<Plain>, Vec<PosedCamera>) {
    let plain: Vec<_> = (0..n)
        .map(|i| {
            let angle = std::f64::consts::TAU * (i as f64 + 0.3) / n as f64;
            let height = 1.3 + 0.4 * ((i * 7) % 5) as f64 / 5.0;
            Plain::looking([1.9 * angle.cos(), 2.6 * angle.sin(), height], [0.0, 0.0, 0.2])
        })
        .collect();
    let posed = plain.iter().map(Plain::posed).collect();
    (plain, posed)
}

/// Exact observations of a point, each with the covariance σ² I.
pub(crate) fn observe_all(
    plain: &[Plain],
    posed: &[PosedCamera],
    point: &Vector3<f64>,
    sigma_px: f64,
) -> Vec<Observation> {
    let covariance = Matrix2::identity() * (sigma_px * sigma_px);
    plain
        .iter()
        .zip(posed)
        .enumerate()
        .map(|(i, (p, c))| c.observe(i, p.pixel(point), covariance).expect("in view"))
        .collect()
}

/// An example rig of the repository, and its cameras as plain numbers.
pub(crate) fn example(cameras: usize) -> (Rig, Vec<Plain>) {
    let file = format!("../common/rigs/example-{cameras}cam.toml");
    let rig = Rig::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).expect("an example rig");
    let plain = rig
        .cameras
        .iter()
        .map(|c| Plain {
            k: [c.model.fx, c.model.fy, c.model.cx, c.model.cy],
            d: c.model.distortion.to_array(),
            r: *c.camera_from_world.rotation.matrix(),
            t: c.camera_from_world.translation,
        })
        .collect();
    (rig, plain)
}

/// A detection of the ball as a good segmenter would give it: centre with noise of `sigma_px`, stated
/// honestly.
pub(crate) fn detection(plain: &Plain, ball: &Vector3<f64>, sigma_px: f64, random: &mut Pcg64) -> Detection {
    let pixel = plain.pixel(ball) + normal2(random) * sigma_px;
    let variance = (sigma_px * sigma_px).max(1e-6);
    Detection {
        u_px: pixel.x,
        v_px: pixel.y,
        covariance_px2: [variance, 0.0, variance],
        diameter_px: diameter_px(plain, ball),
        score: 0.95,
        flags: DetectionFlags::SPHERE_CORRECTED,
        ..Detection::default()
    }
}

/// Diameter of the circle with the area of the ball's image, from the images of two of its diameters that cross
/// the line of sight.
fn diameter_px(plain: &Plain, ball: &Vector3<f64>) -> f64 {
    let sight = plain.r * ball + plain.t;
    let across = sight.cross(&Vector3::x()).normalize();
    let step = |direction: Vector3<f64>| {
        let half = plain.r.transpose() * direction * 0.020;
        plain.pixel(&(ball + half)) - plain.pixel(&(ball - half))
    };
    let (a, b) = (step(across), step(across.cross(&sight).normalize()));
    a.perp(&b).abs().sqrt()
}

/// Two independent standard normal numbers.
pub(crate) fn normal2(random: &mut Pcg64) -> Vector2<f64> {
    let mut normal = || -> f64 { StandardNormal.sample(random) };
    Vector2::new(normal(), normal())
}

/// A camera's message of trigger `trigger_id`, 10 ms after the one before.
pub(crate) fn message(camera: usize, trigger_id: u64, scope: Scope, items: &[Detection]) -> Detections {
    let mut message = Detections {
        trigger_id,
        sequence: trigger_id,
        camera: u32::try_from(camera).expect("few"),
        scope: scope.code(),
        ..Detections::default()
    };
    message.stamps.mid_exposure_ns = trigger_id * 10_000_000;
    items.iter().for_each(|d| message.insert(*d));
    message
}

/// A stroke over the table: position at `t` seconds.
pub(crate) fn stroke(t: f64) -> Vector3<f64> {
    Vector3::new(0.3 - 0.8 * t, -1.2 + 5.0 * t, 0.25 + 2.2 * t - 0.5 * 9.81 * t * t)
}
