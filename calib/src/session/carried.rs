//! Looks at a board while it is carried from place to place: too coarse for poses, they tell of clocks.

use std::collections::VecDeque;

use super::{judging::board_of, setup::SessionCamera, shot::Shot};
use crate::{
    detect::Detector,
    solve::{CameraViews, View, looks_around},
};

/// Looks kept of each camera, the newest: some twenty seconds of guidance.
const MOST: usize = 120;

/// What each camera saw of the board lately, with stamps.
#[derive(Debug, Clone)]
pub(super) struct Carried(Vec<VecDeque<View>>);

impl Carried {
    pub(super) fn new(cameras: usize) -> Self {
        Self(vec![VecDeque::new(); cameras])
    }

    /// Remembers where the board is; frames without a stamp tell nothing.
    pub(super) fn note(&mut self, shot: &Shot, detector: &Detector) {
        for (looks, sight) in self.0.iter_mut().zip(&shot.sights) {
            let stamp_ns = sight.as_ref().and_then(|s| s.as_ref().ok()?.stamp_ns);
            // A stamp that is not later is a frame that was looked at before.
            let later = |stamp: &u64| looks.back().is_none_or(|last| last.stamp_ns < Some(*stamp));
            let (Some(board), Some(stamp_ns)) = (board_of(sight), stamp_ns.filter(later)) else { continue };
            if looks.len() == MOST {
                looks.pop_front();
            }
            looks.push_back(View { stamp_ns: Some(stamp_ns), ..detector.view(&shot.name, board) });
        }
    }

    /// The looks, with the motion that those beside them tell.
    pub(super) fn views(&self, cameras: &[SessionCamera]) -> Vec<CameraViews> {
        let of_camera = |(looks, camera): (&VecDeque<View>, &SessionCamera)| {
            let looks: Vec<View> = looks.iter().cloned().collect();
            let mut views = looks.clone();
            looks_around(&mut views, &looks);
            views.retain(|v| !v.motion.is_empty());
            let size = camera.model.map_or((0, 0), |m| (m.width, m.height));
            CameraViews { name: camera.name.clone(), size, views }
        };
        self.0.iter().zip(cameras).map(of_camera).collect()
    }
}
