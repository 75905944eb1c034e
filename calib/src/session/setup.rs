use std::{fmt, str::FromStr};

use netcord_common::{
    camera::CameraModel,
    geometry::{Camera, Transform, World},
};
use serde::Serialize;

use crate::{
    gather::GatherOptions,
    solve::{MonoOptions, RigOptions},
    table::{BoardOnTable, Contact, TableStart},
};

/// What a session is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Task {
    /// Each camera's intrinsics, from views of its own.
    Mono,
    /// The cameras' poses, from views that several have at once.
    Rig,
    /// Where the table is, from a board that lies on it.
    Table,
}

impl Task {
    /// All, in the order in which a lab does them.
    pub const ALL: [Self; 3] = [Self::Mono, Self::Rig, Self::Table];

    /// Its name in commands and folders.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mono => "mono",
            Self::Rig => "rig",
            Self::Table => "table",
        }
    }
}

impl fmt::Display for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Task {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|t| t.name() == text);
        found.ok_or_else(|| format!("{text:?} is no task; valid are mono, rig and table"))
    }
}

/// A camera that takes part.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionCamera {
    /// Its name.
    pub name: String,
    /// Its intrinsics, where they are known.
    pub model: Option<CameraModel>,
    /// Its pose, where it is known; `World` is the first camera's frame.
    pub camera_from_first: Option<Transform<Camera, World>>,
}

/// How what was gathered is solved.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Solver {
    /// Each camera by itself.
    pub mono: MonoOptions,
    /// All cameras together.
    pub rig: RigOptions,
}

/// What is known of the table beside what cameras see of it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TableKnown {
    /// Points that lie at a known height over it, such as bounces.
    pub contacts: Vec<Contact>,
    /// Where it is believed to be.
    pub start: Option<TableStart>,
    /// Standard deviation of a mark along one axis, px, where it is known.
    pub noise_px: Option<f64>,
}

/// What is settled before a session begins.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// What it is for.
    pub task: Task,
    /// The cameras; the first is the one that poses refer to.
    pub cameras: Vec<SessionCamera>,
    /// How the board lies on the table, for that task.
    pub on_table: Option<BoardOnTable>,
    /// What is known of the table otherwise, for that task.
    pub table: TableKnown,
    /// Which views are kept.
    pub options: GatherOptions,
    /// How they are solved.
    pub solver: Solver,
    /// Whether shots follow each other in time, so that a board in motion can be told, and the same reason to
    /// reject counts once until it changes. Not so for pictures that somebody chose.
    pub continuous: bool,
    /// Largest difference of the stamps of one shot, ns.
    pub tolerance_ns: u64,
}

impl Setup {
    /// The task's own options: what several cameras see at once must be numbered alike, and looks at a board
    /// that lies on the table are all alike.
    pub fn new(task: Task, cameras: Vec<SessionCamera>) -> Self {
        let options = match task {
            Task::Mono => GatherOptions::default(),
            Task::Rig => GatherOptions { allow_unanchored: false, max_views: 60, ..GatherOptions::default() },
            Task::Table => GatherOptions {
                allow_unanchored: false,
                max_iou: 1.0,
                max_views: 10,
                ..GatherOptions::default()
            },
        };
        Self {
            task,
            cameras,
            on_table: None,
            table: TableKnown::default(),
            options,
            solver: Solver::default(),
            continuous: false,
            tolerance_ns: 5_000_000,
        }
    }
}
