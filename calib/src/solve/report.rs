//! Reports as JSON: `rms_px`, parameters with standard deviations, per-view errors, poses.

use std::collections::BTreeMap;

use nalgebra::Vector2;
use serde::Serialize;

use super::{
    mono::{INTRINSIC_NAMES, MonoCalibration, Outlier},
    rig::RigCalibration,
    validate::CrossValidation,
};

/// A value and its standard deviation; zero where the value was fixed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Uncertain {
    /// The value.
    pub value: f64,
    /// Standard deviation.
    pub sd: f64,
}

/// One view's error.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewReport {
    /// Name.
    pub view: String,
    /// Points used.
    pub points: usize,
    /// Per 2D point, px.
    pub rms_px: f64,
    /// Largest residual, px.
    pub max_px: f64,
}

/// A point that fits badly.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OutlierReport {
    /// The view.
    pub view: String,
    /// Index of the point in the view.
    pub point: usize,
    /// Length of the residual, px.
    pub residual_px: f64,
}

/// One camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraReport {
    /// Width and height, px.
    pub size: [u32; 2],
    /// Per 2D point of this camera, px.
    pub rms_px: f64,
    /// fx fy cx cy k1 k2 p1 p2 k3.
    pub parameters: BTreeMap<&'static str, Uncertain>,
    /// 9 × 9, in the order fx fy cx cy k1 k2 p1 p2 k3.
    pub covariance: Vec<Vec<f64>>,
    /// Each view.
    pub views: Vec<ViewReport>,
    /// Points beyond five standard deviations.
    pub outliers: Vec<OutlierReport>,
    /// Share of the cells of a 8 × 6 grid over the image that hold a corner, 0–1.
    pub coverage: f64,
    /// Standard deviation, worst direction, of a far point's pixel: `[u, v, sd_px]` over the image;
    /// cells without an inverse of the lens are left out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub projection_sd_px: Vec<[f64; 3]>,
    /// By views left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cross_validation: Option<CrossValidation>,
    /// 3 × 3 of X_camera = R X_first + T; absent for mono.
    #[serde(rename = "R", skip_serializing_if = "Option::is_none")]
    pub r: Option<[[f64; 3]; 3]>,
    /// Metres.
    #[serde(rename = "T", skip_serializing_if = "Option::is_none")]
    pub t: Option<[f64; 3]>,
    /// Standard deviations of the rotation vector (rad) and of T (m).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose_sd: Option<[f64; 6]>,
    /// How much later than the others' of the same stamp its frames were exposed, s (negative: earlier); absent
    /// where its clock is right, or nothing tells.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposed_later_s: Option<Uncertain>,
}

/// The whole report of `netcord calib mono|stereo|rig`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// `mono`, `stereo` or `rig`.
    pub kind: &'static str,
    /// Per 2D point, over all cameras, px.
    pub rms_px: f64,
    /// By name.
    pub cameras: BTreeMap<String, CameraReport>,
    /// Names in the order given; the first is the frame of reference.
    pub order: Vec<String>,
    /// For two cameras: X₂ = R X₁ + T.
    #[serde(rename = "R", skip_serializing_if = "Option::is_none")]
    pub r: Option<[[f64; 3]; 3]>,
    /// Metres.
    #[serde(rename = "T", skip_serializing_if = "Option::is_none")]
    pub t: Option<[f64; 3]>,
    /// Standard deviations of the rotation vector (rad) and of T (m).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose_sd: Option<[f64; 6]>,
    /// |T|, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub baseline_m: Option<Uncertain>,
    /// Views that contradict the others and took no part.
    pub rejected: Vec<RejectedReport>,
}

/// A view that took no part.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RejectedReport {
    /// The view.
    pub view: String,
    /// The camera, where known.
    pub camera: Option<String>,
    /// Why.
    pub reason: String,
}

fn view_report(view: &str, residuals: &[Vector2<f64>]) -> ViewReport {
    let squares: f64 = residuals.iter().map(Vector2::norm_squared).sum();
    ViewReport {
        view: view.to_owned(),
        points: residuals.len(),
        rms_px: (squares / residuals.len().max(1) as f64).sqrt(),
        max_px: residuals.iter().map(Vector2::norm).fold(0.0, f64::max),
    }
}

fn outlier_reports(outliers: &[Outlier]) -> Vec<OutlierReport> {
    outliers
        .iter()
        .map(|o| OutlierReport { view: o.view.clone(), point: o.point, residual_px: o.residual_px })
        .collect()
}

fn parameters(values: [f64; 9], sd: impl Fn(usize) -> f64) -> BTreeMap<&'static str, Uncertain> {
    INTRINSIC_NAMES.iter().enumerate().map(|(i, n)| (*n, Uncertain { value: values[i], sd: sd(i) })).collect()
}

/// Share of the cells of an 8 × 6 grid over the image that hold one of `pixels`.
pub fn coverage(size: (u32, u32), pixels: impl Iterator<Item = Vector2<f64>>) -> f64 {
    const GRID: (usize, usize) = (8, 6);
    let mut cells = [[false; GRID.0]; GRID.1];
    let cell = |at: f64, size: u32, count: usize| {
        ((at + 0.5) / f64::from(size) * count as f64).clamp(0.0, count as f64 - 1.0) as usize
    };
    for p in pixels {
        cells[cell(p.y, size.1, GRID.1)][cell(p.x, size.0, GRID.0)] = true;
    }
    cells.iter().flatten().filter(|c| **c).count() as f64 / (GRID.0 * GRID.1) as f64
}

/// Rows of a matrix.
fn rows<const N: usize>(m: &nalgebra::SMatrix<f64, N, N>) -> Vec<Vec<f64>> {
    (0..N).map(|i| m.row(i).iter().copied().collect()).collect()
}

impl Report {
    /// Of cameras calibrated one by one.
    pub fn of_mono(cameras: &[(MonoCalibration, f64, Option<CrossValidation>)]) -> Self {
        let (mut squares, mut points) = (0.0, 0usize);
        let mut reports = BTreeMap::new();
        for (c, coverage, validation) in cameras {
            let count: usize = c.views.iter().map(|v| v.residuals.len()).sum();
            squares += c.rms_px * c.rms_px * count as f64;
            points += count;
            let sd = c.standard_deviations();
            reports.insert(
                c.name.clone(),
                CameraReport {
                    size: [c.model.width, c.model.height],
                    rms_px: c.rms_px,
                    parameters: parameters(c.model.parameters(), |i| sd[i]),
                    covariance: rows(&c.covariance),
                    views: c.views.iter().map(|v| view_report(&v.name, &v.residuals)).collect(),
                    outliers: outlier_reports(&c.outliers),
                    coverage: *coverage,
                    projection_sd_px: c
                        .uncertainty
                        .grid(16, 10)
                        .into_iter()
                        .filter_map(|(u, v, sd)| sd.map(|sd| [u, v, sd]))
                        .collect(),
                    cross_validation: validation.clone(),
                    r: None,
                    t: None,
                    pose_sd: None,
                    exposed_later_s: None,
                },
            );
        }
        Self {
            kind: "mono",
            rms_px: (squares / points.max(1) as f64).sqrt(),
            cameras: reports,
            order: cameras.iter().map(|(c, ..)| c.name.clone()).collect(),
            r: None,
            t: None,
            pose_sd: None,
            baseline_m: None,
            rejected: Vec::new(),
        }
    }

    /// Of a rig; `coverage` per camera.
    pub fn of_rig(kind: &'static str, rig: &RigCalibration, coverage: &[f64]) -> Self {
        let mut reports = BTreeMap::new();
        for (i, c) in rig.cameras.iter().enumerate() {
            let own: Vec<_> = rig.views.iter().filter(|v| v.camera == i).collect();
            let all: Vec<Vector2<f64>> = own.iter().flat_map(|v| v.residuals.iter().copied()).collect();
            let prefix = format!("{}/", c.name);
            let intrinsics = c.covariance.fixed_view::<9, 9>(0, 0).into_owned();
            reports.insert(
                c.name.clone(),
                CameraReport {
                    size: [c.model.width, c.model.height],
                    rms_px: view_report("", &all).rms_px,
                    parameters: parameters(c.model.parameters(), |k| c.covariance[(k, k)].max(0.0).sqrt()),
                    covariance: rows(&intrinsics),
                    views: own.iter().map(|v| view_report(&v.view, &v.residuals)).collect(),
                    outliers: outlier_reports(&rig.outliers)
                        .into_iter()
                        .filter_map(|o| {
                            o.view
                                .strip_prefix(&prefix)
                                .map(str::to_owned)
                                .map(|view| OutlierReport { view, ..o })
                        })
                        .collect(),
                    coverage: coverage.get(i).copied().unwrap_or(0.0),
                    projection_sd_px: Vec::new(),
                    cross_validation: None,
                    r: Some(c.camera_from_first.rotation.matrix().transpose().into()),
                    t: Some(c.camera_from_first.translation.into()),
                    pose_sd: Some(std::array::from_fn(|k| c.covariance[(9 + k, 9 + k)].max(0.0).sqrt())),
                    exposed_later_s: c.clock.as_ref().map(|k| Uncertain { value: k.later_s, sd: k.sd_s }),
                },
            );
        }
        let second = (rig.cameras.len() == 2).then(|| &rig.cameras[1]);
        let pair = second.and_then(|c| reports.get(&c.name));
        Self {
            kind,
            rms_px: rig.rms_px,
            r: pair.and_then(|p| p.r),
            t: pair.and_then(|p| p.t),
            pose_sd: pair.and_then(|p| p.pose_sd),
            baseline_m: second
                .map(|c| Uncertain { value: c.camera_from_first.translation.norm(), sd: c.baseline_sd_m() }),
            cameras: reports,
            order: rig.cameras.iter().map(|c| c.name.clone()).collect(),
            rejected: rig
                .rejected
                .iter()
                .map(|r| RejectedReport {
                    view: r.view.clone(),
                    camera: r.camera.clone(),
                    reason: r.reason(),
                })
                .collect(),
        }
    }
}
