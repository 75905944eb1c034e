use nalgebra::{SMatrix, Vector2, Vector3};
use netcord_common::{
    camera::{CameraModel, INTRINSICS},
    geometry::{Board, Camera, Transform, World},
};

use super::{
    bundle::{Bundle, BundleCamera, Freedom, Sighting, SolveOptions},
    error::CalibrationError,
    loss::Loss,
    pose::{Plane, board_pose},
    uncertainty::ProjectionUncertainty,
    views::{CameraViews, View},
    zhang,
};

/// Names of the intrinsics, in the order of [`CameraModel::parameters`].
pub const INTRINSIC_NAMES: [&str; INTRINSICS] = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"];

/// How a camera is calibrated.
#[derive(Debug, Clone, PartialEq)]
pub struct MonoOptions {
    /// Which intrinsics are solved for; a fixed one keeps the value of `start`, or of a pinhole camera.
    pub free: [bool; INTRINSICS],
    /// Whether fx / fy keeps the start's value (1 without a start).
    pub tie_aspect: bool,
    /// Where to start, instead of Zhang's closed form.
    pub start: Option<CameraModel>,
    /// Loss of each point.
    pub loss: Loss,
}

impl Default for MonoOptions {
    fn default() -> Self {
        Self { free: [true; INTRINSICS], tie_aspect: false, start: None, loss: Loss::Squares }
    }
}

/// How well one view fits.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewFit {
    /// The view's name.
    pub name: String,
    /// Pose of the board.
    pub camera_from_board: Transform<Camera, Board>,
    /// Observed − predicted of each point, in px.
    pub residuals: Vec<Vector2<f64>>,
}

impl ViewFit {
    /// Root mean square of the residuals' lengths, in px.
    pub fn rms_px(&self) -> f64 {
        (self.residuals.iter().map(Vector2::norm_squared).sum::<f64>() / self.residuals.len() as f64).sqrt()
    }
}

/// A point that fits far worse than the others.
#[derive(Debug, Clone, PartialEq)]
pub struct Outlier {
    /// The view.
    pub view: String,
    /// Index of the point in the view.
    pub point: usize,
    /// Length of its residual, in px.
    pub residual_px: f64,
}

/// A calibrated camera.
#[derive(Debug, Clone)]
pub struct MonoCalibration {
    /// The camera's name.
    pub name: String,
    /// The intrinsics.
    pub model: CameraModel,
    /// Covariance of `fx fy cx cy k1 k2 p1 p2 k3` (px and 1), for the noise found in the residuals;
    /// zero where fixed.
    pub covariance: SMatrix<f64, INTRINSICS, INTRINSICS>,
    /// Standard deviation of one coordinate of a corner, estimated from the residuals, in px.
    pub noise_px: f64,
    /// Per 2D point, in px.
    pub rms_px: f64,
    /// Each view.
    pub views: Vec<ViewFit>,
    /// Points to look at.
    pub outliers: Vec<Outlier>,
    /// Uncertainty of a projected pixel over the image.
    pub uncertainty: ProjectionUncertainty,
    /// Steps of the solver.
    pub steps: usize,
}

impl MonoCalibration {
    /// Standard deviations of `fx fy cx cy k1 k2 p1 p2 k3`; zero where fixed.
    pub fn standard_deviations(&self) -> [f64; INTRINSICS] {
        std::array::from_fn(|i| self.covariance[(i, i)].max(0.0).sqrt())
    }
}

/// Fewest views: each plane gives two equations for the four pinhole parameters, and a third view
/// shows whether the first two were right.
const MIN_VIEWS: usize = 3;

/// Below this angle between all boards' normals the views are alike: the focal length then trades
/// against distance and tilt.
const MIN_TILT_SPREAD_DEG: f64 = 4.0;

/// Calibrates one camera from views of planar objects.
///
/// Minimises Σ ρ(|observed − predicted|²) over intrinsics and board poses. Views with fewer than four
/// points, or whose points lie on a line, are left out.
///
/// # Errors
/// [`CalibrationError`]: too few views, views all alike, an unknown that the views do not determine.
pub fn calibrate_mono(
    camera: &CameraViews,
    options: &MonoOptions,
) -> Result<MonoCalibration, CalibrationError> {
    let name = || camera.name.clone();
    check_finite(camera)?;
    let usable: Vec<View> = camera.views.iter().filter(|v| Plane::of(&v.object).is_some()).cloned().collect();
    if usable.len() < MIN_VIEWS {
        return Err(CalibrationError::TooFewViews { camera: name(), found: usable.len(), needed: MIN_VIEWS });
    }
    let model = match options.start {
        Some(start) => start,
        None => zhang::start(camera.size, &usable).ok_or_else(|| CalibrationError::TooFewViews {
            camera: name(),
            found: 0,
            needed: MIN_VIEWS,
        })?,
    };
    let model = if options.tie_aspect && options.start.is_none() {
        let f = (model.fx * model.fy).sqrt();
        let mut p = model.parameters();
        (p[0], p[1]) = (f, f);
        model.with_parameters(p).unwrap_or(model)
    } else {
        model
    };
    let mut fitted = usable;
    let poses: Vec<Option<Transform<Camera, Board>>> =
        fitted.iter().map(|v| board_pose(&model, &v.object, &v.image).map(|f| f.camera_from_board)).collect();
    let mut kept = poses.iter().map(Option::is_some);
    fitted.retain(|_| kept.next().unwrap_or(false));
    let blocks: Vec<_> = poses
        .into_iter()
        .flatten()
        .map(|p| Transform::<World, Board>::new(p.rotation, p.translation))
        .collect();
    if fitted.len() < MIN_VIEWS {
        return Err(CalibrationError::TooFewViews { camera: name(), found: fitted.len(), needed: MIN_VIEWS });
    }
    let freedom = Freedom { intrinsics: options.free, tie_aspect: options.tie_aspect, ..Freedom::NOTHING };
    let mut bundle = Bundle {
        cameras: vec![BundleCamera::new(model, Transform::identity(), freedom.clone())],
        blocks,
        sightings: sightings_of(0, &fitted, 0),
    };
    let (equations, unknowns) = (2 * bundle.points(), bundle.unknowns());
    if equations <= unknowns {
        return Err(CalibrationError::Underdetermined { camera: name(), equations, unknowns });
    }
    let solution = solve_staged(&mut bundle, options.loss)
        .ok_or_else(|| CalibrationError::NotConverged { camera: name(), rms_px: f64::INFINITY })?;

    let spread_deg = tilt_spread_deg(&bundle.blocks, &fitted);
    let pinhole_free = options.free[..4].iter().any(|f| *f);
    if pinhole_free && spread_deg < MIN_TILT_SPREAD_DEG {
        return Err(CalibrationError::Alike { camera: name(), spread_deg });
    }
    let views = fits(&bundle, &fitted, &camera.name)?;
    let squares: f64 = views.iter().flat_map(|v| &v.residuals).map(Vector2::norm_squared).sum();
    let rms_px = (squares / bundle.points() as f64).sqrt();
    if !solution.converged {
        return Err(CalibrationError::NotConverged { camera: name(), rms_px });
    }
    let variance = match options.loss {
        Loss::Squares => squares / (equations - unknowns) as f64,
        _ => robust_variance(&views),
    };
    let model = bundle.cameras[0].model;
    let covariance = solution
        .camera_covariance(0, &model, &freedom, variance)
        .ok_or_else(|| CalibrationError::Undetermined {
            camera: name(),
            parameter: "an intrinsic parameter",
            sd: f64::INFINITY,
            advice: "take views at more tilts and distances that reach the image's corners, or fix it",
        })?
        .fixed_view::<INTRINSICS, INTRINSICS>(0, 0)
        .into_owned();
    for (i, &parameter) in INTRINSIC_NAMES.iter().enumerate().take(2) {
        let sd = covariance[(i, i)].sqrt();
        if sd > 0.2 * model.parameters()[i] {
            return Err(CalibrationError::Undetermined {
                camera: name(),
                parameter,
                sd,
                advice: "tilt the board more, in different directions",
            });
        }
    }
    let outliers = find_outliers(&views);
    let uncertainty = ProjectionUncertainty::new(&bundle, 0, covariance)
        .ok_or_else(|| CalibrationError::NotConverged { camera: name(), rms_px })?;
    Ok(MonoCalibration {
        name: name(),
        model,
        covariance,
        noise_px: variance.sqrt(),
        rms_px,
        views,
        outliers,
        uncertainty,
        steps: solution.steps,
    })
}

/// Solves with the radial terms opened one after the other when all at once fails: far from the
/// solution a high polynomial can fold points out of the image.
fn solve_staged(
    bundle: &mut Bundle<6, Transform<World, Board>>,
    loss: Loss,
) -> Option<super::bundle::Solution> {
    let start = bundle.clone();
    let options = SolveOptions { loss, ..SolveOptions::default() };
    let direct = bundle.solve(&options)?;
    let rms = |b: &Bundle<6, _>, cost: f64| (cost / b.points() as f64).sqrt();
    if direct.converged && rms(bundle, direct.cost) < 2.0 {
        return Some(direct);
    }
    let mut staged = start;
    let wanted = staged.cameras[0].freedom.clone();
    for closed in [&[4usize, 5, 6, 7, 8][..], &[5, 8], &[8], &[]] {
        staged.cameras[0].freedom = wanted.clone();
        for &i in closed {
            staged.cameras[0].freedom.intrinsics[i] = false;
        }
        let solution = staged.solve(&options)?;
        if closed.is_empty() && solution.cost < direct.cost {
            *bundle = staged;
            return Some(solution);
        }
    }
    Some(direct)
}

/// Sightings of `views` by `camera`, of the blocks from `first` on.
pub(crate) fn sightings_of(camera: usize, views: &[View], first: usize) -> Vec<Sighting> {
    views
        .iter()
        .enumerate()
        .map(|(i, v)| Sighting::new(camera, first + i, v.object.clone(), v.image.clone()))
        .collect()
}

fn fits(
    bundle: &Bundle<6, Transform<World, Board>>,
    views: &[View],
    camera: &str,
) -> Result<Vec<ViewFit>, CalibrationError> {
    views
        .iter()
        .zip(&bundle.sightings)
        .zip(&bundle.blocks)
        .map(|((view, sighting), board)| {
            let residuals = bundle.residuals(sighting).ok_or_else(|| CalibrationError::NoImage {
                camera: camera.to_owned(),
                view: view.name.clone(),
            })?;
            Ok(ViewFit {
                name: view.name.clone(),
                camera_from_board: &bundle.cameras[0].camera_from_rig * board,
                residuals,
            })
        })
        .collect()
}

pub(crate) fn check_finite(camera: &CameraViews) -> Result<(), CalibrationError> {
    for view in &camera.views {
        let finite = view
            .object
            .iter()
            .flat_map(|p| p.iter())
            .chain(view.image.iter().flat_map(|p| p.iter()))
            .all(|c| c.is_finite());
        if !finite {
            return Err(CalibrationError::NotFinite { camera: camera.name.clone(), view: view.name.clone() });
        }
    }
    Ok(())
}

/// Largest angle between the boards' normals of two views, in degrees.
fn tilt_spread_deg(boards: &[Transform<World, Board>], views: &[View]) -> f64 {
    let normals: Vec<Vector3<f64>> = boards
        .iter()
        .zip(views)
        .filter_map(|(b, v)| Plane::of(&v.object).map(|p| b.rotation * (p.rotation * Vector3::z())))
        .map(|n| if n.z < 0.0 { -n } else { n })
        .collect();
    let pairs = normals.iter().enumerate().flat_map(|(i, a)| normals[..i].iter().map(move |b| a.dot(b)));
    pairs.fold(1.0f64, f64::min).clamp(-1.0, 1.0).acos().to_degrees()
}

/// Median of |residual|² → variance of one coordinate: |r|² is σ² χ²₂, whose median is 2 ln 2.
pub(crate) fn robust_variance(views: &[ViewFit]) -> f64 {
    let mut squares: Vec<f64> = views.iter().flat_map(|v| &v.residuals).map(Vector2::norm_squared).collect();
    if squares.is_empty() {
        return 0.0;
    }
    let middle = squares.len() / 2;
    *squares.select_nth_unstable_by(middle, f64::total_cmp).1 / (2.0 * 2f64.ln())
}

/// A residual beyond five robust standard deviations: with two coordinates e^(−12.5), about four in a
/// million of normal noise.
const OUTLIER_SIGMAS: f64 = 5.0;

pub(crate) fn find_outliers(views: &[ViewFit]) -> Vec<Outlier> {
    let limit = OUTLIER_SIGMAS * robust_variance(views).sqrt();
    views
        .iter()
        .flat_map(|v| v.residuals.iter().enumerate().map(move |(i, r)| (v, i, r.norm())))
        .filter(|(_, _, r)| *r > limit && *r > 1e-6)
        .map(|(v, point, residual_px)| Outlier { view: v.name.clone(), point, residual_px })
        .collect()
}
