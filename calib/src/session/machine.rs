use std::sync::Arc;

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{
    advice::Advice,
    aims::{Aims, CameraAims},
    problem::{Outcome, Problem, ProblemError},
    setup::{SessionCamera, Setup, Task},
    shot::{Shot, Sight},
    stillness::Stillness,
    tally::Tally,
    verdict::{Reason, Verdict},
};
use crate::{
    detect::{BoardView, Detector},
    gather::{GatherOptions, Rejection, intersection_over_union, judge},
    solve::{CameraViews, View},
    table::{self, BoardOnTable},
};

/// Where a session stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// Pictures are shown; nothing is kept.
    Preview,
    /// Good views are kept.
    Gathering,
    /// The calibration is being computed.
    Processing,
    /// There is a result to look at.
    Review,
    /// The result is in the rig file.
    Saved,
}

/// A camera's view in a shot that was kept.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptView {
    /// Corners.
    pub view: View,
    /// The picture's size, px.
    pub size: (u32, u32),
    /// Outline of the corners, px.
    pub outline: Vec<Vector2<f64>>,
}

/// A shot of which something was kept.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptShot {
    /// Its name.
    pub name: String,
    /// Per camera.
    pub views: Vec<Option<KeptView>>,
}

/// A mark of the table that somebody pointed at in a camera's picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// The camera's name.
    pub camera: String,
    /// The mark's, as [`crate::table::mark`] takes it.
    pub mark: String,
    /// Its raw pixel.
    pub at: [f64; 2],
}

/// What a session cannot do where it stands.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SessionError {
    /// Not in this phase.
    #[error("cannot {doing} now: the session is at {phase}")]
    Phase {
        /// What was asked.
        doing: &'static str,
        /// Where it stands.
        phase: &'static str,
    },
    /// Nothing kept.
    #[error("no view has been kept yet")]
    NoViews,
    /// Neither views nor marks.
    #[error("neither a view of the board on the table nor a mark of the table has been given yet")]
    NoTable,
    /// Nobody knows where the board lies.
    #[error("say how the board lies on the table first: where its first corner is, and how far it is turned")]
    NoPlace,
    /// No such mark.
    #[error("{0}")]
    Mark(String),
    /// No such shot.
    #[error("there is no view {0:?}")]
    Unknown(String),
}

/// Largest blur of a view that is kept, px: corners are then found to a tenth of a pixel still.
const MOST_BLUR_PX: f64 = 3.0;

/// How far a board may move from one look to the next, as a share of the picture's width: 1.5 px of 1920.
const STILL_SHARE: f64 = 0.0008;

/// Common views of two cameras that a link in the chain of poses should have.
const COMMON_VIEWS: usize = 8;

/// The session. Nothing in it reads a clock or a file.
#[derive(Debug)]
pub struct Session {
    setup: Setup,
    detector: Arc<Detector>,
    phase: Phase,
    kept: Vec<KeptShot>,
    marks: Vec<Mark>,
    tallies: Vec<Tally>,
    stillness: Vec<Stillness>,
    last: Vec<Option<Sight>>,
    last_verdict: Option<Verdict>,
    outcome: Option<Arc<Outcome>>,
    failure: Option<String>,
    stale: bool,
    exhausted: bool,
}

impl Session {
    /// A session at its beginning.
    pub fn new(setup: Setup, detector: Arc<Detector>) -> Self {
        let cameras = setup.cameras.len();
        Self {
            setup,
            detector,
            phase: Phase::Preview,
            kept: Vec::new(),
            marks: Vec::new(),
            tallies: vec![Tally::default(); cameras],
            stillness: vec![Stillness::default(); cameras],
            last: vec![None; cameras],
            last_verdict: None,
            outcome: None,
            failure: None,
            stale: false,
            exhausted: false,
        }
    }

    /// What was settled before it began.
    pub const fn setup(&self) -> &Setup {
        &self.setup
    }

    /// The board's detector.
    pub const fn detector(&self) -> &Arc<Detector> {
        &self.detector
    }

    /// Where it stands.
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// The shots kept, oldest first.
    pub fn kept(&self) -> &[KeptShot] {
        &self.kept
    }

    /// What was rejected, per camera.
    pub fn tallies(&self) -> &[Tally] {
        &self.tallies
    }

    /// What each camera saw last.
    pub fn last(&self) -> &[Option<Sight>] {
        &self.last
    }

    /// The verdict on the last shot.
    pub const fn last_verdict(&self) -> Option<&Verdict> {
        self.last_verdict.as_ref()
    }

    /// The result, where there is one.
    pub const fn outcome(&self) -> Option<&Arc<Outcome>> {
        self.outcome.as_ref()
    }

    /// Why the last processing gave no result.
    pub fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// Whether views have changed since the result was computed.
    pub const fn is_stale(&self) -> bool {
        self.stale
    }

    /// Takes back what an earlier run of the session has kept.
    pub fn restore(&mut self, kept: Vec<KeptShot>) {
        self.kept = kept;
        self.stale = self.outcome.is_some();
    }

    /// Changes what is known of a camera.
    pub fn set_camera(&mut self, camera: SessionCamera) {
        if let Some(known) = self.setup.cameras.iter_mut().find(|c| c.name == camera.name) {
            *known = camera;
        }
    }

    /// Says how the board lies on the table.
    pub fn place_board(&mut self, place: BoardOnTable) {
        self.setup.on_table = Some(place);
        self.stale = self.outcome.is_some();
    }

    /// The marks pointed at.
    pub fn marks(&self) -> &[Mark] {
        &self.marks
    }

    /// Notes where a mark of the table is, in place of what was noted of it in that camera before.
    ///
    /// # Errors
    /// [`SessionError`] while processing, and for a mark or camera that there is not.
    pub fn set_mark(&mut self, mark: Mark) -> Result<(), SessionError> {
        self.not_processing("set a mark")?;
        table::mark(&mark.mark).map_err(SessionError::Mark)?;
        if !self.setup.cameras.iter().any(|c| c.name == mark.camera) {
            return Err(SessionError::Mark(format!("there is no camera {:?}", mark.camera)));
        }
        self.marks.retain(|m| (&m.camera, &m.mark) != (&mark.camera, &mark.mark));
        self.marks.push(mark);
        self.stale = self.outcome.is_some();
        Ok(())
    }

    /// Takes all marks back.
    ///
    /// # Errors
    /// [`SessionError`] while processing.
    pub fn clear_marks(&mut self) -> Result<(), SessionError> {
        self.not_processing("clear marks")?;
        self.marks.clear();
        self.stale = self.outcome.is_some();
        Ok(())
    }

    /// Notes that there are no more pictures to look at.
    pub const fn set_exhausted(&mut self) {
        self.exhausted = true;
    }

    /// Begins or goes on gathering.
    ///
    /// # Errors
    /// [`SessionError::Phase`] while processing.
    pub fn gather(&mut self) -> Result<(), SessionError> {
        self.not_processing("gather")?;
        self.phase = Phase::Gathering;
        Ok(())
    }

    /// Stops gathering; what was kept stays.
    ///
    /// # Errors
    /// [`SessionError::Phase`] while processing.
    pub fn pause(&mut self) -> Result<(), SessionError> {
        self.not_processing("pause")?;
        self.phase = Phase::Preview;
        Ok(())
    }

    /// Looks at a shot for guidance: nothing is kept, but while gathering what is rejected counts. In a continuous
    /// source a board that moves is rejected.
    pub fn look(&mut self, shot: &Shot) -> &Verdict {
        let moved: Vec<Option<f64>> = self
            .stillness
            .iter_mut()
            .zip(&shot.sights)
            .map(|(still, sight)| still.moved_px(board_of(sight)))
            .collect();
        let verdict = self.judge(shot, self.setup.continuous.then_some(moved.as_slice()));
        if self.phase == Phase::Gathering && !verdict.keeps_any() {
            Tally::note_all(&mut self.tallies, &verdict, self.setup.continuous);
        }
        self.remember(shot);
        self.last_verdict.insert(verdict)
    }

    /// Offers a shot, with its final corners, to be kept; the driver then puts it on disk.
    pub fn offer(&mut self, shot: &Shot) -> Option<&KeptShot> {
        if self.phase != Phase::Gathering {
            return None;
        }
        let verdict = self.judge(shot, None);
        Tally::note_all(&mut self.tallies, &verdict, self.setup.continuous);
        let keeps = verdict.keeps_any();
        if keeps {
            let views = shot
                .sights
                .iter()
                .zip(&verdict.cameras)
                .map(|(sight, verdict)| match (sight, verdict) {
                    (Some(Ok(sight)), Some(Ok(()))) => self.kept_view(&shot.name, sight),
                    _ => None,
                })
                .collect();
            self.kept.push(KeptShot { name: shot.name.clone(), views });
            self.stale = self.outcome.is_some();
        }
        self.remember(shot);
        self.last_verdict = Some(verdict);
        if keeps { self.kept.last() } else { None }
    }

    fn remember(&mut self, shot: &Shot) {
        for (last, sight) in self.last.iter_mut().zip(&shot.sights) {
            if let Some(sight) = sight {
                *last = sight.as_ref().ok().cloned();
            }
        }
    }

    fn kept_view(&self, name: &str, sight: &Sight) -> Option<KeptView> {
        let board = sight.board.as_ref().ok()?;
        let (view, outline) = (self.detector.view(name, board), Detector::outline(board));
        Some(KeptView { view, size: sight.size, outline })
    }

    /// Takes back the shot that was kept last; the driver removes it from disk.
    ///
    /// # Errors
    /// [`SessionError`] while processing, and when nothing is kept.
    pub fn undo(&mut self) -> Result<KeptShot, SessionError> {
        self.not_processing("undo")?;
        let shot = self.kept.pop().ok_or(SessionError::NoViews)?;
        self.stale = self.outcome.is_some();
        Ok(shot)
    }

    /// Takes a shot away; the driver removes it from disk.
    ///
    /// # Errors
    /// [`SessionError`] while processing, and when there is no such shot.
    pub fn drop_shot(&mut self, name: &str) -> Result<KeptShot, SessionError> {
        self.not_processing("leave a view out")?;
        let place = self.kept.iter().position(|s| s.name == name);
        let place = place.ok_or_else(|| SessionError::Unknown(name.to_owned()))?;
        self.stale = self.outcome.is_some();
        Ok(self.kept.remove(place))
    }

    /// Hands out what is to be solved, and waits for [`Self::finish`].
    ///
    /// # Errors
    /// [`SessionError`] while processing, and when nothing is kept.
    pub fn process(&mut self) -> Result<Problem, SessionError> {
        self.not_processing("process")?;
        match self.setup.task {
            Task::Mono | Task::Rig if self.kept.is_empty() => return Err(SessionError::NoViews),
            Task::Table if self.kept.is_empty() && self.marks.is_empty() => {
                return Err(SessionError::NoTable);
            }
            Task::Table if !self.kept.is_empty() && self.setup.on_table.is_none() => {
                return Err(SessionError::NoPlace);
            }
            _ => {}
        }
        self.phase = Phase::Processing;
        self.failure = None;
        Ok(Problem { setup: self.setup.clone(), cameras: self.views(), marks: self.marks.clone() })
    }

    /// Takes the result of the problem that [`Self::process`] handed out. Without one the session goes back to
    /// its preview and says why.
    pub fn finish(&mut self, result: Result<Outcome, ProblemError>) {
        match result {
            Ok(outcome) => {
                self.outcome = Some(Arc::new(outcome));
                self.stale = false;
                self.phase = Phase::Review;
            }
            Err(error) => {
                self.failure = Some(error.to_string());
                self.outcome = None;
                self.phase = Phase::Preview;
            }
        }
    }

    /// Goes back to the preview from a computation that broke off.
    pub fn abandon(&mut self) {
        if self.phase == Phase::Processing {
            self.phase = Phase::Preview;
        }
    }

    /// Notes that the result is in the rig file.
    ///
    /// # Errors
    /// [`SessionError::Phase`] when there is no result to save.
    pub fn saved(&mut self) -> Result<(), SessionError> {
        if self.outcome.is_none() {
            return Err(SessionError::Phase { doing: "save", phase: self.phase_name() });
        }
        self.phase = Phase::Saved;
        Ok(())
    }

    const fn phase_name(&self) -> &'static str {
        match self.phase {
            Phase::Preview => "preview",
            Phase::Gathering => "gathering",
            Phase::Processing => "processing",
            Phase::Review => "review",
            Phase::Saved => "saved",
        }
    }

    const fn not_processing(&self, doing: &'static str) -> Result<(), SessionError> {
        match self.phase {
            Phase::Processing => Err(SessionError::Phase { doing, phase: self.phase_name() }),
            _ => Ok(()),
        }
    }

    /// The views kept, per camera.
    pub fn views(&self) -> Vec<CameraViews> {
        self.setup
            .cameras
            .iter()
            .enumerate()
            .map(|(i, camera)| {
                let kept = || self.kept.iter().filter_map(|s| s.views[i].as_ref());
                CameraViews {
                    name: camera.name.clone(),
                    size: self.size(i).unwrap_or((0, 0)),
                    views: kept().map(|v| v.view.clone()).collect(),
                }
            })
            .collect()
    }

    /// The size that a camera's pictures must have, once it is known.
    fn size(&self, camera: usize) -> Option<(u32, u32)> {
        let of_model = || self.setup.cameras[camera].model.map(|m| (m.width, m.height));
        self.kept.iter().find_map(|s| s.views[camera].as_ref()).map(|v| v.size).or_else(of_model)
    }

    /// Which cameras' sights of a shot are worth keeping; `moved`: how far the boards have moved since the look
    /// before, where that counts.
    fn judge(&self, shot: &Shot, moved: Option<&[Option<f64>]>) -> Verdict {
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

fn board_of(sight: &Option<Result<Sight, Rejection>>) -> Option<&BoardView> {
    match sight {
        Some(Ok(sight)) => sight.board.as_ref().ok(),
        _ => None,
    }
}
