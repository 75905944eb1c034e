use std::{
    collections::BTreeMap,
    error::Error,
    fs,
    path::{Path, PathBuf},
};

use netcord_common::{geometry::Point, rig::Rig};
use netcord_detect::segment::learn::Mark;
use serde::Deserialize;

use super::frames::{Frame, Frames};

/// Marks by camera and place of the frame; a frame with an empty list shows no ball.
#[derive(Debug, Default)]
pub(super) struct Marks {
    by_frame: BTreeMap<(usize, usize), Vec<Noted>>,
}

/// A mark, and for messages where it stands: file and line, or what it was made from.
#[derive(Debug)]
struct Noted {
    mark: Written,
    origin: String,
}

/// A mark as it is written.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Written {
    Pixels(Mark),
    /// Centre and size as shares of the image, 0–1, from its corner.
    Yolo([f64; 4]),
}

/// A row of a CSV file, or an object of a JSON file.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    camera: Option<String>,
    image: Option<String>,
    frame: Option<usize>,
    t_ns: Option<u64>,
    u: Option<f64>,
    v: Option<f64>,
    diameter: Option<f64>,
    blur_u: Option<f64>,
    blur_v: Option<f64>,
    x0: Option<f64>,
    y0: Option<f64>,
    x1: Option<f64>,
    y1: Option<f64>,
}

/// Share of the ball that must be seen for its truth to be a mark, 0–1.
const WELL_SEEN: f64 = 0.98;

impl Marks {
    /// From a file or folder, or from what lies beside the frames.
    pub(super) fn gather(from: Option<&Path>, frames: &Frames, rig: &Rig) -> Result<Self, Box<dyn Error>> {
        let marks = match from {
            Some(folder) if folder.is_dir() => Self::yolo(frames, Some(folder))?,
            Some(file) => Self::file(file, frames)?,
            None if frames.picture(0, 0).is_some() => Self::yolo(frames, None)?,
            // By the calibration with which it was filmed: the rig file may be of another day, or only begun.
            None => {
                let own = frames.own_rig().map(|own| Rig { ball: rig.ball, ..own });
                Self::truth(frames, own.as_ref().unwrap_or(rig))
            }
        };
        if marks.by_frame.values().all(Vec::is_empty) {
            return Err(match from {
                Some(path) => format!("{} marks no ball in these frames", path.display()),
                None => "no ball is marked: there are no YOLO labels beside the pictures (the same names, ending in \
                         .txt, in the same folder or in ../labels), and no /truth/ball in a recording; give --marks"
                    .to_owned(),
            }
            .into());
        }
        Ok(marks)
    }

    /// Camera and place of the frames to learn from: at most `most` of each camera, spread over all.
    pub(super) fn frames(&self, most: usize) -> Vec<(usize, usize)> {
        let mut by_camera: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (camera, place) in self.by_frame.keys() {
            by_camera.entry(*camera).or_default().push(*place);
        }
        let spread = |(camera, places): (usize, Vec<usize>)| {
            let count = places.len().min(most);
            (0..count).map(move |i| (camera, places[i * places.len() / count])).collect::<Vec<_>>()
        };
        by_camera.into_iter().flat_map(spread).collect()
    }

    /// The marks of a frame; the error of one that cannot be a ball's names where it stands.
    pub(super) fn of(&self, camera: usize, place: usize, frame: &Frame) -> Result<Vec<Mark>, String> {
        let (width, height) = (frame.size.0 as f64, frame.size.1 as f64);
        let mark = |noted: &Noted| {
            let mark = match noted.mark {
                Written::Pixels(mark) => mark,
                Written::Yolo([x, y, w, h]) => {
                    // Pixel (0, 0) is the centre of the first; YOLO counts from its corner.
                    let edge =
                        |sign: f64| [(x + sign * 0.5 * w) * width - 0.5, (y + sign * 0.5 * h) * height - 0.5];
                    Mark::Box { low: edge(-1.0), high: edge(1.0) }
                }
            };
            mark.check(frame.size).map_err(|e| format!("{}: {e}", noted.origin))?;
            Ok(mark)
        };
        self.by_frame.get(&(camera, place)).into_iter().flatten().map(mark).collect()
    }

    fn file(path: &Path, frames: &Frames) -> Result<Self, Box<dyn Error>> {
        let text =
            fs::read_to_string(path).map_err(|e| format!("cannot read the marks {}: {e}", path.display()))?;
        let is_json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
        let rows = if is_json { json_rows(path, &text) } else { csv_rows(path, &text) }?;
        let mut marks = Self::default();
        for (origin, row) in rows {
            let add = row.place(frames).and_then(|place| Ok((place, row.mark()?)));
            let (place, mark) = add.map_err(|e| format!("{origin}: {e}"))?;
            let noted = mark.map(|mark| Noted { mark: Written::Pixels(mark), origin });
            marks.by_frame.entry(place).or_default().extend(noted);
        }
        Ok(marks)
    }

    fn yolo(frames: &Frames, folder: Option<&Path>) -> Result<Self, Box<dyn Error>> {
        let mut marks = Self::default();
        for camera in 0..frames.cameras() {
            for place in 0..frames.count(camera) {
                let picture = frames.picture(camera, place).ok_or(
                    "YOLO labels are named after pictures; a recording has none: give a CSV or JSON file",
                )?;
                let Some(path) = label_of(picture, folder).into_iter().find(|path| path.is_file()) else {
                    continue;
                };
                let text = fs::read_to_string(&path)
                    .map_err(|e| format!("cannot read the labels {}: {e}", path.display()))?;
                let list = marks.by_frame.entry((camera, place)).or_default();
                for (n, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
                    let origin = format!("{}:{}", path.display(), n + 1);
                    let shares = yolo_shares(line).ok_or_else(|| {
                        format!(
                            "{origin}: {line:?} is no YOLO label; it must be `class x y width height`, the centre and \
                             the size as shares of the image, 0 to 1"
                        )
                    })?;
                    list.push(Noted { mark: Written::Yolo(shares), origin });
                }
            }
        }
        Ok(marks)
    }

    /// From `/truth/ball`: centre, diameter and blur, by the rig's cameras.
    fn truth(frames: &Frames, rig: &Rig) -> Self {
        let by_stamp = frames.truth().iter().map(|truth| (truth.t_ns, truth)).collect::<BTreeMap<_, _>>();
        let mut marks = Self::default();
        for camera in 0..frames.cameras() {
            // `Frames::check_against` has refused frames of other cameras.
            let Some(known) = rig.camera(frames.camera(camera)) else { continue };
            for place in 0..frames.count(camera) {
                let Some(truth) = frames.stamp_ns(camera, place).and_then(|t| by_stamp.get(&t)) else {
                    continue;
                };
                let index = known.index.get();
                let seen = truth.on_bus(0, rig).cameras[index];
                if !truth.present || seen.visible < WELL_SEEN {
                    continue;
                }
                let image = |t: f64| {
                    let [x, y, z] = [0, 1, 2].map(|i| truth.position_m[i] + t * truth.velocity_m_s[i]);
                    let in_camera = &known.camera_from_world * Point::new(x, y, z);
                    Some((known.model.project(&in_camera)?, in_camera.coords.norm()))
                };
                let half = 0.5 * frames.exposure_s(camera, place).unwrap_or(known.exposure_ns as f64 * 1e-9);
                let (Some((_, range)), Some((ahead, _)), Some((behind, _))) =
                    (image(0.0), image(half), image(-half))
                else {
                    continue;
                };
                let diameter = rig.ball.diameter_m * known.model.fx / range;
                let path = [ahead.x - behind.x, ahead.y - behind.y];
                let mark = Mark::Outline { centre: [seen.u_px, seen.v_px], diameter, path };
                let origin = format!("/truth/ball at {} ns, seen by camera {}", truth.t_ns, known.name);
                let noted = Noted { mark: Written::Pixels(mark), origin };
                marks.by_frame.entry((camera, place)).or_default().push(noted);
            }
        }
        marks
    }
}

impl Row {
    /// The camera and the place of the frame.
    fn place(&self, frames: &Frames) -> Result<(usize, usize), String> {
        let names =
            || (0..frames.cameras()).map(|c| frames.camera(c).as_str()).collect::<Vec<_>>().join(", ");
        let camera = match &self.camera {
            Some(name) => {
                (0..frames.cameras()).find(|camera| frames.camera(*camera).as_str() == name).ok_or_else(
                    || format!("there are no frames of a camera {name:?}; there are those of: {}", names()),
                )?
            }
            None if frames.cameras() == 1 => 0,
            None => return Err(format!("it names no camera, and there are several: {}", names())),
        };
        let count = frames.count(camera);
        let place = match (&self.image, self.frame, self.t_ns) {
            (Some(image), None, None) => (0..count)
                .find(|place| {
                    let picture = frames.picture(camera, *place);
                    picture.is_some_and(|p| {
                        [p.file_name(), p.file_stem()].into_iter().flatten().any(|n| n == &**image)
                    })
                })
                .ok_or_else(|| {
                    format!("there is no picture {image:?} of camera {}", frames.camera(camera))
                })?,
            (None, Some(frame), None) if frame < count => frame,
            (None, Some(frame), None) => {
                return Err(format!(
                    "there is no frame {frame}; camera {} has {count}, from 0",
                    frames.camera(camera)
                ));
            }
            (None, None, Some(t_ns)) => {
                (0..count).find(|place| frames.stamp_ns(camera, *place) == Some(t_ns)).ok_or_else(|| {
                    format!("camera {} has no frame of the stamp {t_ns}", frames.camera(camera))
                })?
            }
            _ => return Err("it must name its frame by one of image, frame and t_ns".to_owned()),
        };
        Ok((camera, place))
    }

    /// The mark; none where the row says that the frame shows no ball.
    fn mark(&self) -> Result<Option<Mark>, String> {
        let outline = [self.u, self.v, self.diameter];
        let blur = [self.blur_u, self.blur_v];
        let corners = [self.x0, self.y0, self.x1, self.y1];
        match (outline, blur, corners) {
            ([Some(u), Some(v), Some(diameter)], [None, None], [None, None, None, None]) => {
                Ok(Some(Mark::Outline { centre: [u, v], diameter, path: [0.0; 2] }))
            }
            ([Some(u), Some(v), Some(diameter)], [Some(along_u), Some(along_v)], [None, None, None, None]) => {
                Ok(Some(Mark::Outline { centre: [u, v], diameter, path: [along_u, along_v] }))
            }
            ([None, None, None], [None, None], [Some(x0), Some(y0), Some(x1), Some(y1)]) => {
                Ok(Some(Mark::Box { low: [x0, y0], high: [x1, y1] }))
            }
            ([None, None, None], [None, None], [None, None, None, None]) => Ok(None),
            _ => Err("it must have u, v and diameter (and both of blur_u and blur_v, or neither), or x0, y0, x1 and \
                      y1, or none of them (no ball)"
                .to_owned()),
        }
    }
}

/// The rows of a CSV file, each with its file and line.
fn csv_rows(path: &Path, text: &str) -> Result<Vec<(String, Row)>, String> {
    let wrong = |e: csv::Error| match e.position() {
        Some(at) => format!("{}:{}: {}", path.display(), at.line(), reason(&e)),
        None => format!("{}: {e}", path.display()),
    };
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let names = reader.headers().map_err(wrong)?.clone();
    let records = reader.records();
    records
        .map(|record| {
            let record = record.map_err(wrong)?;
            // The reader gives every record its place.
            let line = record.position().map_or(0, csv::Position::line);
            let row = record.deserialize(Some(&names)).map_err(wrong)?;
            Ok((format!("{}:{line}", path.display()), row))
        })
        .collect()
}

/// What is wrong, without the place that csv puts before it.
fn reason(e: &csv::Error) -> String {
    match e.kind() {
        csv::ErrorKind::Deserialize { err, .. } => match err.field() {
            Some(field) => format!("column {}: {}", field + 1, err.kind()),
            None => err.kind().to_string(),
        },
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("it has {len} columns, the first line {expected_len}")
        }
        _ => e.to_string(),
    }
}

/// The objects of a JSON file, each with the file and its number; an error of syntax has its line.
fn json_rows(path: &Path, text: &str) -> Result<Vec<(String, Row)>, String> {
    let rows: Vec<Row> = serde_json::from_str(text)
        .map_err(|e| format!("{}:{}: {e}; it must be a list of marks", path.display(), e.line()))?;
    let origin = |n: usize| format!("{}: mark {} of the list", path.display(), n + 1);
    Ok(rows.into_iter().enumerate().map(|(n, row)| (origin(n), row)).collect())
}

/// Centre and size in a line of YOLO labels.
fn yolo_shares(line: &str) -> Option<[f64; 4]> {
    let numbers = line.split_whitespace().map(str::parse::<f64>).collect::<Result<Vec<_>, _>>().ok()?;
    let [_class, shares @ ..] = <[f64; 5]>::try_from(numbers).ok()?;
    shares.iter().all(|share| (0.0..=1.0).contains(share)).then_some(shares)
}

/// Where a picture's labels may be.
fn label_of(picture: &Path, folder: Option<&Path>) -> Vec<PathBuf> {
    let beside = picture.with_extension("txt");
    // Pictures come from a folder's listing: they have a name, and a folder.
    let (Some(name), Some(here)) = (beside.file_name(), beside.parent()) else { return Vec::new() };
    match folder {
        Some(folder) => vec![folder.join(name)],
        None => {
            let labels = here.parent().unwrap_or(Path::new("..")).join("labels").join(name);
            vec![beside, labels]
        }
    }
}
