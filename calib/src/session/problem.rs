use nalgebra::Vector2;
use netcord_common::camera::CameraModel;
use thiserror::Error;

use super::{
    kept::Mark,
    setup::{Setup, Task},
    table::{MARKS_VIEW, TableOutcome},
};
use crate::{
    solve::{
        CalibrationError, CameraViews, CrossValidation, MonoCalibration, MonoOptions, Report, RigCalibration,
        RigOptions, View, calibrate_mono, calibrate_rig, coverage, cross_validate,
    },
    table::TableError,
};

/// Parts of the cross-validation: a fifth of the views left out each time.
const FOLDS: usize = 5;

/// What a session has gathered, ready to be solved away from it.
#[derive(Debug, Clone)]
pub struct Problem {
    /// The task and its cameras.
    pub setup: Setup,
    /// The views, per camera.
    pub cameras: Vec<CameraViews>,
    /// Looks at the board while it was carried, per camera, with its motion: coarse, but they tell of clocks. May be
    /// empty.
    pub carried: Vec<CameraViews>,
    /// Marks of the table that somebody pointed at.
    pub marks: Vec<Mark>,
}

/// Why what was gathered gives no result.
#[derive(Debug, Error)]
pub enum ProblemError {
    /// Intrinsics or poses.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// The table is found from cameras whose lens and pose are known.
    #[error(
        "camera {camera} sees the table, but its lens or its pose is not known: calibrate and save those first"
    )]
    NotCalibrated {
        /// The camera.
        camera: String,
    },
    /// A mark that there is not.
    #[error("{0}")]
    Mark(String),
}

/// A camera calibrated by itself.
#[derive(Debug, Clone)]
pub struct Solved {
    /// The result.
    pub calibration: MonoCalibration,
    /// Share of the picture that had corners, 0–1.
    pub coverage: f64,
    /// What views left out say; absent where there are too few.
    pub validation: Option<CrossValidation>,
}

/// What a session comes to.
#[derive(Debug, Clone)]
pub enum Outcome {
    /// Intrinsics of each camera that had views.
    Mono(Vec<Solved>),
    /// Poses of all cameras.
    Rig {
        /// Intrinsics that had to be calibrated from the same views, because none were known.
        solved: Vec<Solved>,
        /// The poses.
        rig: Box<RigCalibration>,
        /// Share of the picture that had corners, per camera, 0–1.
        coverage: Vec<f64>,
    },
    /// Where the table is.
    Table(Box<TableOutcome>),
}

impl Problem {
    /// Solves it; `progress` is told what is being done and how much is done, 0–1.
    ///
    /// # Errors
    /// [`ProblemError`] names the camera and what would help.
    pub fn solve(&self, progress: &dyn Fn(&str, f64)) -> Result<Outcome, ProblemError> {
        match self.setup.task {
            Task::Mono => {
                let with_views: Vec<&CameraViews> =
                    self.cameras.iter().filter(|c| !c.views.is_empty()).collect();
                if with_views.is_empty() {
                    return Err(CalibrationError::NoCameras.into());
                }
                let mut solved = Vec::new();
                for (i, camera) in with_views.iter().enumerate() {
                    progress(&format!("{}: intrinsics", camera.name), i as f64 / with_views.len() as f64);
                    solved.push(Solved::of(camera, &self.setup.solver.mono)?);
                }
                Ok(Outcome::Mono(solved))
            }
            Task::Rig => {
                let mut solved = Vec::new();
                let mut models: Vec<CameraModel> = Vec::new();
                let steps = self.cameras.len() as f64 + 1.0;
                for (i, (camera, known)) in self.cameras.iter().zip(&self.setup.cameras).enumerate() {
                    match known.model {
                        Some(model) => models.push(model),
                        None => {
                            progress(&format!("{}: intrinsics", camera.name), i as f64 / steps);
                            let own = Solved::of(camera, &self.setup.solver.mono)?;
                            models.push(own.calibration.model);
                            solved.push(own);
                        }
                    }
                }
                progress("poses of all cameras together", (steps - 1.0) / steps);
                let mut rig = calibrate_rig(&self.cameras, &models, &self.setup.solver.rig)?;
                if !rig.timed {
                    progress("clocks", (steps - 0.5) / steps);
                    self.clocks(&mut rig);
                }
                let coverage = self.cameras.iter().map(covered).collect();
                Ok(Outcome::Rig { solved, rig: Box::new(rig), coverage })
            }
            Task::Table => {
                progress("the table's pose", 0.0);
                Ok(Outcome::Table(Box::new(TableOutcome::solve(self)?)))
            }
        }
    }
}

impl Problem {
    /// Clocks from the looks at the board while it was carried; the views that were kept stand still and say nothing
    /// of them. Their poses are not used: kept views are finer.
    fn clocks(&self, rig: &mut RigCalibration) {
        let models: Vec<CameraModel> = rig.cameras.iter().map(|c| c.model).collect();
        // Too few looks, or none together: then nothing is known of clocks, and the poses are as good.
        let looked = self.carried.len() == models.len() && self.carried.iter().any(|c| !c.views.is_empty());
        let Some(Ok(by_looks)) =
            looked.then(|| calibrate_rig(&self.carried, &models, &RigOptions::default()))
        else {
            return;
        };
        rig.timed = by_looks.timed;
        for (camera, by_looks) in rig.cameras.iter_mut().zip(by_looks.cameras) {
            camera.clock = by_looks.clock;
        }
    }

    /// The views, per camera, and the marks that somebody pointed at as one more view, [`MARKS_VIEW`].
    pub fn views_with_marks(&self) -> Vec<CameraViews> {
        let mut cameras = self.cameras.clone();
        for camera in &mut cameras {
            let own = self.marks.iter().filter(|m| m.camera == camera.name);
            let image: Vec<Vector2<f64>> = own.map(|m| Vector2::from(m.at)).collect();
            if !image.is_empty() {
                camera.views.push(View::new(MARKS_VIEW.to_owned(), Vec::new(), image));
            }
        }
        cameras
    }
}

fn covered(camera: &CameraViews) -> f64 {
    coverage(camera.size, camera.views.iter().flat_map(|v| v.image.iter().copied()))
}

impl Solved {
    fn of(camera: &CameraViews, options: &MonoOptions) -> Result<Self, CalibrationError> {
        let calibration = calibrate_mono(camera, options)?;
        let validation = cross_validate(camera, options, &calibration, FOLDS).ok();
        Ok(Self { calibration, coverage: covered(camera), validation })
    }

    fn reported(&self) -> (MonoCalibration, f64, Option<CrossValidation>) {
        (self.calibration.clone(), self.coverage, self.validation.clone())
    }
}

impl Outcome {
    /// As a report.
    pub fn report(&self) -> Report {
        match self {
            Self::Mono(solved) => Report::of_mono(&solved.iter().map(Solved::reported).collect::<Vec<_>>()),
            Self::Rig { rig, coverage, .. } => {
                let kind = if rig.cameras.len() == 2 { "stereo" } else { "rig" };
                Report::of_rig(kind, rig, coverage)
            }
            Self::Table(table) => table.report(),
        }
    }

    /// The intrinsics found or used for a camera.
    pub fn model(&self, camera: &str) -> Option<&CameraModel> {
        match self {
            Self::Mono(solved) => {
                solved.iter().map(|s| &s.calibration).find(|c| c.name == camera).map(|c| &c.model)
            }
            Self::Rig { rig, .. } => rig.cameras.iter().find(|c| c.name == camera).map(|c| &c.model),
            Self::Table(table) => table.cameras.iter().find(|c| c.name == camera).map(|c| &c.model),
        }
    }

    /// Observed − predicted of every point of a camera's view, px, in the view's order; `None` where the view took
    /// no part.
    pub fn residuals(&self, camera: &str, view: &str) -> Option<&[Vector2<f64>]> {
        match self {
            Self::Mono(solved) => {
                let own = solved.iter().map(|s| &s.calibration).find(|c| c.name == camera)?;
                own.views.iter().find(|v| v.name == view).map(|v| v.residuals.as_slice())
            }
            Self::Rig { rig, .. } => {
                let place = rig.cameras.iter().position(|c| c.name == camera)?;
                let fit = rig.views.iter().find(|v| v.camera == place && v.view == view);
                fit.map(|v| v.residuals.as_slice())
            }
            Self::Table(table) => table.residuals(camera, view),
        }
    }
}
