use std::{io, path::Path};

use netcord_common::{NameError, bus::BusError, rig::RigError};
use thiserror::Error;

use crate::supervisor::LaunchError;

/// A trial that could not be carried out.
#[derive(Debug, Error)]
pub enum TrialError {
    /// The setup fits no rig.
    #[error("{0}")]
    Setup(String),
    /// A file of the trial cannot be written.
    #[error("cannot write {path}: {cause}")]
    File {
        /// The file.
        path: String,
        /// Why.
        cause: io::Error,
    },
    /// The rig file.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// The domain's name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// `netcord up` cannot be started.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// The processes did not come up, or did not stay up.
    #[error("the processes {what}; their last lines:\n{last_lines}")]
    Processes {
        /// What they did.
        what: &'static str,
        /// What they said.
        last_lines: String,
    },
    /// A person stopped it.
    #[error("stopped before the end")]
    Stopped,
}

impl TrialError {
    pub(super) fn file(path: &Path, cause: io::Error) -> Self {
        Self::File { path: path.display().to_string(), cause }
    }
}
