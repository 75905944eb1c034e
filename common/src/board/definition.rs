use std::{fmt, sync::Arc};

use nalgebra::{Vector2, Vector3};
use thiserror::Error;

use super::dictionary::{Dictionary, DictionaryError};

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

/// A board that cannot be.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum BoardError {
    /// The dictionary.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    /// The description does not parse.
    #[error(
        "board {spec:?}: {what}; valid are chessboard:COLUMNSxROWS:SQUARE (inner corners), \
         aruco:COLUMNSxROWS:DICTIONARY:MARKER:GAP and charuco:COLUMNSxROWS:DICTIONARY:SQUARE:MARKER, with sizes such \
         as 25mm, and then :inverted, :legacy, :first=ID or :double=THICKNESS"
    )]
    Spec {
        /// What was given.
        spec: String,
        /// What is wrong with it.
        what: String,
    },
    /// There are not enough markers in the dictionary.
    #[error("the board needs markers {first} to {last}, but {dictionary} ends at {end}")]
    Ids {
        /// First marker needed.
        first: usize,
        /// Last marker needed.
        last: usize,
        /// The dictionary.
        dictionary: String,
        /// Its last marker.
        end: usize,
    },
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
    /// A board after its description, such as `charuco:11x8:DICT_5X5_250:30mm:22mm`; a dictionary that
    /// holds a dot or slash is the name of a file, which `read` is asked for.
    ///
    /// # Errors
    /// [`BoardError`] says what would be right.
    pub fn parse(spec: &str, read: impl Fn(&str) -> Result<String, String>) -> Result<Self, BoardError> {
        let failed = |what: String| BoardError::Spec { spec: spec.to_owned(), what };
        let mut parts: Vec<&str> = spec.split(':').collect();
        let (mut inverted, mut legacy, mut first_id, mut double) = (false, false, 0, None);
        while let Some(last) = parts.last() {
            match *last {
                "inverted" => inverted = true,
                "legacy" => legacy = true,
                other if other.starts_with("double=") => double = other.strip_prefix("double="),
                other => match other.strip_prefix("first=").map(str::parse) {
                    Some(Ok(id)) => first_id = id,
                    Some(Err(_)) => return Err(failed(format!("{other:?} has no marker number"))),
                    None => break,
                },
            }
            parts.pop();
        }
        let length = |text: &str| -> Result<f64, BoardError> {
            let wrong = || failed(format!("{text:?} is no length; write 25mm, 2.5cm or 0.025m"));
            let (number, unit) = [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)]
                .iter()
                .find_map(|(u, s)| text.strip_suffix(u).map(|n| (n, s)))
                .ok_or_else(wrong)?;
            let value: f64 = number.parse().map_err(|_| wrong())?;
            let length_m = value * unit;
            if length_m > 0.0 && length_m < 100.0 { Ok(length_m) } else { Err(wrong()) }
        };
        let grid = |text: &str, least: usize| -> Result<(usize, usize), BoardError> {
            let parsed = text.split_once('x').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
            parsed
                .filter(|&(a, b): &(usize, usize)| (least..=200).contains(&a) && (least..=200).contains(&b))
                .ok_or_else(|| {
                    failed(format!("{text:?} is no size; write COLUMNSxROWS, {least} to 200 each"))
                })
        };
        let dictionary = |name: &str| -> Result<Arc<Dictionary>, BoardError> {
            if name.contains(['.', '/']) {
                let text =
                    read(name).map_err(|e| failed(format!("the dictionary {name} cannot be read: {e}")))?;
                Ok(Arc::new(Dictionary::parse(&text, name)?))
            } else {
                Ok(Arc::new(Dictionary::predefined(name)?))
            }
        };
        let pattern = match parts.as_slice() {
            ["chessboard", size, square] => {
                let (columns, rows) = grid(size, 2)?;
                Pattern::Chessboard { columns, rows, square_m: length(square)? }
            }
            ["aruco", size, name, marker, gap] => {
                let (columns, rows) = grid(size, 1)?;
                let (marker_m, gap_m) = (length(marker)?, length(gap)?);
                Pattern::ArucoGrid { columns, rows, marker_m, gap_m, dictionary: dictionary(name)?, first_id }
            }
            ["charuco", size, name, square, marker] => {
                let (columns, rows) = grid(size, 2)?;
                let (square_m, marker_m) = (length(square)?, length(marker)?);
                if marker_m >= square_m {
                    return Err(failed("the marker must be smaller than the square".to_owned()));
                }
                Pattern::Charuco {
                    columns,
                    rows,
                    square_m,
                    marker_m,
                    dictionary: dictionary(name)?,
                    first_id,
                    legacy,
                }
            }
            [kind @ ("chessboard" | "aruco" | "charuco"), ..] => {
                return Err(failed(format!("{} parts are too many or too few for {kind}", parts.len())));
            }
            _ => return Err(failed("the kind is unknown".to_owned())),
        };
        let thickness_m = double.map(length).transpose()?;
        let board = Self { pattern, inverted, thickness_m };
        if thickness_m.is_some() && board.dictionary().is_none() {
            return Err(failed(
                "a chessboard looks the same from both sides; a double board needs markers".to_owned(),
            ));
        }
        let back = board.back();
        let ids: Vec<usize> = back.iter().chain([&board]).flat_map(|b| b.markers()).map(|m| m.id).collect();
        if let (Some(dictionary), Some(&last)) = (board.dictionary(), ids.iter().max())
            && last >= dictionary.len()
        {
            let end = dictionary.len().saturating_sub(1);
            return Err(BoardError::Ids {
                first: first_id,
                last,
                dictionary: dictionary.name().to_owned(),
                end,
            });
        }
        Ok(board)
    }

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

    /// The black rectangles (least x, y; largest x, y; m) that make the pattern, before any inversion.
    pub fn black(&self) -> Vec<(Vector2<f64>, Vector2<f64>)> {
        let (low, _) = self.extent();
        let mut black = Vec::new();
        let (columns, rows, square) = match &self.pattern {
            Pattern::Chessboard { columns, rows, square_m } => (columns + 1, rows + 1, *square_m),
            Pattern::Charuco { columns, rows, square_m, .. } => (*columns, *rows, *square_m),
            Pattern::ArucoGrid { .. } => (0, 0, 0.0),
        };
        for (x, y) in (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))) {
            if self.is_black_square(x, y) {
                let at = low + Vector2::new(x as f64, y as f64) * square;
                black.push((at, at + Vector2::repeat(square)));
            }
        }
        for marker in self.markers() {
            let Some(dictionary) = self.dictionary() else { continue };
            let cells = dictionary.size() + 2;
            let cell = marker.side / cells as f64;
            for row in 0..cells {
                // Neighbouring black cells of a row become one rectangle, so that printers leave no seams.
                let white = |column: usize| {
                    let inner = |i: usize| (1..=dictionary.size()).contains(&i);
                    inner(row)
                        && inner(column)
                        && dictionary.is_white(marker.id, row - 1, column - 1) == Some(true)
                };
                let mut column = 0;
                while column < cells {
                    let start = column;
                    while column < cells && !white(column) {
                        column += 1;
                    }
                    if column > start {
                        let at = |c: usize, r: usize| marker.origin + Vector2::new(c as f64, r as f64) * cell;
                        black.push((at(start, row), at(column, row + 1)));
                    }
                    column += 1;
                }
            }
        }
        black
    }

    /// Whether the point (x, y), m, of the board is white, the inversion included; `None` outside the
    /// pattern and a margin of `margin_m` around it.
    pub fn is_white(&self, at: &Vector2<f64>, margin_m: f64) -> Option<bool> {
        let (low, high) = self.extent();
        if at.x < low.x - margin_m
            || at.y < low.y - margin_m
            || at.x > high.x + margin_m
            || at.y > high.y + margin_m
        {
            return None;
        }
        Some(self.is_white_inside(at, &low, &high) != self.inverted)
    }

    /// White squares before square (x, y), row by row. Two rows that follow each other have as many white
    /// squares as black ones.
    fn white_squares_before(&self, columns: usize, x: usize, y: usize) -> usize {
        let in_row = |row: usize, squares: usize| {
            let white_first = !self.is_black_square(0, row);
            (squares + usize::from(white_first)) / 2
        };
        let odd = if y % 2 == 1 { in_row(y - 1, columns) } else { 0 };
        y / 2 * columns + odd + in_row(y, x)
    }

    fn is_white_inside(&self, at: &Vector2<f64>, low: &Vector2<f64>, high: &Vector2<f64>) -> bool {
        if at.x < low.x || at.y < low.y || at.x >= high.x || at.y >= high.y {
            return true;
        }
        let in_marker = |origin: Vector2<f64>, side: f64, id: usize| -> Option<bool> {
            let dictionary = self.dictionary()?;
            let cells = dictionary.size() + 2;
            let p = (at - origin) / side * cells as f64;
            if p.x < 0.0 || p.y < 0.0 || p.x >= cells as f64 || p.y >= cells as f64 {
                return None;
            }
            let (column, row) = (p.x as usize, p.y as usize);
            let border = column == 0 || row == 0 || column == cells - 1 || row == cells - 1;
            Some(!border && dictionary.is_white(id, row - 1, column - 1) == Some(true))
        };
        match &self.pattern {
            Pattern::Chessboard { square_m, .. } => {
                let p = (at - low) / *square_m;
                !self.is_black_square(p.x as usize, p.y as usize)
            }
            Pattern::Charuco { columns, square_m, marker_m, first_id, .. } => {
                let p = at / *square_m;
                let (x, y) = (p.x as usize, p.y as usize);
                if self.is_black_square(x, y) {
                    return false;
                }
                let before = self.white_squares_before(*columns, x, y);
                let origin = Vector2::new(x as f64, y as f64) * *square_m
                    + Vector2::repeat((square_m - marker_m) / 2.0);
                in_marker(origin, *marker_m, first_id + before).unwrap_or(true)
            }
            Pattern::ArucoGrid { columns, marker_m, gap_m, first_id, .. } => {
                let pitch = marker_m + gap_m;
                let (x, y) = ((at.x / pitch) as usize, (at.y / pitch) as usize);
                let origin = Vector2::new(x as f64, y as f64) * pitch;
                in_marker(origin, *marker_m, first_id + y * columns + x).unwrap_or(true)
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

/// A length in mm, without needless digits.
fn mm(length_m: f64) -> String {
    let text = format!("{:.4}", length_m * 1e3);
    format!("{}mm", text.trim_end_matches('0').trim_end_matches('.'))
}

/// The description that [`CalibrationBoard::parse`] reads.
impl fmt::Display for CalibrationBoard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.pattern {
            Pattern::Chessboard { columns, rows, square_m } => {
                write!(f, "chessboard:{columns}x{rows}:{}", mm(*square_m))?;
            }
            Pattern::ArucoGrid { columns, rows, marker_m, gap_m, dictionary, first_id } => {
                write!(f, "aruco:{columns}x{rows}:{}:{}:{}", dictionary.name(), mm(*marker_m), mm(*gap_m))?;
                if *first_id > 0 {
                    write!(f, ":first={first_id}")?;
                }
            }
            Pattern::Charuco { columns, rows, square_m, marker_m, dictionary, first_id, legacy } => {
                write!(
                    f,
                    "charuco:{columns}x{rows}:{}:{}:{}",
                    dictionary.name(),
                    mm(*square_m),
                    mm(*marker_m)
                )?;
                if *first_id > 0 {
                    write!(f, ":first={first_id}")?;
                }
                if *legacy {
                    f.write_str(":legacy")?;
                }
            }
        }
        if self.inverted {
            f.write_str(":inverted")?;
        }
        self.thickness_m.map_or(Ok(()), |t| write!(f, ":double={}", mm(t)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(spec: &str) -> Result<CalibrationBoard, BoardError> {
        CalibrationBoard::parse(spec, |_| Err("no file here".to_owned()))
    }

    #[test]
    fn descriptions_round_trip_and_wrong_ones_say_what_would_be_right() {
        for spec in [
            "chessboard:9x6:25mm",
            "aruco:5x7:DICT_6X6_250:40mm:10mm:first=3",
            "charuco:4x5:DICT_4X4_1000:54mm:40.5mm:inverted",
            "charuco:11x8:DICT_5X5_250:30mm:22mm:legacy",
            "aruco:4x3:DICT_4X4_50:80mm:20mm:double=6mm",
        ] {
            assert_eq!(parse(spec).expect(spec).to_string(), spec);
        }
        for (spec, says) in [
            ("chessboard:9x6", "too few"),
            ("chessboard:9y6:25mm", "COLUMNSxROWS"),
            ("chessboard:9x6:25", "25mm"),
            ("circles:9x6:25mm", "unknown"),
            ("charuco:4x5:DICT_4X4_1000:54mm:60mm", "smaller"),
            ("aruco:5x7:DICT_X:40mm:10mm", "DICT_6X6_250"),
            ("aruco:9x9:DICT_4X4_50:40mm:10mm", "ends at 49"),
            ("aruco:5x7:own.yml:40mm:10mm", "no file here"),
            ("chessboard:9x6:25mm:double=5mm", "both sides"),
            ("aruco:5x6:DICT_4X4_50:40mm:10mm:double=5mm", "ends at 49"),
        ] {
            let error = parse(spec).expect_err(spec).to_string();
            assert!(error.contains(says), "{spec}: {error}");
        }
    }

    #[test]
    fn the_rectangles_and_the_point_test_describe_the_same_board() {
        for spec in [
            "chessboard:4x3:25mm",
            "aruco:2x3:DICT_5X5_50:40mm:10mm",
            "charuco:4x5:DICT_4X4_1000:54mm:40.5mm",
            "charuco:3x4:DICT_4X4_1000:54mm:40.5mm:legacy:inverted",
        ] {
            let board = parse(spec).expect(spec);
            let (low, high) = board.extent();
            let rectangles = board.black();
            for i in 0..4000 {
                let u = Vector2::new(f64::from(i % 63) / 62.7, f64::from(i / 63) / 63.9);
                let at = low + (high - low).component_mul(&u);
                let black =
                    rectangles.iter().any(|(a, b)| at.x >= a.x && at.y >= a.y && at.x < b.x && at.y < b.y);
                assert_eq!(board.is_white(&at, 0.0), Some(black == board.inverted), "{spec} at {at}");
            }
        }
    }

    #[test]
    fn the_back_of_a_double_board_lies_behind_its_front() {
        let board = parse("charuco:5x4:DICT_4X4_50:40mm:30mm:double=6mm").expect("valid");
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
        let board = parse("charuco:5x7:DICT_6X6_250:40mm:20mm").expect("valid");
        assert_eq!((board.markers().len(), board.corners().len()), (17, 24));
        // OpenCV: marker 0 is in the second square of the first row.
        assert!((board.markers()[0].origin - Vector2::new(0.05, 0.01)).norm() < 1e-12);
        let grid = parse("aruco:5x7:DICT_6X6_250:40mm:10mm").expect("valid");
        assert_eq!(grid.corners().len(), 140);
        assert_eq!(grid.corners()[4 + 2], Vector3::new(0.09, 0.04, 0.0));
    }
}
