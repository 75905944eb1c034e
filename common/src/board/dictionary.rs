use thiserror::Error;

/// Bits of OpenCV's predefined dictionaries, row by row, first bit first, 1 = white; a header line
/// `NAME size count correction` before each. Written out from OpenCV 5.0.0's
/// `aruco.getPredefinedDictionary` (objdetect module, Apache-2.0).
const PREDEFINED: &str = include_str!("dictionaries.txt");

/// Smaller dictionaries are the beginnings of the large ones: name, large one, markers, correctable bits.
const BEGINNINGS: [(&str, &str, usize, u32); 12] = [
    ("DICT_4X4_50", "DICT_4X4_1000", 50, 1),
    ("DICT_4X4_100", "DICT_4X4_1000", 100, 1),
    ("DICT_4X4_250", "DICT_4X4_1000", 250, 1),
    ("DICT_5X5_50", "DICT_5X5_1000", 50, 3),
    ("DICT_5X5_100", "DICT_5X5_1000", 100, 3),
    ("DICT_5X5_250", "DICT_5X5_1000", 250, 2),
    ("DICT_6X6_50", "DICT_6X6_1000", 50, 6),
    ("DICT_6X6_100", "DICT_6X6_1000", 100, 5),
    ("DICT_6X6_250", "DICT_6X6_1000", 250, 5),
    ("DICT_7X7_50", "DICT_7X7_1000", 50, 9),
    ("DICT_7X7_100", "DICT_7X7_1000", 100, 8),
    ("DICT_7X7_250", "DICT_7X7_1000", 250, 8),
];

/// A set of square markers, each a pattern of `size` × `size` bits inside a black border of one cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dictionary {
    name: String,
    size: usize,
    correction: u32,
    markers: Vec<u64>,
}

/// A dictionary that cannot be had.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum DictionaryError {
    /// No such name.
    #[error("{name:?} is no predefined dictionary; there are {}", Dictionary::names().join(", "))]
    Unknown {
        /// The name asked for.
        name: String,
    },
    /// The file does not fit.
    #[error(
        "the dictionary file {file}: {what}; it must hold nmarkers, markersize and marker_0 … as strings of 0 and 1, as \
         OpenCV writes them"
    )]
    File {
        /// The file.
        file: String,
        /// What is wrong.
        what: String,
    },
}

/// What a pattern of bits was read as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reading {
    /// The marker.
    pub id: usize,
    /// Quarter turns, clockwise, from the marker's own top-left corner to where it was read from.
    pub turns: usize,
    /// Bits that differ.
    pub errors: u32,
}

impl Dictionary {
    /// Names of all predefined dictionaries.
    pub fn names() -> Vec<&'static str> {
        let large = PREDEFINED.lines().filter(|l| l.starts_with("DICT_")).filter_map(|l| l.split(' ').next());
        large.chain(BEGINNINGS.iter().map(|b| b.0)).collect()
    }

    /// One of OpenCV's predefined dictionaries, such as `DICT_5X5_250`.
    ///
    /// # Errors
    /// [`DictionaryError::Unknown`] lists those that there are.
    pub fn predefined(name: &str) -> Result<Self, DictionaryError> {
        let unknown = || DictionaryError::Unknown { name: name.to_owned() };
        if let Some((_, large, count, correction)) = BEGINNINGS.iter().find(|b| b.0 == name) {
            let mut dictionary = Self::predefined(large)?;
            dictionary.markers.truncate(*count);
            return Ok(Self { name: name.to_owned(), correction: *correction, ..dictionary });
        }
        let mut lines = PREDEFINED.lines().skip_while(|l| l.split(' ').next() != Some(name));
        let mut header = lines.next().ok_or_else(unknown)?.split(' ').skip(1).map(str::parse::<usize>);
        let mut number = || header.next().and_then(Result::ok).ok_or_else(unknown);
        let (size, count, correction) = (number()?, number()?, number()?);
        let digits = (size * size).div_ceil(4);
        let text: String = lines.take_while(|l| !l.starts_with("DICT_")).collect();
        let word =
            |i: usize| text.get(i * digits..(i + 1) * digits).and_then(|w| u64::from_str_radix(w, 16).ok());
        let markers = (0..count).map(word).collect::<Option<_>>().ok_or_else(unknown)?;
        Ok(Self { name: name.to_owned(), size, correction: u32::try_from(correction).unwrap_or(0), markers })
    }

    /// A dictionary in the YAML that OpenCV's `Dictionary::writeDictionary` writes; `file` is for
    /// messages and becomes its name.
    ///
    /// # Errors
    /// [`DictionaryError::File`] says what does not fit.
    pub fn parse(text: &str, file: &str) -> Result<Self, DictionaryError> {
        let failed = |what: String| DictionaryError::File { file: file.to_owned(), what };
        let value = |key: &str| {
            let mut lines = text.lines().filter_map(|l| l.trim().split_once(':'));
            lines.find(|(k, _)| *k == key).map(|(_, v)| v.trim().trim_matches('"').to_owned())
        };
        let number = |key: &str| -> Result<usize, DictionaryError> {
            let found = value(key).ok_or_else(|| failed(format!("{key} is missing")))?;
            found.parse().map_err(|_| failed(format!("{key} is {found:?}, which is no number")))
        };
        let (count, size) = (number("nmarkers")?, number("markersize")?);
        if !(3..=8).contains(&size) || count == 0 || count > 100_000 {
            return Err(failed(format!(
                "{count} markers of {size} × {size} bits; 3 to 8 bits are supported"
            )));
        }
        let markers = (0..count)
            .map(|i| {
                let key = format!("marker_{i}");
                let bits = value(&key).ok_or_else(|| failed(format!("{key} is missing")))?;
                if bits.len() != size * size || bits.bytes().any(|b| b != b'0' && b != b'1') {
                    return Err(failed(format!("{key} is {bits:?}, not {} digits 0 or 1", size * size)));
                }
                u64::from_str_radix(&bits, 2).map_err(|e| failed(format!("{key}: {e}")))
            })
            .collect::<Result<Vec<_>, _>>()?;
        let correction = value("maxCorrectionBits").and_then(|v| v.parse().ok());
        let mut dictionary = Self { name: file.to_owned(), size, correction: 0, markers };
        dictionary.correction = correction.unwrap_or_else(|| (dictionary.least_distance().max(1) - 1) / 2);
        Ok(dictionary)
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Bits along one side of a marker, without the border.
    pub const fn size(&self) -> usize {
        self.size
    }

    /// Number of markers.
    pub fn len(&self) -> usize {
        self.markers.len()
    }

    /// Whether there is no marker.
    pub fn is_empty(&self) -> bool {
        self.markers.is_empty()
    }

    /// Wrong bits that still leave one marker nearest.
    pub const fn correction(&self) -> u32 {
        self.correction
    }

    /// Whether the bit in `row` and `column` of marker `id` is white; `None` for no such marker or bit.
    pub fn is_white(&self, id: usize, row: usize, column: usize) -> Option<bool> {
        let bits = self.markers.get(id)?;
        (row < self.size && column < self.size)
            .then(|| bits >> (self.size * self.size - 1 - (row * self.size + column)) & 1 == 1)
    }

    /// The marker nearest to `bits` (row by row, first bit highest, 1 = white) among `ids`, in any of
    /// four turns, when it differs by no more than `max_errors` bits and no other is as near.
    pub fn identify(
        &self,
        bits: u64,
        ids: impl Iterator<Item = usize> + Clone,
        max_errors: u32,
    ) -> Option<Reading> {
        let mut turned = bits;
        let mut best: Option<Reading> = None;
        let mut tie = false;
        for turns in 0..4 {
            for id in ids.clone() {
                let Some(marker) = self.markers.get(id) else { continue };
                let errors = (marker ^ turned).count_ones();
                if errors <= max_errors {
                    let better = best.is_none_or(|b| errors < b.errors);
                    tie = !better && (tie || best.is_some_and(|b| errors == b.errors));
                    if better {
                        best = Some(Reading { id, turns, errors });
                    }
                }
            }
            turned = self.turn(turned);
        }
        best.filter(|_| !tie)
    }

    /// The pattern turned by a quarter, counter-clockwise: the cell at the top right becomes the first.
    fn turn(&self, bits: u64) -> u64 {
        let n = self.size;
        let at = |row: usize, column: usize| bits >> (n * n - 1 - (row * n + column)) & 1;
        (0..n * n).fold(0, |word, i| word << 1 | at(i % n, n - 1 - i / n))
    }

    fn least_distance(&self) -> u32 {
        let mut least = u32::MAX;
        for (i, a) in self.markers.iter().enumerate() {
            let mut turned = *a;
            for turn in 0..4 {
                if turn > 0 {
                    least = least.min((turned ^ a).count_ones());
                }
                least = self.markers[..i].iter().map(|b| (turned ^ b).count_ones()).fold(least, u32::min);
                turned = self.turn(turned);
            }
        }
        least
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_predefined_dictionary_reads_each_of_its_markers_in_every_turn() {
        for name in Dictionary::names() {
            let dictionary = Dictionary::predefined(name).expect(name);
            if name == "DICT_ARUCO_ORIGINAL" {
                // It holds patterns that look alike in two turns; those are rightly read as nothing.
                continue;
            }
            for id in [0, dictionary.len() / 2, dictionary.len() - 1] {
                let mut bits = dictionary.markers[id];
                for turned in 0..4 {
                    let read = dictionary.identify(bits, 0..dictionary.len(), 0).expect("itself");
                    assert_eq!((read.id, read.turns), (id, (4 - turned) % 4), "{name}");
                    bits = dictionary.turn(bits);
                }
            }
        }
        assert_eq!(Dictionary::names().len(), 22);
        let error = Dictionary::predefined("DICT_9X9_50").expect_err("none").to_string();
        assert!(error.contains("DICT_5X5_250"), "{error}");
    }

    #[test]
    fn marker_0_of_4x4_is_opencvs() {
        // The first marker of DICT_4X4: rows 1011 0101 0011 0010, as printed in OpenCV's tutorials.
        let dictionary = Dictionary::predefined("DICT_4X4_50").expect("there");
        let rows = ["1011", "0101", "0011", "0010"];
        for (r, row) in rows.iter().enumerate() {
            for (c, bit) in row.chars().enumerate() {
                assert_eq!(dictionary.is_white(0, r, c), Some(bit == '1'));
            }
        }
    }

    #[test]
    fn a_dictionary_file_says_what_is_wrong_with_it() {
        let good =
            "%YAML:1.0\nnmarkers: 2\nmarkersize: 3\nmarker_0: \"101000111\"\nmarker_1: \"000010011\"\n";
        let dictionary = Dictionary::parse(good, "own.yml").expect("valid");
        assert_eq!((dictionary.len(), dictionary.is_white(0, 0, 1)), (2, Some(false)));
        for (from, to, says) in [
            ("marker_1", "marker_7", "marker_1"),
            ("000010011", "0000100112", "digits"),
            ("nmarkers: 2", "nmarkers: x", "number"),
        ] {
            let error = Dictionary::parse(&good.replace(from, to), "own.yml").expect_err(says).to_string();
            assert!(error.contains(says) && error.contains("own.yml"), "{error}");
        }
    }
}
