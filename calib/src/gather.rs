//! Gathering views from pictures: what is read, which are kept, and why others are not.

use std::{
    error::Error as _,
    path::{Path, PathBuf},
};

use nalgebra::Vector2;
use netcord_common::picture::{self, Channels, PictureError};
use thiserror::Error;

use crate::detect::{Absence, BoardView, Detector, Luma};

/// Which views are kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GatherOptions {
    /// A view is kept when the intersection over union of its board's outline with that of every view kept
    /// before is at most this.
    pub max_iou: f64,
    /// Fewest corners, as a share of the board's.
    pub min_corners: f64,
    /// Most views kept: more take longer and make it no better.
    pub max_views: usize,
    /// Whether views whose corners' numbers are not sure are of use: yes for one camera alone.
    pub allow_unanchored: bool,
}

impl Default for GatherOptions {
    fn default() -> Self {
        Self { max_iou: 0.85, min_corners: 0.25, max_views: 40, allow_unanchored: true }
    }
}

/// Why a picture was not kept.
#[derive(Debug, Clone, Error)]
pub enum Rejection {
    /// It cannot be read.
    #[error("it cannot be read as a picture: {0}")]
    Unreadable(String),
    /// It has another size than the camera's others.
    #[error(
        "it is {} × {} px, but this camera's pictures are {} × {} px", .found.0, .found.1, .expected.0, .expected.1
    )]
    Size {
        /// Its size.
        found: (u32, u32),
        /// That of its lens as calibrated, or else of most pictures.
        expected: (u32, u32),
    },
    /// There is no board.
    #[error(transparent)]
    NoBoard(#[from] Absence),
    /// Too little of the board.
    #[error("only {found} of {all} corners were found; at least {needed} are needed")]
    FewCorners {
        /// Found.
        found: usize,
        /// On the board.
        all: usize,
        /// Needed.
        needed: usize,
    },
    /// Nobody knows which corners these are.
    #[error(
        "the chessboard is partly covered, so that its corners cannot be numbered; use a board with markers, or show \
         all of it"
    )]
    Unanchored,
    /// In no picture of this camera is the whole chessboard seen.
    #[error(
        "in no picture is the whole {wanted} seen; the largest part has {} × {} inner corners: is that \
         the board's size?",
        .seen.0,
        .seen.1
    )]
    NeverWhole {
        /// The board looked for.
        wanted: String,
        /// Columns and rows of corners of the largest part.
        seen: (usize, usize),
    },
    /// Much like one that was kept.
    #[error("the board stands as in {like} (intersection over union {iou:.2})")]
    Alike {
        /// That view.
        like: String,
        /// Intersection over union of the outlines.
        iou: f64,
    },
    /// Enough views.
    #[error("there are already {0} views, which is enough")]
    Enough(usize),
}

/// A picture on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Name of the view; pictures of one name in several cameras are simultaneous.
    pub name: String,
    /// The file.
    pub path: PathBuf,
}

/// The pictures (PNG and JPEG) of a folder by name, or one file.
///
/// # Errors
/// What the file system reports.
pub fn pictures(path: &Path) -> std::io::Result<Vec<Picture>> {
    let stem = |p: &Path| p.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    if !path.is_dir() {
        std::fs::metadata(path)?;
        return Ok(vec![Picture { name: stem(path), path: path.to_owned() }]);
    }
    let mut found = Vec::new();
    for entry in std::fs::read_dir(path)? {
        let path = entry?.path();
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        if ["png", "jpg", "jpeg"].contains(&extension.as_str()) {
            found.push(Picture { name: stem(&path), path });
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
}

/// Why, without the path: who reports a rejection has named the picture.
fn reason(error: &PictureError) -> String {
    match error {
        PictureError::Undecodable { cause, .. } => cause.clone(),
        other => other.source().unwrap_or(other).to_string(),
    }
}

/// Reads a picture as grey values.
///
/// # Errors
/// [`Rejection::Unreadable`].
pub fn read(path: &Path) -> Result<Luma, Rejection> {
    let unreadable = |e: String| Rejection::Unreadable(e);
    let picture = picture::Picture::read(path, Channels::Grey).map_err(|e| unreadable(reason(&e)))?;
    Luma::new(picture.width(), picture.height(), picture.into_bytes())
        .ok_or_else(|| unreadable("it is empty".to_owned()))
}

/// Whether a view is worth keeping beside those whose outlines are `kept`.
///
/// # Errors
/// [`Rejection`], the reason.
pub fn judge(
    board: &BoardView,
    detector: &Detector,
    kept: &[(&str, &[Vector2<f64>])],
    options: &GatherOptions,
) -> Result<(), Rejection> {
    let all = detector.points().len();
    let needed = ((all as f64 * options.min_corners).ceil() as usize).max(6).min(all);
    if board.corners.len() < needed {
        return Err(Rejection::FewCorners { found: board.corners.len(), all, needed });
    }
    if !board.anchored && !options.allow_unanchored {
        return Err(Rejection::Unanchored);
    }
    if kept.len() >= options.max_views {
        return Err(Rejection::Enough(kept.len()));
    }
    let outline = Detector::outline(board);
    let closest = kept
        .iter()
        .map(|(name, other)| (*name, intersection_over_union(&outline, other)))
        .max_by(|a, b| a.1.total_cmp(&b.1));
    match closest {
        Some((like, iou)) if iou > options.max_iou => Err(Rejection::Alike { like: like.to_owned(), iou }),
        _ => Ok(()),
    }
}

/// Twice the signed area of a polygon.
fn doubled_area(polygon: &[Vector2<f64>]) -> f64 {
    (0..polygon.len()).map(|i| polygon[i].perp(&polygon[(i + 1) % polygon.len()])).sum()
}

/// Intersection over union of two convex polygons that run the same way round (Sutherland and Hodgman's
/// clipping), 0–1.
pub fn intersection_over_union(a: &[Vector2<f64>], b: &[Vector2<f64>]) -> f64 {
    let (area_a, area_b) = (doubled_area(a), doubled_area(b));
    if a.len() < 3 || b.len() < 3 || area_a == 0.0 || area_b == 0.0 {
        return 0.0;
    }
    let sign = area_b.signum();
    let mut clipped = a.to_vec();
    for i in 0..b.len() {
        let (from, to) = (b[i], b[(i + 1) % b.len()]);
        let inside = |p: &Vector2<f64>| sign * (to - from).perp(&(p - from));
        let mut next = Vec::with_capacity(clipped.len() + 1);
        for k in 0..clipped.len() {
            let (p, q) = (clipped[k], clipped[(k + 1) % clipped.len()]);
            let (dp, dq) = (inside(&p), inside(&q));
            if dp >= 0.0 {
                next.push(p);
            }
            if (dp >= 0.0) != (dq >= 0.0) {
                next.push(p + (q - p) * (dp / (dp - dq)));
            }
        }
        clipped = next;
        if clipped.len() < 3 {
            return 0.0;
        }
    }
    let common = doubled_area(&clipped).abs();
    common / (area_a.abs() + area_b.abs() - common)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f64, y: f64, side: f64) -> Vec<Vector2<f64>> {
        [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)].map(|(u, v)| Vector2::new(x + u, y + v)).to_vec()
    }

    #[test]
    fn intersection_over_union_of_squares_is_what_areas_say() {
        let one = square(0.0, 0.0, 2.0);
        assert!((intersection_over_union(&one, &one) - 1.0).abs() < 1e-12);
        assert!((intersection_over_union(&one, &square(1.0, 0.0, 2.0)) - 2.0 / 6.0).abs() < 1e-12);
        assert!((intersection_over_union(&one, &square(0.5, 0.5, 1.0)) - 0.25).abs() < 1e-12);
        assert_eq!(intersection_over_union(&one, &square(5.0, 0.0, 2.0)), 0.0);
        let backwards: Vec<_> = square(1.0, 0.0, 2.0).into_iter().rev().collect();
        assert!((intersection_over_union(&one, &backwards) - 2.0 / 6.0).abs() < 1e-12);
    }
}
