//! Where corners come from: a file of corners, or pictures of boards.

use std::{error::Error, fs, path::PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use netcord_calib::{
    detect::Detector,
    gather::{GatherOptions, Picture, gather, pictures},
    solve::{CameraViews, read_corners, write_corners},
};

use super::board;

/// Where corners come from.
#[derive(Debug, Clone, clap::Args)]
pub struct InputArgs {
    /// Pictures or folders of pictures; for several cameras NAME=FOLDER each, files of one name being
    /// simultaneous.
    #[arg(value_name = "IMAGES", required_unless_present = "corners")]
    images: Vec<String>,

    /// Corners from a file, instead of pictures.
    #[arg(long, value_name = "FILE.json", conflicts_with = "images")]
    corners: Option<PathBuf>,

    /// The board in the pictures, as for `calib board`.
    #[arg(long, required_unless_present = "corners")]
    board: Option<String>,

    /// Keep a view only if the intersection over union of its board's outline with each view kept before
    /// is at most this (one camera alone).
    #[arg(long, default_value_t = GatherOptions::default().max_iou, value_name = "0–1")]
    max_iou: f64,

    /// Keep at most so many views of each camera.
    #[arg(long, default_value_t = GatherOptions::default().max_views, value_name = "N")]
    max_views: usize,

    /// Write the corners found here, to be read back with --corners.
    #[arg(long, value_name = "FILE.json")]
    save_corners: Option<PathBuf>,
}

/// Corners, and how many pictures gave none.
pub struct Input {
    /// Per camera.
    pub cameras: Vec<CameraViews>,
    /// The board in words, for the rig file.
    pub board: String,
}

impl InputArgs {
    /// Reads or finds the corners. `simultaneous`: several cameras whose views belong together, so that no
    /// view is left out for being alike.
    pub fn load(&self, simultaneous: bool) -> Result<Input, Box<dyn Error>> {
        if let Some(path) = &self.corners {
            let text = fs::read_to_string(path)
                .map_err(|e| format!("cannot read the corner file {}: {e}", path.display()))?;
            return Ok(Input { cameras: read_corners(&text)?, board: "corners from a file".to_owned() });
        }
        let spec = self.board.as_deref().unwrap_or_default();
        let detector = Detector::new(board::parse(spec)?);
        let options = GatherOptions {
            max_iou: if simultaneous { 1.0 } else { self.max_iou },
            max_views: if simultaneous { usize::MAX } else { self.max_views },
            allow_unanchored: !simultaneous,
            ..GatherOptions::default()
        };
        let mut cameras = Vec::new();
        for (camera, pictures) in self.pictures_by_camera()? {
            let style = ProgressStyle::with_template("{prefix} {bar:40} {pos}/{len}")?;
            let bar = ProgressBar::new(pictures.len() as u64).with_style(style).with_prefix(camera.clone());
            let gathered = gather(&camera, &pictures, &detector, &options, &|| bar.inc(1));
            bar.finish_and_clear();
            println!("{camera}: {} of {} pictures kept", gathered.views.views.len(), pictures.len());
            for (name, reason) in &gathered.rejected {
                println!("  {name}: {reason}");
            }
            if gathered.views.views.is_empty() {
                return Err(
                    format!("camera {camera}: none of its {} pictures is of use", pictures.len()).into()
                );
            }
            cameras.push(gathered.views);
        }
        if let Some(path) = &self.save_corners {
            fs::write(path, write_corners(&cameras))
                .map_err(|e| format!("cannot write {}: {e}", path.display()))?;
        }
        Ok(Input { cameras, board: spec.to_owned() })
    }

    fn pictures_by_camera(&self) -> Result<Vec<(String, Vec<Picture>)>, Box<dyn Error>> {
        let mut cameras: Vec<(String, Vec<Picture>)> = Vec::new();
        for image in &self.images {
            let (camera, path) = image.split_once('=').unwrap_or(("camera", image));
            let found = pictures(path.as_ref()).map_err(|e| format!("cannot read {path}: {e}"))?;
            if found.is_empty() {
                return Err(format!("{path} holds no PNG or JPEG pictures").into());
            }
            match cameras.iter_mut().find(|(n, _)| n == camera) {
                Some((_, known)) => known.extend(found),
                None => cameras.push((camera.to_owned(), found)),
            }
        }
        Ok(cameras)
    }
}
