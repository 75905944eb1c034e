//! What several test files need: the real pictures beside the checkout, and boards from descriptions.
#![allow(dead_code, reason = "each test file uses its own part")]

use std::path::{Path, PathBuf};

use netcord_calib::{
    board::CalibrationBoard,
    detect::{Detector, Luma},
};

/// A file or folder of the real data; `None`, said aloud, where it is absent.
pub fn shared(path: &str) -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data").join(path);
    let there = path.exists();
    if !there {
        println!("SKIPPED: {} is not here", path.display());
    }
    there.then_some(path)
}

/// A picture as grey values.
pub fn grey(path: &Path) -> Luma {
    let grey = image::open(path).expect("a picture").to_luma8();
    Luma::new(grey.width() as usize, grey.height() as usize, grey.into_raw()).expect("fits")
}

/// The detector of a board's description.
pub fn detector(spec: &str) -> Detector {
    let read = |path: &str| std::fs::read_to_string(path).map_err(|e| e.to_string());
    Detector::new(CalibrationBoard::parse(spec, read).expect(spec))
}
