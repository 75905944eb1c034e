//! Extrinsics from points in motion: a wand's markers, or the ball in flight. No board, no common view of
//! anything but the points themselves.

use std::collections::BTreeSet;

use nalgebra::{Vector2, Vector3};
use netcord_common::{
    camera::{CameraModel, INTRINSICS},
    geometry::{Camera, Point, Transform, World},
};

use super::{
    block::Block,
    bundle::{Bundle, BundleCamera, Freedom, Sighting, SolveOptions},
    delay::{Delay, delay_of},
    epipolar::relative_pose,
    error::CalibrationError,
    loss::Loss,
    moving_points::MovingPoints,
    resection::{resect, triangulate},
    strays::{Stray, name_strays},
    wand::WandShape,
};

/// How poses are found from points in motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MotionOptions {
    /// Which of `fx fy cx cy k1 k2 p1 p2 k3` are refined with the poses; none by default. Needs points that fill
    /// the pictures.
    pub intrinsics: [bool; INTRINSICS],
    /// Markers at each instant, where they are a wand's: place k of the lists is marker k modulo this. Points of
    /// their own where it is 0 or 1.
    pub markers: usize,
}

/// A camera's pose from points in motion.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionMember {
    /// The camera's name.
    pub name: String,
    /// Pose; the frame is the first consistent camera's, in units of the first baseline until scaled.
    pub camera_from_first: Transform<Camera, World>,
    /// Its intrinsics, refined where that was asked for.
    pub model: CameraModel,
    /// Median length of its residuals, px.
    pub median_px: f64,
    /// Root mean square of the residuals of its points that are no strays, px.
    pub rms_px: f64,
    /// The same over all of its points, the strays too, px.
    pub rms_all_px: f64,
    /// Number of its points, with the strays.
    pub points: usize,
    /// Its points that contradict the rest.
    pub strays: Vec<Stray>,
}

/// Cameras that agree, and those that do not.
#[derive(Debug, Clone)]
pub struct MotionCalibration {
    /// The cameras that agree with each other.
    pub cameras: Vec<MotionMember>,
    /// Cameras whose points contradict the others'.
    pub inconsistent: Vec<Inconsistent>,
    /// Whether the points were found to be a rigid wand's, and held to that.
    pub rigid: bool,
    /// The points, in the first consistent camera's frame; `None` where fewer than two cameras saw it.
    pub points: Vec<Option<Point<World>>>,
}

/// A camera whose points contradict the others'.
#[derive(Debug, Clone, PartialEq)]
pub struct Inconsistent {
    /// Its name.
    pub name: String,
    /// The median residual that it would have among the others, px.
    pub median_px: f64,
    /// The clock's error that would explain it, where one does.
    pub delay: Option<Delay>,
}

/// A residual, in px, beyond which a point in motion does not support a pose in the search for a start.
pub(super) const OUTLIER_PX: f64 = 2.0;
/// Loss of a point in motion: found markers smear, and jump.
const LOSS: Loss = Loss::Cauchy { scale_px: 0.5 };
/// The residual of a point that by the solution has no image at all, px.
const NO_IMAGE_PX: f64 = 1e3;
/// Fewest common points of a pair of cameras.
pub(super) const LEAST_COMMON: usize = 20;
/// A camera is inconsistent when leaving it out lowers the others' median residual, or its own lies above
/// theirs, by this factor…
const INCONSISTENT_RATIO: f64 = 2.5;
/// …and its own is above this, in px.
const INCONSISTENT_FLOOR_PX: f64 = 0.5;
/// A wrong clock explains it when, made good, it leaves no more than this share of the residual.
const EXPLAINED: f64 = 0.3;

/// Calibrates poses from points in motion, up to scale ([`MotionCalibration::scale`]).
///
/// Pairs by the essential matrix (eight points, random samples with a fixed seed), further cameras by
/// resection, then a bundle adjustment over all points with Cauchy's loss. A camera that contradicts the
/// others is left out and named. Markers of a rigid wand are held to its shape in the end, and those that do not fit
/// are named and left out.
///
/// # Errors
/// [`CalibrationError`]: fewer than two cameras, or no two with enough common points.
pub fn calibrate_motion(
    cameras: &[MovingPoints],
    options: &MotionOptions,
) -> Result<MotionCalibration, CalibrationError> {
    if cameras.len() < 2 {
        return Err(CalibrationError::CameraCount { found: cameras.len(), needed: "at least two" });
    }
    let cameras: &[MovingPoints] = &cameras.iter().map(MovingPoints::whole).collect::<Vec<_>>();
    let all: Vec<usize> = (0..cameras.len()).collect();
    let mut inconsistent: Vec<Inconsistent> = Vec::new();
    let mut members = all;
    let mut solved = solve_members(cameras, &members, options)?;
    // Two cameras agree with each other whatever their points: of three nobody can say which is wrong.
    while members.len() > 3 {
        // Who, left out, leaves the others in best agreement?
        let mut best: Option<(usize, Solved)> = None;
        for leave in 0..members.len() {
            let rest: Vec<usize> = members.iter().copied().filter(|m| *m != members[leave]).collect();
            let Ok(without) = solve_members(cameras, &rest, options) else { continue };
            if best.as_ref().is_none_or(|(_, b)| without.worst() < b.worst()) {
                best = Some((leave, without));
            }
        }
        let Some((leave, without)) = best else { break };
        let (own, rest) = (against(&cameras[members[leave]], &without), without.worst());
        if own < INCONSISTENT_FLOOR_PX || own < INCONSISTENT_RATIO * rest || solved.worst() < 1.5 * rest {
            break;
        }
        let camera = &cameras[members[leave]];
        let delay = delay_of(camera, &without.points).filter(|d| d.median_px < EXPLAINED * own);
        inconsistent.push(Inconsistent { name: camera.name.clone(), median_px: own, delay });
        members.remove(leave);
        solved = without;
    }
    let shape = WandShape::of(&solved.points, options.markers);
    let strays = match &shape {
        Some(shape) => stiffen(cameras, &members, &mut solved, shape, options)?,
        None => name_strays(&sightings_of(cameras, &members), &solved.residuals, options.markers.max(1)),
    };
    let cameras = members
        .iter()
        .zip(strays)
        .enumerate()
        .map(|(i, (m, strays))| {
            let residuals = &solved.residuals[i];
            let all: Vec<f64> = residuals.iter().flatten().copied().collect();
            let good: Vec<f64> = residuals
                .iter()
                .enumerate()
                .filter(|(place, _)| strays.iter().all(|s| s.place != *place))
                .filter_map(|(_, r)| *r)
                .collect();
            MotionMember {
                name: cameras[*m].name.clone(),
                camera_from_first: solved.poses[i],
                model: solved.models[i],
                median_px: median(&all),
                rms_px: rms(&good),
                rms_all_px: rms(&all),
                points: all.len(),
                strays,
            }
        })
        .collect();
    Ok(MotionCalibration { cameras, inconsistent, rigid: shape.is_some(), points: solved.points })
}

fn rms(lengths: &[f64]) -> f64 {
    (lengths.iter().map(|r| r * r).sum::<f64>() / lengths.len().max(1) as f64).sqrt()
}

fn sightings_of<'a>(cameras: &'a [MovingPoints], members: &[usize]) -> Vec<&'a [Option<Vector2<f64>>]> {
    members.iter().map(|m| cameras[*m].pixels.as_slice()).collect()
}

impl MotionMember {
    /// Share of its points that are strays, 0–1.
    pub fn stray_share(&self) -> f64 {
        self.strays.len() as f64 / self.points.max(1) as f64
    }
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
    models: Vec<CameraModel>,
    points: Vec<Option<Point<World>>>,
    /// Per camera and place, lengths of its residuals, px.
    residuals: Vec<Vec<Option<f64>>>,
}

impl Solved {
    /// The largest of the cameras' median residuals, px.
    fn worst(&self) -> f64 {
        let of_camera = |r: &Vec<Option<f64>>| median(&r.iter().flatten().copied().collect::<Vec<f64>>());
        self.residuals.iter().map(of_camera).fold(0.0, f64::max)
    }

    /// Measures the residuals anew.
    fn measure(&mut self, cameras: &[MovingPoints], members: &[usize]) {
        let residual = |pose, model: &CameraModel, point: &Option<Point<World>>, pixel: &Option<_>| {
            let (point, pixel): (_, Vector2<f64>) = ((*point)?, (*pixel)?);
            let at = model.project(&(pose * point));
            Some(at.map_or(NO_IMAGE_PX, |at: Vector2<f64>| (at - pixel).norm()))
        };
        self.residuals = members
            .iter()
            .zip(&self.poses)
            .zip(&self.models)
            .map(|((m, pose), model)| {
                let pairs = self.points.iter().zip(&cameras[*m].pixels);
                pairs.map(|(point, pixel)| residual(pose, model, point, pixel)).collect()
            })
            .collect();
    }

    /// Into the frame of the first camera.
    fn move_into_first(&mut self) {
        let Some(first) = self.poses.first().copied() else { return };
        for pose in &mut self.poses {
            let rotation = pose.rotation * first.rotation.inverse();
            *pose = Transform::new(rotation, pose.translation - rotation * first.translation);
        }
        for point in self.points.iter_mut().flatten() {
            *point = Point::from((&first * *point).coords);
        }
    }
}

pub(super) fn median(values: &[f64]) -> f64 {
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

pub(super) fn undistorted(camera: &MovingPoints) -> Vec<Option<Vector2<f64>>> {
    camera.pixels.iter().map(|p| camera.model.undistort(p.as_ref()?)).collect()
}

fn solve_members(
    cameras: &[MovingPoints],
    members: &[usize],
    options: &MotionOptions,
) -> Result<Solved, CalibrationError> {
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
    let models = adjust(cameras, members, &mut poses, &mut points, a, options).ok_or_else(not_connected)?;
    let mut solved = Solved { poses, models, points, residuals: Vec::new() };
    solved.move_into_first();
    solved.measure(cameras, members);
    Ok(solved)
}

/// Rounds in which strays are named anew without those named before.
const STRAY_ROUNDS: usize = 4;

/// Solves once more with the wand held rigid. Strays take no part: what is off is measured from where the rest puts
/// the wand, and named again until no more are found.
fn stiffen(
    cameras: &[MovingPoints],
    members: &[usize],
    solved: &mut Solved,
    shape: &WandShape,
    options: &MotionOptions,
) -> Result<Vec<Vec<Stray>>, CalibrationError> {
    let sightings = sightings_of(cameras, members);
    let mut strays = vec![Vec::new(); members.len()];
    for _ in 0..STRAY_ROUNDS {
        let out: Vec<BTreeSet<usize>> =
            strays.iter().map(|s: &Vec<Stray>| s.iter().map(|s| s.place).collect()).collect();
        adjust_wand(&sightings, &out, solved, shape, options).ok_or_else(|| {
            CalibrationError::NotConverged {
                camera: members.iter().map(|m| cameras[*m].name.as_str()).collect::<Vec<_>>().join(", "),
                rms_px: f64::INFINITY,
            }
        })?;
        solved.move_into_first();
        solved.measure(cameras, members);
        let named = name_strays(&sightings, &solved.residuals, options.markers);
        let same = named.iter().zip(&out).all(|(n, o)| n.iter().map(|s| s.place).eq(o.iter().copied()));
        strays = named;
        if same {
            break;
        }
    }
    Ok(strays)
}

/// Bundle adjustment over poses, wands and the intrinsics that are free; without the places `out` of each camera. The
/// wand's length is the scale.
fn adjust_wand(
    sightings: &[&[Option<Vector2<f64>>]],
    out: &[BTreeSet<usize>],
    solved: &mut Solved,
    shape: &WandShape,
    options: &MotionOptions,
) -> Option<()> {
    let markers = options.markers;
    let mut bundle = Bundle { cameras: Vec::new(), blocks: Vec::new(), sightings: Vec::new() };
    for (i, (model, pose)) in solved.models.iter().zip(&solved.poses).enumerate() {
        let freedom = Freedom { pose: i > 0, intrinsics: options.intrinsics, ..Freedom::NOTHING };
        bundle.cameras.push(BundleCamera::new(*model, *pose, freedom));
    }
    let mut instants = Vec::new();
    for (instant, points) in solved.points.chunks_exact(markers).enumerate() {
        let Some(wand) = shape.lay(points) else { continue };
        let block = bundle.blocks.len();
        let mut seen = Vec::new();
        for (camera, pixels) in sightings.iter().enumerate() {
            let places = (0..markers).map(|k| instant * markers + k);
            let (object, pixels): (Vec<_>, Vec<_>) = places
                .filter(|place| !out[camera].contains(place))
                .filter_map(|place| Some((shape.marker(place % markers), pixels[place]?)))
                .unzip();
            if !pixels.is_empty() {
                seen.push(Sighting::new(camera, block, object, pixels));
            }
        }
        // Two rays of each of two markers, or more: less does not hold a wand.
        if seen.len() >= 2 && seen.iter().map(|s| s.pixels.len()).sum::<usize>() >= 4 {
            bundle.sightings.extend(seen);
            bundle.blocks.push(wand);
            instants.push(instant);
        }
    }
    bundle.solve(&SolveOptions { loss: LOSS, max_steps: 15 })?;
    solved.poses = bundle.cameras.iter().map(|c| c.camera_from_rig).collect();
    solved.models = bundle.cameras.iter().map(|c| c.model).collect();
    solved.points.iter_mut().for_each(|p| *p = None);
    for (instant, wand) in instants.into_iter().zip(&bundle.blocks) {
        for k in 0..markers {
            solved.points[instant * markers + k] = Some(Point::from(wand.place(&shape.marker(k))));
        }
    }
    Some(())
}

/// Bundle adjustment over poses, points and the intrinsics that are free, whose models it returns; with camera
/// `reference` held and one coordinate of the scale left to the damping.
fn adjust(
    cameras: &[MovingPoints],
    members: &[usize],
    poses: &mut [Transform<Camera, World>],
    points: &mut [Option<Point<World>>],
    reference: usize,
    options: &MotionOptions,
) -> Option<Vec<CameraModel>> {
    let mut bundle = Bundle { cameras: Vec::new(), blocks: Vec::new(), sightings: Vec::new() };
    for (i, (m, pose)) in members.iter().zip(poses.iter()).enumerate() {
        let freedom = Freedom { pose: i != reference, intrinsics: options.intrinsics, ..Freedom::NOTHING };
        bundle.cameras.push(BundleCamera::new(cameras[*m].model, *pose, freedom));
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
                bundle.sightings.push(Sighting::new(camera, block, vec![Vector3::zeros()], vec![pixel]));
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
    bundle.solve(&SolveOptions { loss: LOSS, max_steps: 25 })?;
    for (pose, camera) in poses.iter_mut().zip(&bundle.cameras) {
        *pose = camera.camera_from_rig;
    }
    points.iter_mut().for_each(|p| *p = None);
    for (k, block) in block_of.into_iter().zip(&bundle.blocks) {
        points[k] = Some(*block);
    }
    Some(bundle.cameras.iter().map(|c| c.model).collect())
}
