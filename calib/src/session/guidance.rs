//! What to do next, and how much has been done.

use super::{
    advice::Advice,
    aims::{Aims, CameraAims},
    kept::{KeptShot, Mark},
    machine::{Phase, Session},
    setup::Task,
    verdict::Reason,
};
use crate::gather::Rejection;

/// Common views of two cameras that a link in the chain of poses should have.
const COMMON_VIEWS: usize = 8;

impl Session {
    /// What a camera's views have reached. For poses only those views count that another camera shares.
    pub fn aims(&self, camera: usize) -> CameraAims {
        let shared = |s: &&KeptShot| {
            self.setup.task != Task::Rig || s.views.iter().filter(|v| v.is_some()).count() >= 2
        };
        let views = self.kept.iter().filter(shared).filter_map(|s| s.views[camera].as_ref());
        CameraAims::of(Aims::of(self.setup.task), self.setup.cameras[camera].model.as_ref(), views)
    }

    /// How much of what it takes one camera has gathered, 0–1. Four marks of the table do as well as views.
    pub fn camera_reached(&self, camera: usize) -> f64 {
        let own = |m: &&Mark| m.camera == self.setup.cameras[camera].name;
        let marks = self.marks.iter().filter(own).count() as f64 / 4.0;
        self.aims(camera).reached().max(marks.min(1.0))
    }

    /// How much of what it takes has been gathered, 0–1: the least of the cameras; for the table, one is enough.
    pub fn reached(&self) -> f64 {
        let cameras = (0..self.setup.cameras.len()).map(|c| self.camera_reached(c));
        match self.setup.task {
            Task::Table => cameras.fold(0.0, f64::max),
            Task::Mono | Task::Rig => cameras.fold(1.0, f64::min),
        }
    }

    /// What to do next.
    pub fn advice(&self) -> Advice {
        match self.phase {
            Phase::Preview if self.exhausted && self.kept.is_empty() => Advice::NothingFound,
            Phase::Preview if self.exhausted => Advice::AllLookedAt,
            Phase::Preview => Advice::Start,
            Phase::Processing => Advice::Wait,
            Phase::Review => Advice::Review,
            Phase::Saved => Advice::Done,
            Phase::Gathering => self.gathering_advice(),
        }
    }

    fn gathering_advice(&self) -> Advice {
        if self.setup.task == Task::Table && self.reached() > 0.999 {
            return Advice::Process;
        }
        let name = |c: usize| self.setup.cameras[c].name.clone();
        let aims: Vec<CameraAims> = (0..self.setup.cameras.len()).map(|c| self.aims(c)).collect();
        let lacking = |a: &CameraAims| a.reached() < 0.999;
        if !aims.iter().any(lacking) && self.missing_link().is_none() {
            return Advice::Process;
        }
        // A camera that sees the board now and still needs views comes first, then the one that needs most.
        let sees = |c: &usize| self.last[*c].as_ref().is_some_and(|s| s.board.is_ok());
        let needy: Vec<usize> = (0..aims.len()).filter(|c| lacking(&aims[*c])).collect();
        let Some(camera) = needy.iter().copied().find(sees).or_else(|| {
            needy.iter().copied().min_by(|a, b| aims[*a].reached().total_cmp(&aims[*b].reached()))
        }) else {
            return self.missing_link().unwrap_or(Advice::Process);
        };
        let verdict = self.last_verdict.as_ref().and_then(|v| v.cameras[camera].as_ref());
        match verdict {
            Some(Err(Reason::Moving { .. } | Reason::JustSeen | Reason::NotSimultaneous { .. })) => {
                return Advice::HoldStill { camera: name(camera) };
            }
            Some(Err(Reason::Blurred { .. })) => return Advice::Focus { camera: name(camera) },
            Some(Err(Reason::View(Rejection::FewCorners { .. } | Rejection::Unanchored))) => {
                return Advice::ShowMore { camera: name(camera) };
            }
            _ => {}
        }
        if self.setup.task == Task::Table {
            return Advice::LayOnTable;
        }
        if let Some(link) = self.missing_link() {
            return link;
        }
        let a = &aims[camera];
        if a.views() == 0 {
            return Advice::ShowBoard { camera: name(camera) };
        }
        if let Some(place) = a.lacking_place(true) {
            return Advice::MoveTo { camera: name(camera), place };
        }
        if let Some(edge) = a.lacking_tilt() {
            return Advice::Tilt { camera: name(camera), edge };
        }
        if a.lacks_near() {
            return Advice::Closer { camera: name(camera) };
        }
        if a.lacks_far() {
            return Advice::Farther { camera: name(camera) };
        }
        if let Some(place) = a.lacking_place(false) {
            return Advice::MoveTo { camera: name(camera), place };
        }
        Advice::Different { camera: name(camera) }
    }

    /// For poses: the two cameras whose link, in the best chain through all cameras, has the fewest common views.
    fn missing_link(&self) -> Option<Advice> {
        let count = self.setup.cameras.len();
        if self.setup.task != Task::Rig || count < 2 {
            return None;
        }
        let common = |a: usize, b: usize| {
            self.kept.iter().filter(|s| s.views[a].is_some() && s.views[b].is_some()).count()
        };
        let mut linked = vec![0];
        let mut weakest: Option<(usize, usize, usize)> = None;
        while linked.len() < count {
            let pairs = linked.iter().flat_map(|&a| (0..count).map(move |b| (a, b)));
            let (views, a, b) = pairs
                .filter(|(_, b)| !linked.contains(b))
                .map(|(a, b)| (common(a, b), a, b))
                .max_by_key(|&(n, a, b)| (n, std::cmp::Reverse((a, b))))?;
            if weakest.is_none_or(|w| views < w.0) {
                weakest = Some((views, a, b));
            }
            linked.push(b);
        }
        let (common, a, b) = weakest.filter(|w| w.0 < COMMON_VIEWS)?;
        let name = |c: usize| self.setup.cameras[c].name.clone();
        Some(Advice::ShowToBoth { camera: name(a), other: name(b), common })
    }
}
