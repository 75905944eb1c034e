//! Points in motion from CSV files: a wand's markers, detections of the ball, positions of the ball.

use std::{collections::BTreeMap, error::Error, fs, path::Path};

use nalgebra::{Vector2, Vector3};

/// Pixels of markers at instants, ns: per instant as many as there are markers.
pub type Track = BTreeMap<u64, Vec<Option<Vector2<f64>>>>;

/// Reads a track of one camera: rows `t_ns;u1;v1;u2;v2;…`, semicolons or commas; a negative coordinate means
/// that the marker was not seen. A first row that holds no number is a heading.
pub fn read_track(path: &Path) -> Result<Track, Box<dyn Error>> {
    let text = fs::read_to_string(path).map_err(|e| format!("cannot read {}: {e}", path.display()))?;
    let mut track = Track::new();
    let mut markers: Option<usize> = None;
    for (n, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let failed = |what: String| format!("{}, line {}: {what}", path.display(), n + 1);
        let fields: Vec<&str> = line.split([';', ',']).map(str::trim).collect();
        let Ok(t_ns) = fields[0].parse::<u64>() else {
            if n == 0 {
                continue;
            }
            return Err(failed(format!("{:?} is no instant in ns", fields[0])).into());
        };
        let numbers: Vec<f64> = fields[1..]
            .iter()
            .map(|v| v.parse().map_err(|_| failed(format!("{v:?} is no pixel coordinate"))))
            .collect::<Result<_, _>>()?;
        if numbers.is_empty() || numbers.len() % 2 == 1 {
            return Err(
                failed(format!("{} coordinates; u and v of each marker are needed", numbers.len())).into()
            );
        }
        let count = *markers.get_or_insert(numbers.len() / 2);
        if numbers.len() / 2 != count {
            return Err(failed(format!("{} markers, but {count} before", numbers.len() / 2)).into());
        }
        let points = numbers
            .chunks_exact(2)
            .map(|p| (p[0] >= 0.0 && p[1] >= 0.0).then(|| Vector2::new(p[0], p[1])))
            .collect();
        track.insert(t_ns, points);
    }
    if track.is_empty() { Err(format!("{} holds no rows", path.display()).into()) } else { Ok(track) }
}

/// Reads `netcord process --detections`: of each camera the best ball of each instant.
pub fn read_detections(path: &Path) -> Result<Vec<(String, Track)>, Box<dyn Error>> {
    let mut reader =
        csv::Reader::from_path(path).map_err(|e| format!("cannot read {}: {e}", path.display()))?;
    let header = reader.headers().map_err(|e| format!("{}: {e}", path.display()))?;
    let places = columns(path, header, &["t_ns", "camera", "u", "v", "score"])?;
    let mut cameras: Vec<(String, Track)> = Vec::new();
    let mut best: BTreeMap<(String, u64), f64> = BTreeMap::new();
    for record in reader.records() {
        let record = record.map_err(|e| format!("{}: {e}", path.display()))?;
        let field = |i: usize| record.get(places[i]).unwrap_or_default();
        let line = record.position().map_or(0, csv::Position::line);
        let number = |i: usize| -> Result<f64, String> {
            field(i)
                .parse()
                .map_err(|_| format!("{}, line {line}: {:?} is no number", path.display(), field(i)))
        };
        let t_ns: u64 = field(0)
            .parse()
            .map_err(|_| format!("{}, line {line}: t_ns is no whole number", path.display()))?;
        let (u, v, score) = (number(2)?, number(3)?, number(4)?);
        let camera = field(1).to_owned();
        let known = best.entry((camera.clone(), t_ns)).or_insert(f64::NEG_INFINITY);
        if score > *known {
            *known = score;
            let place = cameras.iter().position(|(n, _)| *n == camera).unwrap_or_else(|| {
                cameras.push((camera, Track::new()));
                cameras.len() - 1
            });
            cameras[place].1.insert(t_ns, vec![Some(Vector2::new(u, v))]);
        }
    }
    if cameras.is_empty() {
        Err(format!("{} holds no detections", path.display()).into())
    } else {
        Ok(cameras)
    }
}

/// Reads `netcord process --positions`: instants, ns, and positions, m.
pub fn read_positions(path: &Path) -> Result<Vec<(u64, Vector3<f64>)>, Box<dyn Error>> {
    let mut reader =
        csv::Reader::from_path(path).map_err(|e| format!("cannot read {}: {e}", path.display()))?;
    let header = reader.headers().map_err(|e| format!("{}: {e}", path.display()))?;
    let places = columns(path, header, &["t_ns", "x", "y", "z"])?;
    let mut positions = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| format!("{}: {e}", path.display()))?;
        let line = record.position().map_or(0, csv::Position::line);
        let number = |i: usize| -> Result<f64, String> {
            let text = record.get(places[i]).unwrap_or_default();
            text.parse().map_err(|_| format!("{}, line {line}: {text:?} is no number", path.display()))
        };
        let t_ns = record.get(places[0]).unwrap_or_default().parse::<u64>();
        let t_ns = t_ns.map_err(|_| format!("{}, line {line}: t_ns is no whole number", path.display()))?;
        positions.push((t_ns, Vector3::new(number(1)?, number(2)?, number(3)?)));
    }
    positions.sort_by_key(|p| p.0);
    Ok(positions)
}

/// Where these columns stand.
fn columns(path: &Path, header: &csv::StringRecord, wanted: &[&str]) -> Result<Vec<usize>, Box<dyn Error>> {
    wanted
        .iter()
        .map(|name| {
            header.iter().position(|h| h.trim() == *name).ok_or_else(|| {
                let found = header.iter().collect::<Vec<_>>().join(",");
                format!("{}: there is no column {name}; the header is {found}", path.display()).into()
            })
        })
        .collect()
}
