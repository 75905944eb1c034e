use nalgebra::{Matrix2, Matrix2x3, SMatrix, Vector2, Vector3};
use thiserror::Error;

use crate::geometry::{Camera, Point};

/// Number of intrinsic parameters: `fx fy cx cy k1 k2 p1 p2 k3`, in this order in Jacobians and
/// covariances.
pub const INTRINSICS: usize = 9;
/// Widest and highest image: the largest sensors have half of it.
const LARGEST_PX: u32 = 32_768;

/// Lens distortion after Brown (1971) and Conrady (1919), in OpenCV's order (ROS `plumb_bob`).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Distortion {
    /// Radial, r².
    pub k1: f64,
    /// Radial, r⁴.
    pub k2: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
    /// Radial, r⁶.
    pub k3: f64,
}

impl Distortion {
    /// From `[k1, k2, p1, p2, k3]`.
    pub const fn from_array([k1, k2, p1, p2, k3]: [f64; 5]) -> Self {
        Self { k1, k2, p1, p2, k3 }
    }

    /// As `[k1, k2, p1, p2, k3]`.
    pub const fn to_array(self) -> [f64; 5] {
        [self.k1, self.k2, self.p1, self.p2, self.k3]
    }
}

/// Intrinsics of one camera, in pixels; pixel (0, 0) is the centre of the top-left pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraModel {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Focal length along x, in pixels.
    pub fx: f64,
    /// Focal length along y, in pixels.
    pub fy: f64,
    /// Principal point, x, in pixels.
    pub cx: f64,
    /// Principal point, y, in pixels.
    pub cy: f64,
    /// The lens.
    pub distortion: Distortion,
    /// Square of the largest undistorted radius at which the radial polynomial still grows.
    /// Beyond it the model folds the outside of the field of view back into the image.
    pub(super) fold_r2: f64,
}

/// Intrinsics that no camera has.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CameraModelError {
    /// A parameter is infinite or not a number.
    #[error("{0} is not a finite number")]
    NotFinite(&'static str),
    /// A focal length or the image size is not positive.
    #[error("{0} is {1}; it must be above zero")]
    NotPositive(&'static str, f64),
    /// An image that no sensor has.
    #[error("{0} is {1} px; at most {LARGEST_PX} are valid")]
    TooLarge(&'static str, u32),
}

/// A projected point with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projected {
    /// The pixel.
    pub pixel: Vector2<f64>,
    /// ∂pixel/∂point, per metre, the point in the camera's frame.
    pub by_point: Matrix2x3<f64>,
    /// ∂pixel/∂(fx fy cx cy k1 k2 p1 p2 k3).
    pub by_intrinsics: SMatrix<f64, 2, INTRINSICS>,
}

impl CameraModel {
    /// A camera of `width` × `height` pixels.
    ///
    /// # Errors
    /// [`CameraModelError`] names the parameter that cannot be.
    pub fn new(
        (width, height): (u32, u32),
        (fx, fy): (f64, f64),
        (cx, cy): (f64, f64),
        distortion: Distortion,
    ) -> Result<Self, CameraModelError> {
        let named = [("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy)];
        let lens = ["k1", "k2", "p1", "p2", "k3"].into_iter().zip(distortion.to_array());
        if let Some((name, _)) = named.into_iter().chain(lens).find(|(_, v)| !v.is_finite()) {
            return Err(CameraModelError::NotFinite(name));
        }
        let positive = [("fx", fx), ("fy", fy), ("width", f64::from(width)), ("height", f64::from(height))];
        if let Some((name, value)) = positive.into_iter().find(|(_, v)| *v <= 0.0) {
            return Err(CameraModelError::NotPositive(name, value));
        }
        if let Some((name, size)) =
            [("width", width), ("height", height)].into_iter().find(|(_, n)| *n > LARGEST_PX)
        {
            return Err(CameraModelError::TooLarge(name, size));
        }
        Ok(Self { width, height, fx, fy, cx, cy, distortion, fold_r2: fold_r2(&distortion) })
    }

    /// `[fx, fy, cx, cy, k1, k2, p1, p2, k3]`.
    pub fn parameters(&self) -> [f64; INTRINSICS] {
        let [k1, k2, p1, p2, k3] = self.distortion.to_array();
        [self.fx, self.fy, self.cx, self.cy, k1, k2, p1, p2, k3]
    }

    /// The same image size with other parameters, in the order of [`Self::parameters`].
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_parameters(&self, p: [f64; INTRINSICS]) -> Result<Self, CameraModelError> {
        let lens = Distortion::from_array([p[4], p[5], p[6], p[7], p[8]]);
        Self::new((self.width, self.height), (p[0], p[1]), (p[2], p[3]), lens)
    }

    /// The image of a point; `None` when it lies behind the camera, or so far outside the field of
    /// view that the distortion model no longer holds there.
    pub fn project(&self, point: &Point<Camera>) -> Option<Vector2<f64>> {
        self.distort(&normalise(point)?).map(|d| self.pixel_of(&d))
    }

    /// As [`Self::project`], with derivatives by the point and by the intrinsics.
    pub fn project_with_jacobians(&self, point: &Point<Camera>) -> Option<Projected> {
        let n = normalise(point)?;
        let (distorted, by_normalised) = self.distort_with_jacobian(&n)?;
        let z = point.coords.z;
        let normalised_by_point = Matrix2x3::new(1.0, 0.0, -n.x, 0.0, 1.0, -n.y) / z;
        let focal = Matrix2::from_diagonal(&Vector2::new(self.fx, self.fy));

        let r2 = n.norm_squared();
        let (xy2, r4, r6) = (2.0 * n.x * n.y, r2 * r2, r2 * r2 * r2);
        let (px, py) = (r2 + 2.0 * n.x * n.x, r2 + 2.0 * n.y * n.y);
        #[rustfmt::skip]
        let by_intrinsics = SMatrix::<f64, 2, INTRINSICS>::from_row_slice(&[
            distorted.x, 0.0, 1.0, 0.0, self.fx * n.x * r2, self.fx * n.x * r4, self.fx * xy2, self.fx * px, self.fx * n.x * r6,
            0.0, distorted.y, 0.0, 1.0, self.fy * n.y * r2, self.fy * n.y * r4, self.fy * py, self.fy * xy2, self.fy * n.y * r6,
        ]);
        Some(Projected {
            pixel: self.pixel_of(&distorted),
            by_point: focal * by_normalised * normalised_by_point,
            by_intrinsics,
        })
    }

    /// Applies the lens to undistorted normalised coordinates (x/z, y/z); `None` outside the radius
    /// within which the model holds.
    pub fn distort(&self, n: &Vector2<f64>) -> Option<Vector2<f64>> {
        let Distortion { k1, k2, p1, p2, k3 } = self.distortion;
        let r2 = n.norm_squared();
        if r2 >= self.fold_r2 {
            return None;
        }
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let xy2 = 2.0 * n.x * n.y;
        Some(Vector2::new(
            n.x * radial + p1 * xy2 + p2 * (r2 + 2.0 * n.x * n.x),
            n.y * radial + p1 * (r2 + 2.0 * n.y * n.y) + p2 * xy2,
        ))
    }

    /// As [`Self::distort`], with the 2 × 2 derivative by the undistorted coordinates.
    pub fn distort_with_jacobian(&self, n: &Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let distorted = self.distort(n)?;
        let Distortion { k1, k2, p1, p2, k3 } = self.distortion;
        let (x, y, r2) = (n.x, n.y, n.norm_squared());
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
        let off = x * y * slope + 2.0 * (p1 * x + p2 * y);
        let jacobian = Matrix2::new(
            radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            off,
            off,
            radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        Some((distorted, jacobian))
    }

    /// Distorted normalised coordinates of a pixel: K removed, the lens still in.
    pub fn distorted_of(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy)
    }

    /// The direction, of unit length in the camera's frame, from which light reaches `pixel`; `None`
    /// where the lens model has no inverse.
    pub fn ray(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        self.undistort(pixel).map(|n| Vector3::new(n.x, n.y, 1.0).normalize())
    }

    /// Whether a pixel position lies on the sensor.
    pub fn contains(&self, pixel: &Vector2<f64>) -> bool {
        (-0.5..f64::from(self.width) - 0.5).contains(&pixel.x)
            && (-0.5..f64::from(self.height) - 0.5).contains(&pixel.y)
    }

    fn pixel_of(&self, distorted: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(self.fx * distorted.x + self.cx, self.fy * distorted.y + self.cy)
    }
}

/// Nearest depth that is projected, in metres: nearer points are inside the lens.
const MIN_DEPTH_M: f64 = 1e-6;

fn normalise(point: &Point<Camera>) -> Option<Vector2<f64>> {
    let p = &point.coords;
    (p.z > MIN_DEPTH_M).then(|| Vector2::new(p.x / p.z, p.y / p.z))
}

/// Smallest r² at which d/dr [r (1 + k1 r² + k2 r⁴ + k3 r⁶)] = 1 + 3 k1 r² + 5 k2 r⁴ + 7 k3 r⁶ is
/// zero; infinite where it never is. Found by scanning: a closed form of the cubic is no shorter.
fn fold_r2(d: &Distortion) -> f64 {
    const STEPS: u32 = 4096;
    /// tan² of the widest half angle a pinhole model is ever used for (about 84°).
    const WIDEST_R2: f64 = 90.0;
    let slope = |r2: f64| 1.0 + r2 * (3.0 * d.k1 + r2 * (5.0 * d.k2 + r2 * 7.0 * d.k3));
    let mut inside = 0.0;
    for step in 1..=STEPS {
        let r2 = WIDEST_R2 * f64::from(step) / f64::from(STEPS);
        if slope(r2) <= 0.0 {
            let (mut low, mut high) = (inside, r2);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if slope(middle) > 0.0 { low = middle } else { high = middle }
            }
            return low;
        }
        inside = r2;
    }
    f64::INFINITY
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Camera 1 of the original rig: a wide lens whose radial polynomial folds far outside the image.
    pub(crate) fn wide() -> CameraModel {
        let lens = Distortion::from_array([-0.097_151, 0.067_889, -0.000_716, 0.000_305, -0.003_636]);
        CameraModel::new((1920, 1200), (672.282, 672.689), (984.047, 602.967), lens).expect("valid")
    }

    #[test]
    fn jacobians_match_central_differences() {
        let camera = wide();
        for (x, y, z) in [(0.0, 0.0, 1.0), (1.1, -0.7, 1.3), (-2.0, 1.2, 2.0), (0.3, 2.0, 5.0)] {
            let point = Point::new(x, y, z);
            let at = camera.project_with_jacobians(&point).expect("in view");
            assert_eq!(Some(at.pixel), camera.project(&point));
            let h = 1e-6;
            for axis in 0..3 {
                let step = |sign: f64| {
                    let mut moved = point;
                    moved.coords[axis] += sign * h;
                    camera.project(&moved).expect("in view")
                };
                let numeric = (step(1.0) - step(-1.0)) / (2.0 * h);
                assert!((numeric - at.by_point.column(axis)).norm() < 1e-5, "axis {axis}: {numeric}");
            }
            for parameter in 0..INTRINSICS {
                let step = |sign: f64| {
                    let mut p = camera.parameters();
                    p[parameter] += sign * h;
                    camera.with_parameters(p).expect("valid").project(&point).expect("in view")
                };
                let numeric = (step(1.0) - step(-1.0)) / (2.0 * h);
                assert!(
                    (numeric - at.by_intrinsics.column(parameter)).norm() < 1e-4,
                    "parameter {parameter}"
                );
            }
        }
    }

    #[test]
    fn points_behind_the_camera_and_beyond_the_fold_have_no_image() {
        let camera = wide();
        assert_eq!(camera.project(&Point::new(0.1, 0.1, -1.0)), None);
        assert_eq!(camera.project(&Point::new(0.1, 0.1, 0.0)), None);
        // k3 < 0: at large radii the polynomial turns back and would put this point into the image.
        assert!(camera.fold_r2.is_finite());
        assert_eq!(camera.project(&Point::new(9.0, 0.0, 1.0)), None);
    }

    #[test]
    fn impossible_intrinsics_are_named() {
        let lens = Distortion::default();
        let error =
            CameraModel::new((640, 480), (0.0, 500.0), (320.0, 240.0), lens).expect_err("no focal length");
        assert!(error.to_string().contains("fx"), "{error}");
        let error =
            CameraModel::new((640, 480), (500.0, 500.0), (f64::NAN, 240.0), lens).expect_err("no centre");
        assert!(error.to_string().contains("cx"), "{error}");
    }
}
