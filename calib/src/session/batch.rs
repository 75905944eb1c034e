//! Pictures that were all taken before: offered to a session at once.

use super::{
    error::SessionError,
    machine::Session,
    setup::Task,
    shot::{Shot, Sight},
    verdict::Verdict,
};
use crate::{
    board::Pattern,
    detect::{BoardView, Detector},
    gather::Rejection,
    solve::{View, looks_around},
};

/// What became of a shot.
#[derive(Debug, Clone)]
pub struct Offered {
    /// The shot's name.
    pub name: String,
    /// The verdict on it.
    pub verdict: Verdict,
}

impl Session {
    /// Begins gathering and offers all of `shots`. As all of them are known, a camera's pictures must have the size
    /// that most of them have, a chessboard that is whole in none of several is told to be another, and of a rig's
    /// shots those come first that several cameras see: they give poses as well as intrinsics.
    ///
    /// # Errors
    /// [`SessionError::Phase`] while processing.
    pub fn offer_all(&mut self, mut shots: Vec<Shot>) -> Result<Vec<Offered>, SessionError> {
        self.gather()?;
        for camera in 0..self.setup.cameras.len() {
            if let Some(expected) = usual_size(boards(&shots, camera).map(|(_, size)| size)) {
                // Those without a board, too: it may be for their size that none was found.
                for shot in &mut shots {
                    if let Some(Ok(Sight { size: found, .. })) = shot.sights[camera]
                        && found != expected
                    {
                        shot.sights[camera] = Some(Err(Rejection::Size { found, expected }));
                    }
                }
            }
            if let Some(seen) = largest_part(&self.detector, boards(&shots, camera).map(|(board, _)| board)) {
                let wanted = self.detector.board().to_string();
                for shot in shots.iter_mut().filter(|s| board_in(s, camera).is_some()) {
                    let wanted = wanted.clone();
                    shot.sights[camera] = Some(Err(Rejection::NeverWhole { wanted, seen }));
                }
            }
        }
        if self.setup.task == Task::Rig {
            let seen_by =
                |shot: &Shot| (0..shot.sights.len()).filter(|c| board_in(shot, *c).is_some()).count();
            shots.sort_by_key(|s| seen_by(s) < 2);
        }
        let looks: Vec<Vec<View>> = (0..self.setup.cameras.len()).map(|c| self.looks(&shots, c)).collect();
        let offered = shots.into_iter().filter_map(|shot| {
            self.offer(&shot);
            Some(Offered { verdict: self.last_verdict.clone()?, name: shot.name })
        });
        let offered = offered.collect();
        for kept in &mut self.kept {
            for (view, looks) in kept.views.iter_mut().zip(&looks) {
                if let Some(kept) = view {
                    looks_around(std::slice::from_mut(&mut kept.view), looks);
                }
            }
        }
        Ok(offered)
    }

    /// All that a camera saw of the board, with stamps: what is not kept still tells how the board moves.
    fn looks(&self, shots: &[Shot], camera: usize) -> Vec<View> {
        let stamped = shots.iter().filter_map(|shot| {
            let stamp_ns = shot.sights[camera].as_ref()?.as_ref().ok()?.stamp_ns?;
            let (board, _) = board_in(shot, camera)?;
            Some(View { stamp_ns: Some(stamp_ns), ..self.detector.view(&shot.name, board) })
        });
        stamped.collect()
    }
}

/// The board that a camera saw, and the picture's size.
fn board_in(shot: &Shot, camera: usize) -> Option<(&BoardView, (u32, u32))> {
    let sight = shot.sights[camera].as_ref()?.as_ref().ok()?;
    Some((sight.board.as_ref().ok()?, sight.size))
}

fn boards(shots: &[Shot], camera: usize) -> impl Iterator<Item = (&BoardView, (u32, u32))> + Clone {
    shots.iter().filter_map(move |s| board_in(s, camera))
}

/// The size that most pictures have; of equally many the first.
fn usual_size(sizes: impl Iterator<Item = (u32, u32)>) -> Option<(u32, u32)> {
    let mut counts: Vec<((u32, u32), usize)> = Vec::new();
    for size in sizes {
        match counts.iter_mut().find(|(s, _)| *s == size) {
            Some((_, n)) => *n += 1,
            None => counts.push((size, 1)),
        }
    }
    let most = counts.iter().map(|(_, n)| *n).max()?;
    counts.into_iter().find(|(_, n)| *n == most).map(|(s, _)| s)
}

/// Of a chessboard that is never seen whole in several pictures: columns and rows of its largest part.
fn largest_part<'a>(
    detector: &Detector,
    views: impl Iterator<Item = &'a BoardView> + Clone,
) -> Option<(usize, usize)> {
    /// Fewer pictures may all happen to be cut.
    const SEVERAL: usize = 3;
    let Pattern::Chessboard { columns, .. } = detector.board().pattern else { return None };
    if views.clone().count() < SEVERAL || views.clone().any(|v| v.anchored) {
        return None;
    }
    let span = |values: &mut dyn Iterator<Item = usize>| -> usize {
        let (low, high) = values.fold((usize::MAX, 0), |(l, h), v| (l.min(v), h.max(v)));
        if low > high { 0 } else { high - low + 1 }
    };
    let parts = views.map(|v| {
        let across = span(&mut v.corners.iter().map(|c| c.id % columns));
        (across, span(&mut v.corners.iter().map(|c| c.id / columns)))
    });
    parts.max_by_key(|(w, h)| w * h)
}
