use std::{
    collections::{BTreeMap, BTreeSet},
    error::Error,
    path::PathBuf,
    sync::Arc,
};

use netcord_calib::gather::{pictures, read};
use rayon::prelude::*;

use super::{Next, Picture, RawShot, Source};

/// Folders of pictures, one a camera; pictures of one name are simultaneous.
#[derive(Debug)]
pub struct FolderSource {
    /// Per shot its name and, per camera, its file.
    shots: Vec<(String, Vec<Option<PathBuf>>)>,
    next: usize,
    looked: BTreeSet<String>,
}

impl FolderSource {
    /// Of `NAME=FOLDER` for cameras of `cameras`; a folder without a name belongs to the only camera.
    ///
    /// # Errors
    /// When a folder cannot be read or holds no pictures, or a camera is unknown.
    pub fn open(images: &[String], cameras: &[String]) -> Result<Self, Box<dyn Error>> {
        let mut shots: BTreeMap<String, Vec<Option<PathBuf>>> = BTreeMap::new();
        for image in images {
            let (camera, folder) = match (image.split_once('='), cameras) {
                (Some((name, folder)), _) => (cameras.iter().position(|c| c == name), folder),
                (None, [_]) => (Some(0), image.as_str()),
                (None, _) => {
                    return Err(format!(
                        "{image}: which camera's? Write NAME={image}; the rig has {}",
                        cameras.join(", ")
                    )
                    .into());
                }
            };
            let Some(camera) = camera else {
                return Err(
                    format!("{image}: the rig has no such camera; it has {}", cameras.join(", ")).into()
                );
            };
            let found = pictures(folder.as_ref()).map_err(|e| format!("cannot read {folder}: {e}"))?;
            if found.is_empty() {
                return Err(format!("{folder} holds no PNG or JPEG pictures").into());
            }
            for picture in found {
                let shot = shots.entry(picture.name).or_insert_with(|| vec![None; cameras.len()]);
                shot[camera] = Some(picture.path);
            }
        }
        Ok(Self { shots: shots.into_iter().collect(), next: 0, looked: BTreeSet::new() })
    }
}

impl Source for FolderSource {
    fn kind(&self) -> &'static str {
        "pictures"
    }

    fn next(&mut self) -> Result<Next, Box<dyn Error>> {
        while let Some((name, files)) = self.shots.get(self.next) {
            self.next += 1;
            if self.looked.contains(name) {
                continue;
            }
            let picture = |file: &Option<PathBuf>| {
                let read = read(file.as_ref()?);
                Some(read.map(|luma| Picture { luma: Arc::new(luma), stamp_ns: None }))
            };
            let pictures = files.par_iter().map(picture).collect();
            return Ok(Next::Shot(RawShot { name: name.clone(), pictures }));
        }
        Ok(Next::End)
    }

    fn position(&self) -> Option<(usize, usize)> {
        Some((self.next, self.shots.len()))
    }

    fn is_continuous(&self) -> bool {
        false
    }

    fn rewind(&mut self, looked: BTreeSet<String>) {
        self.next = 0;
        self.looked = looked;
    }
}
