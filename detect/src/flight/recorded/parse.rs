//! The formats that recorded flights come in, told apart by their content.

use nalgebra::Vector3;
use thiserror::Error;

/// A position of a recorded flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Seconds since the recording's first.
    pub t_s: f64,
    /// Where, m, in the recording's frame.
    pub position: Vector3<f64>,
}

/// What the format says of the frame of the positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordedFrame {
    /// The table frame.
    Table,
    /// z points up; all else must be found or told.
    Upright,
}

/// A recording as its file gives it.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// The file's name.
    pub name: String,
    /// Positions by time, without repeats.
    pub samples: Vec<Sample>,
    /// Their frame.
    pub frame: RecordedFrame,
    /// The spin at the beginning, where it was measured, rad/s.
    pub spin_rad_s: Option<Vector3<f64>>,
}

/// A file that holds no flight.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RecordingError {
    /// The first line is none of those that are known.
    #[error(
        "{name}: no known format of flights; its first line is {line:?}, and valid are `Timestamp,X,Y,Z` or \
         `t,x,y,z` with a header, `t;x;y;z`, `t_ns,x,y,z,…` with a header, and tuples `((id, t_ns, [x, y, z], …), …)`"
    )]
    Unknown {
        /// The file.
        name: String,
        /// Its first line, shortened.
        line: String,
    },
    /// A line has another form than the first.
    #[error("{name}:{line}: expected {expected}, found {found:?}")]
    Line {
        /// The file.
        name: String,
        /// The line, from 1.
        line: usize,
        /// What the format has there.
        expected: &'static str,
        /// What stands there, shortened.
        found: String,
    },
    /// Too few positions.
    #[error("{name}: {found} positions are no flight; at least {needed} are needed", needed = LEAST_SAMPLES)]
    TooShort {
        /// The file.
        name: String,
        /// How many it has.
        found: usize,
    },
}

/// A recording with fewer positions predicts nothing.
const LEAST_SAMPLES: usize = 5;

#[derive(Debug, Clone, Copy)]
enum Format {
    /// A header with `t` or `Timestamp` in s, or `t_ns`, then x, y, z; table frame.
    Commas { seconds_per_tick: f64 },
    /// `t;x;y;z` in s and m without a header.
    Semicolons,
    /// `((ball_id, t_ns, [x, y, z], [vx, vy, vz]), (…))`; ball_id −1 = no ball, repeats of an id are
    /// repeats of the position.
    Tuples,
}

fn short(line: &str) -> String {
    line.chars().take(60).collect()
}

impl Format {
    fn of(name: &str, text: &str) -> Result<Self, RecordingError> {
        let line = text.lines().next().unwrap_or_default().trim();
        let mut columns = line.split(',').map(str::trim);
        match columns.next().map(str::to_ascii_lowercase).as_deref() {
            Some("timestamp" | "t" | "t_s") => return Ok(Self::Commas { seconds_per_tick: 1.0 }),
            Some("t_ns") => return Ok(Self::Commas { seconds_per_tick: 1e-9 }),
            _ => {}
        }
        if line.starts_with("((") {
            return Ok(Self::Tuples);
        }
        if line.split(';').filter(|c| c.trim().parse::<f64>().is_ok()).count() >= 4 {
            return Ok(Self::Semicolons);
        }
        Err(RecordingError::Unknown { name: name.into(), line: short(line) })
    }
}

/// Time in ticks less an offset, and a position; `None` for a line without a ball.
type Row = Option<(i64, f64, Vector3<f64>)>;

fn four(line: &str, separator: char) -> Option<(f64, Vector3<f64>)> {
    let mut numbers = line.split(separator).map(|c| c.trim().parse::<f64>().ok());
    let mut next = || numbers.next().flatten().filter(|v| v.is_finite());
    Some((next()?, Vector3::new(next()?, next()?, next()?)))
}

fn tuple(line: &str) -> Option<Row> {
    let rest = line.trim().strip_prefix("((")?;
    let (id, rest) = rest.split_once(',')?;
    let (t_ns, rest) = rest.split_once(',')?;
    let list = rest.trim_start().strip_prefix('[')?.split_once(']')?.0;
    let id: i64 = id.trim().parse().ok()?;
    let t_ns: i64 = t_ns.trim().parse().ok()?;
    let mut numbers = list.split(',').map(|c| c.trim().parse::<f64>().ok());
    let mut next = || numbers.next().flatten();
    let position = Vector3::new(next()?, next()?, next()?);
    Some((id >= 0).then_some((t_ns, id as f64, position)))
}

/// Reads the text of one file.
///
/// # Errors
/// [`RecordingError`] names file and line.
pub fn parse(name: &str, text: &str) -> Result<Recording, RecordingError> {
    let format = Format::of(name, text)?;
    let mut samples: Vec<Sample> = Vec::new();
    let (mut first, mut last_id) = (None, -1.0);
    let header = usize::from(matches!(format, Format::Commas { .. }));
    for (number, line) in text.lines().enumerate().skip(header) {
        if line.trim().is_empty() {
            continue;
        }
        let wrong = |expected| RecordingError::Line {
            name: name.into(),
            line: number + 1,
            expected,
            found: short(line),
        };
        let (t_s, position) = match format {
            Format::Commas { seconds_per_tick } => {
                let (t, p) = four(line, ',').ok_or_else(|| wrong("time and x, y, z, separated by commas"))?;
                let first = *first.get_or_insert(t);
                ((t - first) * seconds_per_tick, p)
            }
            Format::Semicolons => {
                let (t, p) = four(line, ';').ok_or_else(|| wrong("t;x;y;z"))?;
                (t - *first.get_or_insert(t), p)
            }
            Format::Tuples => {
                let row = tuple(line).ok_or_else(|| wrong("((ball_id, t_ns, [x, y, z], …"))?;
                let Some((t_ns, id, p)) = row else { continue };
                if id == last_id {
                    continue;
                }
                last_id = id;
                // Differences of integers: these stamps have more digits than a float.
                let first = *first.get_or_insert(t_ns as f64);
                ((t_ns - first as i64) as f64 * 1e-9, p)
            }
        };
        if samples.last().is_none_or(|s| t_s > s.t_s) {
            samples.push(Sample { t_s, position });
        }
    }
    if samples.len() < LEAST_SAMPLES {
        return Err(RecordingError::TooShort { name: name.into(), found: samples.len() });
    }
    let frame = match format {
        Format::Commas { .. } => RecordedFrame::Table,
        Format::Semicolons | Format::Tuples => RecordedFrame::Upright,
    };
    Ok(Recording { name: name.into(), samples, frame, spin_rad_s: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_format_is_told_by_its_content() {
        let lines = |f: &dyn Fn(u32) -> String| (0..8).map(f).collect::<Vec<_>>().join("\n");
        let commas = format!("Timestamp,X,Y,Z\n{}", lines(&|k| format!("12.{k},0.{k},1.5,0.3")));
        let nanoseconds =
            format!("t_ns,x,y,z,sigma_x\n{}", lines(&|k| format!("900{k}00000000,0.{k},1.5,0.3,0.001")));
        let semicolons = lines(&|k| format!("0.{k};0.{k};1.5;0.3"));
        let tuples = lines(&|k| {
            let tick = |id: i64| {
                format!(
                    "(({id}, 1669130908{k}87064832, [0.{k}, 1.5, 0.3], [0.0, 0.0, 0.0]), (5, [0.1], [0.0]))"
                )
            };
            format!("{}\n{}\n{}", tick(-1), tick(i64::from(k) + 70), tick(i64::from(k) + 70))
        });
        for (text, frame) in [
            (commas, RecordedFrame::Table),
            (nanoseconds, RecordedFrame::Table),
            (semicolons, RecordedFrame::Upright),
            (tuples, RecordedFrame::Upright),
        ] {
            let r = parse("flight", &text).expect(&text);
            assert_eq!((r.samples.len(), r.frame), (8, frame));
            for (k, s) in r.samples.iter().enumerate() {
                assert!((s.t_s - 0.1 * k as f64).abs() < 1e-6, "{s:?}");
                assert!((s.position - Vector3::new(0.1 * k as f64, 1.5, 0.3)).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn what_is_no_flight_is_named() {
        let error = parse("notes.txt", "dear diary\n").expect_err("no flight").to_string();
        assert!(error.contains("notes.txt") && error.contains("dear diary"), "{error}");
        let error = parse("a.csv", "t,x,y,z\n0,1,2,3\n0.1,1,2\n").expect_err("a column lacks").to_string();
        assert!(error.contains("a.csv:3"), "{error}");
        let error = parse("a.csv", "t,x,y,z\n0,1,2,3\n").expect_err("one position").to_string();
        assert!(error.contains("at least 5"), "{error}");
    }
}
