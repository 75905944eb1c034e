use std::path::PathBuf;

use thiserror::Error;

/// A rig file that cannot be used.
#[derive(Debug, Error)]
pub enum RigError {
    /// It cannot be read or written.
    #[error("cannot {doing} the rig file {}: {cause}", path.display())]
    File {
        /// `read` or `write`.
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// It says something that is not valid.
    #[error("{}:{line}: {message}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong, and what would be valid.
        message: String,
    },
}

impl RigError {
    /// An error at byte `offset` of `text`.
    pub(super) fn at(path: &std::path::Path, text: &str, offset: usize, message: impl Into<String>) -> Self {
        let line = 1 + text.as_bytes()[..offset.min(text.len())].iter().filter(|b| **b == b'\n').count();
        Self::Content { path: path.to_owned(), line, message: message.into() }
    }
}
