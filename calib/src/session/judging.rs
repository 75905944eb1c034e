//! Which sights are worth keeping.

use nalgebra::Vector2;

use super::{
    kept::KeptShot,
    machine::Session,
    setup::Task,
    shot::{Shot, Sight},
    verdict::{Reason, Verdict},
};
use crate::{
    detect::{BoardView, Detector},
    gather::{GatherOptions, Rejection, intersection_over_union, judge},
};

/// Largest blur of a view that is kept, px: corners are then found to a tenth of a pixel still.
const MOST_BLUR_PX: f64 = 3.0;

/// How far a board may move from one look to the next, as a share of the picture's width: 1.5 px of 1920.
const STILL_SHARE: f64 = 0.0008;

impl Session {
    /// The size that a camera's pictures must have, once it is known.
    pub(super) fn size(&self, camera: usize) -> Option<(u32, u32)> {
        let of_model = || self.setup.cameras[camera].model.map(|m| (m.width, m.height));
        self.kept.iter().find_map(|s| s.views[camera].as_ref()).map(|v| v.size).or_else(of_model)
    }

    /// Which cameras' sights of a shot are worth keeping; `moved`: how far the boards have moved since the look
    /// before, where that counts.
    pub(super) fn judge(&self, shot: &Shot, moved: Option<&[Option<f64>]>) -> Verdict {
        let mut cameras: Vec<Option<Result<(), Reason>>> = shot
            .sights
            .iter()
            .enumerate()
            .map(|(camera, sight)| {
                let sight = sight.as_ref()?;
                Some(match sight {
                    Err(rejection) => Err(rejection.clone().into()),
                    Ok(sight) => self.judge_sight(camera, sight, moved.map(|m| m[camera])),
                })
            })
            .collect();
        if self.setup.task == Task::Rig {
            self.judge_together(shot, &mut cameras);
        }
        Verdict { cameras }
    }

    /// One camera's sight by itself.
    fn judge_sight(&self, camera: usize, sight: &Sight, moved: Option<Option<f64>>) -> Result<(), Reason> {
        if let Some(expected) = self.size(camera)
            && expected != sight.size
        {
            return Err(Rejection::Size { found: sight.size, expected }.into());
        }
        let board = sight.board.as_ref().map_err(|absence| Rejection::from(absence.clone()))?;
        let outlines: Vec<(&str, &[Vector2<f64>])> = self
            .kept
            .iter()
            .filter_map(|s| s.views[camera].as_ref().map(|v| (s.name.as_str(), v.outline.as_slice())))
            .collect();
        // Shots of several cameras are compared as a whole, later.
        let options = match self.setup.task {
            Task::Rig => GatherOptions { max_iou: 1.0, ..self.setup.options },
            Task::Mono | Task::Table => self.setup.options,
        };
        judge(board, &self.detector, &outlines, &options)?;
        match moved {
            Some(None) => return Err(Reason::JustSeen),
            Some(Some(moved_px)) if moved_px > STILL_SHARE * f64::from(sight.size.0) => {
                return Err(Reason::Moving { moved_px });
            }
            _ => {}
        }
        match sight.blur_px {
            Some(blur_px) if blur_px > MOST_BLUR_PX => {
                Err(Reason::Blurred { blur_px, most_px: MOST_BLUR_PX })
            }
            _ => Ok(()),
        }
    }

    /// Sights that are good by themselves must also go together.
    fn judge_together(&self, shot: &Shot, cameras: &mut [Option<Result<(), Reason>>]) {
        let good: Vec<usize> = (0..cameras.len()).filter(|c| matches!(cameras[*c], Some(Ok(())))).collect();
        let stamps = good.iter().filter_map(|c| match &shot.sights[*c] {
            Some(Ok(sight)) => sight.stamp_ns,
            _ => None,
        });
        let (first, last) = stamps.fold((u64::MAX, 0), |(a, b), s| (a.min(s), b.max(s)));
        let apart = last.saturating_sub(first);
        let alike = self.alike(shot, &good);
        for &c in &good {
            let model = self.setup.cameras[c].model;
            cameras[c] = Some(if good.len() >= 2 && apart > self.setup.tolerance_ns {
                Err(Reason::NotSimultaneous {
                    apart_ms: apart as f64 * 1e-6,
                    most_ms: self.setup.tolerance_ns as f64 * 1e-6,
                })
            } else if let Some((like, iou)) = &alike {
                Err(Rejection::Alike { like: like.clone(), iou: *iou }.into())
            } else if good.len() == 1 && model.is_some() {
                Err(Reason::Alone { camera: self.setup.cameras[c].name.clone() })
            } else {
                Ok(())
            });
        }
    }

    /// A kept shot in which every one of `cameras` saw the board where it is now.
    fn alike(&self, shot: &Shot, cameras: &[usize]) -> Option<(String, f64)> {
        let outlines: Vec<(usize, Vec<Vector2<f64>>)> = cameras
            .iter()
            .filter_map(|&c| board_of(&shot.sights[c]).map(|b| (c, Detector::outline(b))))
            .collect();
        let least = |kept: &KeptShot| {
            let ious = outlines.iter().map(|(c, outline)| {
                kept.views[*c].as_ref().map_or(0.0, |v| intersection_over_union(outline, &v.outline))
            });
            ious.fold(1.0, f64::min)
        };
        let closest = self.kept.iter().map(|k| (k, least(k))).max_by(|a, b| a.1.total_cmp(&b.1))?;
        (closest.1 > self.setup.options.max_iou).then(|| (closest.0.name.clone(), closest.1))
    }
}

pub(super) fn board_of(sight: &Option<Result<Sight, Rejection>>) -> Option<&BoardView> {
    match sight {
        Some(Ok(sight)) => sight.board.as_ref().ok(),
        _ => None,
    }
}
