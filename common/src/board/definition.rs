use std::sync::Arc;

use nalgebra::{Vector2, Vector3};

use super::dictionary::Dictionary;

/// What is printed on a board.
#[derive(Debug, Clone, PartialEq)]
pub enum Pattern {
    /// Black and white squares; the outer corner square at the first corner is black.
    Chessboard {
        /// Inner corners along x.
        columns: usize,
        /// Inner corners along y.
        rows: usize,
        /// Side of a square, m.
        square_m: f64,
    },
    /// A grid of ArUco markers on white.
    ArucoGrid {
        /// Markers along x.
        columns: usize,
        /// Markers along y.
        rows: usize,
        /// Side of a marker with its border, m.
        marker_m: f64,
        /// White between two markers, m.
        gap_m: f64,
        /// The markers.
        dictionary: Arc<Dictionary>,
        /// Number of the first marker; the others count up along the rows.
        first_id: usize,
    },
    /// A chessboard with ArUco markers in its white squares.
    Charuco {
        /// Squares along x.
        columns: usize,
        /// Squares along y.
        rows: usize,
        /// Side of a square, m.
        square_m: f64,
        /// Side of a marker with its border, m.
        marker_m: f64,
        /// The markers.
        dictionary: Arc<Dictionary>,
        /// Number of the first marker; the others count up along the rows.
        first_id: usize,
        /// The pattern before OpenCV 4.6: with an even number of rows the first square is white.
        legacy: bool,
    },
}

/// A calibration board. Its frame has its origin at the first corner (chessboard: inner corner; ArUco
/// grid: corner of the first marker; ChArUco: corner of the first square), x along the columns, y along
/// the rows, z away from the viewer.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationBoard {
    /// What is printed.
    pub pattern: Pattern,
    /// Whether black and white are swapped, the margin included.
    pub inverted: bool,
    /// Distance between the two printed sides of a board that has two, m: see [`Self::back`].
    pub thickness_m: Option<f64>,
}

/// A marker of a board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacedMarker {
    /// Its number in the dictionary.
    pub id: usize,
    /// Its top-left corner in the board's frame, m.
    pub origin: Vector2<f64>,
    /// Its side, m.
    pub side: f64,
}

impl PlacedMarker {
    /// Its corners, clockwise from the top left, in the board's frame, m.
    pub fn corners(&self) -> [Vector2<f64>; 4] {
        let s = self.side;
        [(0.0, 0.0), (s, 0.0), (s, s), (0.0, s)].map(|(x, y)| self.origin + Vector2::new(x, y))
    }
}

impl CalibrationBoard {
    /// The other side of a double board: the same pattern with the markers that follow the front's, its
    /// outline where the front's is. A camera that stands behind the board sees it upright.
    pub fn back(&self) -> Option<Self> {
        self.thickness_m?;
        let mut back = Self { thickness_m: None, ..self.clone() };
        let markers = self.markers().len();
        match &mut back.pattern {
            Pattern::Chessboard { .. } => return None,
            Pattern::ArucoGrid { first_id, .. } | Pattern::Charuco { first_id, .. } => *first_id += markers,
        }
        Some(back)
    }

    /// Where a point of [`Self::back`], in the back's own frame, lies in this board's frame, m: turned by
    /// half a turn about y, one thickness behind.
    pub fn front_from_back(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let (low, high) = self.extent();
        Vector3::new(low.x + high.x - point.x, point.y, self.thickness_m.unwrap_or(0.0) - point.z)
    }

    /// The dictionary, where the board has markers.
    pub fn dictionary(&self) -> Option<&Dictionary> {
        match &self.pattern {
            Pattern::Chessboard { .. } => None,
            Pattern::ArucoGrid { dictionary, .. } | Pattern::Charuco { dictionary, .. } => Some(dictionary),
        }
    }

    /// All markers, in the order of their numbers.
    pub fn markers(&self) -> Vec<PlacedMarker> {
        match &self.pattern {
            Pattern::Chessboard { .. } => Vec::new(),
            Pattern::ArucoGrid { columns, rows, marker_m, gap_m, first_id, .. } => {
                let pitch = marker_m + gap_m;
                let place =
                    |i: usize| Vector2::new((i % columns) as f64 * pitch, (i / columns) as f64 * pitch);
                (0..columns * rows)
                    .map(|i| PlacedMarker { id: first_id + i, origin: place(i), side: *marker_m })
                    .collect()
            }
            Pattern::Charuco { columns, rows, square_m, marker_m, first_id, .. } => {
                let margin = Vector2::repeat((square_m - marker_m) / 2.0);
                (0..columns * rows)
                    .map(|i| (i % columns, i / columns))
                    .filter(|&(x, y)| !self.is_black_square(x, y))
                    .enumerate()
                    .map(|(n, (x, y))| PlacedMarker {
                        id: first_id + n,
                        origin: Vector2::new(x as f64, y as f64) * *square_m + margin,
                        side: *marker_m,
                    })
                    .collect()
            }
        }
    }

    /// Whether square (x, y), counted from the outer corner, is black (before any inversion).
    pub fn is_black_square(&self, x: usize, y: usize) -> bool {
        match &self.pattern {
            Pattern::Chessboard { .. } => (x + y).is_multiple_of(2),
            Pattern::ArucoGrid { .. } => false,
            Pattern::Charuco { rows, legacy, .. } => (x + y) % 2 == usize::from(*legacy && rows % 2 == 0),
        }
    }

    /// All calibration points in the board's frame, in metres; the place in the list is the corner's id.
    /// Chessboard and ChArUco: inner corners along the rows. ArUco grid: four corners of each marker,
    /// clockwise from its top left. The back's, where there is one, follow the front's.
    pub fn corners(&self) -> Vec<Vector3<f64>> {
        let mut corners = self.front_corners();
        if let Some(back) = self.back() {
            corners.extend(back.front_corners().iter().map(|p| self.front_from_back(p)));
        }
        corners
    }

    fn front_corners(&self) -> Vec<Vector3<f64>> {
        match &self.pattern {
            Pattern::Chessboard { columns, rows, square_m } => lattice(*columns, *rows, *square_m, 0.0),
            Pattern::Charuco { columns, rows, square_m, .. } => {
                lattice(columns - 1, rows - 1, *square_m, *square_m)
            }
            Pattern::ArucoGrid { .. } => {
                self.markers().iter().flat_map(|m| m.corners().map(|c| Vector3::new(c.x, c.y, 0.0))).collect()
            }
        }
    }

    /// The printed rectangle without margin: least and largest x and y, m.
    pub fn extent(&self) -> (Vector2<f64>, Vector2<f64>) {
        match &self.pattern {
            Pattern::Chessboard { columns, rows, square_m } => {
                (Vector2::repeat(-square_m), Vector2::new(*columns as f64, *rows as f64) * *square_m)
            }
            Pattern::Charuco { columns, rows, square_m, .. } => {
                (Vector2::zeros(), Vector2::new(*columns as f64, *rows as f64) * *square_m)
            }
            Pattern::ArucoGrid { columns, rows, marker_m, gap_m, .. } => {
                let side = |n: usize| n as f64 * marker_m + (n as f64 - 1.0) * gap_m;
                (Vector2::zeros(), Vector2::new(side(*columns), side(*rows)))
            }
        }
    }
}

fn lattice(columns: usize, rows: usize, pitch: f64, offset: f64) -> Vec<Vector3<f64>> {
    (0..columns * rows)
        .map(|i| {
            Vector3::new((i % columns) as f64 * pitch + offset, (i / columns) as f64 * pitch + offset, 0.0)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn valid(spec: &str) -> CalibrationBoard {
        CalibrationBoard::parse(spec, |_| Err("no file here".to_owned())).expect(spec)
    }

    #[test]
    fn the_back_of_a_double_board_lies_behind_its_front() {
        let board = valid("charuco:5x4:DICT_4X4_50:40mm:30mm:double=6mm");
        let back = board.back().expect("double");
        assert_eq!(back.markers()[0].id, board.markers().len());
        let corners = board.corners();
        assert_eq!(corners.len(), 24);
        // The back's first corner, at its top left, is at the front's top right, one thickness away.
        assert!((corners[12] - Vector3::new(0.16, 0.04, 0.006)).norm() < 1e-12, "{}", corners[12]);
        // The turn keeps handedness: x to the left, y kept, z towards the front.
        let (x, y, z) = (corners[13] - corners[12], corners[16] - corners[12], Vector3::new(0.0, 0.0, -1.0));
        assert!(x.cross(&y).dot(&z) > 0.0);
    }

    #[test]
    fn ids_and_corners_follow_opencv() {
        let board = valid("charuco:5x7:DICT_6X6_250:40mm:20mm");
        assert_eq!((board.markers().len(), board.corners().len()), (17, 24));
        // OpenCV: marker 0 is in the second square of the first row.
        assert!((board.markers()[0].origin - Vector2::new(0.05, 0.01)).norm() < 1e-12);
        let grid = valid("aruco:5x7:DICT_6X6_250:40mm:10mm");
        assert_eq!(grid.corners().len(), 140);
        assert_eq!(grid.corners()[4 + 2], Vector3::new(0.09, 0.04, 0.0));
    }
}
