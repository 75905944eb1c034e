//! Files that take the name of an output when they are complete. What a writer that was killed leaves of them is
//! removed by the next one in the same folder.

use std::{
    fs::{self, File, Permissions},
    io,
    os::unix::fs::MetadataExt as _,
    path::Path,
};

use tempfile::NamedTempFile;

const PREFIX: &str = ".netcord-";
const SUFFIX: &str = ".part";

/// A new file in `folder`, which is locked (flock) as long as this process has it open: so others know that its writer
/// lives.
pub(super) fn create(folder: &Path, permissions: Permissions) -> io::Result<NamedTempFile> {
    remove_abandoned(folder);
    loop {
        let part = tempfile::Builder::new()
            .prefix(PREFIX)
            .suffix(SUFFIX)
            .permissions(permissions.clone())
            .tempfile_in(folder)?;
        // Where the file system has no locks, nobody else gets one on it either, and it stays.
        let locked = part.as_file().lock();
        // Somebody may have taken it for abandoned between the two calls.
        if locked.is_err() || part.as_file().metadata()?.nlink() > 0 {
            return Ok(part);
        }
    }
}

/// Removes the parts in `folder` whose writer is gone. What cannot be looked at or removed stays: it is in nobody's way.
fn remove_abandoned(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let is_part = name.to_str().is_some_and(|name| name.starts_with(PREFIX) && name.ends_with(SUFFIX));
        // Opening a pipe would wait for its other end.
        if !is_part || !entry.file_type().is_ok_and(|kind| kind.is_file()) {
            continue;
        }
        let path = entry.path();
        if let Ok(file) = File::open(&path)
            && file.try_lock().is_ok()
            // A part that has just been completed has another name now, and its old one may be another's.
            && is_at(&file, &path)
        {
            let _ = fs::remove_file(&path);
        }
    }
}

/// Whether `path` is the name of the open `file`.
fn is_at(file: &File, path: &Path) -> bool {
    let (Ok(open), Ok(there)) = (file.metadata(), fs::symlink_metadata(path)) else { return false };
    (open.dev(), open.ino()) == (there.dev(), there.ino())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).expect("a folder").map(|e| e.expect("an entry").file_name());
        let mut names: Vec<String> = entries.map(|name| name.into_string().expect("UTF-8")).collect();
        names.sort();
        names
    }

    #[test]
    fn only_parts_without_a_writer_are_removed() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path();
        for name in [".netcord-gone.part", "own.part", ".netcord-own", "netcord-own.part"] {
            fs::write(path.join(name), "left behind").expect("written");
        }
        fs::create_dir(path.join(".netcord-folder.part")).expect("made");
        nix::unistd::mkfifo(&path.join(".netcord-pipe.part"), nix::sys::stat::Mode::S_IRUSR).expect("made");
        let first = create(path, Permissions::from_mode(0o600)).expect("a part");
        let second = create(path, Permissions::from_mode(0o600)).expect("another");
        let own =
            |part: &NamedTempFile| part.path().file_name().expect("named").to_string_lossy().into_owned();
        let mut expected = [
            ".netcord-folder.part",
            ".netcord-own",
            ".netcord-pipe.part",
            "netcord-own.part",
            "own.part",
            &own(&first),
            &own(&second),
        ];
        expected.sort_unstable();
        assert_eq!(names(path), expected);
    }

    #[test]
    fn a_part_is_its_writers_until_the_last_handle_is_closed() {
        let folder = tempfile::tempdir().expect("a folder");
        let part = create(folder.path(), Permissions::from_mode(0o600)).expect("a part");
        let handle = part.as_file().try_clone().expect("open");
        // As a process that is killed leaves it.
        let (file, path) = part.into_parts();
        let path = path.keep().expect("kept");
        drop(file);
        remove_abandoned(folder.path());
        assert!(path.exists(), "somebody still writes");
        drop(handle);
        remove_abandoned(folder.path());
        assert!(!path.exists());
    }
}
