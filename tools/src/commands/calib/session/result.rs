//! A result as the page shows it.

use netcord_calib::{session::Outcome, solve::Report};
use serde::Serialize;

use super::desk::Shown;

/// The report, and every point with its residual.
#[derive(Debug, Serialize)]
pub struct ResultPage {
    report: Report,
    cameras: Vec<CameraFit>,
}

#[derive(Debug, Serialize)]
struct CameraFit {
    name: String,
    size: (u32, u32),
    /// fx fy cx cy k1 k2 p1 p2 k3.
    parameters: Vec<f64>,
    views: Vec<ViewFit>,
}

#[derive(Debug, Serialize)]
struct ViewFit {
    name: String,
    rms_px: f64,
    max_px: f64,
    /// u, v, observed − predicted in u and v; px.
    points: Vec<[f64; 4]>,
}

impl ResultPage {
    /// Of a result and the views that it was computed from.
    pub fn of(shown: &Shown) -> Self {
        let outcome: &Outcome = &shown.outcome;
        let cameras = shown.views.iter().filter_map(|camera| {
            let model = outcome.model(&camera.name)?;
            let views = camera.views.iter().filter_map(|view| {
                let residuals = outcome.residuals(&camera.name, &view.name)?;
                let squares: f64 = residuals.iter().map(|r| r.norm_squared()).sum();
                Some(ViewFit {
                    name: view.name.clone(),
                    rms_px: (squares / residuals.len().max(1) as f64).sqrt(),
                    max_px: residuals.iter().map(|r| r.norm()).fold(0.0, f64::max),
                    points: view.image.iter().zip(residuals).map(|(p, r)| [p.x, p.y, r.x, r.y]).collect(),
                })
            });
            Some(CameraFit {
                name: camera.name.clone(),
                size: camera.size,
                parameters: model.parameters().to_vec(),
                views: views.collect(),
            })
        });
        Self { report: outcome.report(), cameras: cameras.collect() }
    }
}
