//! A board in a line of text, such as `charuco:11x8:DICT_5X5_250:30mm:22mm`, read and written.

use std::{fmt, sync::Arc};

use thiserror::Error;

use super::{CalibrationBoard, Dictionary, DictionaryError, Pattern};

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
}
