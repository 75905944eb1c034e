//! Where corners come from: a file of corners, or pictures of boards.

use std::{error::Error, fs, path::PathBuf};

use netcord_calib::{
    gather::{GatherOptions, thin_out},
    solve::{CameraViews, read_corners, write_corners},
};

use super::pictures;

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
    #[arg(long, value_name = "FILE.json")]
    save_corners: Option<PathBuf>,
}

/// Corners, and what they are of.
pub struct Input {
    /// Per camera.
    pub cameras: Vec<CameraViews>,
    /// The board in words, for the rig file.
    pub board: String,
}

impl InputArgs {
    /// Reads or finds the corners. `simultaneous`: of several cameras whose views belong together.
    pub fn load(&self, simultaneous: bool) -> Result<Input, Box<dyn Error>> {
        if let Some(path) = &self.corners {
            let text = fs::read_to_string(path)
                .map_err(|e| format!("cannot read the corner file {}: {e}", path.display()))?;
            return Ok(Input { cameras: read_corners(&text)?, board: "corners from a file".to_owned() });
        }
        let spec = self.board.as_deref().unwrap_or_default();
        let options =
            GatherOptions { max_iou: self.max_iou, max_views: self.max_views, ..GatherOptions::default() };
        let cameras = if simultaneous {
            let all =
                GatherOptions { max_iou: 1.0, max_views: usize::MAX, allow_unanchored: false, ..options };
            let mut cameras = pictures::find(spec, &self.images, &all)?;
            let left_out = thin_out(&mut cameras, &options);
            if !left_out.is_empty() {
                println!("{} more views are left out: they tell nothing new", left_out.len());
            }
            cameras
        } else {
            pictures::find(spec, &self.images, &options)?
        };
        if let Some(path) = &self.save_corners {
            fs::write(path, write_corners(&cameras))
                .map_err(|e| format!("cannot write {}: {e}", path.display()))?;
        }
        Ok(Input { cameras, board: spec.to_owned() })
    }
}
