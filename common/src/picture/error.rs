use std::{io, path::PathBuf};

use thiserror::Error;

/// A picture that cannot be read or written.
#[derive(Debug, Error)]
pub enum PictureError {
    /// The file cannot be opened or read.
    #[error("cannot read the picture {path}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file's contents are no picture, or a damaged one.
    #[error("cannot read the picture {path}: {cause}")]
    Undecodable {
        /// The file.
        path: PathBuf,
        /// What is wrong with its contents.
        cause: String,
    },
    /// The file cannot be written.
    #[error("cannot write the picture {path}")]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The picture does not fit into its format.
    #[error("cannot encode a picture as PNG")]
    Encode(#[from] png::EncodingError),
}
