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
    by_frame: BTreeMap<(usize, usize), Vec<Written>>,
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
            None => Self::truth(frames, rig),
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

    /// The marks of a frame.
    pub(super) fn of(&self, camera: usize, place: usize, frame: &Frame) -> Result<Vec<Mark>, String> {
        let (width, height) = (frame.size.0 as f64, frame.size.1 as f64);
        let mark = |written: &Written| match *written {
            Written::Pixels(mark) => Ok(mark),
            Written::Yolo([x, y, w, h]) => {
                if [x, y, w, h].iter().any(|share| !(0.0..=1.0).contains(share)) {
                    return Err(format!(
                        "{}: the label {x} {y} {w} {h} is not of shares of the image, 0 to 1",
                        frame.name
                    ));
                }
                // Pixel (0, 0) is the centre of the first; YOLO counts from its corner.
                let edge =
                    |sign: f64| [(x + sign * 0.5 * w) * width - 0.5, (y + sign * 0.5 * h) * height - 0.5];
                Ok(Mark::Box { low: edge(-1.0), high: edge(1.0) })
            }
        };
        self.by_frame.get(&(camera, place)).into_iter().flatten().map(mark).collect()
    }

    fn file(path: &Path, frames: &Frames) -> Result<Self, Box<dyn Error>> {
        let text =
            fs::read_to_string(path).map_err(|e| format!("cannot read the marks {}: {e}", path.display()))?;
        let is_json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
        let wrong = |e: &dyn std::fmt::Display| format!("{}: {e}", path.display());
        let rows: Vec<Row> = if is_json {
            serde_json::from_str(&text).map_err(|e| wrong(&e))?
        } else {
            let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
            reader.deserialize().collect::<Result<_, _>>().map_err(|e| wrong(&e))?
        };
        let mut marks = Self::default();
        for (n, row) in rows.iter().enumerate() {
            let add = row.place(frames).and_then(|place| Ok((place, row.mark()?)));
            let (place, mark) = add.map_err(|e| format!("{}: mark {}: {e}", path.display(), n + 1))?;
            marks.by_frame.entry(place).or_default().extend(mark.map(Written::Pixels));
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
                    let numbers =
                        line.split_whitespace().map(str::parse::<f64>).collect::<Result<Vec<_>, _>>();
                    match numbers.as_deref() {
                        Ok([_, x, y, w, h]) => list.push(Written::Yolo([*x, *y, *w, *h])),
                        _ => {
                            return Err(format!(
                                "{}:{}: {line:?} is no YOLO label; it must be `class x y width height`",
                                path.display(),
                                n + 1
                            )
                            .into());
                        }
                    }
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
                marks.by_frame.entry((camera, place)).or_default().push(Written::Pixels(mark));
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
        let blur = [self.blur_u, self.blur_v].map(|b| b.unwrap_or(0.0));
        match (self.u, self.v, self.diameter, self.x0, self.y0, self.x1, self.y1) {
            (Some(u), Some(v), Some(diameter), None, None, None, None) => {
                Ok(Some(Mark::Outline { centre: [u, v], diameter, path: blur }))
            }
            (None, None, None, Some(x0), Some(y0), Some(x1), Some(y1)) => {
                Ok(Some(Mark::Box { low: [x0, y0], high: [x1, y1] }))
            }
            (None, None, None, None, None, None, None) => Ok(None),
            _ => {
                Err("it must have u, v and diameter, or x0, y0, x1 and y1, or none of them (no ball)"
                    .to_owned())
            }
        }
    }
}

/// Where a picture's labels may be.
fn label_of(picture: &Path, folder: Option<&Path>) -> Vec<PathBuf> {
    let name = picture.with_extension("txt");
    let name = Path::new(name.file_name().unwrap_or_default());
    match (folder, picture.parent()) {
        (Some(folder), _) => vec![folder.join(name)],
        (None, Some(here)) => {
            let beside =
                here.parent().map_or_else(|| Path::new("..").join("labels"), |above| above.join("labels"));
            vec![here.join(name), beside.join(name)]
        }
        (None, None) => Vec::new(),
    }
}
