use nalgebra::{Matrix2, Matrix3, Vector2};
use netcord_common::camera::{CameraModel, Distortion};

use super::{homography::homography, pose::Plane, views::View};

/// The start of a mono calibration: focal lengths from the homographies of planar views (Zhang 2000,
/// §3.1), with the principal point held at the image's centre, where few views at small tilt would
/// else throw it far off. Each homography gives two equations in 1/fx² and 1/fy²; where they have no
/// positive solution, one focal length for both is tried, then the image's longer side.
/// `None` when no view has a homography.
pub(crate) fn start((width, height): (u32, u32), views: &[View]) -> Option<CameraModel> {
    let centre = Vector2::new((f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0);
    let unshift = Matrix3::new(1.0, 0.0, -centre.x, 0.0, 1.0, -centre.y, 0.0, 0.0, 1.0);
    let (mut normal, mut rhs, mut seen) = (Matrix2::<f64>::zeros(), Vector2::<f64>::zeros(), 0);
    for view in views {
        let Some(plane) = Plane::of(&view.object) else { continue };
        let Some(h) = homography(&plane.coordinates, &view.image) else { continue };
        seen += 1;
        let h = unshift * h;
        let (h1, h2) = (h.column(0) / h.norm(), h.column(1) / h.norm());
        // h1ᵀ ω h2 = 0 and (h1 + h2)ᵀ ω (h1 − h2) = 0, with ω = diag(1/fx², 1/fy², 1).
        let (sum, difference) = (h1 + h2, h1 - h2);
        for (a, b) in [(h1, h2), (sum, difference)] {
            let scale = 1.0 / (a.norm() * b.norm());
            let row = Vector2::new(a[0] * b[0], a[1] * b[1]) * scale;
            normal += row * row.transpose();
            rhs -= row * (a[2] * b[2] * scale);
        }
    }
    if seen == 0 {
        return None;
    }
    let longer = f64::from(width.max(height));
    let plausible = |f: f64| (0.1 * longer..50.0 * longer).contains(&f);
    let two = normal
        .try_inverse()
        .map(|inverse| inverse * rhs)
        .filter(|q| q.x > 0.0 && q.y > 0.0)
        .map(|q| (1.0 / q.x.sqrt(), 1.0 / q.y.sqrt()))
        .filter(|&(fx, fy)| plausible(fx) && plausible(fy) && (0.5..2.0).contains(&(fx / fy)));
    let one = || {
        let q = rhs.sum() / normal.sum();
        (q > 0.0).then(|| 1.0 / q.sqrt()).filter(|&f| plausible(f)).map(|f| (f, f))
    };
    let focal = two.or_else(one).unwrap_or((longer, longer));
    CameraModel::new((width, height), focal, (centre.x, centre.y), Distortion::default()).ok()
}
