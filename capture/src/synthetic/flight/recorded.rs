use std::{
    fs,
    path::{Path, PathBuf},
};

use nalgebra::Vector3;
use thiserror::Error;

use super::{BallState, BallTrack, TrackPoint};

/// Flights read from CSV files `t,x,y,z` (s and m, table frame), one after the other with a pause
/// between, over and over.
#[derive(Debug, Clone)]
pub struct RecordedFlights {
    flights: Vec<Vec<Sample>>,
    /// Start of each flight in one round, s.
    starts: Vec<f64>,
    round_s: f64,
}

#[derive(Debug, Clone, Copy)]
struct Sample {
    t_s: f64,
    position: Vector3<f64>,
    velocity: Vector3<f64>,
}

/// A file of flights that cannot be used.
#[derive(Debug, Error)]
pub enum RecordedFlightsError {
    /// It cannot be read.
    #[error("the flights {path} cannot be read: {cause}")]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// A line is not `t,x,y,z`.
    #[error("{path}:{line}: {found:?} is not a flight's `t,x,y,z` in seconds and metres, with t growing")]
    Line {
        /// The file.
        path: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// What stands there.
        found: String,
    },
    /// No flight at all.
    #[error("{path} holds no flight of at least {MIN_SAMPLES} positions `t,x,y,z`")]
    Empty {
        /// The file or folder.
        path: PathBuf,
    },
}

/// Time without a ball between two flights, s.
const PAUSE_S: f64 = 0.5;

/// A longer step of time inside a file separates two flights, s.
const GAP_S: f64 = 0.1;

/// Shorter flights are left out.
const MIN_SAMPLES: usize = 4;

impl RecordedFlights {
    /// Reads a CSV file, or all `*.csv` of a folder in order of their names. A first line that is no
    /// numbers is taken for the header.
    ///
    /// # Errors
    /// [`RecordedFlightsError`] names the file and line.
    pub fn read(path: &Path) -> Result<Self, RecordedFlightsError> {
        let failed = |cause| RecordedFlightsError::Read { path: path.to_owned(), cause };
        let mut files = Vec::new();
        if path.is_dir() {
            for entry in fs::read_dir(path).map_err(failed)? {
                files.push(entry.map_err(failed)?.path());
            }
            files.retain(|f| f.extension().is_some_and(|e| e == "csv"));
            files.sort();
        } else {
            files.push(path.to_owned());
        }
        let mut flights = Vec::new();
        for file in &files {
            let text = fs::read_to_string(file)
                .map_err(|cause| RecordedFlightsError::Read { path: file.clone(), cause })?;
            flights.extend(parse(&text, file)?);
        }
        if flights.is_empty() {
            return Err(RecordedFlightsError::Empty { path: path.to_owned() });
        }
        Ok(Self::new(flights))
    }

    fn new(flights: Vec<Vec<Sample>>) -> Self {
        let mut round_s = PAUSE_S;
        let mut starts = Vec::new();
        for flight in &flights {
            starts.push(round_s);
            round_s += flight[flight.len() - 1].t_s + PAUSE_S;
        }
        Self { flights, starts, round_s }
    }

    /// Number of flights.
    pub fn len(&self) -> usize {
        self.flights.len()
    }

    /// Whether there is none; never for flights that were read.
    pub fn is_empty(&self) -> bool {
        self.flights.is_empty()
    }
}

fn parse(text: &str, path: &Path) -> Result<Vec<Vec<Sample>>, RecordedFlightsError> {
    let mut flights: Vec<Vec<Sample>> = vec![Vec::new()];
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        let numbers: Vec<f64> = line.split([',', ';']).filter_map(|f| f.trim().parse().ok()).collect();
        let wrong =
            || RecordedFlightsError::Line { path: path.to_owned(), line: index + 1, found: line.into() };
        if line.is_empty() || (index == 0 && numbers.is_empty()) {
            continue;
        }
        let &[t_s, x, y, z] = numbers.as_slice() else { return Err(wrong()) };
        if !numbers.iter().all(|n| n.is_finite()) {
            return Err(wrong());
        }
        let current = flights.last_mut().expect("never empty");
        let step = current.last().map(|last| t_s - last.t_s);
        if step.is_some_and(|step| step <= 0.0) {
            return Err(wrong());
        }
        let sample = Sample { t_s, position: Vector3::new(x, y, z), velocity: Vector3::zeros() };
        if step.is_some_and(|step| step > GAP_S) { flights.push(vec![sample]) } else { current.push(sample) }
    }
    flights.retain(|f| f.len() >= MIN_SAMPLES);
    for flight in &mut flights {
        let start = flight[0].t_s;
        flight.iter_mut().for_each(|s| s.t_s -= start);
        set_velocities(flight);
    }
    Ok(flights)
}

/// Each velocity is the slope of the parabola through three neighbours; one-sided at the ends and where
/// the vertical velocity turns upwards, so that a bounce stays sharp.
fn set_velocities(flight: &mut [Sample]) {
    let slope = |a: &Sample, b: &Sample| (b.position - a.position) / (b.t_s - a.t_s);
    for i in 0..flight.len() {
        let before = i.checked_sub(1).map(|j| slope(&flight[j], &flight[i]));
        let after = flight.get(i + 1).map(|next| slope(&flight[i], next));
        flight[i].velocity = match (before, after) {
            (Some(b), Some(a)) => {
                let (hb, ha) = (flight[i].t_s - flight[i - 1].t_s, flight[i + 1].t_s - flight[i].t_s);
                (b * ha + a * hb) / (ha + hb)
            }
            (b, a) => b.or(a).unwrap_or_default(),
        };
    }
}

impl BallTrack for RecordedFlights {
    fn at(&mut self, t_s: f64) -> Option<TrackPoint> {
        if t_s < 0.0 {
            return None;
        }
        let round = (t_s / self.round_s).floor();
        let in_round = t_s - round * self.round_s;
        let flight = self.starts.partition_point(|start| *start <= in_round).checked_sub(1)?;
        let samples = &self.flights[flight];
        let t = in_round - self.starts[flight];
        let after = samples.partition_point(|s| s.t_s <= t);
        let (a, b) = (samples.get(after.checked_sub(1)?)?, samples.get(after)?);
        let h = b.t_s - a.t_s;
        let s = (t - a.t_s) / h;
        let (s2, s3) = (s * s, s * s * s);
        let position = a.position * (2.0 * s3 - 3.0 * s2 + 1.0)
            + a.velocity * (h * (s3 - 2.0 * s2 + s))
            + b.position * (3.0 * s2 - 2.0 * s3)
            + b.velocity * (h * (s3 - s2));
        let velocity = (b.position - a.position) * (6.0 * (s - s2) / h)
            + a.velocity * (3.0 * s2 - 4.0 * s + 1.0)
            + b.velocity * (3.0 * s2 - 2.0 * s);
        let flight_id = round as u64 * self.flights.len() as u64 + flight as u64 + 1;
        Some(TrackPoint { state: BallState { position, velocity, spin: Vector3::zeros() }, flight_id })
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;

    use super::*;

    fn parabola(t: f64) -> Vector3<f64> {
        Vector3::new(0.1 + 0.5 * t, -1.2 + 6.0 * t, 0.3 + 2.0 * t - 4.905 * t * t)
    }

    #[test]
    fn a_flight_is_met_between_its_samples_and_flights_follow_each_other() {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, start) in [("a.csv", 12.5), ("b.csv", 0.0)] {
            let mut text = String::from("Timestamp,X,Y,Z\n");
            for i in 0..90 {
                let t = f64::from(i) / 180.0;
                let p = parabola(t);
                writeln!(text, "{},{},{},{}", start + t, p.x, p.y, p.z).expect("into a string");
            }
            fs::write(folder.path().join(name), text).expect("written");
        }
        let mut flights = RecordedFlights::read(folder.path()).expect("valid");
        assert_eq!(flights.len(), 2);
        assert_eq!(flights.at(0.2), None, "before the first");
        let point = flights.at(PAUSE_S + 0.2013).expect("in the first");
        assert_eq!(point.flight_id, 1);
        assert!((point.state.position - parabola(0.2013)).norm() < 1e-6, "{point:?}");
        assert!((point.state.velocity.z - (2.0 - 9.81 * 0.2013)).abs() < 1e-3);
        let second = flights.at(2.0 * PAUSE_S + 89.0 / 180.0 + 0.1).expect("in the second");
        assert_eq!(second.flight_id, 2);
        let again = flights.at(flights.round_s + PAUSE_S + 0.1).expect("in the second round");
        assert_eq!(again.flight_id, 3);
    }

    #[test]
    fn a_bad_line_is_named() {
        let file = Path::new("x.csv");
        let error = parse("t,x,y,z\n0,0,0,0\n0.1,a,0,0\n", file).expect_err("no number");
        assert!(error.to_string().starts_with("x.csv:3:"), "{error}");
        let error = parse("0,0,0,0\n0,1,1,1\n", file).expect_err("time stands still");
        assert!(error.to_string().starts_with("x.csv:2:"), "{error}");
    }

    #[test]
    fn real_flights_are_read() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/flights/tt3d");
        if !folder.is_dir() {
            eprintln!("SKIPPED: {} is absent", folder.display());
            return;
        }
        let flights = RecordedFlights::read(&folder).expect("readable");
        assert!(flights.len() >= 95, "{}", flights.len());
    }
}
