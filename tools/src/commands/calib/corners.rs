//! Corner files.

use std::{error::Error, fs, path::Path};

use netcord_calib::solve::{CameraViews, read_corners};

/// Reads a corner file.
pub fn load(path: &Path) -> Result<Vec<CameraViews>, Box<dyn Error>> {
    let text = fs::read_to_string(path)
        .map_err(|e| format!("cannot read the corner file {}: {e}", path.display()))?;
    Ok(read_corners(&text)?)
}
