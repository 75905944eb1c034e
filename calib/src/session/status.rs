use std::collections::BTreeMap;

use serde::Serialize;

use super::{
    advice::Advice,
    aims::Aim,
    heat::HeatMap,
    kept::Mark,
    machine::{Phase, Session},
    setup::Task,
};
use crate::detect::Detector;

/// Cells of the heat map over a picture.
const HEAT: (usize, usize) = (16, 10);

/// What a page shows of a session.
#[derive(Debug, Clone, Serialize)]
pub struct Status {
    /// What it is for.
    pub task: Task,
    /// Where it stands.
    pub phase: Phase,
    /// What to do next, in words.
    pub advice: String,
    /// The same for drawing.
    pub next: Advice,
    /// How much of what it takes has been gathered, 0–1.
    pub reached: f64,
    /// The cameras.
    pub cameras: Vec<CameraStatus>,
    /// The shots kept, oldest first.
    pub kept: Vec<KeptStatus>,
    /// Marks of the table that somebody pointed at.
    pub marks: Vec<Mark>,
    /// How the board lies on the table: x and y of its first corner, m, its turn, °, its height, m.
    pub on_table: Option<[f64; 4]>,
    /// Whether there is a result.
    pub has_result: bool,
    /// Whether views have changed since it was computed.
    pub stale: bool,
    /// Why there is none.
    pub failure: Option<String>,
}

/// One camera.
#[derive(Debug, Clone, Serialize)]
pub struct CameraStatus {
    /// Its name.
    pub name: String,
    /// Width and height of its last picture, px.
    pub size: Option<(u32, u32)>,
    /// Corners in its last picture, px.
    pub corners: Vec<(f64, f64)>,
    /// The board's outline there, px.
    pub outline: Vec<(f64, f64)>,
    /// Why the last picture was not kept; empty when it was, or would be.
    pub rejected: Option<String>,
    /// Whether the last picture was, or would be, kept.
    pub good: bool,
    /// How blurred the board is, px.
    pub blur_px: Option<f64>,
    /// Views kept.
    pub views: usize,
    /// Pictures rejected, by reason.
    pub tally: BTreeMap<String, u64>,
    /// Where corners were.
    pub heat: HeatMap,
    /// How much has been gathered, 0–1.
    pub reached: f64,
    /// The same in parts.
    pub aims: Vec<Aim>,
    /// Whether its intrinsics are known.
    pub has_model: bool,
}

/// A shot that was kept.
#[derive(Debug, Clone, Serialize)]
pub struct KeptStatus {
    /// Its name.
    pub name: String,
    /// Per camera: the number of corners, or nothing.
    pub corners: Vec<Option<usize>>,
}

fn round(p: &nalgebra::Vector2<f64>) -> (f64, f64) {
    ((p.x * 100.0).round() / 100.0, (p.y * 100.0).round() / 100.0)
}

impl Session {
    /// What a page shows of it.
    pub fn status(&self) -> Status {
        let next = self.advice();
        Status {
            task: self.setup().task,
            phase: self.phase(),
            advice: next.to_string(),
            next,
            reached: self.reached(),
            cameras: (0..self.setup().cameras.len()).map(|c| self.camera_status(c)).collect(),
            kept: self
                .kept()
                .iter()
                .map(|s| KeptStatus {
                    name: s.name.clone(),
                    corners: s.views.iter().map(|v| v.as_ref().map(|v| v.view.image.len())).collect(),
                })
                .collect(),
            marks: self.marks().to_vec(),
            on_table: self
                .setup()
                .on_table
                .map(|b| [b.origin_m[0], b.origin_m[1], b.yaw_rad.to_degrees(), b.height_m]),
            has_result: self.outcome().is_some(),
            stale: self.is_stale(),
            failure: self.failure().map(str::to_owned),
        }
    }

    fn camera_status(&self, camera: usize) -> CameraStatus {
        let setup = &self.setup().cameras[camera];
        let sight = self.last()[camera].as_ref();
        let board = sight.and_then(|s| s.board.as_ref().ok());
        let verdict = self.last_verdict().and_then(|v| v.cameras[camera].as_ref());
        let mut heat = HeatMap::new(HEAT.0, HEAT.1);
        let kept = || self.kept().iter().filter_map(|s| s.views[camera].as_ref());
        for view in kept() {
            heat.add(view.size, &view.view.image);
        }
        let aims = self.aims(camera);
        CameraStatus {
            name: setup.name.clone(),
            size: sight.map(|s| s.size),
            // Empty where no board was seen.
            corners: board.iter().flat_map(|b| &b.corners).map(|c| round(&c.at)).collect(),
            outline: board.iter().flat_map(|b| Detector::outline(b)).map(|p| round(&p)).collect(),
            rejected: verdict.and_then(|v| v.as_ref().err()).map(ToString::to_string),
            good: matches!(verdict, Some(Ok(()))),
            blur_px: sight.and_then(|s| s.blur_px),
            views: kept().count(),
            tally: self.tallies()[camera].rejected.clone(),
            heat,
            reached: self.camera_reached(camera),
            aims: aims.list(),
            has_model: setup.model.is_some(),
        }
    }
}
