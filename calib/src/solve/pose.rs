use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use netcord_common::{
    camera::CameraModel,
    geometry::{Board, Camera, Transform, World},
};

use super::{
    bundle::{Bundle, BundleCamera, Freedom, Sighting, SolveOptions},
    homography::homography,
};

/// The plane that planar object points lie in, and their coordinates in it.
pub(crate) struct Plane {
    /// `X = rotation (u, v, 0) + origin`.
    pub rotation: Rotation3<f64>,
    pub origin: Vector3<f64>,
    pub coordinates: Vec<Vector2<f64>>,
}

impl Plane {
    /// `None` when the points lie on a line, or off any one plane by more than a thousandth of their
    /// extent.
    pub fn of(object: &[Vector3<f64>]) -> Option<Self> {
        if object.len() < 4 {
            return None;
        }
        let origin = object.iter().sum::<Vector3<f64>>() / object.len() as f64;
        let scatter: Matrix3<f64> = object.iter().map(|p| (p - origin) * (p - origin).transpose()).sum();
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let [large, middle, small] = order.map(|i| eigen.eigenvalues[i].max(0.0));
        if middle < 1e-6 * large || small > 1e-6 * large {
            return None;
        }
        let (x, y): (Vector3<f64>, Vector3<f64>) =
            (eigen.eigenvectors.column(order[0]).into(), eigen.eigenvectors.column(order[1]).into());
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, x.cross(&y)]));
        let coordinates = object.iter().map(|p| (rotation.inverse() * (p - origin)).xy()).collect();
        Some(Self { rotation, origin, coordinates })
    }
}

/// The pose of a plane from its homography to undistorted normalised coordinates (Zhang 2000, §3.1).
fn decompose(h: &Matrix3<f64>) -> Option<(Rotation3<f64>, Vector3<f64>)> {
    let scale = 2.0 / (h.column(0).norm() + h.column(1).norm());
    if !scale.is_finite() {
        return None;
    }
    let sign = h[(2, 2)].signum();
    let (r1, r2, t) = (h.column(0) * scale * sign, h.column(1) * scale * sign, h.column(2) * scale * sign);
    let svd = Matrix3::from_columns(&[r1, r2, r1.cross(&r2)]).svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    (rotation.determinant() > 0.0).then(|| (Rotation3::from_matrix_unchecked(rotation), t))
}

/// A board's pose and how well it fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedPose {
    /// The pose.
    pub camera_from_board: Transform<Camera, Board>,
    /// Root mean square of the points' residuals, in px.
    pub rms_px: f64,
}

/// The pose of a planar object that minimises the squared re-projection error: from the homography
/// of the undistorted points, refined through the whole camera model. A plane seen from afar has two
/// poses that look alike (its normal mirrored at the line of sight): both are refined, the better is
/// kept. `None` for too few points, points on a line, or points that the lens model cannot see.
pub fn board_pose(
    model: &CameraModel,
    object: &[Vector3<f64>],
    pixels: &[Vector2<f64>],
) -> Option<FittedPose> {
    let plane = Plane::of(object)?;
    let undistorted: Vec<_> = pixels.iter().map(|p| model.undistort(p)).collect::<Option<_>>()?;
    let h = homography(&plane.coordinates, &undistorted)?;
    let (rotation, translation) = decompose(&h)?;
    let start = refine(model, object, pixels, on_plane(&plane, rotation, translation))?;

    let normal = start.camera_from_board.rotation * (plane.rotation * Vector3::z());
    let centre = start.camera_from_board.rotation * plane.origin + start.camera_from_board.translation;
    let sight = centre.normalize();
    let mirrored = sight * (2.0 * normal.dot(&sight)) - normal;
    let turn = Rotation3::rotation_between(&normal, &-mirrored)
        .into_iter()
        .chain(Rotation3::rotation_between(&normal, &mirrored))
        .min_by(|a, b| a.angle().total_cmp(&b.angle()))?;
    let other = Transform::new(
        turn * start.camera_from_board.rotation,
        centre - turn * (start.camera_from_board.rotation * plane.origin),
    );
    Some(match refine(model, object, pixels, other) {
        Some(other) if other.rms_px < start.rms_px => other,
        _ => start,
    })
}

fn on_plane(plane: &Plane, rotation: Rotation3<f64>, translation: Vector3<f64>) -> Transform<Camera, Board> {
    let rotation = rotation * plane.rotation.inverse();
    Transform::new(rotation, translation - rotation * plane.origin)
}

/// The pose of least squared error near `start`, the camera fixed.
pub(crate) fn refine(
    model: &CameraModel,
    object: &[Vector3<f64>],
    pixels: &[Vector2<f64>],
    start: Transform<Camera, Board>,
) -> Option<FittedPose> {
    let mut bundle = Bundle {
        cameras: vec![BundleCamera::new(*model, Transform::identity(), Freedom::NOTHING)],
        blocks: vec![Transform::<World, Board>::new(start.rotation, start.translation)],
        sightings: vec![Sighting::new(0, 0, object.to_vec(), pixels.to_vec())],
    };
    let solution = bundle.solve(&SolveOptions { max_steps: 60, ..SolveOptions::default() })?;
    let board = bundle.blocks[0];
    Some(FittedPose {
        camera_from_board: Transform::new(board.rotation, board.translation),
        rms_px: (solution.cost / pixels.len() as f64).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use netcord_common::{camera::Distortion, geometry::Point};

    use super::*;

    #[test]
    fn a_pose_is_found_from_exact_points_in_any_plane() {
        let lens = Distortion::from_array([-0.097_151, 0.067_889, -0.000_716, 0.000_305, -0.003_636]);
        let model = CameraModel::new((1920, 1200), (672.3, 672.7), (984.0, 603.0), lens).expect("valid");
        let truth = Transform::<Camera, Board>::from_rodrigues(
            Vector3::new(0.4, -0.7, 1.1),
            Vector3::new(0.1, -0.2, 1.4),
        );
        let tilted = Rotation3::new(Vector3::new(0.5, 0.1, 0.0));
        let object: Vec<_> = (0..30)
            .map(|i| tilted * Vector3::new(f64::from(i % 6) * 0.05, f64::from(i / 6) * 0.05, 0.02))
            .collect();
        let pixels: Vec<_> =
            object.iter().map(|p| model.project(&(&truth * Point::from(*p))).expect("seen")).collect();
        let found = board_pose(&model, &object, &pixels).expect("well posed");
        assert!(found.rms_px < 1e-7, "{}", found.rms_px);
        assert!((found.camera_from_board.translation - truth.translation).norm() < 1e-9);
    }
}
