//! Where a session's pictures come from.

mod folder;
mod live;
mod recording;

use std::{collections::BTreeSet, error::Error, sync::Arc};

use netcord_calib::{
    detect::{Depth, Detector, Luma},
    gather::Rejection,
    session::{Shot, Sight},
};
use rayon::prelude::*;

pub use folder::FolderSource;
pub use live::LiveSource;
pub use recording::RecordingSource;

/// One camera's picture.
#[derive(Debug, Clone)]
pub struct Picture {
    /// Its grey values.
    pub luma: Arc<Luma>,
    /// Middle of the exposure, ns, where it is known.
    pub stamp_ns: Option<u64>,
}

/// What all cameras took at once.
#[derive(Debug, Clone)]
pub struct RawShot {
    /// Its name, unlike that of any other shot.
    pub name: String,
    /// Per camera; nothing where it gave no picture.
    pub pictures: Vec<Option<Result<Picture, Rejection>>>,
}

impl RawShot {
    /// Searches all pictures, on all cores.
    pub fn search(&self, detector: &Detector, depth: Depth) -> Shot {
        let sights = self.pictures.par_iter().map(|picture| {
            picture.as_ref().map(|picture| {
                picture
                    .as_ref()
                    .map(|p| Sight::of(&p.luma, detector, depth, p.stamp_ns))
                    .map_err(Rejection::clone)
            })
        });
        Shot { name: self.name.clone(), sights: sights.collect() }
    }

    /// The pictures that could be read.
    pub fn lumas(&self) -> Vec<Option<&Arc<Luma>>> {
        self.pictures.iter().map(|p| p.as_ref().and_then(|p| p.as_ref().ok()).map(|p| &p.luma)).collect()
    }
}

/// What a source gives when asked.
#[derive(Debug)]
pub enum Next {
    /// A shot.
    Shot(RawShot),
    /// Nothing new yet; asking waits a little.
    NotYet,
    /// There are no more.
    End,
}

/// A source of shots.
pub trait Source {
    /// `live`, `recording` or `pictures`.
    fn kind(&self) -> &'static str;

    /// The next shot.
    ///
    /// # Errors
    /// What makes the source useless.
    fn next(&mut self) -> Result<Next, Box<dyn Error>>;

    /// How many shots have been given, of how many; `None` for one without an end.
    fn position(&self) -> Option<(usize, usize)> {
        None
    }

    /// Whether shots follow each other in time.
    fn is_continuous(&self) -> bool;

    /// Begins again, leaving out the shots of these names.
    fn rewind(&mut self, _looked: BTreeSet<String>) {}
}
