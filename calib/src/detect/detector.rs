use std::cmp::Reverse;

use nalgebra::{Vector2, Vector3};
use thiserror::Error;

use super::{
    Corner, Depth,
    crossing::fit_crossing,
    fiducial::{any_markers, board_markers, charuco_corners, grid_corners, quads_of, recover},
    lattice,
    luma::Luma,
    markers::Marker,
    quads::Quad,
};
use crate::{
    board::{CalibrationBoard, Dictionary, Pattern},
    solve::View,
};

/// Finds one kind of board in pictures.
#[derive(Debug, Clone)]
pub struct Detector {
    board: CalibrationBoard,
    /// What is printed on the front, and on the back where there is something.
    sides: Vec<CalibrationBoard>,
    points: Vec<Vector3<f64>>,
}

/// A board in a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardView {
    /// Its corners, by number.
    pub corners: Vec<Corner>,
    /// Its markers, where it has any.
    pub markers: Vec<Marker>,
    /// Whether the corners' numbers are sure. A plain chessboard of which rows or columns are covered fits
    /// in several places: good for one camera's intrinsics, not for two cameras.
    pub anchored: bool,
}

/// Why there is no board in a picture.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum Absence {
    /// Nothing that looks like the board.
    #[error("no {wanted} in the picture; nothing else was recognised either")]
    Nothing {
        /// The board looked for.
        wanted: String,
    },
    /// Something else was there.
    #[error("no {wanted} in the picture; seen instead: {seen}")]
    Other {
        /// The board looked for.
        wanted: String,
        /// What was seen.
        seen: String,
    },
}

/// Fewest corners that count as a board: a homography and one to check it.
const LEAST_CORNERS: usize = 5;

impl Detector {
    /// For `board`.
    pub fn new(board: CalibrationBoard) -> Self {
        let front = CalibrationBoard { thickness_m: None, ..board.clone() };
        Self { points: board.corners(), sides: std::iter::once(front).chain(board.back()).collect(), board }
    }

    /// The board that it looks for.
    pub const fn board(&self) -> &CalibrationBoard {
        &self.board
    }

    /// The board's points, m, by the number of the corner.
    pub fn points(&self) -> &[Vector3<f64>] {
        &self.points
    }

    /// The board in `image`; `None` where there is none. Partial views count.
    pub fn find(&self, image: &Luma, depth: Depth) -> Option<BoardView> {
        let swapped;
        let image = if self.board.inverted {
            swapped = image.inverted();
            &swapped
        } else {
            image
        };
        let quads = if self.board.dictionary().is_some() { quads_of(image, depth) } else { Vec::new() };
        // A camera sees one side only: the one of which more is found.
        let mut first_corner = 0;
        let mut best: Option<BoardView> = None;
        for side in &self.sides {
            let found = find_side(image, side, depth, &quads).map(|mut view| {
                view.corners.iter_mut().for_each(|c| c.id += first_corner);
                view
            });
            first_corner += self.points.len() / self.sides.len();
            if let Some(found) = found
                && best.as_ref().is_none_or(|b| found.corners.len() > b.corners.len())
            {
                best = Some(found);
            }
        }
        best
    }

    /// Why `image` has no board: looks for other dictionaries, inverted boards and other sizes.
    pub fn diagnose(&self, image: &Luma) -> Absence {
        let wanted = self.board.to_string();
        let mut seen = Vec::new();
        for (picture, inverted) in [(image.clone(), false), (image.inverted(), true)] {
            let note = if inverted { ", inverted" } else { "" };
            let quads = quads_of(&picture, Depth::Final);
            let mut best: Option<((usize, Reverse<usize>), String)> = None;
            for name in Dictionary::names() {
                let Ok(dictionary) = Dictionary::predefined(name) else { continue };
                let markers = any_markers(&picture, &quads, &dictionary);
                // The smallest that explains as many is the likeliest.
                let explains = (markers.len(), Reverse(dictionary.len()));
                if markers.len() >= 2 && best.as_ref().is_none_or(|b| explains > b.0) {
                    let ids: Vec<String> = markers.iter().take(6).map(|m| m.id.to_string()).collect();
                    let more = if markers.len() > 6 { " …" } else { "" };
                    let text = format!(
                        "{} markers of {name} (numbers {}{more}{note})",
                        markers.len(),
                        ids.join(" ")
                    );
                    best = Some((explains, text));
                }
            }
            seen.extend(best.map(|b| b.1));
            if !inverted && let Some((columns, rows)) = lattice::seen(&picture) {
                seen.push(format!("a chessboard of {columns} × {rows} inner corners"));
            }
        }
        if seen.is_empty() {
            Absence::Nothing { wanted }
        } else {
            Absence::Other { wanted, seen: seen.join("; ") }
        }
    }

    /// The corners as a view of calibration.
    pub fn view(&self, name: &str, found: &BoardView) -> View {
        let object = found.corners.iter().map(|c| self.points[c.id]).collect();
        View::new(name.to_owned(), object, found.corners.iter().map(|c| c.at).collect())
    }

    /// The outline of the found corners in the picture: their convex hull.
    pub fn outline(found: &BoardView) -> Vec<Vector2<f64>> {
        convex_hull(found.corners.iter().map(|c| c.at).collect())
    }
}

/// One printed side in `image`, corners counted from its own first.
fn find_side(image: &Luma, side: &CalibrationBoard, depth: Depth, quads: &[Quad]) -> Option<BoardView> {
    let mut view = match &side.pattern {
        Pattern::Chessboard { columns, rows, .. } => {
            let board = lattice::find(image, *columns, *rows, depth)?;
            // A lattice much smaller than the board is something else.
            if board.corners.len() * 4 < columns * rows {
                return None;
            }
            BoardView { corners: board.corners, markers: Vec::new(), anchored: board.anchored }
        }
        Pattern::ArucoGrid { .. } => {
            let mut markers = board_markers(image, quads, side);
            if depth == Depth::Final {
                recover(image, &mut markers, side);
            }
            let corners = grid_corners(image, &markers, side, depth);
            BoardView { corners, markers, anchored: true }
        }
        Pattern::Charuco { .. } => {
            let markers = board_markers(image, quads, side);
            let corners = charuco_corners(image, &markers, side);
            BoardView { corners, markers, anchored: true }
        }
    };
    if depth == Depth::Final && !matches!(side.pattern, Pattern::ArucoGrid { .. }) {
        settle(image, side, &mut view.corners);
    }
    let least = if matches!(side.pattern, Pattern::ArucoGrid { .. }) { 4 } else { LEAST_CORNERS };
    (view.corners.len() >= least).then_some(view)
}

/// Fits the corners of a noisy picture once more, as crossings of edges as long as their squares allow: there
/// noise counts for more than what perspective and lens do to edges of a few pixels.
fn settle(image: &Luma, side: &CalibrationBoard, corners: &mut [Corner]) {
    /// Noise, grey levels, from which it is worth it.
    const NOISY: f64 = 4.0;
    const WIDEST_PX: f64 = 10.0;
    // As in the first fit, what is printed beside the corner stays out.
    let (pitch, share) = match side.pattern {
        Pattern::Chessboard { square_m, .. } => (square_m, 0.3),
        Pattern::Charuco { square_m, .. } => (square_m, 0.16),
        Pattern::ArucoGrid { .. } => return,
    };
    if image.noise() < NOISY {
        return;
    }
    let (points, seen) = (side.corners(), corners.to_vec());
    for corner in corners {
        let beside = |along_x: bool| {
            seen.iter().find_map(|c| {
                let apart = points[c.id] - points[corner.id];
                let (along, across) = if along_x { (apart.x, apart.y) } else { (apart.y, apart.x) };
                let next = (along.abs() - pitch).abs() < 0.1 * pitch && across.abs() < 0.1 * pitch;
                next.then(|| c.at - corner.at)
            })
        };
        let (Some(x), Some(y)) = (beside(true), beside(false)) else { continue };
        let radius = (share * x.norm().min(y.norm())).min(WIDEST_PX);
        // Where this finds nothing the first fit stands.
        if radius > 3.0
            && let Some(at) = fit_crossing(image, corner.at, [x, y], radius)
        {
            corner.at = at;
        }
    }
}

/// The convex hull, counter-clockwise for y up (Andrew's monotone chain).
pub(crate) fn convex_hull(mut points: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let chain = |points: &mut dyn Iterator<Item = Vector2<f64>>| {
        let mut hull: Vec<Vector2<f64>> = Vec::new();
        for p in points {
            while hull.len() >= 2
                && (hull[hull.len() - 1] - hull[hull.len() - 2]).perp(&(p - hull[hull.len() - 1])) <= 0.0
            {
                hull.pop();
            }
            hull.push(p);
        }
        hull.pop();
        hull
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}
