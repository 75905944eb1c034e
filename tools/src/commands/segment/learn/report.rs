use std::path::Path;

use netcord_common::{CameraName, rig::ColourKind};
use netcord_detect::segment::learn::{Lesson, Separation};
use serde::Serialize;

use crate::output;

/// What `--report` writes.
#[derive(Debug, Default, Serialize)]
pub(super) struct Report {
    pub(super) cameras: Vec<CameraReport>,
}

/// What one camera was taught.
#[derive(Debug, Serialize)]
pub(super) struct CameraReport {
    camera: String,
    /// `mosaic` or `grey`.
    from: &'static str,
    frames: usize,
    balls: usize,
    ball_cells: usize,
    /// Frames that were left out, and why.
    left_out: Vec<String>,
    /// Share of the ball's cells that pass, 0–1.
    kept: f64,
    /// Share of the other cells that pass, 0–1.
    let_through: f64,
    separation: Separation,
    /// r, g, b and bound: a cell of the ball has `r R + g G + b B > bound`, of all.
    tests: Vec<[f64; 4]>,
    mean: [f64; 3],
    covariance: [f64; 6],
    diameter_px: [f64; 2],
}

impl CameraReport {
    pub(super) fn of(camera: &CameraName, lesson: &Lesson, left_out: &[String]) -> Self {
        let colour = &lesson.colour;
        let row = |t: &netcord_common::rig::ColourTest| {
            let [r, g, b] = t.weights;
            [r, g, b, t.bound]
        };
        Self {
            camera: camera.to_string(),
            from: match colour.kind {
                ColourKind::Mosaic => "mosaic",
                ColourKind::Grey => "grey",
            },
            frames: lesson.frames,
            balls: lesson.balls,
            ball_cells: lesson.ball_cells,
            left_out: left_out.to_vec(),
            kept: lesson.separation.confusion.kept(),
            let_through: lesson.separation.confusion.let_through(),
            separation: lesson.separation.clone(),
            tests: colour.tests().iter().map(row).collect(),
            mean: colour.mean,
            covariance: colour.covariance,
            diameter_px: colour.diameter_px,
        }
    }
}

impl Report {
    pub(super) fn write(&self, path: &Path) -> Result<(), Box<dyn std::error::Error>> {
        let json = serde_json::to_string_pretty(self)?;
        Ok(output::write(path, json + "\n")?)
    }
}
