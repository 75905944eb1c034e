use std::collections::BTreeMap;

use nalgebra::{Matrix3, Rotation3, SMatrix, Vector2, Vector3};
use netcord_common::{
    camera::{CameraModel, INTRINSICS},
    geometry::{Board, Camera, Point, Transform, World},
};

use super::{
    bundle::{Bundle, BundleCamera, Freedom, Sighting, SolveOptions},
    clocks::{Clock, clock_of, drop_unmoved, find_clocks, tells_of_clocks},
    error::CalibrationError,
    looks::{after_s, instant_ns},
    loss::Loss,
    mono::{Outlier, check_finite},
    pose::{FittedPose, board_pose},
    rejection::{RejectedView, compact, reject},
    views::{CameraViews, View},
};

/// How a rig is calibrated.
#[derive(Debug, Clone, PartialEq)]
pub struct RigOptions {
    /// Which intrinsics are refined together with the poses; none of them by default.
    pub free: [bool; INTRINSICS],
    /// Loss of each point.
    pub loss: Loss,
}

impl Default for RigOptions {
    fn default() -> Self {
        Self { free: [false; INTRINSICS], loss: Loss::Squares }
    }
}

/// A camera in its calibrated rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigMember {
    /// Name.
    pub name: String,
    /// Intrinsics, refined where they were free.
    pub model: CameraModel,
    /// Pose; the rig's frame is the first camera's.
    pub camera_from_first: Transform<Camera, World>,
    /// Covariance of the nine intrinsics and of the pose (rotation vector applied from the left in
    /// rad, translation in m); zero where fixed.
    pub covariance: SMatrix<f64, 15, 15>,
    /// The error of its clock, where that is significant; views must have stamps, and the board must move.
    pub clock: Option<Clock>,
    /// Views of it left out because its clock is off and nothing tells how the board moved in them.
    pub unmoved: usize,
}

/// How one camera's view of the board fits.
#[derive(Debug, Clone, PartialEq)]
pub struct RigViewFit {
    /// Index of the camera.
    pub camera: usize,
    /// The view's name.
    pub view: String,
    /// Observed − predicted of each point, in px.
    pub residuals: Vec<Vector2<f64>>,
}

/// A calibrated rig.
#[derive(Debug, Clone)]
pub struct RigCalibration {
    /// Cameras, in the order given.
    pub cameras: Vec<RigMember>,
    /// Poses of the board, by view.
    pub boards: BTreeMap<String, Transform<World, Board>>,
    /// Per 2D point over all cameras, in px.
    pub rms_px: f64,
    /// Standard deviation of one coordinate of a corner, from the residuals, in px.
    pub noise_px: f64,
    /// Every camera's every view that was used.
    pub views: Vec<RigViewFit>,
    /// Views left out, with the reason.
    pub rejected: Vec<RejectedView>,
    /// Points to look at; the view's name has the camera's before it.
    pub outliers: Vec<Outlier>,
    /// Whether the views tell anything of clocks: they have stamps, and the board moved in several.
    pub timed: bool,
}

/// Most views from which a pair's relative pose is guessed.
const MAX_CANDIDATES: usize = 40;

struct Seen {
    view: usize,
    pose: FittedPose,
    from: View,
}

/// Calibrates the poses of cameras from simultaneous views of boards, in one bundle adjustment; no
/// view needs all cameras, a chain of overlaps is enough. `models` are the cameras' intrinsics, in the
/// same order. Views that contradict the rest are rejected and named. Where views have stamps and the board moves,
/// a camera whose clock is off is found by that, and its corners are taken to the others' instants.
///
/// # Errors
/// [`CalibrationError`]: fewer than two cameras, cameras without common views.
///
/// # Panics
/// When `models` and `cameras` differ in length.
pub fn calibrate_rig(
    cameras: &[CameraViews],
    models: &[CameraModel],
    options: &RigOptions,
) -> Result<RigCalibration, CalibrationError> {
    assert_eq!(cameras.len(), models.len(), "one model per camera");
    if cameras.len() < 2 {
        return Err(CalibrationError::CameraCount { found: cameras.len(), needed: "at least two" });
    }
    cameras.iter().try_for_each(check_finite)?;
    let mut names: Vec<String> = Vec::new();
    let mut seen: Vec<Vec<Seen>> = Vec::new();
    for (camera, model) in cameras.iter().zip(models) {
        let mut own = Vec::new();
        for v in &camera.views {
            let Some(pose) = board_pose(model, &v.object, &v.image) else { continue };
            let view = names.iter().position(|n| *n == v.name).unwrap_or_else(|| {
                names.push(v.name.clone());
                names.len() - 1
            });
            own.push(Seen { view, pose, from: v.clone() });
        }
        seen.push(own);
    }
    let poses = chain(cameras, models, &seen)?;
    let refine = options.free.iter().any(|f| *f);

    let mut bundle = Bundle { cameras: Vec::new(), blocks: Vec::new(), sightings: Vec::new() };
    for (i, (model, pose)) in models.iter().zip(&poses).enumerate() {
        let freedom = Freedom { intrinsics: options.free, pose: i > 0, ..Freedom::NOTHING };
        bundle.cameras.push(BundleCamera::new(*model, *pose, freedom));
    }
    let mut view_of_block = Vec::new();
    for view in 0..names.len() {
        let by: Vec<(usize, &Seen)> = seen
            .iter()
            .enumerate()
            .flat_map(|(c, s)| s.iter().filter(|s| s.view == view).map(move |s| (c, s)))
            .collect();
        // A board that one camera alone sees says nothing of poses; it does of free intrinsics.
        if by.len() < 2 && !refine {
            continue;
        }
        let Some(board) =
            by.iter().map(|(c, s)| &poses[*c].inverse() * &s.pose.camera_from_board).min_by(|a, b| {
                let cost = |board: &Transform<World, Board>| -> f64 {
                    by.iter().map(|(c, s)| transfer_rms(&models[*c], &(&poses[*c] * board), s)).sum()
                };
                cost(a).total_cmp(&cost(b))
            })
        else {
            continue;
        };
        let instant = instant_ns(by.iter().map(|(_, s)| &s.from));
        for (camera, s) in by {
            let (object, pixels) = (s.from.object.clone(), s.from.image.clone());
            bundle.sightings.push(Sighting {
                motion: s.from.motion.clone(),
                after_s: after_s(&s.from, instant),
                ..Sighting::new(camera, bundle.blocks.len(), object, pixels)
            });
        }
        bundle.blocks.push(board);
        view_of_block.push(view);
    }
    let clocks = find_clocks(&bundle);
    let timed = tells_of_clocks(&bundle);
    for (camera, found) in bundle.cameras.iter_mut().zip(&clocks) {
        camera.later_s = found.later_s;
        camera.freedom.clock = found.later_s != 0.0;
    }
    let unmoved = drop_unmoved(&mut bundle);
    compact(&mut bundle, &mut view_of_block, refine);
    let rejected = reject(&mut bundle, &mut view_of_block, &names, cameras, refine)?;
    still_connected(cameras, &bundle)?;
    let all = || cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ");
    let not_converged = |rms_px| CalibrationError::NotConverged { camera: all(), rms_px };
    let solution = bundle
        .solve(&SolveOptions { loss: options.loss, ..SolveOptions::default() })
        .ok_or_else(|| not_converged(f64::INFINITY))?;
    let views: Vec<RigViewFit> = bundle
        .sightings
        .iter()
        .map(|s| {
            let view = names[view_of_block[s.block]].clone();
            let residuals = bundle.residuals(s).ok_or_else(|| CalibrationError::NoImage {
                camera: cameras[s.camera].name.clone(),
                view: view.clone(),
            })?;
            Ok(RigViewFit { camera: s.camera, view, residuals })
        })
        .collect::<Result<_, CalibrationError>>()?;
    let squares: f64 = views.iter().flat_map(|v| &v.residuals).map(Vector2::norm_squared).sum();
    let rms_px = (squares / bundle.points() as f64).sqrt();
    if !solution.converged {
        return Err(not_converged(rms_px));
    }
    let (equations, unknowns) = (2 * bundle.points(), bundle.unknowns());
    if equations <= unknowns {
        return Err(CalibrationError::Underdetermined { camera: all(), equations, unknowns });
    }
    let variance = squares / (equations - unknowns) as f64;
    let members = bundle
        .cameras
        .iter()
        .zip(cameras)
        .enumerate()
        .map(|(i, (state, views))| {
            let covariance = solution
                .camera_covariance(i, &state.model, &state.freedom, variance)
                .ok_or_else(|| CalibrationError::Undetermined {
                    camera: views.name.clone(),
                    parameter: "its pose or intrinsics",
                    sd: f64::INFINITY,
                    advice: "take more common views at different tilts, or keep the intrinsics fixed",
                })?;
            Ok(RigMember {
                name: views.name.clone(),
                model: state.model,
                camera_from_first: state.camera_from_rig,
                covariance,
                clock: clock_of(&bundle, &solution, i, variance, &clocks[i]),
                unmoved: unmoved[i],
            })
        })
        .collect::<Result<_, CalibrationError>>()?;
    let limit = 5.0 * variance.sqrt();
    let outliers = views
        .iter()
        .flat_map(|v| v.residuals.iter().enumerate().map(move |(point, r)| (v, point, r.norm())))
        .filter(|(_, _, r)| *r > limit && *r > 1e-6)
        .map(|(v, point, residual_px)| Outlier {
            view: format!("{}/{}", cameras[v.camera].name, v.view),
            point,
            residual_px,
        })
        .collect();
    let boards = view_of_block.iter().zip(&bundle.blocks).map(|(v, b)| (names[*v].clone(), *b)).collect();
    Ok(RigCalibration {
        cameras: members,
        boards,
        rms_px,
        noise_px: variance.sqrt(),
        views,
        rejected,
        outliers,
        timed,
    })
}

/// How far, RMS in px, a board at `camera_from_board` is from what was seen.
fn transfer_rms(model: &CameraModel, camera_from_board: &Transform<Camera, Board>, seen: &Seen) -> f64 {
    let mut squares = 0.0;
    for (object, pixel) in seen.from.object.iter().zip(&seen.from.image) {
        let Some(at) = model.project(&(camera_from_board * Point::from(*object))) else { return 1e6 };
        squares += (at - pixel).norm_squared();
    }
    (squares / seen.from.image.len() as f64).sqrt()
}

/// First poses of all cameras, from the first: a tree of pairs, those with the most common points
/// first (Prim), each pair's relative pose being the view's that most other views agree with.
fn chain(
    cameras: &[CameraViews],
    models: &[CameraModel],
    seen: &[Vec<Seen>],
) -> Result<Vec<Transform<Camera, World>>, CalibrationError> {
    let count = cameras.len();
    let mut poses: Vec<Option<Transform<Camera, World>>> = vec![None; count];
    poses[0] = Some(Transform::identity());
    let common = |a: usize, b: usize| -> Vec<(&Seen, &Seen)> {
        seen[a].iter().filter_map(|s| seen[b].iter().find(|t| t.view == s.view).map(|t| (s, t))).collect()
    };
    while poses.iter().any(Option::is_none) {
        let best = (0..count)
            .filter(|a| poses[*a].is_some())
            .flat_map(|a| (0..count).map(move |b| (a, b)))
            .filter(|&(_, b)| poses[b].is_none())
            .map(|(a, b)| {
                let pairs = common(a, b);
                (pairs.iter().map(|(s, t)| s.from.image.len().min(t.from.image.len())).sum::<usize>(), a, b)
            })
            .max_by_key(|&(points, a, b)| (points, std::cmp::Reverse((a, b))));
        let Some((points, a, b)) = best else { break };
        if points == 0 {
            let names = |connected: bool| {
                let those = (0..count).filter(|&i| poses[i].is_some() == connected);
                those.map(|i| cameras[i].name.as_str()).collect::<Vec<_>>().join(", ")
            };
            return Err(CalibrationError::NotConnected { camera: names(false), others: names(true) });
        }
        let pairs = common(a, b);
        let stride = pairs.len().div_ceil(MAX_CANDIDATES);
        let relative = pairs
            .iter()
            .step_by(stride)
            .map(|(s, t)| {
                let (to, from) = (&t.pose.camera_from_board, &s.pose.camera_from_board);
                let rotation = to.rotation * from.rotation.inverse();
                (rotation, to.translation - rotation * from.translation)
            })
            .min_by(|x, y| {
                median_transfer(x, models, &pairs, b).total_cmp(&median_transfer(y, models, &pairs, b))
            });
        if let (Some((rotation, translation)), Some(from)) = (relative, poses[a]) {
            poses[b] =
                Some(Transform::new(rotation * from.rotation, rotation * from.translation + translation));
        }
    }
    Ok(poses.into_iter().flatten().collect())
}

fn median_transfer(
    (rotation, translation): &(Rotation3<f64>, Vector3<f64>),
    models: &[CameraModel],
    pairs: &[(&Seen, &Seen)],
    b: usize,
) -> f64 {
    let mut errors: Vec<f64> = pairs
        .iter()
        .map(|(s, t)| {
            let from = &s.pose.camera_from_board;
            let there = Transform::new(rotation * from.rotation, rotation * from.translation + translation);
            transfer_rms(&models[b], &there, t)
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

fn still_connected(
    cameras: &[CameraViews],
    bundle: &Bundle<6, Transform<World, Board>>,
) -> Result<(), CalibrationError> {
    let mut group: Vec<bool> = (0..cameras.len()).map(|i| i == 0).collect();
    for _ in 0..cameras.len() {
        for block in 0..bundle.blocks.len() {
            let by: Vec<usize> =
                bundle.sightings.iter().filter(|s| s.block == block).map(|s| s.camera).collect();
            if by.iter().any(|c| group[*c]) {
                by.iter().for_each(|c| group[*c] = true);
            }
        }
    }
    let names = |connected: bool| {
        let those = cameras.iter().zip(&group).filter(|(_, g)| **g == connected);
        those.map(|(c, _)| c.name.as_str()).collect::<Vec<_>>().join(", ")
    };
    if group.iter().all(|g| *g) {
        Ok(())
    } else {
        Err(CalibrationError::NotConnected { camera: names(false), others: names(true) })
    }
}

impl RigMember {
    /// Standard deviation of the distance to the first camera, in m.
    pub fn baseline_sd_m(&self) -> f64 {
        let t = self.camera_from_first.translation;
        let along = if t.norm() > 0.0 { t.normalize() } else { return 0.0 };
        let c: Matrix3<f64> = self.covariance.fixed_view::<3, 3>(12, 12).into_owned();
        (along.transpose() * c * along)[0].max(0.0).sqrt()
    }
}
