use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector2, Vector3};
use netcord_common::{
    camera::CameraModel,
    geometry::{Camera, Point, ReferenceFrame, Transform, World},
};
use thiserror::Error;

use crate::{check::nearest_point, solve::board_pose};

/// The table's frame: origin at the centre of the playing surface, x along its width, y along its length, z up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Table {}
impl ReferenceFrame for Table {}

/// A calibrated camera; `World` is the first camera's frame here.
#[derive(Debug, Clone, PartialEq)]
pub struct TableCamera {
    /// Its name.
    pub name: String,
    /// Its intrinsics.
    pub model: CameraModel,
    /// Its pose.
    pub camera_from_first: Transform<Camera, World>,
}

/// A known point of the table in one camera's picture.
#[derive(Debug, Clone, PartialEq)]
pub struct TableSighting {
    /// Index of the camera.
    pub camera: usize,
    /// What it is called in messages.
    pub mark: String,
    /// The point, m, in the table frame.
    pub on_table: Vector3<f64>,
    /// Its raw pixel.
    pub pixel: Vector2<f64>,
}

/// A point that is known to lie at a height over the table, such as the ball's centre in a bounce.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// The point, m, in the first camera's frame.
    pub at: Point<World>,
    /// Its height over the playing surface, m.
    pub height_m: f64,
    /// Standard deviation of the height, m.
    pub sigma_m: f64,
}

/// Where the table is believed to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableStart {
    /// The pose.
    pub first_from_table: Transform<World, Table>,
    /// Standard deviations of its rotation vector (rad) and translation (m), held where the measurements say
    /// nothing, as bounces do of the directions in the table's plane.
    pub sigma: [f64; 6],
}

/// How one measurement fits.
#[derive(Debug, Clone, PartialEq)]
pub struct TableResidual {
    /// The camera's index, or `None` for a bounce.
    pub camera: Option<usize>,
    /// The mark, or the bounce's number.
    pub mark: String,
    /// Length of the residual: px for a mark, m for a bounce.
    pub length: f64,
    /// Whether it lies so far off that it took no part.
    pub outlier: bool,
}

/// The table's pose.
#[derive(Debug, Clone, PartialEq)]
pub struct TableCalibration {
    /// The pose.
    pub first_from_table: Transform<World, Table>,
    /// Covariance of the rotation vector, applied from the left in the first camera's frame (rad), and of the
    /// translation (m).
    pub covariance: SMatrix<f64, 6, 6>,
    /// Root mean square of the marks' residuals, per mark, px; zero without marks.
    pub rms_px: f64,
    /// Root mean square of the bounces' heights, m; zero without bounces.
    pub rms_contact_m: f64,
    /// Each measurement.
    pub residuals: Vec<TableResidual>,
}

/// Why there is no table pose.
#[derive(Debug, Error)]
pub enum TableError {
    /// Too little to go by.
    #[error(
        "{marks} marks ({places} different places) and {bounces} bounces do not settle the table's pose: give four \
         marks in one camera, or three that two cameras see, or a table pose to start from"
    )]
    TooFew {
        /// Sightings of marks.
        marks: usize,
        /// Different places on the table.
        places: usize,
        /// Bounces.
        bounces: usize,
    },
    /// The marks lie on a line, or all bounces do.
    #[error(
        "the table's pose is not determined: all marks and bounces lie on one line, or in one spot; add marks \
         at other corners"
    )]
    Degenerate,
    /// The table would be seen from below.
    #[error(
        "by these marks the cameras look at the table from below: they run the wrong way round. Seen \
         from above, x+ is to the right of x- when y+ is ahead"
    )]
    UpsideDown,
    /// The measurements contradict each other.
    #[error(
        "the marks contradict each other: {rms_px:.1} px RMS; the worst is {worst}. Marks are named by the signs of \
         the table's x and y: two of them may be exchanged, or the table's long and short sides"
    )]
    Contradiction {
        /// RMS, px.
        rms_px: f64,
        /// The worst mark.
        worst: String,
    },
}

/// Noise of a mark clicked by hand, px, where there are too few to tell.
const CLICK_SIGMA_PX: f64 = 0.7;
/// Degrees of freedom from which the residuals say what the noise is.
const TRUSTED_FREEDOM: usize = 8;
/// A measurement further off than this many standard deviations takes no part.
const OUTLIER_SIGMAS: f64 = 4.0;
/// RMS, px, from which marks must have been exchanged: a click is never this far off.
const CONTRADICTION_PX: f64 = 20.0;

/// Solves for the table's pose: the least weighted squares of marks in all cameras and of bounces' heights.
/// `noise_px` is the marks' standard deviation along one axis, where it is known. The uncertainty is that of
/// the measurements; the cameras' own poses are taken as they are.
///
/// # Errors
/// [`TableError`].
pub fn calibrate_table(
    cameras: &[TableCamera],
    sightings: &[TableSighting],
    contacts: &[Contact],
    start: Option<&TableStart>,
    noise_px: Option<f64>,
) -> Result<TableCalibration, TableError> {
    let guess = match guess(cameras, sightings) {
        Some(guess) => guess,
        None => match start {
            Some(start) => start.first_from_table,
            None => {
                return Err(TableError::TooFew {
                    marks: sightings.len(),
                    places: places(sightings),
                    bounces: contacts.len(),
                });
            }
        },
    };
    let mut problem = Problem {
        cameras,
        sightings,
        contacts,
        // Marks alone settle the pose; then what was believed before has no say.
        prior: start.filter(|_| !settled(cameras, sightings)),
        sigma_px: noise_px.unwrap_or(CLICK_SIGMA_PX),
        used: vec![true; sightings.len() + contacts.len()],
    };
    let mut pose = problem.solve(guess)?;
    for _ in 0..5 {
        if noise_px.is_none() {
            problem.sigma_px = problem.noise(&pose).unwrap_or(CLICK_SIGMA_PX);
        }
        let before = problem.used.clone();
        problem.reject(&pose);
        pose = problem.solve(pose)?;
        if before == problem.used {
            break;
        }
    }
    let residuals = problem.residuals(&pose);
    let rms = |of_mark: bool| {
        let own = residuals.iter().filter(|r| r.camera.is_some() == of_mark && !r.outlier);
        let (sum, count) = own.fold((0.0, 0), |(s, n), r| (s + r.length * r.length, n + 1));
        if count > 0 { (sum / f64::from(count)).sqrt() } else { 0.0 }
    };
    let rms_px = rms(true);
    let outliers = residuals.iter().filter(|r| r.camera.is_some() && r.outlier).count();
    if rms_px > CONTRADICTION_PX || 2 * outliers > sightings.len() {
        let worst =
            residuals.iter().filter(|r| r.camera.is_some()).max_by(|a, b| a.length.total_cmp(&b.length));
        let worst = worst.map_or_else(String::new, |r| {
            let camera = r.camera.map_or("", |c| cameras[c].name.as_str());
            format!("{} in {camera}, {:.1} px off", r.mark, r.length)
        });
        return Err(TableError::Contradiction { rms_px, worst });
    }
    let table_from_first = pose.inverse();
    if cameras.iter().all(|c| (&table_from_first * c.camera_from_first.origin()).coords.z < 0.0) {
        return Err(TableError::UpsideDown);
    }
    let covariance = problem.normal(&pose).0.try_inverse().ok_or(TableError::Degenerate)?;
    Ok(TableCalibration { first_from_table: pose, covariance, rms_px, rms_contact_m: rms(false), residuals })
}

impl TableCalibration {
    /// Standard deviations of the rotation vector (rad) and the translation (m).
    pub fn standard_deviations(&self) -> [f64; 6] {
        std::array::from_fn(|i| self.covariance[(i, i)].max(0.0).sqrt())
    }

    /// Standard deviation, along the table's x, y and z, m, of where a point of the table frame lies.
    pub fn sigma_at(&self, on_table: &Vector3<f64>) -> Vector3<f64> {
        let j = by_step(&self.first_from_table, on_table);
        let covariance: Matrix3<f64> = j * self.covariance * j.transpose();
        let turn = self.first_from_table.rotation.inverse();
        let along = turn.matrix() * covariance * turn.matrix().transpose();
        Vector3::new(along[(0, 0)], along[(1, 1)], along[(2, 2)]).map(|v| v.max(0.0).sqrt())
    }
}

/// Number of different places that are marked.
fn places(sightings: &[TableSighting]) -> usize {
    let mut seen: Vec<&Vector3<f64>> = Vec::new();
    for s in sightings {
        if !seen.iter().any(|p| (*p - s.on_table).norm() < 1e-9) {
            seen.push(&s.on_table);
        }
    }
    seen.len()
}

/// Whether marks alone determine all six unknowns.
fn settled(cameras: &[TableCamera], sightings: &[TableSighting]) -> bool {
    guess(cameras, sightings).is_some()
}

/// A first pose from the camera that sees most marks of one plane, or from marks that two cameras see.
fn guess(cameras: &[TableCamera], sightings: &[TableSighting]) -> Option<Transform<World, Table>> {
    let cost = |pose: &Transform<World, Table>| -> f64 {
        sightings.iter().map(|s| pixel_off(cameras, s, pose).map_or(1e4, |r| r.norm().min(1e4))).sum()
    };
    let single = (0..cameras.len()).filter_map(|camera| {
        let own: Vec<_> = sightings.iter().filter(|s| s.camera == camera).collect();
        let object: Vec<_> = own.iter().map(|s| s.on_table).collect();
        let pixels: Vec<_> = own.iter().map(|s| s.pixel).collect();
        let seen = board_pose(&cameras[camera].model, &object, &pixels)?.camera_from_board;
        let camera_from_table = Transform::<Camera, Table>::new(seen.rotation, seen.translation);
        Some(&cameras[camera].camera_from_first.inverse() * &camera_from_table)
    });
    let several = aligned(cameras, sightings);
    single.chain(several).min_by(|a, b| cost(a).total_cmp(&cost(b)))
}

/// The pose that moves marks onto where two or more cameras see them (Kabsch); `None` for fewer than three
/// that are not on a line.
fn aligned(cameras: &[TableCamera], sightings: &[TableSighting]) -> Option<Transform<World, Table>> {
    let mut pairs: Vec<(Vector3<f64>, Vector3<f64>)> = Vec::new();
    for (i, first) in sightings.iter().enumerate() {
        let same = |s: &&TableSighting| (s.on_table - first.on_table).norm() < 1e-9;
        if sightings[..i].iter().any(|s| same(&s)) {
            continue;
        }
        let rays = sightings.iter().filter(same).filter_map(|s| {
            let camera = &cameras[s.camera];
            Some((&camera.camera_from_first, camera.model.ray(&s.pixel)?))
        });
        if let Some(at) = nearest_point(rays) {
            pairs.push((first.on_table, at));
        }
    }
    if pairs.len() < 3 {
        return None;
    }
    let count = pairs.len() as f64;
    let from = pairs.iter().map(|p| p.0).sum::<Vector3<f64>>() / count;
    let to = pairs.iter().map(|p| p.1).sum::<Vector3<f64>>() / count;
    let spread: Matrix3<f64> = pairs.iter().map(|(a, b)| (b - to) * (a - from).transpose()).sum();
    let svd = spread.svd(true, true);
    // Points on a line leave the turn about it open.
    if svd.singular_values.as_slice().iter().filter(|s| **s > 1e-6 * svd.singular_values.max()).count() < 2 {
        return None;
    }
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = Rotation3::from_matrix_unchecked(u * sign * v_t);
    Some(Transform::new(rotation, to - rotation * from))
}

fn pixel_off(
    cameras: &[TableCamera],
    s: &TableSighting,
    pose: &Transform<World, Table>,
) -> Option<Vector2<f64>> {
    let camera = &cameras[s.camera];
    let at = &camera.camera_from_first * (pose * Point::from(s.on_table));
    camera.model.project(&at).map(|p| s.pixel - p)
}

/// ∂(pose × point)/∂(turn from the left, move).
fn by_step(pose: &Transform<World, Table>, point: &Vector3<f64>) -> SMatrix<f64, 3, 6> {
    let mut j = SMatrix::<f64, 3, 6>::zeros();
    j.fixed_view_mut::<3, 3>(0, 0).copy_from(&-(pose.rotation * point).cross_matrix());
    j.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
    j
}

struct Problem<'a> {
    cameras: &'a [TableCamera],
    sightings: &'a [TableSighting],
    contacts: &'a [Contact],
    prior: Option<&'a TableStart>,
    sigma_px: f64,
    /// Of the sightings, then of the contacts.
    used: Vec<bool>,
}

impl Problem<'_> {
    /// Jᵀ W J, Jᵀ W r and the weighted squares at `pose`.
    fn normal(&self, pose: &Transform<World, Table>) -> (SMatrix<f64, 6, 6>, SVector<f64, 6>, f64) {
        let mut a = SMatrix::<f64, 6, 6>::zeros();
        let mut g = SVector::<f64, 6>::zeros();
        let mut cost = 0.0;
        for (s, _) in self.sightings.iter().zip(&self.used).filter(|(_, used)| **used) {
            let camera = &self.cameras[s.camera];
            let at = &camera.camera_from_first * (pose * Point::from(s.on_table));
            let Some(p) = camera.model.project_with_jacobians(&at) else {
                // Behind the camera: worse than any place in front of it.
                cost += 1e8;
                continue;
            };
            let r = (s.pixel - p.pixel) / self.sigma_px;
            let j = p.by_point * camera.camera_from_first.rotation.matrix() * by_step(pose, &s.on_table)
                / self.sigma_px;
            a += j.transpose() * j;
            g += j.transpose() * r;
            cost += r.norm_squared();
        }
        let from_table = pose.rotation.matrix();
        let up: Vector3<f64> = from_table.column(2).into();
        for (c, _) in self.contacts.iter().zip(&self.used[self.sightings.len()..]).filter(|(_, used)| **used)
        {
            let arm = c.at.coords - pose.translation;
            let r = (c.height_m - up.dot(&arm)) / c.sigma_m;
            // Height = (R ẑ)·(X − t): a turn δω moves R ẑ by δω × R ẑ.
            let mut j = SVector::<f64, 6>::zeros();
            j.fixed_rows_mut::<3>(0).copy_from(&up.cross(&arm));
            j.fixed_rows_mut::<3>(3).copy_from(&-up);
            let j = j / c.sigma_m;
            a += j * j.transpose();
            g += j * r;
            cost += r * r;
        }
        if let Some(prior) = self.prior {
            let turn = (prior.first_from_table.rotation * pose.rotation.inverse()).scaled_axis();
            let moved = prior.first_from_table.translation - pose.translation;
            for i in 0..6 {
                let sigma = prior.sigma[i].max(1e-9);
                let off = if i < 3 { turn[i] } else { moved[i - 3] } / sigma;
                a[(i, i)] += 1.0 / (sigma * sigma);
                g[i] += off / sigma;
                cost += off * off;
            }
        }
        (a, g, cost)
    }

    /// Levenberg–Marquardt from `pose`.
    fn solve(&self, mut pose: Transform<World, Table>) -> Result<Transform<World, Table>, TableError> {
        let (mut a, mut g, mut cost) = self.normal(&pose);
        let mut lambda = 1e-4;
        for _ in 0..100 {
            let mut damped = a;
            for i in 0..6 {
                damped[(i, i)] += lambda * a[(i, i)];
            }
            let Some(step) = damped.cholesky().map(|c| c.solve(&g)) else {
                return Err(TableError::Degenerate);
            };
            let mut rotation = Rotation3::new(step.fixed_rows::<3>(0).into_owned()) * pose.rotation;
            rotation.renormalize();
            let next = Transform::new(rotation, pose.translation + step.fixed_rows::<3>(3));
            let (next_a, next_g, next_cost) = self.normal(&next);
            if next_cost <= cost {
                let still = step.dot(&g).abs() < 1e-12 * (1.0 + cost);
                (pose, a, g, cost) = (next, next_a, next_g, next_cost);
                lambda = (lambda * 0.1).max(1e-12);
                if still {
                    break;
                }
            } else if lambda > 1e10 {
                break;
            } else {
                lambda *= 10.0;
            }
        }
        // A direction that nothing measures: pixels and metres scaled alike first.
        let scale = SVector::<f64, 6>::from_fn(|i, _| 1.0 / a[(i, i)].max(1e-300).sqrt());
        let scaled = SMatrix::<f64, 6, 6>::from_fn(|i, j| a[(i, j)] * scale[i] * scale[j]);
        if scaled.symmetric_eigenvalues().min() < 1e-10 { Err(TableError::Degenerate) } else { Ok(pose) }
    }

    /// The marks' noise along one axis from their residuals; `None` where there are too few to tell.
    fn noise(&self, pose: &Transform<World, Table>) -> Option<f64> {
        let mut squares: Vec<f64> = self
            .sightings
            .iter()
            .zip(&self.used)
            .filter(|(_, used)| **used)
            .filter_map(|(s, _)| pixel_off(self.cameras, s, pose))
            .map(|r| r.norm_squared())
            .collect();
        let freedom = (2 * squares.len()).checked_sub(6).filter(|f| *f >= TRUSTED_FREEDOM)?;
        squares.sort_by(f64::total_cmp);
        // The largest quarter may be mistaken: the median of |r|² is 2 ln 2 σ², less what the fit takes.
        let median = squares[squares.len() / 2] / (2.0 * 2f64.ln());
        let shrink = 2.0 * squares.len() as f64 / freedom as f64;
        Some((median * shrink).sqrt().max(1e-6))
    }

    fn reject(&mut self, pose: &Transform<World, Table>) {
        let marks = self.sightings.len();
        for (i, s) in self.sightings.iter().enumerate() {
            let off = pixel_off(self.cameras, s, pose).map_or(f64::INFINITY, |r| r.norm());
            self.used[i] = off < OUTLIER_SIGMAS * self.sigma_px.max(0.05) * 2f64.sqrt();
        }
        let up = pose.rotation * Vector3::z();
        for (i, c) in self.contacts.iter().enumerate() {
            let off = up.dot(&(c.at.coords - pose.translation)) - c.height_m;
            self.used[marks + i] = off.abs() < OUTLIER_SIGMAS * c.sigma_m;
        }
    }

    fn residuals(&self, pose: &Transform<World, Table>) -> Vec<TableResidual> {
        let up = pose.rotation * Vector3::z();
        let marks = self.sightings.iter().map(|s| TableResidual {
            camera: Some(s.camera),
            mark: s.mark.clone(),
            length: pixel_off(self.cameras, s, pose).map_or(f64::INFINITY, |r| r.norm()),
            outlier: false,
        });
        let bounces = self.contacts.iter().enumerate().map(|(i, c)| TableResidual {
            camera: None,
            mark: format!("bounce {}", i + 1),
            length: (up.dot(&(c.at.coords - pose.translation)) - c.height_m).abs(),
            outlier: false,
        });
        marks.chain(bounces).zip(&self.used).map(|(r, used)| TableResidual { outlier: !used, ..r }).collect()
    }
}
