//! What the engine and the page's requests hand each other.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        mpsc::{Receiver, Sender, channel},
    },
    time::Duration,
};

use netcord_calib::{
    detect::Luma,
    session::{Mark, Outcome, Task},
    solve::CameraViews,
};
use serde::Deserialize;

/// What a page may ask for.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Command {
    /// Turn to another task.
    Task {
        /// Its name.
        task: String,
    },
    /// Keep good views from now on.
    Gather,
    /// Keep none from now on.
    Pause,
    /// Take the last kept shot back.
    Undo,
    /// Leave a kept shot out.
    Drop {
        /// Its name.
        view: String,
    },
    /// Say how the board lies on the table.
    Place {
        /// Its first corner along the table's x, m.
        x_m: f64,
        /// And along y, m.
        y_m: f64,
        /// Its x axis from the table's x axis towards y, degrees.
        turned_deg: f64,
        /// Its printed side over the playing surface, m.
        height_m: f64,
    },
    /// Note where a mark of the table is in a camera's picture.
    Mark(Mark),
    /// Take all marks back.
    ClearMarks,
    /// Compute.
    Process,
    /// Write the result into the rig file.
    Save,
}

/// A command, and where its answer goes.
pub type Asked = (Command, Sender<Result<(), String>>);

/// A result that is shown.
#[derive(Debug, Clone)]
pub struct Shown {
    /// The result.
    pub outcome: Arc<Outcome>,
    /// The views that it was computed from.
    pub views: Arc<Vec<CameraViews>>,
}

/// What the page is told.
#[derive(Debug, Default)]
pub struct Published {
    /// Grows with every change.
    pub version: u64,
    /// The state, as JSON.
    pub state: Arc<str>,
    /// The pictures of the newest shots, newest last, with the shots' numbers: what the page draws on a picture
    /// must belong to it, and it asks for the picture a little later.
    pub pictures: VecDeque<(u64, Vec<Option<Arc<Luma>>>)>,
    /// The task that is shown.
    pub task: Option<Task>,
    /// Its result.
    pub shown: Option<Shown>,
}

/// Between the engine, which has the session, and the threads that answer the page.
#[derive(Debug)]
pub struct Desk {
    published: Mutex<Published>,
    changed: Condvar,
    commands: Mutex<Sender<Asked>>,
}

impl Desk {
    /// And the end at which commands come out.
    pub fn new() -> (Arc<Self>, Receiver<Asked>) {
        let (sender, receiver) = channel();
        let desk = Self {
            published: Mutex::new(Published::default()),
            changed: Condvar::new(),
            commands: Mutex::new(sender),
        };
        (Arc::new(desk), receiver)
    }

    /// What is published now.
    pub fn published(&self) -> MutexGuard<'_, Published> {
        self.published.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Publishes a change.
    pub fn publish(&self, change: impl FnOnce(&mut Published)) {
        let mut published = self.published();
        change(&mut published);
        published.version += 1;
        self.changed.notify_all();
    }

    /// The state once it is newer than `version`, or what it is after `patience`.
    pub fn state_after(&self, version: u64, patience: Duration) -> Arc<str> {
        let published = self.published();
        let (published, _) = self
            .changed
            .wait_timeout_while(published, patience, |p| p.version <= version)
            .unwrap_or_else(PoisonError::into_inner);
        Arc::clone(&published.state)
    }

    /// Hands a command to the engine and waits for its answer.
    ///
    /// # Errors
    /// Why it was not done.
    pub fn ask(&self, command: Command) -> Result<(), String> {
        /// A look at a large picture without a board takes seconds at most.
        const PATIENCE: Duration = Duration::from_secs(30);
        let (sender, answer) = channel();
        let gone = || "the session has ended".to_owned();
        let commands = self.commands.lock().unwrap_or_else(PoisonError::into_inner).clone();
        commands.send((command, sender)).map_err(|_| gone())?;
        answer.recv_timeout(PATIENCE).map_err(|_| gone())?
    }
}
