use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};
use netcord_common::{
    camera::CameraModel,
    geometry::{Camera, Point, Transform, World},
};

/// A camera model with its pose: what triangulation needs of one camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosedCamera {
    /// Intrinsics and lens.
    pub model: CameraModel,
    /// R of camera-from-world.
    pub(super) rotation: Matrix3<f64>,
    /// t of camera-from-world, m.
    pub(super) translation: Vector3<f64>,
    /// The projection centre in the world, m.
    pub(super) centre: Vector3<f64>,
}

/// Where one camera saw the ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Place of the camera in the slice of [`PosedCamera`]s.
    pub camera: usize,
    /// Raw (distorted) pixel.
    pub pixel: Vector2<f64>,
    /// Its covariance, px².
    pub covariance_px2: Matrix2<f64>,
    /// Inverse of the covariance, 1/px²: the weight in least squares.
    pub(super) information: Matrix2<f64>,
    /// Undistorted normalised coordinates (x/z, y/z).
    pub(super) normalised: Vector2<f64>,
    /// ∂pixel/∂normalised at the observation.
    pub(super) pixel_by_normalised: Matrix2<f64>,
    /// Unit direction of the ray in the world.
    pub(super) ray: Vector3<f64>,
}

impl PosedCamera {
    /// A camera with this model at this pose.
    pub fn new(model: CameraModel, camera_from_world: &Transform<Camera, World>) -> Self {
        Self {
            model,
            rotation: *camera_from_world.rotation.matrix(),
            translation: camera_from_world.translation,
            centre: camera_from_world.origin().coords,
        }
    }

    /// The projection centre, in metres.
    pub fn centre(&self) -> Point<World> {
        Point::from(self.centre)
    }

    /// The raw pixel of a point of the world; `None` behind the camera or beyond the lens model.
    pub fn project(&self, point: &Point<World>) -> Option<Vector2<f64>> {
        self.model.project(&Point::from(self.in_camera(&point.coords)))
    }

    pub(super) fn in_camera(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// The raw pixel with ∂pixel/∂point (world, per metre), without the derivatives by the
    /// intrinsics, which triangulation has no use for.
    pub(super) fn project_with_jacobian(
        &self,
        point: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let p = self.in_camera(point);
        if p.z <= MIN_DEPTH_M {
            return None;
        }
        let inverse_z = 1.0 / p.z;
        let n = Vector2::new(p.x * inverse_z, p.y * inverse_z);
        let (distorted, d) = self.model.distort_with_jacobian(&n)?;
        let (fx, fy) = (self.model.fx, self.model.fy);
        let pixel = Vector2::new(fx * distorted.x + self.model.cx, fy * distorted.y + self.model.cy);
        let (a, b) = (fx * d.m11 * inverse_z, fx * d.m12 * inverse_z);
        let (c, e) = (fy * d.m21 * inverse_z, fy * d.m22 * inverse_z);
        let by_camera = Matrix2x3::new(a, b, -(a * n.x + b * n.y), c, e, -(c * n.x + e * n.y));
        Some((pixel, by_camera * self.rotation))
    }

    /// Prepares an observation of this camera, which stands at `camera` in the rig; `None` for a pixel
    /// that the lens model has no ray for, or a covariance that is none.
    pub fn observe(
        &self,
        camera: usize,
        pixel: Vector2<f64>,
        covariance_px2: Matrix2<f64>,
    ) -> Option<Observation> {
        let information = covariance_px2.try_inverse()?;
        if !(information.m11 > 0.0 && information.determinant() > 0.0) {
            return None;
        }
        let undistorted = self.model.undistort(&pixel)?;
        let (distorted, by_normalised) = self.model.distort_with_jacobian(&undistorted)?;
        let (fx, fy) = (self.model.fx, self.model.fy);
        // One more Newton step, whose derivative is at hand, takes out the last digits: ill-conditioned
        // methods enlarge them ten thousand times.
        let off = Vector2::new(
            (pixel.x - self.model.cx) / fx - distorted.x,
            (pixel.y - self.model.cy) / fy - distorted.y,
        );
        let normalised = undistorted + by_normalised.try_inverse()? * off;
        let focal = Matrix2::new(fx, 0.0, 0.0, fy);
        let ray = self.rotation.tr_mul(&Vector3::new(normalised.x, normalised.y, 1.0)).normalize();
        Some(Observation {
            camera,
            pixel,
            covariance_px2,
            information,
            normalised,
            pixel_by_normalised: focal * by_normalised,
            ray,
        })
    }
}

/// Nearest depth at which a ball is seen, in metres: nearer points are inside the lens.
pub(super) const MIN_DEPTH_M: f64 = 1e-6;
