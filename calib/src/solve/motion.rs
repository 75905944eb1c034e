//! Extrinsics from points in motion: a wand's markers, or the ball in flight. No board, no common view of
//! anything but the points themselves.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector2, Vector3};
use netcord_common::{
    camera::CameraModel,
    geometry::{Camera, Point, Transform, World},
};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use super::{
    bundle::{Bundle, BundleCamera, Freedom, Sighting, SolveOptions},
    error::CalibrationError,
    loss::Loss,
};

/// One camera's sightings: its intrinsics, and the pixel of each point where it saw it. The place in the
/// list is the point: one marker at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct MovingPoints {
    /// The camera's name.
    pub name: String,
    /// Its intrinsics.
    pub model: CameraModel,
    /// Raw pixels.
    pub pixels: Vec<Option<Vector2<f64>>>,
}

/// A camera's pose from points in motion.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionMember {
    /// The camera's name.
    pub name: String,
    /// Pose; the frame is the first consistent camera's, in units of the first baseline until scaled.
    pub camera_from_first: Transform<Camera, World>,
    /// Median length of its residuals, px.
    pub median_px: f64,
    /// Root mean square of the residuals of its points that are no outliers, px.
    pub rms_px: f64,
    /// Share of its points that are outliers, 0–1: further off than five robust standard deviations (from the
    /// median), as in calibration by boards. Found markers smear in fast motion, and jump.
    pub outliers: f64,
}

/// Cameras that agree, and those that do not.
#[derive(Debug, Clone)]
pub struct MotionCalibration {
    /// The cameras that agree with each other.
    pub cameras: Vec<MotionMember>,
    /// Cameras whose points contradict the others', with the median residual that they would have, px.
    pub inconsistent: Vec<(String, f64)>,
    /// The points, in the first consistent camera's frame; `None` where fewer than two cameras saw it.
    pub points: Vec<Option<Point<World>>>,
}

/// A residual, in px, beyond which a point in motion does not support a pose in the search for a start.
const OUTLIER_PX: f64 = 2.0;
/// Robust standard deviations from which a point is an outlier in the end.
const OUTLIER_SIGMAS: f64 = 5.0;
/// Fewest common points of a pair of cameras.
const LEAST_COMMON: usize = 20;
/// A camera is inconsistent when leaving it out lowers the others' median residual, or its own lies above
/// theirs, by this factor…
const INCONSISTENT_RATIO: f64 = 2.5;
/// …and its own is above this, in px.
const INCONSISTENT_FLOOR_PX: f64 = 0.5;

/// Calibrates poses from points in motion, up to scale ([`MotionCalibration::scale`]).
///
/// Pairs by the essential matrix (eight points, random samples with a fixed seed), further cameras by
/// resection, then a bundle adjustment over all points with Cauchy's loss. A camera that contradicts the
/// others is left out and named.
///
/// # Errors
/// [`CalibrationError`]: fewer than two cameras, or no two with enough common points.
pub fn calibrate_motion(cameras: &[MovingPoints]) -> Result<MotionCalibration, CalibrationError> {
    if cameras.len() < 2 {
        return Err(CalibrationError::CameraCount { found: cameras.len(), needed: "at least two" });
    }
    let all: Vec<usize> = (0..cameras.len()).collect();
    let mut inconsistent: Vec<(String, f64)> = Vec::new();
    let mut members = all;
    let mut solved = solve_members(cameras, &members)?;
    // Two cameras agree with each other whatever their points: of three nobody can say which is wrong.
    while members.len() > 3 {
        // Who, left out, leaves the others in best agreement?
        let mut best: Option<(usize, Solved)> = None;
        for leave in 0..members.len() {
            let rest: Vec<usize> = members.iter().copied().filter(|m| *m != members[leave]).collect();
            let Ok(without) = solve_members(cameras, &rest) else { continue };
            if best.as_ref().is_none_or(|(_, b)| without.worst() < b.worst()) {
                best = Some((leave, without));
            }
        }
        let Some((leave, without)) = best else { break };
        let (own, rest) = (against(&cameras[members[leave]], &without), without.worst());
        if own < INCONSISTENT_FLOOR_PX || own < INCONSISTENT_RATIO * rest || solved.worst() < 1.5 * rest {
            break;
        }
        inconsistent.push((cameras[members[leave]].name.clone(), own));
        members.remove(leave);
        solved = without;
    }
    let cameras = members
        .iter()
        .zip(&solved.poses)
        .zip(&solved.residuals)
        .map(|((m, pose), r)| {
            // The median length of a normal residual in two directions is √(2 ln 2) of its standard deviation.
            let limit = OUTLIER_SIGMAS * median(r) / (2.0 * 2f64.ln()).sqrt();
            let good: Vec<f64> = r.iter().copied().filter(|r| *r < limit).collect();
            MotionMember {
                name: cameras[*m].name.clone(),
                camera_from_first: *pose,
                median_px: median(r),
                rms_px: (good.iter().map(|r| r * r).sum::<f64>() / good.len().max(1) as f64).sqrt(),
                outliers: 1.0 - good.len() as f64 / r.len().max(1) as f64,
            }
        })
        .collect();
    Ok(MotionCalibration { cameras, inconsistent, points: solved.points })
}

impl MotionCalibration {
    /// Multiplies all lengths, so that they become metres.
    pub fn scale(&mut self, factor: f64) {
        for c in &mut self.cameras {
            c.camera_from_first.translation *= factor;
        }
        for p in self.points.iter_mut().flatten() {
            p.coords *= factor;
        }
    }

    /// The median distance of pairs of points, as of a wand's two markers at the same instants: the known
    /// length over it is the factor of [`Self::scale`]. `None` when no pair was seen.
    pub fn median_distance(&self, pairs: impl Iterator<Item = (usize, usize)>) -> Option<f64> {
        let lengths: Vec<f64> = pairs
            .filter_map(|(a, b)| Some(self.points.get(a)?.as_ref()?.distance(self.points.get(b)?.as_ref()?)))
            .collect();
        (!lengths.is_empty()).then(|| median(&lengths))
    }
}

struct Solved {
    poses: Vec<Transform<Camera, World>>,
    points: Vec<Option<Point<World>>>,
    /// Per camera, lengths of its residuals.
    residuals: Vec<Vec<f64>>,
}

impl Solved {
    /// The largest of the cameras' median residuals, px.
    fn worst(&self) -> f64 {
        self.residuals.iter().map(|r| median(r)).fold(0.0, f64::max)
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    if sorted.is_empty() {
        return f64::INFINITY;
    }
    let middle = sorted.len() / 2;
    *sorted.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The median residual, px, of a camera that took no part, resected against the others' points.
fn against(camera: &MovingPoints, solved: &Solved) -> f64 {
    let rays = undistorted(camera);
    let Some(pose) = resect(camera, &rays, &solved.points) else { return f64::INFINITY };
    let off: Vec<f64> = solved
        .points
        .iter()
        .zip(&camera.pixels)
        .filter_map(|(p, pixel)| {
            let (p, pixel) = ((*p)?, (*pixel)?);
            Some(camera.model.project(&(&pose * p)).map_or(1e3, |at| (at - pixel).norm()))
        })
        .collect();
    median(&off)
}

fn undistorted(camera: &MovingPoints) -> Vec<Option<Vector2<f64>>> {
    camera.pixels.iter().map(|p| camera.model.undistort(p.as_ref()?)).collect()
}

fn solve_members(cameras: &[MovingPoints], members: &[usize]) -> Result<Solved, CalibrationError> {
    let rays: Vec<Vec<Option<Vector2<f64>>>> = members.iter().map(|m| undistorted(&cameras[*m])).collect();
    let names = || members.iter().map(|m| cameras[*m].name.as_str()).collect::<Vec<_>>().join(", ");
    // The pair with the most points that its essential matrix explains.
    let mut start: Option<(usize, usize, usize, Transform<Camera, World>)> = None;
    for b in 1..members.len() {
        for a in 0..b {
            let tolerance = OUTLIER_PX / cameras[members[a]].model.fx;
            if let Some((inliers, pose)) = relative_pose(&rays[a], &rays[b], tolerance)
                && start.as_ref().is_none_or(|s| inliers > s.0)
            {
                start = Some((inliers, a, b, pose));
            }
        }
    }
    let not_connected =
        || CalibrationError::NotConnected { camera: names(), others: "each other".to_owned() };
    let (_, a, b, pose) = start.ok_or_else(not_connected)?;
    let mut poses: Vec<Option<Transform<Camera, World>>> = vec![None; members.len()];
    (poses[a], poses[b]) = (Some(Transform::identity()), Some(pose));
    let mut points = triangulate(&rays, &poses);
    while poses.iter().any(Option::is_none) {
        let next = (0..members.len())
            .filter(|i| poses[*i].is_none())
            .max_by_key(|i| points.iter().zip(&rays[*i]).filter(|(p, r)| p.is_some() && r.is_some()).count());
        let Some(next) = next else { break };
        let pose = resect(&cameras[members[next]], &rays[next], &points).ok_or_else(|| {
            CalibrationError::NotConnected { camera: cameras[members[next]].name.clone(), others: names() }
        })?;
        poses[next] = Some(pose);
        points = triangulate(&rays, &poses);
    }
    let mut poses: Vec<Transform<Camera, World>> = poses.into_iter().flatten().collect();
    adjust(cameras, members, &mut poses, &mut points, a).ok_or_else(not_connected)?;
    let residuals = members
        .iter()
        .zip(&poses)
        .map(|(m, pose)| {
            let camera = &cameras[*m];
            let pairs = points.iter().zip(&camera.pixels);
            pairs
                .filter_map(|(p, pixel)| {
                    let (p, pixel) = ((*p)?, (*pixel)?);
                    Some(camera.model.project(&(pose * p)).map_or(1e3, |at| (at - pixel).norm()))
                })
                .collect()
        })
        .collect();
    // Into the frame of the first member, in units of the first baseline.
    let first = poses[0];
    let from_first = |pose: &Transform<Camera, World>| {
        let rotation = pose.rotation * first.rotation.inverse();
        Transform::new(rotation, pose.translation - rotation * first.translation)
    };
    let moved = poses.iter().map(from_first).collect();
    let points = points.into_iter().map(|p| p.map(|p| Point::from((&first * p).coords))).collect();
    Ok(Solved { poses: moved, points, residuals })
}

/// Essential matrix from eight points, by random samples; gives the number of inliers and the pose of the
/// second camera seen from the first, with a baseline of one.
fn relative_pose(
    a: &[Option<Vector2<f64>>],
    b: &[Option<Vector2<f64>>],
    tolerance: f64,
) -> Option<(usize, Transform<Camera, World>)> {
    let pairs: Vec<(Vector2<f64>, Vector2<f64>)> =
        a.iter().zip(b).filter_map(|(a, b)| Some(((*a)?, (*b)?))).collect();
    if pairs.len() < LEAST_COMMON {
        return None;
    }
    /// With 40 % outliers a sample of eight is clean in 1.7 % of draws; 800 draws miss once in a million.
    const DRAWS: usize = 800;
    let mut random = Pcg64Mcg::seed_from_u64(8);
    let inliers = |e: &Matrix3<f64>| -> Vec<usize> {
        (0..pairs.len()).filter(|i| sampson(e, &pairs[*i]) < tolerance * tolerance).collect()
    };
    let mut best: Vec<usize> = Vec::new();
    let mut essential = Matrix3::zeros();
    for _ in 0..DRAWS {
        let sample: Vec<usize> = (0..8).map(|_| random.random_range(0..pairs.len())).collect();
        let Some(e) = eight_points(sample.iter().map(|i| &pairs[*i])) else { continue };
        let found = inliers(&e);
        if found.len() > best.len() {
            (best, essential) = (found, e);
        }
    }
    for _ in 0..5 {
        let Some(e) = eight_points(best.iter().map(|i| &pairs[*i])) else { break };
        let found = inliers(&e);
        if found.len() < best.len() {
            break;
        }
        (best, essential) = (found, e);
    }
    if best.len() < LEAST_COMMON {
        return None;
    }
    // Of the four decompositions, the one with the most points before both cameras.
    let svd = essential.svd(true, true);
    let (mut u, mut v_t) = (svd.u?, svd.v_t?);
    if u.determinant() < 0.0 {
        u = -u;
    }
    if v_t.determinant() < 0.0 {
        v_t = -v_t;
    }
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let t: Vector3<f64> = u.column(2).into();
    let candidates = [(w, t), (w, -t), (w.transpose(), t), (w.transpose(), -t)];
    let pose = candidates
        .into_iter()
        .map(|(w, t)| Transform::<Camera, World>::new(Rotation3::from_matrix_unchecked(u * w * v_t), t))
        .max_by_key(|pose| {
            let before = |i: &&usize| {
                let (p, q) = &pairs[**i];
                intersect(&[(Transform::identity(), *p), (*pose, *q)]).is_some()
            };
            best.iter().filter(before).count()
        })?;
    Some((best.len(), pose))
}

fn eight_points<'a>(pairs: impl Iterator<Item = &'a (Vector2<f64>, Vector2<f64>)>) -> Option<Matrix3<f64>> {
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (p, q) in pairs {
        let row =
            SVector::<f64, 9>::from([q.x * p.x, q.x * p.y, q.x, q.y * p.x, q.y * p.y, q.y, p.x, p.y, 1.0]);
        normal += row * row.transpose();
    }
    let eigen = normal.symmetric_eigen();
    let least = (0..9).min_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]))?;
    let e = eigen.eigenvectors.column(least);
    let svd = Matrix3::new(e[0], e[1], e[2], e[3], e[4], e[5], e[6], e[7], e[8]).svd(true, true);
    Some(svd.u? * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0)) * svd.v_t?)
}

/// Sampson's squared distance to the epipolar geometry, in normalised units.
fn sampson(e: &Matrix3<f64>, (p, q): &(Vector2<f64>, Vector2<f64>)) -> f64 {
    let (p, q) = (Vector3::new(p.x, p.y, 1.0), Vector3::new(q.x, q.y, 1.0));
    let (ep, eq) = (e * p, e.transpose() * q);
    let d = q.dot(&ep);
    d * d / (ep.x * ep.x + ep.y * ep.y + eq.x * eq.x + eq.y * eq.y).max(1e-300)
}

/// The point of least summed squared distance to the rays; `None` when it lies behind one of them, or the
/// rays are parallel.
fn intersect(rays: &[(Transform<Camera, World>, Vector2<f64>)]) -> Option<Point<World>> {
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

fn triangulate(
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
fn resect(
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
    let mut bundle = Bundle {
        cameras: vec![BundleCamera {
            model: camera.model,
            camera_from_rig: pose,
            freedom: Freedom { pose: true, ..Freedom::NOTHING },
        }],
        // One block that does not move: its unknowns are held by a sighting of no camera's freedom.
        blocks: Vec::<Fixed>::from([Fixed]),
        sightings: vec![Sighting {
            camera: 0,
            block: 0,
            object: pairs.iter().filter(|p| off(&pose, p).is_finite()).map(|p| p.0).collect(),
            pixels: pairs.iter().filter(|p| off(&pose, p).is_finite()).map(|p| p.2).collect(),
        }],
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

/// Bundle adjustment over poses and points, with camera `reference` held and one coordinate of the scale
/// left to the damping.
fn adjust(
    cameras: &[MovingPoints],
    members: &[usize],
    poses: &mut [Transform<Camera, World>],
    points: &mut [Option<Point<World>>],
    reference: usize,
) -> Option<()> {
    let mut bundle = Bundle { cameras: Vec::new(), blocks: Vec::new(), sightings: Vec::new() };
    for (i, (m, pose)) in members.iter().zip(poses.iter()).enumerate() {
        let freedom = Freedom { pose: i != reference, ..Freedom::NOTHING };
        bundle.cameras.push(BundleCamera { model: cameras[*m].model, camera_from_rig: *pose, freedom });
    }
    let mut block_of = Vec::new();
    for (k, point) in points.iter().enumerate() {
        let Some(point) = point else { continue };
        let block = bundle.blocks.len();
        for (camera, m) in members.iter().enumerate() {
            let seen = cameras[*m].pixels[k];
            let projected = cameras[*m].model.project(&(&poses[camera] * *point));
            // A gross outlier would only bend the start.
            if let (Some(pixel), Some(at)) = (seen, projected)
                && (at - pixel).norm() < 50.0 * OUTLIER_PX
            {
                bundle.sightings.push(Sighting {
                    camera,
                    block,
                    object: vec![Vector3::zeros()],
                    pixels: vec![pixel],
                });
            }
        }
        let seen_by = bundle.sightings.iter().rev().take_while(|s| s.block == block).count();
        if seen_by >= 2 {
            bundle.blocks.push(*point);
            block_of.push(k);
        } else {
            let keep = bundle.sightings.len() - seen_by;
            bundle.sightings.truncate(keep);
        }
    }
    bundle.solve(&SolveOptions { loss: Loss::Cauchy { scale_px: 0.5 }, max_steps: 25 })?;
    for (pose, camera) in poses.iter_mut().zip(&bundle.cameras) {
        *pose = camera.camera_from_rig;
    }
    points.iter_mut().for_each(|p| *p = None);
    for (k, block) in block_of.into_iter().zip(&bundle.blocks) {
        points[k] = Some(*block);
    }
    Some(())
}
