//! Files of a session: written whole or not at all.

use std::{
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use netcord_common::picture::{Channels, Effort, Picture, PictureError};
use thiserror::Error;

use crate::{detect::Luma, solve::CalibrationError};

/// A folder that cannot be used.
#[derive(Debug, Error)]
pub enum FolderError {
    /// Reading or writing failed.
    #[error("cannot {doing} {path}")]
    File {
        /// What was tried.
        doing: &'static str,
        /// With which file or folder.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// The folder belongs to another board.
    #[error(
        "the session in {path} was begun with the board {found}, not {wanted}; go on with that board, or give another \
         --folder"
    )]
    Board {
        /// The folder.
        path: PathBuf,
        /// Its board.
        found: String,
        /// The board asked for.
        wanted: String,
    },
    /// `session.json` or the marks do not read.
    #[error("{path} does not read as what a session writes there; remove it, or give another --folder")]
    Description {
        /// The file.
        path: PathBuf,
        /// Why.
        source: serde_json::Error,
    },
    /// The corners of a shot do not read.
    #[error("the corners in {path} do not read; remove that folder to go on without it")]
    Corners {
        /// The file.
        path: PathBuf,
        /// Why.
        source: CalibrationError,
    },
    /// A picture cannot be written as PNG.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

/// Writes beside, then renames.
pub(super) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), FolderError> {
    let mut new = path.as_os_str().to_owned();
    new.push(".new");
    let new = PathBuf::from(new);
    let written = fs::File::create(&new).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()
    });
    written.and_then(|()| fs::rename(&new, path)).map_err(|source| FolderError::File {
        doing: "write",
        path: path.to_owned(),
        source,
    })
}

pub(super) fn write_png(path: &Path, picture: &Luma) -> Result<(), FolderError> {
    let size = (picture.width(), picture.height());
    let Some(picture) = Picture::new(size, Channels::Grey, picture.pixels().to_vec()) else { return Ok(()) };
    // The board is held up while this is written: quick before small.
    Ok(picture.write_png(path, Effort::Quick)?)
}
