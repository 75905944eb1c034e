//! Views that contradict the rest of a rig.

use std::collections::BTreeMap;

use nalgebra::Vector2;
use netcord_common::{
    camera::INTRINSICS,
    geometry::{Board, Transform, World},
};

use super::{
    bundle::{Bundle, Freedom, SolveOptions},
    error::CalibrationError,
    loss::Loss,
    views::CameraViews,
};

/// A view that contradicts the others.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedView {
    /// The view.
    pub view: String,
    /// Its camera; `None` when only two cameras saw it, so that nobody knows which is wrong.
    pub camera: Option<String>,
    /// RMS against the rest of the rig, in px; infinite where a corner would have no image at all.
    pub rms_px: f64,
}

impl RejectedView {
    /// Why, in words.
    pub fn reason(&self) -> String {
        let off = if self.rms_px.is_finite() {
            format!("{:.2} px RMS against the rest of the rig", self.rms_px)
        } else {
            "behind a camera, by the rest of the rig".to_owned()
        };
        format!("{off}: not simultaneous, or corners mixed up")
    }
}

/// A view's error relative to the median view from which it counts as unsynchronised or wrong…
const REJECT_RATIO: f64 = 5.0;
/// …if it is also larger than this, in px: among views that all fit to a tenth of a pixel, five times
/// the median is no mistake.
const REJECT_FLOOR_PX: f64 = 1.0;

/// Solves robustly with fixed intrinsics, and takes out sightings that contradict the rest, the worst
/// of a board first.
pub(super) fn reject(
    bundle: &mut Bundle<6, Transform<World, Board>>,
    view_of_block: &mut Vec<usize>,
    names: &[String],
    cameras: &[CameraViews],
    keep_single: bool,
) -> Result<Vec<RejectedView>, CalibrationError> {
    let mut rejected = Vec::new();
    let freedoms: Vec<Freedom> = bundle.cameras.iter().map(|c| c.freedom.clone()).collect();
    for camera in &mut bundle.cameras {
        camera.freedom.intrinsics = [false; INTRINSICS];
    }
    loop {
        let options = SolveOptions { loss: Loss::Cauchy { scale_px: 1.0 }, max_steps: 60 };
        bundle.solve(&options).ok_or_else(|| CalibrationError::NotConverged {
            camera: cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", "),
            rms_px: f64::INFINITY,
        })?;
        let rms: Vec<f64> = bundle
            .sightings
            .iter()
            // A view with a point that has no image contradicts the rest more than any number of pixels.
            .map(|s| {
                bundle.residuals(s).map_or(f64::INFINITY, |r| {
                    (r.iter().map(Vector2::norm_squared).sum::<f64>() / r.len().max(1) as f64).sqrt()
                })
            })
            .collect();
        let mut sorted = rms.clone();
        sorted.sort_by(f64::total_cmp);
        let Some(median) = sorted.get(sorted.len() / 2) else { break };
        let limit = (REJECT_RATIO * median).max(REJECT_FLOOR_PX);
        // The worst sighting of each board.
        let mut worst: BTreeMap<usize, usize> = BTreeMap::new();
        for (i, s) in bundle.sightings.iter().enumerate().filter(|(i, _)| rms[*i] > limit) {
            let entry = worst.entry(s.block).or_insert(i);
            if rms[i] > rms[*entry] {
                *entry = i;
            }
        }
        if worst.is_empty() {
            break;
        }
        let mut gone = Vec::new();
        for (block, i) in worst {
            let others = bundle.sightings.iter().filter(|s| s.block == block).count();
            let camera = (others > 2).then(|| cameras[bundle.sightings[i].camera].name.clone());
            rejected.push(RejectedView {
                view: names[view_of_block[block]].clone(),
                camera: camera.clone(),
                rms_px: rms[i],
            });
            gone.push((block, camera.is_some().then_some(i)));
        }
        let mut index = 0;
        bundle.sightings.retain(|s| {
            let keep = !gone.iter().any(|(block, one)| s.block == *block && one.is_none_or(|i| i == index));
            index += 1;
            keep
        });
        compact(bundle, view_of_block, keep_single);
    }
    for (camera, freedom) in bundle.cameras.iter_mut().zip(freedoms) {
        camera.freedom = freedom;
    }
    Ok(rejected)
}

/// Removes blocks that nobody, or one camera alone, sees.
pub(super) fn compact(
    bundle: &mut Bundle<6, Transform<World, Board>>,
    view_of_block: &mut Vec<usize>,
    keep_single: bool,
) {
    let needed = if keep_single { 1 } else { 2 };
    let mut place = vec![None; bundle.blocks.len()];
    let (mut blocks, mut views) = (Vec::new(), Vec::new());
    for (b, block) in bundle.blocks.iter().enumerate() {
        if bundle.sightings.iter().filter(|s| s.block == b).count() >= needed {
            place[b] = Some(blocks.len());
            blocks.push(*block);
            views.push(view_of_block[b]);
        }
    }
    bundle.sightings.retain_mut(|s| {
        place[s.block].is_some_and(|p| {
            s.block = p;
            true
        })
    });
    (bundle.blocks, *view_of_block) = (blocks, views);
}
