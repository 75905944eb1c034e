use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    ops::Range,
    sync::Arc,
};

use rayon::prelude::*;

use super::{FilmedFrame, Footage, Place, RecordingError};

/// The pixels of one frame: in the file's map, or in an unpacked chunk that lives as long as this.
#[derive(Debug, Clone)]
pub struct FramePixels {
    footage: Arc<Footage>,
    unpacked: Option<Arc<Vec<u8>>>,
    range: Range<usize>,
}

impl FramePixels {
    /// The pixels at a place in the file itself; of one in a packed chunk, nothing.
    pub fn mapped(footage: &Arc<Footage>, place: &Place) -> Self {
        let range = match place {
            Place::File(range) => range.clone(),
            Place::Chunk { .. } => 0..0,
        };
        Self { footage: Arc::clone(footage), unpacked: None, range }
    }
}

impl AsRef<[u8]> for FramePixels {
    fn as_ref(&self) -> &[u8] {
        match &self.unpacked {
            Some(bytes) => &bytes[self.range.clone()],
            None => &self.footage.file().bytes()[self.range.clone()],
        }
    }
}

/// Frames that are fetched at the same time: their chunks are unpacked on all cores.
const BATCH: usize = 16;

/// Unpacked chunks that are kept for frames to come: cameras may be recorded a little out of step.
const KEPT: usize = 8;

/// Gives the pixels of frames in a given order, unpacking their chunks ahead, each once.
#[derive(Debug)]
pub struct FrameReader<I> {
    footage: Arc<Footage>,
    wanted: I,
    chunks: BTreeMap<u64, Arc<Vec<u8>>>,
    /// The chunks in the order of their last use.
    used: VecDeque<u64>,
    ready: VecDeque<Result<FramePixels, RecordingError>>,
}

impl<I: Iterator<Item = Place>> FrameReader<I> {
    /// Will give the pixels at the places `wanted`.
    pub const fn new(footage: Arc<Footage>, wanted: I) -> Self {
        Self { footage, wanted, chunks: BTreeMap::new(), used: VecDeque::new(), ready: VecDeque::new() }
    }

    fn fetch(&mut self) {
        let places = self.wanted.by_ref().take(BATCH).collect::<Vec<_>>();
        let missing = places
            .iter()
            .filter_map(|place| match place {
                Place::Chunk { chunk, .. } if !self.chunks.contains_key(chunk) => Some(*chunk),
                _ => None,
            })
            .collect::<BTreeSet<_>>();
        let file = self.footage.file();
        let unpacked = missing.into_par_iter().map(|at| (at, file.unpack(at))).collect::<Vec<_>>();
        let mut failed = BTreeMap::new();
        for (at, bytes) in unpacked {
            match bytes {
                Ok(bytes) => drop(self.chunks.insert(at, Arc::new(bytes))),
                Err(e) => drop(failed.insert(at, e)),
            }
        }
        for place in places {
            let pixels =
                |unpacked, range| FramePixels { footage: Arc::clone(&self.footage), unpacked, range };
            let result = match place {
                Place::File(range) => Ok(pixels(None, range)),
                Place::Chunk { chunk, range } => match self.chunks.get(&chunk) {
                    Some(bytes) => {
                        self.used.retain(|used| *used != chunk);
                        self.used.push_back(chunk);
                        Ok(pixels(Some(Arc::clone(bytes)), range))
                    }
                    // An error is told once; the reader of the stream ends there.
                    None => match failed.remove(&chunk) {
                        Some(e) => Err(e),
                        None => break,
                    },
                },
            };
            self.ready.push_back(result);
        }
        while self.used.len() > KEPT {
            if let Some(oldest) = self.used.pop_front() {
                self.chunks.remove(&oldest);
            }
        }
    }
}

impl<I: Iterator<Item = Place>> Iterator for FrameReader<I> {
    type Item = Result<FramePixels, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ready.is_empty() {
            self.fetch();
        }
        self.ready.pop_front()
    }
}

impl FilmedFrame {
    /// Columns and rows.
    pub const fn size(&self) -> (usize, usize) {
        (self.width as usize, self.height as usize)
    }
}
