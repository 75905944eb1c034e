//! Pictures of boards: files, folders of files, or a recording; and the boards found in them.

use std::{collections::BTreeMap, error::Error, path::PathBuf, sync::Arc};

use indicatif::{ProgressBar, ProgressStyle};
use netcord_calib::{
    detect::{Detector, Luma},
    gather::{GatherOptions, Gathered, Rejection, gather_from, pictures, read},
    solve::CameraViews,
};
use netcord_capture::recording::{FilmedCamera, Footage, group};
use netcord_common::FrameView;

use super::board;

/// A picture that has not been read yet.
#[derive(Debug, Clone)]
pub enum Shot {
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
pub type CameraShots = (String, Vec<(String, Shot)>);

/// Triggers of a recording that are searched, spread evenly over it: a minute's recording holds thousands.
const SEARCHED: usize = 300;

impl Shot {
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
pub fn shots(images: &[String]) -> Result<Vec<CameraShots>, Box<dyn Error>> {
    let mut cameras: Vec<CameraShots> = Vec::new();
    let mut add =
        |camera: &str, found: Vec<(String, Shot)>| match cameras.iter_mut().find(|(n, _)| n == camera) {
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
        let found = found.into_iter().map(|p| (p.name, Shot::File(p.path))).collect();
        add(camera.unwrap_or("camera"), found);
    }
    Ok(cameras)
}

fn of_recording(path: &str, only: Option<&str>) -> Result<Vec<CameraShots>, Box<dyn Error>> {
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
    let mut cameras: Vec<CameraShots> =
        wanted.iter().map(|(_, c)| (c.name.to_string(), Vec::new())).collect();
    for trigger in triggers.iter().step_by(stride) {
        for ((place, frame), (_, found)) in trigger.frames.iter().enumerate().zip(&mut cameras) {
            if let Some(frame) = frame {
                let shot =
                    Shot::Frame { footage: Arc::clone(&footage), camera: wanted[place].0, frame: *frame };
                found.push((format!("{:06}", trigger.id), shot));
            }
        }
    }
    Ok(cameras)
}

/// Finds the board `spec` in the pictures of each camera, with a progress bar; says what was not kept, and why.
pub fn find(
    spec: &str,
    images: &[String],
    options: &GatherOptions,
) -> Result<Vec<CameraViews>, Box<dyn Error>> {
    let detector = Detector::new(board::parse(spec)?);
    let mut cameras = Vec::new();
    for (camera, shots) in shots(images)? {
        let style = ProgressStyle::with_template("{prefix} {bar:40} {pos}/{len}")?;
        let bar = ProgressBar::new(shots.len() as u64).with_style(style).with_prefix(camera.clone());
        let gathered = gather_from(&camera, &shots, Shot::read, &detector, options, &|| bar.inc(1));
        bar.finish_and_clear();
        println!("{camera}: {} of {} pictures kept", gathered.views.views.len(), shots.len());
        say_rejected(&gathered);
        if gathered.views.views.is_empty() {
            let why =
                gathered.rejected.first().map_or(String::new(), |(name, why)| format!(" ({name}: {why})"));
            return Err(
                format!("camera {camera}: none of its {} pictures is of use{why}", shots.len()).into()
            );
        }
        cameras.push(gathered.views);
    }
    Ok(cameras)
}

/// One line a picture; of many that share their reason, one line.
fn say_rejected(gathered: &Gathered) {
    /// More than this many of one reason are told together.
    const FEW: usize = 5;
    let mut by_reason: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for (name, reason) in &gathered.rejected {
        by_reason.entry(reason.to_string()).or_default().push(name);
    }
    for (reason, names) in by_reason {
        let shown = names.iter().take(FEW).copied().collect::<Vec<_>>().join(", ");
        let more = if names.len() > FEW { format!(" and {} more", names.len() - FEW) } else { String::new() };
        println!("  {shown}{more}: {reason}");
    }
}
