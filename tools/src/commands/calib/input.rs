//! Where corners come from: a file of corners, or pictures of boards, which a session without a browser gathers.

use std::{
    error::Error,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use indicatif::ProgressBar;
use netcord_calib::{
    detect::Detector,
    gather::GatherOptions,
    session::{Outcome, Problem, ProblemError, Session, SessionCamera, Setup, Solver, Task},
    solve::{CameraViews, read_corners, write_corners},
};
use netcord_common::camera::CameraModel;

use super::{
    board,
    pictures::{self, CameraPictures},
    plots,
};
use crate::output::{self, OutputError};

/// Where corners come from.
#[derive(Debug, Clone, clap::Args)]
pub struct InputArgs {
    /// Pictures or folders of pictures; for several cameras NAME=FOLDER each, files of one name being
    /// simultaneous; or one recording (.mcap).
    #[arg(value_name = "IMAGES", required_unless_present = "corners")]
    images: Vec<String>,

    /// Corners from a file, instead of pictures.
    #[arg(long, value_name = "FILE.json", conflicts_with = "images")]
    corners: Option<PathBuf>,

    /// The board in the pictures, as for `calib board`.
    #[arg(long, required_unless_present = "corners")]
    board: Option<String>,

    /// Keep a view only if the intersection over union of its board's outline with each view kept before
    /// is at most this; of simultaneous views, with one camera's.
    #[arg(long, default_value_t = GatherOptions::default().max_iou, value_name = "0–1")]
    max_iou: f64,

    /// Keep at most so many views of each camera.
    #[arg(long, default_value_t = GatherOptions::default().max_views, value_name = "N")]
    max_views: usize,

    /// Write the corners found here, to be read back with --corners.
    #[arg(long, value_name = "FILE.json", conflicts_with = "corners")]
    save_corners: Option<PathBuf>,
}

/// What is to be calibrated.
pub struct Wanted<'a> {
    /// Lenses, or poses.
    pub task: Task,
    /// How many cameras it takes, where that is settled, and what to say to another number.
    pub exactly: Option<(usize, &'static str)>,
    /// How.
    pub solver: Solver,
    /// Intrinsics of a camera that are known and stay.
    pub model: &'a dyn Fn(&str) -> Result<Option<CameraModel>, Box<dyn Error>>,
}

/// A result, and what it came from.
pub struct Solved {
    /// The result.
    pub outcome: Arc<Outcome>,
    /// Per camera.
    pub cameras: Vec<CameraViews>,
    /// The board in words, for the rig file.
    pub board: String,
}

/// Where corners come from, looked at and not yet searched.
pub struct Input<'a> {
    args: &'a InputArgs,
    from: From<'a>,
}

enum From<'a> {
    Corners { path: &'a Path, cameras: Vec<CameraViews> },
    Pictures { board: &'a str, cameras: Vec<CameraPictures> },
}

impl InputArgs {
    /// Reads the corners, or finds out what pictures there are.
    pub fn open(&self) -> Result<Input<'_>, Box<dyn Error>> {
        let from = if let Some(path) = &self.corners {
            From::Corners { path, cameras: read_corner_file(path)? }
        } else {
            let board = self.board.as_deref().ok_or("--board is missing: which board is in the pictures?")?;
            From::Pictures { board, cameras: pictures::unread(&self.images)? }
        };
        Ok(Input { args: self, from })
    }
}

impl Input<'_> {
    /// Refuses outputs that would replace what is read, or each other: the rig file is read, and written by its own
    /// rules; beside the report go the cameras' plots.
    pub fn check_outputs(&self, rig: Option<&Path>, report: Option<&Path>) -> Result<(), OutputError> {
        let mut read: Vec<PathBuf> = rig.map(Path::to_owned).into_iter().collect();
        let names: Vec<&str> = match &self.from {
            From::Corners { path, cameras } => {
                read.push((*path).to_owned());
                cameras.iter().map(|camera| camera.name.as_str()).collect()
            }
            From::Pictures { board, cameras } => {
                read.extend(board::dictionary_file(board));
                read.extend(pictures::files(cameras).map(Path::to_owned));
                cameras.iter().map(|(name, _)| name.as_str()).collect()
            }
        };
        let mut written: Vec<PathBuf> = self.args.save_corners.iter().cloned().collect();
        if let Some(report) = report {
            written.push(report.to_owned());
            written.extend(plots::paths(report, names)?);
        }
        output::check(&read, &written)
    }

    /// Leads a session through the pictures, unless there are corners; and solves.
    pub fn solve(self, wanted: Wanted<'_>) -> Result<Solved, Box<dyn Error>> {
        let (spec, pictures) = match self.from {
            From::Corners { cameras, .. } => return solve_corners(cameras, wanted),
            From::Pictures { board, cameras } => (board, cameras),
        };
        let detector = Arc::new(Detector::new(board::parse(spec)?));
        let mut setup = wanted.setup(pictures.iter().map(|(name, _)| name.clone()).collect())?;
        let shots = pictures::search(&detector, &pictures)?;
        (setup.options.max_iou, setup.options.max_views) = (self.args.max_iou, self.args.max_views);
        let mut session = Session::new(setup, detector);
        pictures::offer(&mut session, shots)?;
        let cameras = session.views();
        if let Some(path) = &self.args.save_corners {
            output::write(path, write_corners(&cameras))?;
        }
        let outcome = process(&mut session)?;
        Ok(Solved { outcome, cameras, board: spec.to_owned() })
    }
}

/// Solves what a session has gathered, with a progress bar.
pub fn process(session: &mut Session) -> Result<Arc<Outcome>, Box<dyn Error>> {
    let problem = session.process()?;
    session.finish(solved(&problem));
    let failed = || session.failure().unwrap_or("the computation gave no result").to_owned();
    Ok(session.outcome().cloned().ok_or_else(failed)?)
}

fn solved(problem: &Problem) -> Result<Outcome, ProblemError> {
    let bar = ProgressBar::new(100);
    let result = problem.solve(&|what, share| {
        bar.set_position((100.0 * share) as u64);
        bar.set_message(what.to_owned());
    });
    bar.finish_and_clear();
    result
}

fn read_corner_file(path: &Path) -> Result<Vec<CameraViews>, String> {
    let text = fs::read_to_string(path)
        .map_err(|e| format!("cannot read the corner file {}: {e}", path.display()))?;
    read_corners(&text).map_err(|e| {
        let why = e.source().map_or(String::new(), |s| format!(": {s}"));
        format!("{}: {e}{why}", path.display())
    })
}

/// Corners that somebody else found: nothing is to be gathered.
fn solve_corners(cameras: Vec<CameraViews>, wanted: Wanted<'_>) -> Result<Solved, Box<dyn Error>> {
    let setup = wanted.setup(cameras.iter().map(|c| c.name.clone()).collect())?;
    for (camera, known) in cameras.iter().zip(&setup.cameras) {
        if let Some(m) = known.model.filter(|m| (m.width, m.height) != camera.size) {
            return Err(format!(
                "camera {}: the pictures are {} × {} px, its intrinsics are for {} × {}",
                camera.name, camera.size.0, camera.size.1, m.width, m.height
            )
            .into());
        }
    }
    let problem = Problem { setup, cameras, carried: Vec::new(), marks: Vec::new() };
    let outcome = Arc::new(solved(&problem)?);
    Ok(Solved { outcome, cameras: problem.cameras, board: "corners from a file".to_owned() })
}

impl Wanted<'_> {
    fn setup(self, names: Vec<String>) -> Result<Setup, Box<dyn Error>> {
        if let Some((_, said)) = self.exactly.filter(|(count, _)| *count != names.len()) {
            return Err(format!("{said}, not {}", names.len()).into());
        }
        let camera = |name: String| -> Result<SessionCamera, Box<dyn Error>> {
            Ok(SessionCamera { model: (self.model)(&name)?, name, camera_from_first: None })
        };
        let cameras = names.into_iter().map(camera).collect::<Result<_, _>>()?;
        Ok(Setup { solver: self.solver, ..Setup::new(self.task, cameras) })
    }
}
