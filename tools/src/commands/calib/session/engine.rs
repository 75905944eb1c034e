//! Drives the session: gives it pictures, does what it says, keeps what it keeps.

mod publish;

use std::{
    error::Error,
    path::PathBuf,
    sync::{
        Arc,
        mpsc::{Receiver, TryRecvError, channel},
    },
    time::Duration,
};

use netcord_calib::{
    detect::Depth,
    session::{Outcome, Phase, ProblemError, Session, SessionFolder, Shot, Task},
    solve::CameraViews,
    table::BoardOnTable,
};
use netcord_common::Shutdown;

use super::{
    super::save,
    desk::{Asked, Command, Desk, Shown},
    source::{Next, RawShot, Source},
};

/// How long the engine rests when there is nothing to do.
const REST: Duration = Duration::from_millis(40);

/// Shots whose pictures the page may still ask for.
const SHOTS_SHOWN: usize = 4;

/// The session's engine.
pub struct Engine {
    /// One session a task.
    pub sessions: Vec<Session>,
    /// Which of them is shown.
    pub active: usize,
    /// Where pictures come from.
    pub source: Box<dyn Source>,
    /// Where what was gathered is kept.
    pub folder: SessionFolder,
    /// The rig file.
    pub rig: PathBuf,
    /// The board in words.
    pub board: String,
    /// Where the page looks.
    pub desk: Arc<Desk>,
    /// Work in progress.
    pub state: Progress,
}

/// What the engine is in the middle of.
#[derive(Default)]
pub struct Progress {
    /// A shot of a source with an end that is shown, but has not been offered.
    pending: Option<(RawShot, Shot)>,
    ended: bool,
    solving: Option<Receiver<Solving>>,
    step: Option<(String, f64)>,
    /// Views of the result of each task.
    shown: Vec<Option<Shown>>,
    trouble: Option<String>,
}

enum Solving {
    Step(String, f64),
    Done(Box<Result<Outcome, ProblemError>>, Vec<CameraViews>),
}

impl Engine {
    /// Works until `stop`.
    ///
    /// # Errors
    /// What makes the source or the folder useless.
    pub fn run(&mut self, commands: &Receiver<Asked>, stop: &Shutdown) -> Result<(), Box<dyn Error>> {
        self.state.shown = vec![None; self.sessions.len()];
        self.turn_to(self.active)?;
        self.publish(None);
        while !stop.is_requested() {
            while let Ok((command, answer)) = commands.try_recv() {
                let done = self.obey(&command).map_err(|e| e.to_string());
                self.publish(None);
                // The page may have been closed.
                let _ = answer.send(done);
            }
            if !self.work()?
                && let Ok((command, answer)) = commands.recv_timeout(REST)
            {
                let done = self.obey(&command).map_err(|e| e.to_string());
                self.publish(None);
                let _ = answer.send(done);
            }
        }
        Ok(())
    }

    fn session(&mut self) -> &mut Session {
        &mut self.sessions[self.active]
    }

    fn task(&self) -> Task {
        self.sessions[self.active].setup().task
    }

    /// Does a little; says whether there was anything to do.
    fn work(&mut self) -> Result<bool, Box<dyn Error>> {
        match self.session().phase() {
            Phase::Processing => Ok(self.follow_solving()),
            Phase::Gathering => self.gather(),
            Phase::Preview | Phase::Review | Phase::Saved => self.preview(),
        }
    }

    fn preview(&mut self) -> Result<bool, Box<dyn Error>> {
        let endless = self.source.position().is_none();
        if !endless && (self.state.pending.is_some() || self.state.ended) {
            return Ok(false);
        }
        let Some(raw) = self.next()? else { return Ok(false) };
        let depth = if endless { Depth::Guiding } else { Depth::Final };
        let shot = raw.search(self.session().detector(), depth);
        self.session().look(&shot);
        self.publish(Some(&raw));
        if !endless {
            self.state.pending = Some((raw, shot));
        }
        Ok(true)
    }

    fn gather(&mut self) -> Result<bool, Box<dyn Error>> {
        if self.source.is_continuous() {
            let raw = match self.state.pending.take() {
                Some((raw, _)) => raw,
                None => match self.next()? {
                    Some(raw) => raw,
                    None => return Ok(false),
                },
            };
            let detector = Arc::clone(self.session().detector());
            let glance = raw.search(&detector, Depth::Guiding);
            if self.session().look(&glance).keeps_any() {
                let shot = raw.search(&detector, Depth::Final);
                self.offer(&raw, &shot)?;
            } else {
                self.publish(Some(&raw));
            }
            return Ok(true);
        }
        let (raw, shot) = match self.state.pending.take() {
            Some(pending) => pending,
            None => {
                let Some(raw) = self.next()? else { return Ok(false) };
                let shot = raw.search(self.session().detector(), Depth::Final);
                (raw, shot)
            }
        };
        self.offer(&raw, &shot)?;
        Ok(true)
    }

    /// Offers a shot to the session; what is kept is on disk before anything else happens.
    fn offer(&mut self, raw: &RawShot, shot: &Shot) -> Result<(), Box<dyn Error>> {
        let task = self.task();
        let session = &mut self.sessions[self.active];
        let cameras = session.setup().cameras.clone();
        let kept = session.offer(shot).cloned();
        let pictures: Vec<_> = raw.lumas().into_iter().map(|l| l.map(AsRef::as_ref)).collect();
        if let Some(kept) = &kept {
            self.folder.store(task, &cameras, kept, &pictures)?;
        }
        // A live rig's frames never come again, so nobody asks whether one has been looked at.
        if self.source.position().is_some() {
            let verdict = self.sessions[self.active].last_verdict();
            let reasons: Vec<String> = verdict
                .iter()
                .flat_map(|v| &v.cameras)
                .zip(&cameras)
                .filter_map(|(v, camera)| match v {
                    Some(Err(reason)) => Some(format!("{}: {reason}", camera.name)),
                    _ => None,
                })
                .collect();
            self.folder.note(task, &shot.name, kept.is_none().then(|| reasons.join("; ")))?;
        }
        self.publish(Some(raw));
        Ok(())
    }

    fn next(&mut self) -> Result<Option<RawShot>, Box<dyn Error>> {
        match self.source.next()? {
            Next::Shot(raw) => Ok(Some(raw)),
            Next::NotYet => Ok(None),
            Next::End => {
                self.state.ended = true;
                let session = self.session();
                session.set_exhausted();
                if session.phase() == Phase::Gathering {
                    session.pause()?;
                }
                self.publish(None);
                Ok(None)
            }
        }
    }

    fn follow_solving(&mut self) -> bool {
        let Some(receiver) = &self.state.solving else { return false };
        match receiver.try_recv() {
            Ok(Solving::Step(what, share)) => self.state.step = Some((what, share)),
            Ok(Solving::Done(result, views)) => {
                let active = self.active;
                self.sessions[active].finish(*result);
                self.state.shown[active] = self.sessions[active]
                    .outcome()
                    .map(|outcome| Shown { outcome: Arc::clone(outcome), views: Arc::new(views) });
                self.adopt();
                (self.state.solving, self.state.step) = (None, None);
            }
            Err(TryRecvError::Empty) => return false,
            Err(TryRecvError::Disconnected) => {
                // The solver's thread died: its panic has been printed.
                self.state.trouble = Some("the computation broke off; see the terminal".into());
                (self.state.solving, self.state.step) = (None, None);
                self.session().abandon();
            }
        }
        self.publish(None);
        true
    }

    /// Lenses and poses that were just found serve what comes next.
    fn adopt(&mut self) {
        let Some(outcome) = self.sessions[self.active].outcome().cloned() else { return };
        for session in self.sessions.iter_mut().filter(|s| s.setup().task != Task::Mono) {
            for mut camera in session.setup().cameras.clone() {
                camera.model = outcome.model(&camera.name).copied().or(camera.model);
                match outcome.as_ref() {
                    Outcome::Rig { rig, .. } => {
                        let found = rig.cameras.iter().find(|c| c.name == camera.name);
                        camera.camera_from_first = found.map(|c| c.camera_from_first);
                    }
                    Outcome::Mono(_) | Outcome::Table(_) => {}
                }
                session.set_camera(camera);
            }
        }
    }

    fn obey(&mut self, command: &Command) -> Result<(), Box<dyn Error>> {
        self.state.trouble = None;
        let task = self.task();
        match command {
            Command::Task { task } => {
                let task: Task = task.parse()?;
                let place = self.sessions.iter().position(|s| s.setup().task == task);
                let place = place.ok_or_else(|| format!("this session has no task {task}"))?;
                if self.session().phase() == Phase::Processing {
                    return Err("wait until the computation is done".into());
                }
                if self.session().phase() == Phase::Gathering {
                    self.session().pause()?;
                }
                self.turn_to(place)?;
            }
            Command::Gather => self.session().gather()?,
            Command::Pause => self.session().pause()?,
            Command::Undo => {
                let shot = self.session().undo()?;
                self.folder.remove(task, &shot.name)?;
            }
            Command::Drop { view } => {
                let shot = self.session().drop_shot(view)?;
                self.folder.remove(task, &shot.name)?;
            }
            Command::Place { x_m, y_m, turned_deg, height_m } => {
                if ![x_m, y_m, turned_deg, height_m].iter().all(|v| v.is_finite()) {
                    return Err("a place is four numbers".into());
                }
                let yaw_rad = turned_deg.to_radians();
                let place = BoardOnTable { origin_m: [*x_m, *y_m], yaw_rad, height_m: *height_m };
                self.session().place_board(place);
            }
            Command::Mark(mark) => {
                self.session().set_mark(mark.clone())?;
                self.folder.store_marks(task, self.sessions[self.active].marks())?;
            }
            Command::ClearMarks => {
                self.session().clear_marks()?;
                self.folder.store_marks(task, &[])?;
            }
            Command::Process => {
                let problem = self.session().process()?;
                let (sender, receiver) = channel();
                std::thread::Builder::new().name("solve".into()).spawn(move || {
                    // Nobody listens any more when the session is ended meanwhile.
                    let step = |what: &str, share| {
                        let _ = sender.send(Solving::Step(what.to_owned(), share));
                    };
                    let result = problem.solve(&step);
                    let _ = sender.send(Solving::Done(Box::new(result), problem.views_with_marks()));
                })?;
                self.state.solving = Some(receiver);
            }
            Command::Save => self.save()?,
        }
        Ok(())
    }

    fn save(&mut self) -> Result<(), Box<dyn Error>> {
        let task = self.task();
        let session = &self.sessions[self.active];
        let outcome = session.outcome().cloned().ok_or("there is no result to save: process first")?;
        if session.is_stale() {
            return Err("views have changed since the result was computed: process again first".into());
        }
        match outcome.as_ref() {
            Outcome::Mono(solved) => {
                save::intrinsics(&self.rig, &self.board, solved.iter().map(|s| &s.calibration))?;
            }
            Outcome::Rig { solved, rig, .. } => {
                if !solved.is_empty() {
                    save::intrinsics(&self.rig, &self.board, solved.iter().map(|s| &s.calibration))?;
                }
                save::rig(&self.rig, &self.board, rig)?;
            }
            Outcome::Table(table) => {
                let frames = session.kept().len() + usize::from(!session.marks().is_empty());
                save::table(&self.rig, &self.board, frames, &table.table)?;
            }
        }
        self.folder.write(task, "report.json", &serde_json::to_string_pretty(&outcome.report())?)?;
        self.session().saved()?;
        Ok(())
    }

    /// Shows another task; a source with an end begins again, without what the task has looked at.
    fn turn_to(&mut self, place: usize) -> Result<(), Box<dyn Error>> {
        self.active = place;
        let looked = self.folder.looked(self.task())?;
        self.source.rewind(looked);
        (self.state.pending, self.state.ended) = (None, false);
        Ok(())
    }
}
