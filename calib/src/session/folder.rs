use std::{
    collections::BTreeSet,
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use super::{
    files::{FolderError, write_png, write_whole},
    kept::{KeptShot, KeptView, Mark},
    setup::{SessionCamera, Task},
};
use crate::{
    detect::{Luma, convex_hull},
    solve::{CameraViews, read_corners, write_corners},
};

/// What a session has gathered, on disk: of each shot a folder with the cameras' pictures as PNG and their corners
/// in the form that `netcord calib … --corners` reads.
///
/// ```text
/// session.json                  the board
/// mono/0003-picture7/left.png   a picture of the third shot kept
/// mono/0003-picture7/corners.json
/// mono/looked.jsonl             every picture looked at, and why it was not kept
/// table/marks.json              marks of the table that somebody pointed at
/// ```
///
/// A shot is written under another name and renamed when it is whole, so that a session that is killed finds
/// either all of it or nothing.
#[derive(Debug)]
pub struct SessionFolder {
    root: PathBuf,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    board: String,
}

/// One line of `looked.jsonl`.
#[derive(Serialize, Deserialize)]
struct Looked {
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    rejected: Option<String>,
}

const UNFINISHED: &str = ".new-";
const MARKS_FILE: &str = "marks.json";

impl SessionFolder {
    /// Opens a session's folder, or begins one.
    ///
    /// # Errors
    /// [`FolderError`]; one that was begun with another board is refused.
    pub fn open(root: &Path, board: &str) -> Result<Self, FolderError> {
        let failed = |doing, path: &Path| {
            let path = path.to_owned();
            move |source| FolderError::File { doing, path, source }
        };
        fs::create_dir_all(root).map_err(failed("create", root))?;
        let path = root.join("session.json");
        if path.exists() {
            let text = fs::read_to_string(&path).map_err(failed("read", &path))?;
            let found: Description = serde_json::from_str(&text)
                .map_err(|source| FolderError::Description { path: path.clone(), source })?;
            if found.board != board {
                return Err(FolderError::Board {
                    path: root.to_owned(),
                    found: found.board,
                    wanted: board.to_owned(),
                });
            }
        } else {
            let text = serde_json::to_string(&Description { board: board.to_owned() })
                .expect("a text always has a JSON form");
            write_whole(&path, text.as_bytes())?;
        }
        Ok(Self { root: root.to_owned() })
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    fn task(&self, task: Task) -> PathBuf {
        self.root.join(task.name())
    }

    /// The folders of whole shots, with their numbers and names, in order.
    fn shots(&self, task: Task) -> Result<Vec<(u32, String, PathBuf)>, FolderError> {
        let folder = self.task(task);
        let failed = |source| FolderError::File { doing: "read", path: folder.clone(), source };
        let entries = match fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(e) => return Err(failed(e)),
        };
        let mut shots = Vec::new();
        for entry in entries {
            let path = entry.map_err(failed)?.path();
            // What a folder lists has a name.
            let Some(name) = path.file_name().map(|n| n.to_string_lossy().into_owned()) else { continue };
            if let Some((number, name)) = name.split_once('-')
                && let Ok(number) = number.parse()
                && path.is_dir()
            {
                shots.push((number, name.to_owned(), path));
            }
        }
        shots.sort();
        Ok(shots)
    }

    /// What has been kept for `task` before, oldest first.
    ///
    /// # Errors
    /// [`FolderError`] names the file that does not read.
    pub fn load(&self, task: Task, cameras: &[SessionCamera]) -> Result<Vec<KeptShot>, FolderError> {
        let mut kept = Vec::new();
        for (_, name, folder) in self.shots(task)? {
            let path = folder.join("corners.json");
            let text = fs::read_to_string(&path).map_err(|source| FolderError::File {
                doing: "read",
                path: path.clone(),
                source,
            })?;
            let found = read_corners(&text).map_err(|source| FolderError::Corners { path, source })?;
            let view_of = |camera: &SessionCamera| {
                let own = found.iter().find(|c| c.name == camera.name)?;
                let view = own.views.first()?.clone();
                Some(KeptView { outline: convex_hull(view.image.clone()), size: own.size, view })
            };
            // The folder's name may have lost characters that paths cannot have.
            let name = found.iter().find_map(|c| c.views.first()).map_or(name, |v| v.name.clone());
            kept.push(KeptShot { name, views: cameras.iter().map(view_of).collect() });
        }
        Ok(kept)
    }

    /// Puts a shot on disk: its corners, and the picture of each camera whose view was kept.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn store(
        &self,
        task: Task,
        cameras: &[SessionCamera],
        shot: &KeptShot,
        pictures: &[Option<&Luma>],
    ) -> Result<(), FolderError> {
        let number = self.shots(task)?.last().map_or(1, |(n, ..)| n + 1);
        let folder = self.task(task);
        let (new, whole) =
            (folder.join(format!("{UNFINISHED}{number}")), folder.join(dir(number, &shot.name)));
        let failed = |doing, path: &Path| {
            let path = path.to_owned();
            move |source| FolderError::File { doing, path, source }
        };
        if new.exists() {
            fs::remove_dir_all(&new).map_err(failed("remove", &new))?;
        }
        fs::create_dir_all(&new).map_err(failed("create", &new))?;
        let mut views = Vec::new();
        for ((camera, view), picture) in cameras.iter().zip(&shot.views).zip(pictures) {
            let Some(view) = view else { continue };
            views.push(CameraViews {
                name: camera.name.clone(),
                size: view.size,
                views: vec![view.view.clone()],
            });
            if let Some(picture) = picture {
                write_png(&new.join(format!("{}.png", camera.name)), picture)?;
            }
        }
        write_whole(&new.join("corners.json"), write_corners(&views).as_bytes())?;
        fs::rename(&new, &whole).map_err(failed("rename", &new))
    }

    /// Removes a shot.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn remove(&self, task: Task, name: &str) -> Result<(), FolderError> {
        let found = self.shots(task)?.into_iter().rfind(|(_, n, _)| *n == dir_name(name));
        match found {
            Some((.., path)) => fs::remove_dir_all(&path).map_err(|source| FolderError::File {
                doing: "remove",
                path,
                source,
            }),
            None => Ok(()),
        }
    }

    /// The picture of a camera in a shot that was kept.
    ///
    /// # Errors
    /// [`FolderError`] when the shots cannot be listed.
    pub fn picture(&self, task: Task, shot: &str, camera: &str) -> Result<Option<PathBuf>, FolderError> {
        let found = self.shots(task)?.into_iter().rfind(|(_, n, _)| *n == dir_name(shot));
        Ok(found.map(|(.., folder)| folder.join(format!("{camera}.png"))).filter(|p| p.exists()))
    }

    /// Notes that a shot has been looked at, and why nothing of it was kept.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn note(&self, task: Task, name: &str, rejected: Option<String>) -> Result<(), FolderError> {
        let folder = self.task(task);
        let path = folder.join("looked.jsonl");
        let line = serde_json::to_string(&Looked { name: name.to_owned(), rejected })
            .expect("texts always have a JSON form");
        fs::create_dir_all(&folder)
            .and_then(|()| fs::OpenOptions::new().create(true).append(true).open(&path))
            .and_then(|mut file| file.write_all(format!("{line}\n").as_bytes()))
            .map_err(|source| FolderError::File { doing: "write", path, source })
    }

    /// Names of the shots that have been looked at. A last line that was cut off is ignored.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn looked(&self, task: Task) -> Result<BTreeSet<String>, FolderError> {
        let path = self.task(task).join("looked.jsonl");
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == io::ErrorKind::NotFound => String::new(),
            Err(source) => return Err(FolderError::File { doing: "read", path, source }),
        };
        let names = text.lines().filter_map(|l| serde_json::from_str::<Looked>(l).ok()).map(|l| l.name);
        Ok(names.collect())
    }

    /// Puts the marks of the table on disk.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn store_marks(&self, task: Task, marks: &[Mark]) -> Result<(), FolderError> {
        let text = serde_json::to_string_pretty(marks).expect("names and numbers always have a JSON form");
        self.write(task, MARKS_FILE, &text).map(|_| ())
    }

    /// The marks of the table that an earlier run has put on disk.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn load_marks(&self, task: Task) -> Result<Vec<Mark>, FolderError> {
        let path = self.task(task).join(MARKS_FILE);
        match fs::read_to_string(&path) {
            Ok(text) => {
                serde_json::from_str(&text).map_err(|source| FolderError::Description { path, source })
            }
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
            Err(source) => Err(FolderError::File { doing: "read", path, source }),
        }
    }

    /// Writes a file beside the shots, such as a report.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(&self, task: Task, name: &str, text: &str) -> Result<PathBuf, FolderError> {
        let folder = self.task(task);
        fs::create_dir_all(&folder).map_err(|source| FolderError::File {
            doing: "create",
            path: folder.clone(),
            source,
        })?;
        let path = folder.join(name);
        write_whole(&path, text.as_bytes())?;
        Ok(path)
    }
}

/// A shot's name as part of a path.
fn dir_name(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || "-_. ".contains(c) { c } else { '_' }).collect()
}

fn dir(number: u32, name: &str) -> String {
    format!("{number:04}-{}", dir_name(name))
}
