use std::collections::BTreeMap;

use nalgebra::{Vector2, Vector3};
use netcord_common::geometry::Point;

use super::problem::{Problem, ProblemError};
use crate::{
    solve::{CalibrationError, CameraReport, RejectedReport, Report, Uncertain, ViewReport, coverage},
    table::{TableCalibration, TableCamera, TableSighting, calibrate_table, mark},
};

/// Where the table is, and how well all that was seen of it fits.
#[derive(Debug, Clone)]
pub struct TableOutcome {
    /// The pose.
    pub table: TableCalibration,
    /// The cameras that saw the table or the board on it.
    pub cameras: Vec<TableCamera>,
    /// Observed − predicted, px, by camera and view; marks that somebody pointed at are the view [`MARKS_VIEW`].
    residuals: BTreeMap<(String, String), Vec<Vector2<f64>>>,
    coverage: Vec<f64>,
}

/// The name under which marks are reported, as if they were a view.
pub const MARKS_VIEW: &str = "marks";

struct Seen {
    camera: usize,
    view: String,
    on_table: Vector3<f64>,
    pixel: Vector2<f64>,
    mark: String,
}

impl TableOutcome {
    /// Solves for the table's pose from views of a board that lies on it, and from marks.
    pub(super) fn solve(problem: &Problem) -> Result<Self, ProblemError> {
        let mut cameras = Vec::new();
        let mut seen = Vec::new();
        let mut covered = Vec::new();
        for (camera, views) in problem.setup.cameras.iter().zip(&problem.cameras) {
            let marks: Vec<_> = problem.marks.iter().filter(|m| m.camera == camera.name).collect();
            if views.views.is_empty() && marks.is_empty() {
                continue;
            }
            let (Some(model), Some(camera_from_first)) = (camera.model, camera.camera_from_first) else {
                return Err(ProblemError::NotCalibrated { camera: camera.name.clone() });
            };
            let place = cameras.len();
            cameras.push(TableCamera { name: camera.name.clone(), model, camera_from_first });
            covered.push(coverage(
                (model.width, model.height),
                views.views.iter().flat_map(|v| v.image.iter().copied()),
            ));
            if let Some(board) = &problem.setup.on_table {
                for view in &views.views {
                    seen.extend(view.object.iter().zip(&view.image).enumerate().map(
                        |(i, (object, pixel))| Seen {
                            camera: place,
                            view: view.name.clone(),
                            on_table: board.place(object),
                            pixel: *pixel,
                            mark: format!("point {i} of view {}", view.name),
                        },
                    ));
                }
            }
            for m in marks {
                seen.push(Seen {
                    camera: place,
                    view: MARKS_VIEW.to_owned(),
                    on_table: mark(&m.mark).map_err(ProblemError::Mark)?,
                    pixel: Vector2::from(m.at),
                    mark: m.mark.clone(),
                });
            }
        }
        let known = &problem.setup.table;
        if cameras.is_empty() && known.contacts.is_empty() {
            return Err(CalibrationError::NoCameras.into());
        }
        let sightings: Vec<TableSighting> = seen
            .iter()
            .map(|s| TableSighting {
                camera: s.camera,
                mark: s.mark.clone(),
                on_table: s.on_table,
                pixel: s.pixel,
            })
            .collect();
        let table =
            calibrate_table(&cameras, &sightings, &known.contacts, known.start.as_ref(), known.noise_px)?;
        let mut residuals: BTreeMap<_, Vec<_>> = BTreeMap::new();
        for s in &seen {
            let camera = &cameras[s.camera];
            let in_first = &table.first_from_table * Point::from(s.on_table);
            // The solver would not have come to a pose that puts a mark behind a camera that sees it.
            let predicted = camera.model.project(&(&camera.camera_from_first * in_first)).unwrap_or(s.pixel);
            let key = (camera.name.clone(), s.view.clone());
            residuals.entry(key).or_default().push(s.pixel - predicted);
        }
        Ok(Self { table, cameras, residuals, coverage: covered })
    }

    /// Observed − predicted, px, of a camera's view.
    pub fn residuals(&self, camera: &str, view: &str) -> Option<&[Vector2<f64>]> {
        self.residuals.get(&(camera.to_owned(), view.to_owned())).map(Vec::as_slice)
    }

    /// As a report: R and T are those of `first_from_table`.
    pub fn report(&self) -> Report {
        let rms = |squares: f64, points: usize| (squares / points.max(1) as f64).sqrt();
        let cameras = self.cameras.iter().zip(&self.coverage).map(|(camera, coverage)| {
            let views: Vec<ViewReport> = self
                .residuals
                .iter()
                .filter(|((name, _), _)| *name == camera.name)
                .map(|((_, view), residuals)| ViewReport {
                    view: view.clone(),
                    points: residuals.len(),
                    rms_px: rms(residuals.iter().map(Vector2::norm_squared).sum(), residuals.len()),
                    max_px: residuals.iter().map(Vector2::norm).fold(0.0, f64::max),
                })
                .collect();
            let points = views.iter().map(|v| v.points).sum();
            let report = CameraReport {
                exposed_later_s: None,
                size: [camera.model.width, camera.model.height],
                rms_px: rms(views.iter().map(|v| v.rms_px.powi(2) * v.points as f64).sum(), points),
                parameters: crate::solve::INTRINSIC_NAMES
                    .into_iter()
                    .zip(camera.model.parameters())
                    .map(|(name, value)| (name, Uncertain { value, sd: 0.0 }))
                    .collect(),
                covariance: Vec::new(),
                views,
                outliers: Vec::new(),
                coverage: *coverage,
                projection_sd_px: Vec::new(),
                cross_validation: None,
                r: Some(camera.camera_from_first.rotation.matrix().transpose().into()),
                t: Some(camera.camera_from_first.translation.into()),
                pose_sd: None,
            };
            (camera.name.clone(), report)
        });
        let outliers = self.table.residuals.iter().filter(|r| r.outlier);
        Report {
            kind: "table",
            rms_px: self.table.rms_px,
            cameras: cameras.collect(),
            order: self.cameras.iter().map(|c| c.name.clone()).collect(),
            r: Some(self.table.first_from_table.rotation.matrix().transpose().into()),
            t: Some(self.table.first_from_table.translation.into()),
            pose_sd: Some(self.table.standard_deviations()),
            baseline_m: None,
            rejected: outliers
                .map(|r| RejectedReport {
                    view: r.mark.clone(),
                    camera: r.camera.map(|c| self.cameras[c].name.clone()),
                    reason: format!("{:.2} px off: it took no part", r.length),
                })
                .collect(),
        }
    }
}
