use std::path::PathBuf;

use thiserror::Error;

use super::Format;

/// A calibration that cannot be exchanged.
#[derive(Debug, Error)]
pub enum ExchangeError {
    /// None of the formats.
    #[error(
        "{} is in none of the formats that can be imported (opencv, ros, kalibr, parameters, json); if it should be, \
         say which with --format to see what is wrong",
        path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// It says something that is not valid.
    #[error("{} cannot be read as {format}: {message}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// As what it was read.
        format: Format,
        /// What is wrong, and what would be valid.
        message: String,
    },
    /// The format has no place for it.
    #[error("the rig cannot be written as {format}: {message}")]
    CannotExpress {
        /// The format.
        format: Format,
        /// What it has no place for.
        message: String,
    },
}
