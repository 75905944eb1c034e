use nalgebra::Vector2;

use super::CameraModel;

/// Convergence in normalised coordinates: 1e-12 is 1e-9 px at any focal length in use.
const TOLERANCE: f64 = 1e-13;

/// Newton's method doubles the digits each step; a point that needs more is outside the model.
const MAX_STEPS: u32 = 30;

impl CameraModel {
    /// Undistorted normalised coordinates (x/z, y/z) of a raw pixel; `None` where the lens model
    /// has no inverse (beyond its fold).
    ///
    /// Newton's method on the full model with its analytic Jacobian, halving a step that overshoots,
    /// until converged: the customary fixed-point iteration with a fixed handful of steps is off by
    /// millimetres at the corners of wide lenses.
    pub fn undistort(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        let target = self.distorted_of(pixel);
        if !(target.x.is_finite() && target.y.is_finite()) {
            return None;
        }
        // Inside the fold by a hair: the start must itself be in the model's domain.
        let mut n = target;
        if n.norm_squared() >= self.fold_r2 {
            n *= 0.99 * (self.fold_r2 / n.norm_squared()).sqrt();
        }
        let (at, mut jacobian) = self.distort_with_jacobian(&n)?;
        let mut error = at - target;
        for _ in 0..MAX_STEPS {
            if error.amax() < TOLERANCE {
                return Some(n);
            }
            let step = jacobian.try_inverse()? * error;
            let mut scale = 1.0;
            loop {
                let tried = n - step * scale;
                if let Some((tried_at, tried_jacobian)) = self.distort_with_jacobian(&tried) {
                    let tried_error = tried_at - target;
                    if tried_error.norm_squared() < error.norm_squared() || tried_error.amax() < TOLERANCE {
                        (n, jacobian, error) = (tried, tried_jacobian, tried_error);
                        break;
                    }
                }
                scale *= 0.5;
                if scale < 1e-6 {
                    // Rounding stops progress at the last digits; anything larger is no solution.
                    return (error.amax() < 1e-11).then_some(n);
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use crate::camera::{CameraModel, Distortion};

    #[test]
    fn every_pixel_of_a_wide_lens_goes_there_and_back_to_a_billionth_of_a_pixel() {
        let lens = Distortion::from_array([-0.097_151, 0.067_889, -0.000_716, 0.000_305, -0.003_636]);
        let camera =
            CameraModel::new((1920, 1200), (672.282, 672.689), (984.047, 602.967), lens).expect("valid");
        for y in (0..=1200).step_by(50) {
            for x in (0..=1920).step_by(40) {
                let pixel = Vector2::new(f64::from(x) - 0.5, f64::from(y) - 0.5);
                let n = camera.undistort(&pixel).expect("inside the image");
                let again = camera.distort(&n).expect("inside the model");
                let back = Vector2::new(again.x * camera.fx + camera.cx, again.y * camera.fy + camera.cy);
                assert!((back - pixel).norm() < 1e-9, "{pixel} came back as {back}");
            }
        }
    }

    #[test]
    fn a_strong_barrel_lens_has_no_inverse_outside_its_image_circle() {
        let lens = Distortion { k1: -0.3, ..Distortion::default() };
        let camera = CameraModel::new((2000, 2000), (500.0, 500.0), (1000.0, 1000.0), lens).expect("valid");
        // r (1 − 0.3 r²) is at most 0.703, at r = 1.054: 351 px from the centre.
        assert!(camera.undistort(&Vector2::new(1340.0, 1000.0)).is_some());
        assert_eq!(camera.undistort(&Vector2::new(1400.0, 1000.0)), None);
        assert_eq!(camera.undistort(&Vector2::new(f64::NAN, 1000.0)), None);
    }
}
