//! Files that a command writes: never over what it reads, and whole or not at all.

mod part;

use std::{
    fs::{self, File, Permissions},
    io::{self, Write as _},
    os::{
        fd::{AsFd as _, BorrowedFd},
        unix::fs::{MetadataExt as _, PermissionsExt as _},
    },
    path::{Path, PathBuf},
};

use nix::unistd::{AccessFlags, access};
use tempfile::NamedTempFile;
use thiserror::Error;

/// A file that cannot be an output.
#[derive(Debug, Error)]
pub enum OutputError {
    /// The command reads it.
    #[error("{0} is read by this command; give the output another name")]
    Input(PathBuf),
    /// Another output goes there.
    #[error("{0} is given for two outputs; each needs a name of its own")]
    Twice(PathBuf),
    /// It would be replaced.
    #[error("{0} is there already; give another name (record, recover and import also take --overwrite)")]
    Exists(PathBuf),
    /// It is a folder.
    #[error("{0} is a folder; give the name of a file")]
    IsFolder(PathBuf),
    /// It ends in `..`.
    #[error("{0} has no file name; give the name of a file")]
    NoName(PathBuf),
    /// Its folder is missing.
    #[error("there is no folder {folder} for {path}; make it first")]
    NoFolder {
        /// The file.
        path: PathBuf,
        /// What is missing.
        folder: PathBuf,
    },
    /// The system refuses.
    #[error("cannot write {path}: {cause}")]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: io::Error,
    },
}

/// What a command reads and writes, so that no output is an input or another output, under whatever name.
#[derive(Debug, Default)]
pub struct Plan {
    inputs: Vec<Identity>,
    outputs: Vec<Identity>,
}

/// A file, however it is called.
#[derive(Debug, PartialEq, Eq)]
enum Identity {
    There { device: u64, inode: u64 },
    Absent(PathBuf),
}

impl Identity {
    fn of(path: &Path) -> Option<Self> {
        if let Ok(known) = fs::metadata(path) {
            return Some(Self::There { device: known.dev(), inode: known.ino() });
        }
        let folder = folder_of(path).canonicalize().ok()?;
        path.file_name().map(|name| Self::Absent(folder.join(name)))
    }
}

impl Plan {
    /// Of a command that reads these files.
    pub fn of<P: AsRef<Path>>(inputs: impl IntoIterator<Item = P>) -> Self {
        let inputs = inputs.into_iter().filter_map(|path| Identity::of(path.as_ref())).collect();
        Self { inputs, outputs: Vec::new() }
    }

    /// Begins an output. To be called before long work, which is not to be done in vain.
    ///
    /// # Errors
    /// [`OutputError`] when nothing can be written there, or nothing may.
    pub fn begin(&mut self, path: &Path) -> Result<Output, OutputError> {
        let failed = |cause| OutputError::File { path: path.to_owned(), cause };
        if path.is_dir() {
            return Err(OutputError::IsFolder(path.to_owned()));
        }
        if is_stream(path) {
            let file = open_stream(path).map_err(failed)?;
            return Ok(Output { path: path.to_owned(), target: Target::Stream(file) });
        }
        let folder = folder_of(path);
        if !folder.is_dir() {
            return Err(OutputError::NoFolder { path: path.to_owned(), folder: folder.to_owned() });
        }
        let identity = Identity::of(path).ok_or_else(|| OutputError::NoName(path.to_owned()))?;
        if self.inputs.contains(&identity) {
            return Err(OutputError::Input(path.to_owned()));
        }
        if self.outputs.contains(&identity) {
            return Err(OutputError::Twice(path.to_owned()));
        }
        // A link stays, and what it points to is replaced.
        let to = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let permissions = match fs::metadata(&to) {
            Ok(there) => {
                access(&to, AccessFlags::W_OK).map_err(|e| failed(e.into()))?;
                there.permissions()
            }
            // The system takes off what the user's mask says.
            Err(_) => Permissions::from_mode(0o666),
        };
        let part = part::create(folder_of(&to), permissions).map_err(failed)?;
        self.outputs.push(identity);
        Ok(Output { path: path.to_owned(), target: Target::Beside { part, to } })
    }
}

/// An output that has begun. What was at its place stays there until [`Self::complete`]; dropped before that, nothing
/// of it is left.
#[derive(Debug)]
pub struct Output {
    path: PathBuf,
    target: Target,
}

#[derive(Debug)]
enum Target {
    /// A file of the same folder, which takes the name when it is complete.
    Beside { part: NamedTempFile, to: PathBuf },
    /// A device, a pipe or an open file of this process: nothing can take its place.
    Stream(File),
}

impl Output {
    /// Its name, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What is to be written to.
    ///
    /// # Errors
    /// [`OutputError::File`].
    pub fn file(&self) -> Result<File, OutputError> {
        let file = match &self.target {
            Target::Beside { part, .. } => part.as_file().try_clone(),
            Target::Stream(file) => file.try_clone(),
        };
        file.map_err(|cause| OutputError::File { path: self.path.clone(), cause })
    }

    /// Puts what was written in its place.
    ///
    /// # Errors
    /// [`OutputError::File`].
    pub fn complete(self) -> Result<(), OutputError> {
        let Self { path, target } = self;
        match target {
            Target::Beside { part, to } => {
                part.persist(to).map(drop).map_err(|e| OutputError::File { path, cause: e.error })
            }
            Target::Stream(_) => Ok(()),
        }
    }

    /// Writes all of it.
    ///
    /// # Errors
    /// [`OutputError::File`].
    pub fn write(self, bytes: impl AsRef<[u8]>) -> Result<(), OutputError> {
        let written = self.file()?.write_all(bytes.as_ref());
        written.map_err(|cause| OutputError::File { path: self.path.clone(), cause })?;
        self.complete()
    }
}

/// Writes a file. A command that reads files has compared them with it before its work ([`check`]).
///
/// # Errors
/// [`OutputError`].
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> Result<(), OutputError> {
    Plan::default().begin(path)?.write(bytes)
}

/// Refuses outputs that cannot be written, go to one place or replace an input, where they are begun only after long
/// work.
///
/// # Errors
/// [`OutputError`].
pub fn check<I: AsRef<Path>, O: AsRef<Path>>(
    inputs: impl IntoIterator<Item = I>,
    outputs: impl IntoIterator<Item = O>,
) -> Result<(), OutputError> {
    let mut plan = Plan::of(inputs);
    // A pipe's reader would take the closing for the end.
    let mut files = outputs.into_iter().filter(|path| !is_stream(path.as_ref()));
    files.try_for_each(|path| plan.begin(path.as_ref()).map(drop))
}

/// A file beside a report: of `r.json` and `-left.png`, `r-left.png`. `None` where the report goes on to somewhere
/// else, such as `/dev/stdout`, and nothing has a place beside it.
///
/// # Errors
/// [`OutputError::NoName`].
pub fn beside(report: &Path, ending: &str) -> Result<Option<PathBuf>, OutputError> {
    let mut name = report.file_stem().ok_or_else(|| OutputError::NoName(report.to_owned()))?.to_owned();
    name.push(ending);
    Ok((!is_stream(report)).then(|| report.with_file_name(name)))
}

/// Refuses an output that would replace a file with content. Recordings cannot be made again.
///
/// # Errors
/// [`OutputError::Exists`].
pub fn refuse_existing(path: &Path, overwrite: bool) -> Result<(), OutputError> {
    let holds_something = fs::metadata(path).is_ok_and(|there| there.is_file() && there.len() > 0);
    if holds_something && !overwrite { Err(OutputError::Exists(path.to_owned())) } else { Ok(()) }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Whether what is written there goes on to somewhere else: a device, a pipe, or a file that is open already, such
/// as `/dev/stdout`.
fn is_stream(path: &Path) -> bool {
    let kept_by_the_system =
        path.starts_with("/proc") || path.starts_with("/dev") && !path.starts_with("/dev/shm");
    kept_by_the_system || fs::metadata(path).is_ok_and(|there| !there.is_file() && !there.is_dir())
}

/// What this process prints to is not opened anew: where it is a file, both would begin at their own place in it.
fn open_stream(path: &Path) -> io::Result<File> {
    let own = |descriptor: BorrowedFd<'_>| descriptor.try_clone_to_owned().map(File::from);
    match path.to_str() {
        Some("/dev/stdout") => own(io::stdout().as_fd()),
        Some("/dev/stderr") => own(io::stderr().as_fd()),
        _ => File::options().append(true).open(path),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stood_there_stays_until_the_output_is_complete() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("out.csv");
        fs::write(&path, "before").expect("written");
        fs::set_permissions(&path, Permissions::from_mode(0o640)).expect("mine");
        let begin = || Plan::default().begin(&path).expect("a place");
        let given_up = begin();
        given_up.file().expect("open").write_all(b"a part").expect("written");
        drop(given_up);
        assert_eq!(fs::read_to_string(&path).expect("there"), "before");
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 1, "nothing is left beside it");
        begin().write("after").expect("written");
        assert_eq!(fs::read_to_string(&path).expect("there"), "after");
        assert_eq!(fs::metadata(&path).expect("there").permissions().mode() & 0o777, 0o640);
    }

    #[test]
    fn an_input_and_another_output_are_refused_under_any_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let [input, link, new] = ["in.mcap", "link.mcap", "new.csv"].map(|name| folder.path().join(name));
        fs::write(&input, "frames").expect("written");
        fs::hard_link(&input, &link).expect("linked");
        let mut plan = Plan::of([&input]);
        for path in [&input, &link, &folder.path().join("./in.mcap")] {
            assert!(matches!(plan.begin(path), Err(OutputError::Input(_))), "{}", path.display());
        }
        let _first = plan.begin(&new).expect("a place");
        let again = folder.path().join(".").join("new.csv");
        assert!(matches!(plan.begin(&again), Err(OutputError::Twice(_))));
        assert!(matches!(plan.begin(folder.path()), Err(OutputError::IsFolder(_))));
        let nowhere = plan.begin(&folder.path().join("no/file")).expect_err("no folder").to_string();
        assert!(nowhere.contains("there is no folder"), "{nowhere}");
        assert_eq!(fs::read_to_string(&input).expect("there"), "frames");
    }

    #[test]
    fn outputs_are_compared_with_inputs_before_they_are_begun() {
        let folder = tempfile::tempdir().expect("a folder");
        let [rig, report] = ["rig.toml", "report.json"].map(|name| folder.path().join(name));
        fs::write(&rig, "cameras").expect("written");
        check([&rig], [&report]).expect("apart");
        check([&rig], [Path::new("/dev/null"), Path::new("/dev/null")]).expect("a device takes any number");
        assert!(matches!(check([&rig], [&report, &rig]), Err(OutputError::Input(path)) if path == rig));
        assert!(matches!(check([&rig], [&report, &report]), Err(OutputError::Twice(_))));
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 1, "nothing is left of the check");
    }

    #[test]
    fn what_goes_beside_a_report_is_called_after_it() {
        let beside = |report: &str| beside(Path::new(report), "-left.png");
        assert_eq!(beside("a/r.json").expect("a name"), Some(PathBuf::from("a/r-left.png")));
        assert_eq!(beside("r").expect("a name"), Some(PathBuf::from("r-left.png")));
        assert_eq!(beside("/dev/stdout").expect("a name"), None, "nothing is beside a pipe");
        for nameless in ["absent/..", "/", ".."] {
            assert!(matches!(beside(nameless), Err(OutputError::NoName(_))), "{nameless}");
        }
    }

    #[test]
    fn devices_are_written_to_and_links_stay_links() {
        let mut plan = Plan::default();
        for _ in 0..2 {
            plan.begin(Path::new("/dev/null")).expect("open").write("x").expect("taken");
        }
        let full = plan.begin(Path::new("/dev/full")).expect("open").write("x").expect_err("full");
        assert!(full.to_string().contains("cannot write /dev/full"), "{full}");
        assert!(Path::new("/dev/full").exists());
        let folder = tempfile::tempdir().expect("a folder");
        let [file, link] = ["file", "link"].map(|name| folder.path().join(name));
        fs::write(&file, "before").expect("written");
        std::os::unix::fs::symlink(&file, &link).expect("linked");
        plan.begin(&link).expect("a place").write("after").expect("written");
        assert!(link.is_symlink());
        assert_eq!(fs::read_to_string(&file).expect("there"), "after");
    }

    #[test]
    fn only_what_holds_something_is_kept_from_being_replaced() {
        let file = NamedTempFile::new().expect("a file");
        refuse_existing(file.path(), false).expect("empty");
        fs::write(file.path(), "frames").expect("written");
        assert!(refuse_existing(file.path(), false).expect_err("kept").to_string().contains("--overwrite"));
        refuse_existing(file.path(), true).expect("wanted");
        refuse_existing(Path::new("/dev/null"), false).expect("a device");
    }
}
