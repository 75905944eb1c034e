use std::sync::Arc;

use serde::Serialize;

use super::{
    carried::Carried,
    error::SessionError,
    judging::board_of,
    kept::{KeptShot, KeptView, Mark},
    problem::{Outcome, Problem, ProblemError},
    setup::{SessionCamera, Setup, Task},
    shot::{Shot, Sight},
    stillness::Stillness,
    tally::Tally,
    verdict::Verdict,
};
use crate::{
    detect::Detector,
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

/// The session. Nothing in it reads a clock or a file.
#[derive(Debug)]
pub struct Session {
    pub(super) setup: Setup,
    pub(super) detector: Arc<Detector>,
    pub(super) phase: Phase,
    pub(super) kept: Vec<KeptShot>,
    pub(super) marks: Vec<Mark>,
    tallies: Vec<Tally>,
    stillness: Vec<Stillness>,
    carried: Carried,
    pub(super) last: Vec<Option<Sight>>,
    pub(super) last_verdict: Option<Verdict>,
    outcome: Option<Arc<Outcome>>,
    failure: Option<String>,
    stale: bool,
    pub(super) exhausted: bool,
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
            carried: Carried::new(cameras),
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
        if self.setup.task == Task::Rig && self.setup.continuous {
            self.carried.note(shot, &self.detector);
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
        let view = View { stamp_ns: sight.stamp_ns, ..self.detector.view(name, board) };
        let outline = Detector::outline(board);
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
            Task::Table
                if self.kept.is_empty() && self.marks.is_empty() && self.setup.table.contacts.is_empty() =>
            {
                return Err(SessionError::NoTable);
            }
            Task::Table if !self.kept.is_empty() && self.setup.on_table.is_none() => {
                return Err(SessionError::NoPlace);
            }
            _ => {}
        }
        self.phase = Phase::Processing;
        self.failure = None;
        Ok(Problem {
            setup: self.setup.clone(),
            cameras: self.views(),
            carried: self.carried.views(&self.setup.cameras),
            marks: self.marks.clone(),
        })
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
}
