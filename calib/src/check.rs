//! What a calibration is worth today: fresh views of a board, and a rod of known length, against a rig as it
//! stands in its file.

use nalgebra::{Matrix3, Vector2, Vector3};
use netcord_common::geometry::{Board, Camera, Point, Transform, World};
use serde::Serialize;

use crate::{
    solve::{
        Bundle, BundleCamera, CameraViews, Freedom, Loss, MovingPoints, Sighting, SolveOptions, board_pose,
    },
    table::TableCamera,
};

/// How far a rig may be off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Median residual of a camera's corners in the board's common pose, px.
    pub reprojection_px: f64,
    /// Median epipolar distance of a pair, px.
    pub epipolar_px: f64,
    /// Error of a rod's length, as a share of it.
    pub length: f64,
}

impl Default for Limits {
    /// What a rig that was calibrated well keeps in daily use: half a pixel, and two in a thousand.
    fn default() -> Self {
        Self { reprojection_px: 0.5, epipolar_px: 0.5, length: 2e-3 }
    }
}

/// Median, 95th percentile and largest of some errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// How many.
    pub count: usize,
    /// Root mean square.
    pub rms: f64,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Largest.
    pub max: f64,
}

impl Spread {
    /// Of the absolute values; `None` of none.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = values.into_iter().map(f64::abs).collect();
        sorted.sort_by(f64::total_cmp);
        let count = sorted.len();
        let rank =
            |share: f64| sorted.get((share * count.saturating_sub(1) as f64).round() as usize).copied();
        let rms = (sorted.iter().map(|v| v * v).sum::<f64>() / count.max(1) as f64).sqrt();
        Some(Self { count, rms, median: rank(0.5)?, p95: rank(0.95)?, max: rank(1.0)? })
    }
}

/// One camera's part in a check by boards.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraCheck {
    /// The camera.
    pub camera: String,
    /// Views of the board.
    pub views: usize,
    /// Residuals when each view's board may lie where this camera alone wants it, px: what its intrinsics
    /// are worth.
    pub own_px: Option<Spread>,
    /// Residuals against the pose of the board that all cameras share, px; absent when no other camera saw it.
    pub common_px: Option<Spread>,
}

/// The epipolar error of a pair of cameras.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairCheck {
    /// The cameras.
    pub cameras: [String; 2],
    /// Distance of corners that both see from the epipolar lines (Sampson), px.
    pub epipolar_px: Spread,
}

/// A rod's lengths.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RodCheck {
    /// The true length, m.
    pub length_m: f64,
    /// Median of the measured ones, m.
    pub median_m: f64,
    /// Differences from the true length, m.
    pub error_m: Spread,
    /// (median − true) / true.
    pub scale_error: f64,
    /// The middle of the rod (m, in the first camera's frame) and its length's error (m), for each instant.
    pub places: Vec<([f64; 3], f64)>,
}

/// The whole check.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Check {
    /// Each camera, by boards.
    pub cameras: Vec<CameraCheck>,
    /// Each pair that saw corners in common.
    pub pairs: Vec<PairCheck>,
    /// Distances between a board's corners as the rig measures them, over the true ones, less one: the scale's
    /// error, by corners that two cameras or more see.
    pub board_scale_error: Option<f64>,
    /// The rod.
    pub rod: Option<RodCheck>,
    /// What to do again, in words; empty when all is well.
    pub redo: Vec<String>,
}

/// One camera's residual of a corner, for plots.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CheckedCorner {
    /// Index of the camera.
    pub camera: usize,
    /// Its pixel.
    pub pixel: Vector2<f64>,
    /// Observed − predicted by the board's common pose, px.
    pub residual: Vector2<f64>,
}

/// Checks a rig against views of boards; views of one name are simultaneous. `views` go with `cameras` by
/// place. Returns the residuals too.
///
/// # Panics
/// When `cameras` and `views` differ in length.
pub fn check_boards(
    cameras: &[TableCamera],
    views: &[CameraViews],
    limits: &Limits,
) -> (Check, Vec<CheckedCorner>) {
    assert_eq!(cameras.len(), views.len(), "views for each camera");
    let mut own: Vec<Vec<f64>> = vec![Vec::new(); cameras.len()];
    let mut corners: Vec<CheckedCorner> = Vec::new();
    let mut names: Vec<&str> = Vec::new();
    for (camera, (model, seen)) in cameras.iter().map(|c| &c.model).zip(views).enumerate() {
        for view in &seen.views {
            if let Some(fit) = board_pose(model, &view.object, &view.image) {
                let off = view.object.iter().zip(&view.image).filter_map(|(o, p)| {
                    Some((model.project(&(&fit.camera_from_board * Point::from(*o)))? - p).norm())
                });
                own[camera].extend(off);
            }
            if !names.contains(&view.name.as_str()) {
                names.push(&view.name);
            }
        }
    }
    let mut lengths: Vec<f64> = Vec::new();
    for name in names {
        let by: Vec<_> = views
            .iter()
            .enumerate()
            .filter_map(|(c, v)| v.views.iter().find(|v| v.name == name).map(|v| (c, v)))
            .collect();
        if by.len() < 2 {
            continue;
        }
        lengths.extend(measured_lengths(cameras, &by));
        corners.extend(against_common_pose(cameras, &by));
    }
    let camera_checks: Vec<CameraCheck> = cameras
        .iter()
        .enumerate()
        .map(|(i, c)| CameraCheck {
            camera: c.name.clone(),
            views: views[i].views.len(),
            own_px: Spread::of(own[i].iter().copied()),
            common_px: Spread::of(corners.iter().filter(|k| k.camera == i).map(|k| k.residual.norm())),
        })
        .collect();
    let mut pairs = Vec::new();
    for b in 1..cameras.len() {
        for a in 0..b {
            let distances = common(&views[a], &views[b])
                .filter_map(|(p, q)| epipolar_px(&cameras[a], &cameras[b], &p, &q));
            if let Some(epipolar_px) = Spread::of(distances) {
                let cameras = [a, b].map(|i| cameras[i].name.clone());
                pairs.push(PairCheck { cameras, epipolar_px });
            }
        }
    }
    let board_scale_error = Spread::of(lengths.iter().copied()).map(|s| s.median - 1.0);
    let mut check = Check { cameras: camera_checks, pairs, board_scale_error, rod: None, redo: Vec::new() };
    check.redo = redo(&check, limits);
    (check, corners)
}

/// Checks a rig against a rod of known length: `ends` gives, for each instant, the places of its two ends in
/// the lists of `points`, which go with `cameras` by place.
pub fn check_rod(
    cameras: &[TableCamera],
    points: &[MovingPoints],
    ends: impl Iterator<Item = (usize, usize)>,
    length_m: f64,
) -> Option<RodCheck> {
    let triangulated = |k: usize| {
        let seen = cameras.iter().zip(points).filter_map(|(c, p)| Some((c, (*p.pixels.get(k)?)?)));
        triangulate(seen)
    };
    let places: Vec<([f64; 3], f64)> = ends
        .filter_map(|(a, b)| {
            let (a, b) = (triangulated(a)?, triangulated(b)?);
            Some((((a + b) * 0.5).into(), (a - b).norm() - length_m))
        })
        .collect();
    let error_m = Spread::of(places.iter().map(|p| p.1))?;
    let mut signed: Vec<f64> = places.iter().map(|p| p.1).collect();
    signed.sort_by(f64::total_cmp);
    let median_m = length_m + signed[signed.len() / 2];
    Some(RodCheck { length_m, median_m, error_m, scale_error: median_m / length_m - 1.0, places })
}

impl Check {
    /// Adds a rod's result, and what follows from it.
    pub fn add_rod(&mut self, rod: RodCheck, limits: &Limits) {
        self.rod = Some(rod);
        self.redo = redo(self, limits);
    }
}

/// Corners that both cameras see in simultaneous views: same object point.
fn common<'a>(
    a: &'a CameraViews,
    b: &'a CameraViews,
) -> impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> + 'a {
    a.views.iter().filter_map(|v| b.views.iter().find(|w| w.name == v.name).map(|w| (v, w))).flat_map(
        |(v, w)| {
            v.object.iter().zip(&v.image).filter_map(|(o, p)| {
                let other = w.object.iter().position(|x| (x - o).norm() < 1e-9)?;
                Some((*p, w.image[other]))
            })
        },
    )
}

/// Sampson's distance, px, of a pair of pixels to the epipolar geometry of two calibrated cameras; `None`
/// outside the lens models.
pub fn epipolar_px(a: &TableCamera, b: &TableCamera, p: &Vector2<f64>, q: &Vector2<f64>) -> Option<f64> {
    let rotation = b.camera_from_first.rotation * a.camera_from_first.rotation.inverse();
    let translation = b.camera_from_first.translation - rotation * a.camera_from_first.translation;
    let essential: Matrix3<f64> = translation.cross_matrix() * rotation.matrix();
    let (x, y) = (a.model.undistort(p)?, b.model.undistort(q)?);
    let (x, y) = (Vector3::new(x.x, x.y, 1.0), Vector3::new(y.x, y.y, 1.0));
    let (forth, back) = (essential * x, essential.transpose() * y);
    let slope = (forth.xy().norm_squared() + back.xy().norm_squared()).sqrt();
    let focal = 0.25 * (a.model.fx + a.model.fy + b.model.fx + b.model.fy);
    (slope > 0.0).then(|| y.dot(&forth).abs() / slope * focal)
}

fn triangulate<'a>(seen: impl Iterator<Item = (&'a TableCamera, Vector2<f64>)>) -> Option<Vector3<f64>> {
    nearest_point(seen.filter_map(|(c, pixel)| Some((&c.camera_from_first, c.model.ray(&pixel)?))))
}

/// The point, in the frame that the poses start from, of least squared distance to the rays (unit directions in
/// their cameras' frames) of two cameras or more; `None` for fewer, or for parallel rays.
pub fn nearest_point<'a>(
    rays: impl Iterator<Item = (&'a Transform<Camera, World>, Vector3<f64>)>,
) -> Option<Vector3<f64>> {
    let (mut normal, mut rhs, mut count) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros(), 0);
    for (pose, ray) in rays {
        let along = pose.rotation.inverse() * ray;
        let across = Matrix3::identity() - along * along.transpose();
        normal += across;
        rhs += across * pose.origin().coords;
        count += 1;
    }
    if count < 2 || normal.symmetric_eigenvalues().min() < 1e-4 {
        return None;
    }
    Some(normal.try_inverse()? * rhs)
}

type Seen<'a> = (usize, &'a crate::solve::View);

/// Ratios of measured to true distances between corners far apart on the board.
fn measured_lengths(cameras: &[TableCamera], by: &[Seen<'_>]) -> Vec<f64> {
    let mut points: Vec<(Vector3<f64>, Vector3<f64>)> = Vec::new();
    for (c, view) in by {
        for (o, _) in view.object.iter().zip(&view.image) {
            if points.iter().any(|(p, _)| (p - o).norm() < 1e-9) {
                continue;
            }
            let seen = by.iter().filter(|(d, _)| d >= c).filter_map(|(d, w)| {
                let k = w.object.iter().position(|x| (x - o).norm() < 1e-9)?;
                Some((&cameras[*d], w.image[k]))
            });
            if let Some(at) = triangulate(seen) {
                points.push((*o, at));
            }
        }
    }
    let far = points.iter().flat_map(|a| points.iter().map(move |b| (a.0 - b.0).norm())).fold(0.0, f64::max);
    let mut ratios = Vec::new();
    for (i, a) in points.iter().enumerate() {
        for b in &points[..i] {
            let length = (a.0 - b.0).norm();
            if length > 0.6 * far {
                ratios.push((a.1 - b.1).norm() / length);
            }
        }
    }
    ratios
}

/// Residuals of all corners of one instant against the one pose of the board that fits them best, robustly.
fn against_common_pose(cameras: &[TableCamera], by: &[Seen<'_>]) -> Vec<CheckedCorner> {
    let starts = by.iter().filter_map(|(c, v)| {
        let fit = board_pose(&cameras[*c].model, &v.object, &v.image)?;
        Some(&cameras[*c].camera_from_first.inverse() * &fit.camera_from_board)
    });
    let mut bundle: Bundle<6, Transform<World, Board>> = Bundle {
        cameras: cameras
            .iter()
            .map(|c| BundleCamera::new(c.model, c.camera_from_first, Freedom::NOTHING))
            .collect(),
        blocks: Vec::new(),
        sightings: by.iter().map(|(c, v)| Sighting::new(*c, 0, v.object.clone(), v.image.clone())).collect(),
    };
    let loss = Loss::Huber { scale_px: 1.0 };
    let best = starts
        .filter_map(|start| {
            let mut tried = bundle.clone();
            tried.blocks = vec![start];
            let cost = tried.solve(&SolveOptions { loss, max_steps: 60 })?.cost;
            Some((cost, tried))
        })
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, solved)) = best else { return Vec::new() };
    bundle = solved;
    bundle
        .sightings
        .iter()
        .filter_map(|s| bundle.residuals(s).map(|r| (s, r)))
        .flat_map(|(s, residuals)| {
            s.pixels.iter().zip(residuals).map(move |(pixel, residual)| CheckedCorner {
                camera: s.camera,
                pixel: *pixel,
                residual,
            })
        })
        .collect()
}

/// What the figures ask for.
fn redo(check: &Check, limits: &Limits) -> Vec<String> {
    let mut advice = Vec::new();
    let bad_own = |c: &&CameraCheck| c.own_px.is_some_and(|s| s.median > limits.reprojection_px);
    for c in check.cameras.iter().filter(bad_own) {
        let own = c.own_px.map_or(0.0, |s| s.median);
        advice.push(format!(
            "camera {}: its intrinsics no longer fit ({own:.2} px by itself): was the lens turned or \
             focused? Run `netcord calib mono`",
            c.camera
        ));
    }
    let bad_pair = |p: &&PairCheck| p.epipolar_px.median > limits.epipolar_px;
    let bad: Vec<&PairCheck> = check.pairs.iter().filter(bad_pair).collect();
    if !bad.is_empty() {
        let moved = check.cameras.iter().filter(|c| !bad_own(c)).find(|c| {
            let with = check.pairs.iter().filter(|p| p.cameras.contains(&c.camera));
            let without_bad = bad.iter().all(|p| p.cameras.contains(&c.camera));
            without_bad && with.clone().count() >= 2 && with.clone().all(|p| bad_pair(&p))
        });
        let worst = bad.iter().map(|p| p.epipolar_px.median).fold(0.0, f64::max);
        match moved {
            Some(c) => advice.push(format!(
                "camera {} has moved: its pairs are up to {worst:.2} px off, all others fit. Run `netcord calib rig`",
                c.camera
            )),
            None => {
                let names: Vec<String> = bad.iter().map(|p| p.cameras.join(" and ")).collect();
                advice.push(format!(
                    "{}: up to {worst:.2} px off the epipolar lines; a camera has moved, or they are not \
                     synchronised. Run `netcord calib rig`",
                    names.join("; ")
                ));
            }
        }
    }
    let poses_off = check
        .cameras
        .iter()
        .filter(|c| !bad_own(c) && c.common_px.is_some_and(|s| s.median > limits.reprojection_px))
        .map(|c| c.camera.as_str())
        .collect::<Vec<_>>();
    if bad.is_empty() && !poses_off.is_empty() {
        advice.push(format!(
            "cameras {}: boards are off along the epipolar lines: a lens, or the distance between cameras, has \
             changed. Run `netcord calib mono`, then `netcord calib rig`",
            poses_off.join(", ")
        ));
    }
    if let Some(off) = check.board_scale_error.filter(|off| off.abs() > limits.length) {
        advice.push(format!(
            "lengths on the board come out {:+.2} % wrong: was a board of another size given now, or at \
             calibration? Measure its ruler, run `netcord calib rig`",
            100.0 * off
        ));
    }
    if let Some(rod) = &check.rod {
        if rod.scale_error.abs() > limits.length {
            advice.push(format!(
                "the rod comes out {:+.2} % wrong ({:.1} mm instead of {:.1} mm): the rig's scale is \
                 wrong. Measure the board's ruler, run `netcord calib rig`",
                100.0 * rod.scale_error,
                rod.median_m * 1e3,
                rod.length_m * 1e3
            ));
        } else if rod.error_m.p95 > 5.0 * limits.length * rod.length_m {
            advice.push(format!(
                "the rod's length varies by {:.1} mm (95 %): see in the plot where, and calibrate with boards there",
                rod.error_m.p95 * 1e3
            ));
        }
    }
    advice
}
