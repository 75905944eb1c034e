//! Recorded flights on disk.

use std::{
    collections::BTreeMap,
    fs,
    io::Read as _,
    path::{Path, PathBuf},
};

use flate2::read::MultiGzDecoder;
use nalgebra::Vector3;
use netcord_detect::flight::recorded::{Recording, RecordingError, parse};
use thiserror::Error;

/// The table of measured spins that stands beside flights of some data sets.
const INDEX: &str = "index.csv";
/// What a gzip file begins with (RFC 1952).
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// A file or folder that gives no flights.
#[derive(Debug, Error)]
pub enum FlightsError {
    /// It cannot be read.
    #[error("cannot read {path}")]
    Read {
        /// Which.
        path: PathBuf,
        /// Why.
        #[source]
        cause: std::io::Error,
    },
    /// It holds something else.
    #[error(transparent)]
    Content(#[from] RecordingError),
    /// A folder without flights.
    #[error("{0} holds no recorded flight")]
    Empty(PathBuf),
}

/// Flights that share a folder, and so a frame.
#[derive(Debug)]
pub struct Set {
    /// The folder's name.
    pub name: String,
    /// Its flights, by name.
    pub recordings: Vec<Recording>,
}

/// Reads files and folders. In folders, files of no known format are passed over with a warning; a file
/// that was named must be a flight.
///
/// # Errors
/// [`FlightsError`] names the path.
pub fn load(paths: &[PathBuf]) -> Result<Vec<Set>, FlightsError> {
    let mut folders: BTreeMap<PathBuf, Vec<Recording>> = BTreeMap::new();
    for path in paths {
        let folder = if path.is_dir() { path.as_path() } else { path.parent().unwrap_or(path) };
        let into = folders.entry(folder.to_owned()).or_default();
        if path.is_dir() {
            let before = into.len();
            for file in sorted(path)? {
                match read(&file) {
                    Ok(recording) => into.push(recording),
                    Err(FlightsError::Content(cause)) => tracing::debug!(%cause, "passed over"),
                    Err(other) => return Err(other),
                }
            }
            if into.len() == before {
                return Err(FlightsError::Empty(path.clone()));
            }
        } else {
            into.push(read(path)?);
        }
    }
    folders
        .into_iter()
        .map(|(folder, mut recordings)| {
            add_spins(&folder, &mut recordings)?;
            let name = folder.file_name().map_or_else(|| ".".into(), |n| n.to_string_lossy().into_owned());
            Ok(Set { name, recordings })
        })
        .collect()
}

/// The files that [`load`] reads.
///
/// # Errors
/// [`FlightsError::Read`].
pub fn listed(paths: &[PathBuf]) -> Result<Vec<PathBuf>, FlightsError> {
    let mut files = Vec::new();
    for path in paths {
        files.extend(if path.is_dir() { sorted(path)? } else { vec![path.clone()] });
    }
    Ok(files)
}

fn sorted(folder: &Path) -> Result<Vec<PathBuf>, FlightsError> {
    let failed = |cause| FlightsError::Read { path: folder.to_owned(), cause };
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_file() && path.file_name().is_some_and(|n| n != INDEX) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

fn read(path: &Path) -> Result<Recording, FlightsError> {
    let text = text_of(path).map_err(|cause| FlightsError::Read { path: path.to_owned(), cause })?;
    let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    Ok(parse(&name, &text)?)
}

fn text_of(path: &Path) -> std::io::Result<String> {
    let bytes = fs::read(path)?;
    if !bytes.starts_with(&GZIP) {
        return Ok(String::from_utf8_lossy(&bytes).into_owned());
    }
    let mut text = Vec::new();
    MultiGzDecoder::new(bytes.as_slice()).read_to_end(&mut text)?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// Measured spins: rows `traj_file,x,y,z` of `index.csv`, the number being that of the file's name.
fn add_spins(folder: &Path, recordings: &mut [Recording]) -> Result<(), FlightsError> {
    let path = folder.join(INDEX);
    if !path.is_file() {
        return Ok(());
    }
    let text = text_of(&path).map_err(|cause| FlightsError::Read { path, cause })?;
    for line in text.lines().skip(1) {
        let mut numbers = line.split(',').map(|c| c.trim().parse::<f64>().ok());
        let mut next = || numbers.next().flatten();
        let (Some(number), Some(x), Some(y), Some(z)) = (next(), next(), next(), next()) else { continue };
        let stem = |r: &Recording| r.name.split('.').next().and_then(|s| s.parse::<u32>().ok());
        if let Some(r) = recordings.iter_mut().find(|r| stem(r) == Some(number as u32)) {
            r.spin_rad_s = Some(Vector3::new(x, y, z));
        }
    }
    Ok(())
}
