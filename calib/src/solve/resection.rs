//! Points from poses, and a pose from points: what a start of a rig in motion is built up from.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector2, Vector3};
use netcord_common::geometry::{Camera, Point, Transform, World};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use super::{
    bundle::{Bundle, BundleCamera, Freedom, Sighting, SolveOptions},
    loss::Loss,
    motion::{LEAST_COMMON, OUTLIER_PX},
    moving_points::MovingPoints,
};

/// The point of least summed squared distance to the rays; `None` when it lies behind one of them, or the
/// rays are parallel.
pub(super) fn intersect(rays: &[(Transform<Camera, World>, Vector2<f64>)]) -> Option<Point<World>> {
    let (mut normal, mut rhs) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
    for (pose, n) in rays {
        let direction = pose.rotation.inverse() * Vector3::new(n.x, n.y, 1.0).normalize();
        let across = Matrix3::identity() - direction * direction.transpose();
        normal += across;
        rhs += across * pose.origin().coords;
    }
    if normal.symmetric_eigenvalues().min() < 1e-6 {
        return None;
    }
    let point = Point::from(normal.try_inverse()? * rhs);
    rays.iter().all(|(pose, _)| (pose * point).coords.z > 0.0).then_some(point)
}

pub(super) fn triangulate(
    rays: &[Vec<Option<Vector2<f64>>>],
    poses: &[Option<Transform<Camera, World>>],
) -> Vec<Option<Point<World>>> {
    let count = rays.first().map_or(0, Vec::len);
    (0..count)
        .map(|i| {
            let seen: Vec<_> =
                rays.iter().zip(poses).filter_map(|(r, pose)| Some(((*pose)?, (*r.get(i)?)?))).collect();
            if seen.len() < 2 { None } else { intersect(&seen) }
        })
        .collect()
}

/// A camera's pose from known points: direct linear transform on random samples of six, then all inliers,
/// then the robust minimum of the re-projection error.
pub(super) fn resect(
    camera: &MovingPoints,
    rays: &[Option<Vector2<f64>>],
    points: &[Option<Point<World>>],
) -> Option<Transform<Camera, World>> {
    const DRAWS: usize = 400;
    let pairs: Vec<(Vector3<f64>, Vector2<f64>, Vector2<f64>)> = points
        .iter()
        .zip(rays)
        .zip(&camera.pixels)
        .filter_map(|((p, r), pixel)| Some(((*p)?.coords, (*r)?, (*pixel)?)))
        .collect();
    if pairs.len() < LEAST_COMMON {
        return None;
    }
    let off = |pose: &Transform<Camera, World>,
               (p, _, pixel): &(Vector3<f64>, Vector2<f64>, Vector2<f64>)| {
        camera.model.project(&(pose * Point::from(*p))).map_or(f64::INFINITY, |at| (at - pixel).norm())
    };
    let mut random = Pcg64Mcg::seed_from_u64(6);
    let mut best: (usize, Option<Transform<Camera, World>>) = (0, None);
    for _ in 0..DRAWS {
        let sample: Vec<usize> = (0..6).map(|_| random.random_range(0..pairs.len())).collect();
        let Some(pose) = direct(sample.iter().map(|i| (&pairs[*i].0, &pairs[*i].1))) else { continue };
        // Six noisy points lead only near the pose.
        let close = pairs.iter().filter(|p| off(&pose, p) < 10.0 * OUTLIER_PX).count();
        if close > best.0 {
            best = (close, Some(pose));
        }
    }
    let mut pose = best.1?;
    let close: Vec<_> = pairs.iter().filter(|p| off(&pose, p) < 10.0 * OUTLIER_PX).collect();
    if let Some(finer) = direct(close.iter().map(|p| (&p.0, &p.1)))
        && pairs.iter().filter(|p| off(&finer, p) < 10.0 * OUTLIER_PX).count() >= best.0
    {
        pose = finer;
    }
    polish(camera, &pairs.iter().map(|p| (p.0, p.2)).collect::<Vec<_>>(), pose)
}

/// The robust minimum of the re-projection error of known points, from a pose that is nearly right.
pub(super) fn polish(
    camera: &MovingPoints,
    pairs: &[(Vector3<f64>, Vector2<f64>)],
    pose: Transform<Camera, World>,
) -> Option<Transform<Camera, World>> {
    let before =
        |p: &&(Vector3<f64>, Vector2<f64>)| camera.model.project(&(&pose * Point::from(p.0))).is_some();
    let mut bundle = Bundle {
        cameras: vec![BundleCamera::new(camera.model, pose, Freedom { pose: true, ..Freedom::NOTHING })],
        // One block that does not move: its unknowns are held by a sighting of no camera's freedom.
        blocks: Vec::<Fixed>::from([Fixed]),
        sightings: vec![Sighting::new(
            0,
            0,
            pairs.iter().filter(before).map(|p| p.0).collect(),
            pairs.iter().filter(before).map(|p| p.1).collect(),
        )],
    };
    bundle.solve(&SolveOptions { loss: Loss::Cauchy { scale_px: 1.0 }, max_steps: 50 })?;
    Some(bundle.cameras[0].camera_from_rig)
}

/// Points that are known: nothing to solve for.
#[derive(Debug, Clone)]
struct Fixed;

impl super::block::Block<0> for Fixed {
    fn place(&self, object: &Vector3<f64>) -> Vector3<f64> {
        *object
    }

    fn jacobian(&self, _object: &Vector3<f64>) -> SMatrix<f64, 3, 0> {
        SMatrix::zeros()
    }

    fn stepped(&self, _step: &SVector<f64, 0>) -> Self {
        self.clone()
    }
}

/// P = [R | t] from points and undistorted images (direct linear transform), R made orthonormal.
fn direct<'a>(
    pairs: impl Iterator<Item = (&'a Vector3<f64>, &'a Vector2<f64>)> + Clone,
) -> Option<Transform<Camera, World>> {
    let count = pairs.clone().count() as f64;
    let mean = pairs.clone().map(|(p, _)| p).sum::<Vector3<f64>>() / count;
    let spread = (pairs.clone().map(|(p, _)| (p - mean).norm_squared()).sum::<f64>() / count).sqrt();
    if spread <= 0.0 {
        return None;
    }
    let mut normal = SMatrix::<f64, 12, 12>::zeros();
    for (p, n) in pairs.clone() {
        let q = (p - mean) / spread;
        let h = [q.x, q.y, q.z, 1.0];
        for (row, value) in [(0, n.x), (1, n.y)] {
            let mut v = SVector::<f64, 12>::zeros();
            for k in 0..4 {
                v[4 * row + k] = h[k];
                v[8 + k] = -value * h[k];
            }
            normal += v * v.transpose();
        }
    }
    let eigen = normal.symmetric_eigen();
    let least = (0..12).min_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]))?;
    let e = eigen.eigenvectors.column(least);
    let mut m = Matrix3::new(e[0], e[1], e[2], e[4], e[5], e[6], e[8], e[9], e[10]) / spread;
    let mut t = Vector3::new(e[3], e[7], e[11]) - m * mean;
    if m.determinant() < 0.0 {
        (m, t) = (-m, -t);
    }
    let svd = m.svd(true, true);
    let scale = svd.singular_values.mean();
    (scale > 1e-12)
        .then(|| svd.u.zip(svd.v_t))
        .flatten()
        .map(|(u, v_t)| Transform::new(Rotation3::from_matrix_unchecked(u * v_t), t / scale))
}
