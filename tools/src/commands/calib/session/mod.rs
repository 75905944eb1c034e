//! `netcord calib session`: a page that leads from the preview to a saved calibration.

mod desk;
mod engine;
mod guard;
mod http;
mod picture;
mod result;
mod routes;
mod source;

use std::{
    error::Error,
    net::{IpAddr, SocketAddr},
    path::{Path, PathBuf},
    sync::Arc,
};

use netcord_calib::{
    detect::Detector,
    session::{Session, SessionCamera, SessionFolder, Setup, Task},
};
use netcord_common::{DomainName, Shutdown, rig::RigEdit};

use self::{
    desk::Desk,
    engine::{Engine, Progress},
    guard::Guard,
    routes::Routes,
    source::{FolderSource, LiveSource, RecordingSource, Source},
};
use super::board;
use crate::exit::{CommandResult, Outcome};

/// Leads through a calibration in a browser: preview, gathering, processing, review, saving into the rig file. Open
/// the address that it prints. What has been gathered is on disk at once, so that a session that is stopped goes on
/// where it was. Frames come from the running rig, or from a recording or pictures where these are given.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The rig file; it need not be calibrated yet.
    rig: PathBuf,

    /// The board, as for `calib board`.
    #[arg(long)]
    board: String,

    /// Pictures instead of a running rig: NAME=FOLDER for each camera, files of one name being simultaneous.
    #[arg(long, value_name = "NAME=FOLDER", num_args = 1.., conflicts_with = "recording")]
    images: Vec<String>,

    /// A recording instead of a running rig.
    #[arg(long, value_name = "IN.mcap")]
    recording: Option<PathBuf>,

    /// What to begin with: mono (each camera's lens), rig (the cameras' poses) or table.
    #[arg(long, default_value = "mono")]
    task: Task,

    /// Where to keep what is gathered; default: the rig file's name with .session at its end.
    #[arg(long, value_name = "FOLDER")]
    folder: Option<PathBuf>,

    /// The domain of the running rig; default: the rig's name.
    #[arg(long, env = "NETCORD_DOMAIN", value_name = "NAME")]
    domain: Option<DomainName>,

    /// The address on which the page is served; 0.0.0.0 for all of this machine's, for whoever knows the page's
    /// full address.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    bind: IpAddr,

    /// The port on which the page is served; 0 for any that is free.
    #[arg(long, value_name = "PORT", default_value_t = 8770)]
    port: u16,
}

/// Runs `netcord calib session`.
pub fn run(args: &Args) -> CommandResult {
    let edit = RigEdit::open(&args.rig)?;
    let names = edit.camera_names();
    if names.is_empty() {
        return Err(format!("{} has no [[camera]]", args.rig.display()).into());
    }
    let board = board::parse(&args.board)?;
    let description = board.to_string();
    let source = source(args, &edit, &names)?;
    let detector = Arc::new(Detector::new(board));
    let root = args.folder.clone().unwrap_or_else(|| default_folder(&args.rig));
    let folder = SessionFolder::open(&root, &description)?;
    let mut sessions = Vec::new();
    for task in Task::ALL {
        if task == Task::Rig && names.len() < 2 {
            continue;
        }
        sessions.push(session(task, &edit, &names, source.as_ref(), &detector, &folder)?);
    }
    let active = sessions.iter().position(|s| s.setup().task == args.task);
    let active =
        active.ok_or_else(|| format!("{} has too few cameras for {}", args.rig.display(), args.task))?;

    let stop = Shutdown::on_signals()?;
    let (desk, commands) = Desk::new();
    let address = SocketAddr::new(args.bind, args.port);
    // The port may be any: the guard is made once it is known.
    let routes: Arc<std::sync::OnceLock<Routes>> = Arc::default();
    let answering = Arc::clone(&routes);
    let (local, server) = http::serve(address, stop.clone(), move |request| match answering.get() {
        Some(routes) => routes.answer(request),
        None => http::Response::text(404, "Not yet."),
    })
    .map_err(|e| format!("cannot serve the page on {address}: {e}"))?;
    let guard = Guard::new(local);
    println!("{}", guard.url());
    let own = SessionFolder::open(&root, &description)?;
    // Nobody else sets it.
    let _ = routes.set(Routes { guard, desk: Arc::clone(&desk), cameras: names, folder: own });

    let mut engine = Engine {
        sessions,
        active,
        source,
        folder,
        rig: args.rig.clone(),
        board: description,
        desk,
        state: Progress::default(),
    };
    let result = engine.run(&commands, &stop);
    stop.request();
    // It only waits and sleeps.
    let _ = server.join();
    result.map(|()| Outcome::Good)
}

fn source(args: &Args, edit: &RigEdit, names: &[String]) -> Result<Box<dyn Source>, Box<dyn Error>> {
    if !args.images.is_empty() {
        return Ok(Box::new(FolderSource::open(&args.images, names)?));
    }
    if let Some(recording) = &args.recording {
        return Ok(Box::new(RecordingSource::open(recording, names)?));
    }
    let domain = match &args.domain {
        Some(domain) => domain.clone(),
        None => DomainName::new(edit.name().unwrap_or_default())?,
    };
    Ok(Box::new(LiveSource::attach(&domain, names)?))
}

fn session(
    task: Task,
    edit: &RigEdit,
    names: &[String],
    source: &dyn Source,
    detector: &Arc<Detector>,
    folder: &SessionFolder,
) -> Result<Session, Box<dyn Error>> {
    // A lens that is being calibrated is not known, whatever the file says of it.
    let model = |name: &String| if task == Task::Mono { None } else { edit.intrinsics(name) };
    let poses = edit.poses();
    let cameras = names.iter().map(|name| SessionCamera {
        name: name.clone(),
        model: model(name),
        camera_from_first: poses.get(name).copied(),
    });
    let cameras = cameras.collect();
    let setup = Setup { continuous: source.is_continuous(), ..Setup::new(task, cameras) };
    let kept = folder.load(task, &setup.cameras)?;
    let mut session = Session::new(setup, Arc::clone(detector));
    session.restore(kept);
    for mark in folder.load_marks(task)? {
        session.set_mark(mark)?;
    }
    Ok(session)
}

fn default_folder(rig: &Path) -> PathBuf {
    rig.with_extension("session")
}
