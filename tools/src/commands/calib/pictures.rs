//! Pictures of boards: files, folders of files, or a recording; and the boards found in them.

use std::{
    collections::{BTreeMap, BTreeSet},
    error::Error,
    path::{Path, PathBuf},
    sync::Arc,
};

use indicatif::{ProgressBar, ProgressStyle, style::TemplateError};
use netcord_calib::{
    detect::{Depth, Detector, Luma},
    gather::{GatherOptions, Rejection, pictures, read},
    session::{Reason, Session, SessionCamera, Setup, Shot, Sight, Task},
    solve::CameraViews,
};
use netcord_capture::recording::{FilmedCamera, Footage, group};
use netcord_common::FrameView;
use rayon::prelude::*;

use super::board;

/// A picture that has not been read yet.
#[derive(Debug, Clone)]
pub enum Unread {
    /// A file.
    File(PathBuf),
    /// A frame of a recording.
    Frame {
        /// The recording.
        footage: Arc<Footage>,
        /// Place of its camera.
        camera: usize,
        /// Place of the frame.
        frame: usize,
    },
}

/// Pictures of one camera by the names of their instants.
pub type CameraPictures = (String, Vec<(String, Unread)>);

/// Triggers of a recording that are searched, spread evenly over it: a minute's recording holds thousands.
const SEARCHED: usize = 300;

impl Unread {
    /// The file that it is read from.
    pub fn file(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Frame { footage, .. } => footage.file().path(),
        }
    }

    /// Middle of the exposure, ns, where it is known.
    fn stamp_ns(&self) -> Option<u64> {
        match self {
            Self::File(_) => None,
            Self::Frame { footage, camera, frame } => Some(footage.cameras[*camera].frames[*frame].stamp_ns),
        }
    }

    /// Reads it as grey values.
    pub fn read(&self) -> Result<Luma, Rejection> {
        let unreadable = |e: String| Rejection::Unreadable(e);
        match self {
            Self::File(path) => read(path),
            Self::Frame { footage, camera, frame } => {
                let frame = &footage.cameras[*camera].frames[*frame];
                let bytes = footage.file().read(&frame.pixels).map_err(|e| unreadable(e.to_string()))?;
                let size = (frame.width as usize, frame.height as usize);
                let view = FrameView::new(&bytes, size, frame.step as usize, frame.format)
                    .map_err(|e| unreadable(e.to_string()))?;
                Ok(Luma::of_frame(&view))
            }
        }
    }
}

/// The pictures that `images` mean, by camera in their order: `NAME=PATH` or `PATH` of a picture or a folder of
/// them (the camera is then called `camera`), or a recording with all its cameras (or with `NAME=` one of them).
pub fn unread(images: &[String]) -> Result<Vec<CameraPictures>, Box<dyn Error>> {
    let mut cameras: Vec<CameraPictures> = Vec::new();
    let mut add =
        |camera: &str, found: Vec<(String, Unread)>| match cameras.iter_mut().find(|(n, _)| n == camera) {
            Some((_, known)) => known.extend(found),
            None => cameras.push((camera.to_owned(), found)),
        };
    for image in images {
        let (camera, path) = match image.split_once('=') {
            Some((camera, path)) => (Some(camera), path),
            None => (None, image.as_str()),
        };
        if path.ends_with(".mcap") {
            for (name, found) in of_recording(path, camera)? {
                add(&name, found);
            }
            continue;
        }
        let found = pictures(path.as_ref()).map_err(|e| format!("cannot read {path}: {e}"))?;
        if found.is_empty() {
            return Err(format!("{path} holds no PNG or JPEG pictures").into());
        }
        let found = found.into_iter().map(|p| (p.name, Unread::File(p.path))).collect();
        add(camera.unwrap_or("camera"), found);
    }
    Ok(cameras)
}

/// All files that these pictures are read from.
pub fn files(cameras: &[CameraPictures]) -> impl Iterator<Item = &Path> {
    let all = cameras.iter().flat_map(|(_, pictures)| pictures.iter().map(|(_, picture)| picture.file()));
    // The frames of a recording share one.
    all.collect::<BTreeSet<_>>().into_iter()
}

fn of_recording(path: &str, only: Option<&str>) -> Result<Vec<CameraPictures>, Box<dyn Error>> {
    let footage = Arc::new(Footage::open(path.as_ref())?);
    let wanted: Vec<(usize, &FilmedCamera)> = footage
        .cameras
        .iter()
        .enumerate()
        .filter(|(_, c)| only.is_none_or(|o| c.name.as_str() == o))
        .collect();
    if wanted.is_empty() {
        let names: Vec<&str> = footage.cameras.iter().map(|c| c.name.as_str()).collect();
        let only = only.unwrap_or("that delivered frames");
        return Err(format!("{path} has no camera {only}; it has {}", names.join(", ")).into());
    }
    let filmed: Vec<&FilmedCamera> = wanted.iter().map(|(_, c)| *c).collect();
    let tolerance_ns = footage.interval_ns().unwrap_or(0) / 2;
    let triggers = group(&filmed, tolerance_ns);
    let stride = triggers.len().div_ceil(SEARCHED).max(1);
    let mut cameras: Vec<CameraPictures> =
        wanted.iter().map(|(_, c)| (c.name.to_string(), Vec::new())).collect();
    for trigger in triggers.iter().step_by(stride) {
        for ((place, frame), (_, found)) in trigger.frames.iter().enumerate().zip(&mut cameras) {
            if let Some(frame) = frame {
                let shot =
                    Unread::Frame { footage: Arc::clone(&footage), camera: wanted[place].0, frame: *frame };
                found.push((format!("{:06}", trigger.id), shot));
            }
        }
    }
    Ok(cameras)
}

/// What the cameras saw at each instant of the board: all pictures searched, on all cores, with a progress bar.
pub fn search(detector: &Detector, cameras: &[CameraPictures]) -> Result<Vec<Shot>, TemplateError> {
    let mut instants: BTreeMap<String, Vec<Option<Unread>>> = BTreeMap::new();
    for (place, (_, pictures)) in cameras.iter().enumerate() {
        for (name, picture) in pictures {
            // Two pictures of one name by one camera, from two folders, are two instants.
            let free = |name: &String, instants: &BTreeMap<String, Vec<Option<Unread>>>| {
                instants.get(name).is_none_or(|p| p[place].is_none())
            };
            let (mut own, mut copies) = (name.clone(), 1);
            while !free(&own, &instants) {
                copies += 1;
                own = format!("{name} ({copies})");
            }
            instants.entry(own).or_insert_with(|| vec![None; cameras.len()])[place] = Some(picture.clone());
        }
    }
    let style = ProgressStyle::with_template("{prefix} {bar:40} {pos}/{len}")?;
    let count = cameras.iter().map(|(_, p)| p.len() as u64).sum();
    let bar = ProgressBar::new(count).with_style(style).with_prefix("searching");
    let sight = |picture: &Unread| -> Result<Sight, Rejection> {
        let found = picture.read().map(|l| Sight::of(&l, detector, Depth::Final, picture.stamp_ns()));
        bar.inc(1);
        found
    };
    let shots = instants
        .into_iter()
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|(name, pictures)| {
            let sights = pictures.par_iter().map(|p| p.as_ref().map(sight)).collect();
            Shot { name, sights }
        })
        .collect();
    bar.finish_and_clear();
    Ok(shots)
}

/// Offers all shots to a session; says what it kept, and why not the rest.
pub fn offer(session: &mut Session, shots: Vec<Shot>) -> Result<(), Box<dyn Error>> {
    let cameras: Vec<String> = session.setup().cameras.iter().map(|c| c.name.clone()).collect();
    let offered = session.offer_all(shots)?;
    for (place, camera) in cameras.iter().enumerate() {
        let verdicts = || offered.iter().filter_map(|o| Some((&o.name, o.verdict.cameras[place].as_ref()?)));
        let rejected = || verdicts().filter_map(|(name, v)| Some((name.as_str(), v.as_ref().err()?)));
        let (given, kept) = (verdicts().count(), verdicts().count() - rejected().count());
        println!("{camera}: {kept} of {given} pictures kept");
        say_rejected(rejected());
        if kept == 0 {
            let why = rejected().next().map_or(String::new(), |(name, why)| format!(" ({name}: {why})"));
            return Err(format!("camera {camera}: none of its {given} pictures is of use{why}").into());
        }
    }
    Ok(())
}

/// All views of the board `spec` in the pictures of each camera that `options` let pass.
pub fn find(
    spec: &str,
    cameras: &[CameraPictures],
    options: &GatherOptions,
) -> Result<Vec<CameraViews>, Box<dyn Error>> {
    let detector = Arc::new(Detector::new(board::parse(spec)?));
    let shots = search(&detector, cameras)?;
    let unknown = |(name, _): &CameraPictures| SessionCamera {
        name: name.clone(),
        model: None,
        camera_from_first: None,
    };
    let setup = Setup::new(Task::Mono, cameras.iter().map(unknown).collect());
    let mut session = Session::new(Setup { options: *options, ..setup }, detector);
    offer(&mut session, shots)?;
    Ok(session.views())
}

/// One line a picture; of many that share their reason, one line.
fn say_rejected<'a>(rejected: impl Iterator<Item = (&'a str, &'a Reason)>) {
    /// More than this many of one reason are told together.
    const FEW: usize = 5;
    let mut by_reason: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for (name, reason) in rejected {
        // Each is like another one: what they are like tells little.
        let text = match reason {
            Reason::View(Rejection::Alike { .. }) => {
                "the board stands much as in a view that is kept".to_owned()
            }
            other => other.to_string(),
        };
        by_reason.entry(text).or_default().push(name);
    }
    for (reason, names) in by_reason {
        let shown = names.iter().take(FEW).copied().collect::<Vec<_>>().join(", ");
        let more = if names.len() > FEW { format!(" and {} more", names.len() - FEW) } else { String::new() };
        println!("  {shown}{more}: {reason}");
    }
}
