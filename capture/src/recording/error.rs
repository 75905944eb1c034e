use std::path::PathBuf;

use thiserror::Error;

/// A recording that cannot be used.
#[derive(Debug, Error)]
pub enum RecordingError {
    /// It cannot be opened, read or written.
    #[error("cannot {doing} the recording {}: {cause}", path.display())]
    File {
        /// `open`, `map`, `write`, ….
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// It is no MCAP file.
    #[error("{} is no MCAP recording: it begins with {found}, not with the eight bytes 89 4D 43 41 50 30 0D 0A", path.display())]
    NoMcap {
        /// The file.
        path: PathBuf,
        /// Its first bytes, as a person reads them.
        found: String,
    },
    /// The container is damaged in its middle: what follows cannot be found.
    #[error("{}: the {what} at byte {at} is damaged: {why}; `netcord recover` saves what is whole", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// `chunk`, `channel record`, ….
        what: &'static str,
        /// Where it begins.
        at: u64,
        /// What does not fit.
        why: String,
    },
    /// A message is not what its topic promises.
    #[error("{}: {topic}, message {index}: {why}", path.display())]
    Message {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Its place in the topic, from 0.
        index: u64,
        /// What is wrong, and what would be right.
        why: String,
    },
    /// A channel is not what its topic promises.
    #[error("{}: {topic}: {why}", path.display())]
    Channel {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// What is wrong, and what would be right.
        why: String,
    },
    /// The recording as a whole lacks what is needed.
    #[error("{}: {why}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is missing, and what would be right.
        why: String,
    },
}
