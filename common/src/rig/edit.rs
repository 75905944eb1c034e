use std::{
    collections::BTreeMap,
    fs,
    io::Write as _,
    ops::Range,
    path::{Path, PathBuf},
};

use nalgebra::{Matrix3, Vector3};
use toml_edit::{Array, DocumentMut, InlineTable, Item, Table, Value, value};

use super::{ClockDelay, ColourKind, IntrinsicsSigma, LearningNote, LearntColour, Rig, RigError};
use crate::{
    camera::{CameraModel, Distortion},
    geometry::{Camera, Transform, World},
    name::CameraName,
};

/// What calibration notes beside its result.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CalibrationNote {
    /// Day of the calibration, ISO 8601.
    pub date: String,
    /// The board, in words.
    pub board: String,
    /// Frames used.
    pub frames: u64,
    /// Root mean square reprojection error, px.
    pub rms_px: f64,
}

/// A rig file being changed: comments and order are kept, and nothing is written until [`Self::save`].
#[derive(Debug, Clone)]
pub struct RigEdit {
    path: PathBuf,
    document: DocumentMut,
}

impl RigEdit {
    /// Opens a rig file for changing; it need not be complete yet.
    ///
    /// # Errors
    /// [`RigError`] when it cannot be read, is no TOML, or holds under `camera`, `table` or `flight` what is none of a
    /// rig file's tables.
    pub fn open(path: &Path) -> Result<Self, RigError> {
        let text = fs::read_to_string(path).map_err(|cause| RigError::File {
            doing: "read",
            path: path.to_owned(),
            cause,
        })?;
        let wrong = |at: usize, what: &str| RigError::at(path, &text, at, what);
        // Spans are lost when a document is made changeable.
        let parsed =
            toml_edit::Document::parse(&*text).map_err(|e| wrong(start_of(e.span()), e.message().trim()))?;
        let misplaced = |key: &str, fits: fn(&Item) -> bool| {
            let item = parsed.get(key).filter(|item| !fits(item))?;
            Some(start_of(item.span()))
        };
        if let Some(at) = misplaced("camera", Item::is_array_of_tables) {
            return Err(wrong(
                at,
                "cameras must be written as [[camera]] tables, so that results can be added",
            ));
        }
        for key in ["table", "flight"] {
            if let Some(at) = misplaced(key, Item::is_table_like) {
                return Err(wrong(at, &format!("`{key}` must be a table")));
            }
        }
        let document = parsed.into_mut();
        Ok(Self { path: path.to_owned(), document })
    }

    /// Begins a rig file that is not there yet.
    pub fn create(path: &Path, name: &str) -> Self {
        let mut document = DocumentMut::new();
        document["name"] = value(name);
        Self { path: path.to_owned(), document }
    }

    /// The rig's name.
    pub fn name(&self) -> Option<&str> {
        self.document.get("name")?.as_str()
    }

    /// Names of the cameras in the file.
    pub fn camera_names(&self) -> Vec<String> {
        let Some(cameras) = self.document.get("camera").and_then(Item::as_array_of_tables) else {
            return Vec::new();
        };
        cameras.iter().filter_map(|c| c.get("name")?.as_str().map(str::to_owned)).collect()
    }

    /// The intrinsics of the camera called `name`; `None` where the file does not give them whole.
    pub fn intrinsics(&self, name: &str) -> Option<CameraModel> {
        let cameras = self.document.get("camera")?.as_array_of_tables()?;
        let camera = cameras.iter().find(|c| c.get("name").and_then(Item::as_str) == Some(name))?;
        let size = |key: &str| u32::try_from(camera.get(key)?.as_integer()?).ok();
        let table = camera.get("intrinsics")?.as_table_like()?;
        let value = |key: &str| number(table.get(key)?.as_value()?);
        let lens: Vec<f64> = table.get("distortion")?.as_array()?.iter().map_while(number).collect();
        let lens = Distortion::from_array(lens.try_into().ok()?);
        let focal = (value("fx")?, value("fy")?);
        CameraModel::new((size("width")?, size("height")?), focal, (value("cx")?, value("cy")?), lens).ok()
    }

    /// `camera_from_first` of the cameras whose pose the file gives, by name; the first camera's is the identity.
    pub fn poses(&self) -> BTreeMap<String, Transform<Camera, World>> {
        let pose_of = |table: &Table| {
            let pose = table.get("pose")?.as_table_like()?;
            let numbers = |key: &str| -> Option<Vec<f64>> {
                Some(pose.get(key)?.as_array()?.iter().map_while(number).collect())
            };
            let rotation: [f64; 9] = numbers("rotation")?.try_into().ok()?;
            let translation: [f64; 3] = numbers("translation_m")?.try_into().ok()?;
            Transform::from_matrix(&Matrix3::from_row_slice(&rotation), translation.into()).ok()
        };
        let Some(cameras) = self.document.get("camera").and_then(Item::as_array_of_tables) else {
            return BTreeMap::new();
        };
        let found = cameras.iter().enumerate().filter_map(|(i, table)| {
            let name = table.get("name")?.as_str()?.to_owned();
            Some((name, if i == 0 { Transform::identity() } else { pose_of(table)? }))
        });
        found.collect()
    }

    /// Gives each camera that is not calibrated yet a lens of about 53° and the first camera's place: whoever only
    /// takes pictures, for calibrating, needs no better.
    #[must_use]
    pub fn with_nominal_calibration(mut self) -> Self {
        let Ok(names) = self.camera_names().into_iter().map(CameraName::new).collect::<Result<Vec<_>, _>>()
        else {
            return self;
        };
        for (i, name) in names.iter().enumerate() {
            let camera = self.camera(name);
            let size =
                |key: &str| camera.get(key).and_then(Item::as_integer).and_then(|n| u32::try_from(n).ok());
            let (Some(width), Some(height)) = (size("width"), size("height")) else { continue };
            let (without_lens, without_pose) =
                (!camera.contains_key("intrinsics"), i > 0 && !camera.contains_key("pose"));
            let middle = |n: u32| f64::from(n) / 2.0 - 0.5;
            let lens = CameraModel::new(
                (width, height),
                (f64::from(width), f64::from(width)),
                (middle(width), middle(height)),
                Distortion::default(),
            );
            if let (true, Ok(lens)) = (without_lens, lens) {
                self.set_intrinsics(name, &lens, None, None);
            }
            if without_pose {
                self.set_pose(name, &Matrix3::identity(), &Vector3::zeros(), None, None);
            }
        }
        self
    }

    /// The table of the camera called `name`, for keys that have no method here; it is added at the end
    /// where there was none.
    pub fn camera(&mut self, name: &CameraName) -> &mut Table {
        let cameras = self.document["camera"]
            .or_insert(Item::ArrayOfTables(toml_edit::ArrayOfTables::new()))
            .as_array_of_tables_mut()
            .expect("`open` has seen [[camera]] tables, or none");
        let place = cameras.iter().position(|c| c.get("name").and_then(Item::as_str) == Some(name.as_str()));
        let place = place.unwrap_or_else(|| {
            let mut table = Table::new();
            table["name"] = value(name.as_str());
            cameras.push(table);
            cameras.len() - 1
        });
        cameras.get_mut(place).expect("found or just added")
    }

    /// The whole document, for keys that have no method here.
    pub fn document_mut(&mut self) -> &mut DocumentMut {
        &mut self.document
    }

    /// Sets a camera's intrinsics and image size.
    pub fn set_intrinsics(
        &mut self,
        name: &CameraName,
        model: &CameraModel,
        sigma: Option<&IntrinsicsSigma>,
        note: Option<&CalibrationNote>,
    ) {
        let camera = self.camera(name);
        camera["width"] = value(i64::from(model.width));
        camera["height"] = value(i64::from(model.height));
        let mut table = Table::new();
        for (key, number) in [("fx", model.fx), ("fy", model.fy), ("cx", model.cx), ("cy", model.cy)] {
            table[key] = value(number);
        }
        table["distortion"] = numbers(&model.distortion.to_array());
        if let Some(sigma) = sigma {
            table["sigma"] = numbers(sigma);
        }
        if let Some(note) = note {
            table["calibrated"] = note_item(note);
        }
        camera["intrinsics"] = Item::Table(table);
    }

    /// Sets a camera's pose: `camera_from_first`, R and t in metres.
    pub fn set_pose(
        &mut self,
        name: &CameraName,
        rotation: &Matrix3<f64>,
        translation_m: &Vector3<f64>,
        sigma: Option<&[f64; 6]>,
        note: Option<&CalibrationNote>,
    ) {
        let pose = pose_table(rotation, translation_m, sigma, note);
        self.camera(name)["pose"] = Item::Table(pose);
    }

    /// Notes a camera's clock error, or that none is known.
    pub fn set_clock_delay(&mut self, name: &CameraName, delay: Option<&ClockDelay>) {
        let camera = self.camera(name);
        match delay {
            Some(delay) => {
                // To a microsecond: what lies below is noise.
                let ms = |seconds: f64| value((seconds * 1e6).round() / 1e3);
                camera["clock_delay_ms"] = ms(delay.delay_s);
                camera["clock_delay_sigma_ms"] = ms(delay.sigma_s);
            }
            None => {
                camera.remove("clock_delay_ms");
                camera.remove("clock_delay_sigma_ms");
            }
        }
    }

    /// How much later than stamped the frames of the camera called `name` are exposed, s; 0 where the file says
    /// nothing.
    pub fn clock_delay_s(&self, name: &str) -> f64 {
        let cameras = self.document.get("camera").and_then(Item::as_array_of_tables);
        let camera = cameras
            .and_then(|cameras| cameras.iter().find(|c| c.get("name").and_then(Item::as_str) == Some(name)));
        camera.and_then(|c| number(c.get("clock_delay_ms")?.as_value()?)).map_or(0.0, |ms| ms * 1e-3)
    }

    /// Sets the ball's colour as a camera sees it.
    pub fn set_ball(&mut self, name: &CameraName, colour: &LearntColour, note: &LearningNote) {
        let mut table = Table::new();
        table["from"] = value(match colour.kind {
            ColourKind::Mosaic => "mosaic",
            ColourKind::Grey => "grey",
        });
        let mut tests = Array::new();
        for test in colour.tests() {
            let [r, g, b] = test.weights;
            let mut row = Value::Array([r, g, b, test.bound].into_iter().collect::<Array>());
            row.decor_mut().set_prefix("\n    ");
            tests.push_formatted(row);
        }
        tests.set_trailing("\n");
        table["tests"] = Item::Value(Value::Array(tests));
        table["mean"] = numbers(&colour.mean);
        table["covariance"] = numbers(&colour.covariance);
        table["diameter_px"] = numbers(&colour.diameter_px);
        let mut learnt = InlineTable::new();
        learnt.insert("date", note.date.as_str().into());
        for (key, count) in [("frames", note.frames), ("balls", note.balls)] {
            learnt.insert(key, i64::try_from(count).unwrap_or(i64::MAX).into());
        }
        for (key, share) in [("kept", note.kept), ("let_through", note.let_through)] {
            if let Some(share) = share {
                learnt.insert(key, share.into());
            }
        }
        table["learnt"] = Item::Value(Value::InlineTable(learnt));
        self.camera(name)["ball"] = Item::Table(table);
    }

    /// Sets the table's pose: `first_from_table`, R and t in metres.
    pub fn set_table(
        &mut self,
        rotation: &Matrix3<f64>,
        translation_m: &Vector3<f64>,
        sigma: Option<&[f64; 6]>,
        note: Option<&CalibrationNote>,
    ) {
        self.document["table"] = Item::Table(pose_table(rotation, translation_m, sigma, note));
    }

    /// Sets a key of `[flight]`; `remark` stands behind it as a comment, and replaces what stood there.
    pub fn set_flight(&mut self, key: &str, number: f64, remark: &str) {
        let flight = self.document.entry("flight").or_insert(Item::Table(Table::new()));
        let mut number = Value::from(number);
        // A table in one line has no room for comments.
        if !remark.is_empty() && flight.is_table() {
            number.decor_mut().set_suffix(format!(" # {remark}"));
        }
        flight[key] = Item::Value(number);
    }

    /// The file's text as it would be written.
    pub fn text(&self) -> String {
        self.document.to_string()
    }

    /// What the file would mean.
    ///
    /// # Errors
    /// As [`Rig::parse`].
    pub fn resolve(&self) -> Result<Rig, RigError> {
        Rig::parse(&self.text(), &self.path)
    }

    /// Writes into a new file and renames it over the old one, which is kept as `<file>.bak`, or `.bak2` and so on
    /// where there is one already: a reader sees the old or the new, never a part. Returns where the old one is.
    ///
    /// # Errors
    /// [`RigError::File`].
    pub fn save(&self) -> Result<Option<PathBuf>, RigError> {
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |cause| RigError::File { doing: "write", path, cause }
        };
        let with = |suffix: &str| {
            let mut name = self.path.clone().into_os_string();
            name.push(suffix);
            PathBuf::from(name)
        };
        let new = with(".new");
        let mut file = fs::File::create(&new).map_err(failed(&new))?;
        file.write_all(self.text().as_bytes()).and_then(|()| file.sync_all()).map_err(failed(&new))?;
        let mut kept = None;
        if self.path.exists() {
            // The first one is what calibration began with, which no later one may replace.
            let names = std::iter::once(".bak".to_owned()).chain((2_u32..).map(|n| format!(".bak{n}")));
            if let Some(old) = names.map(|name| with(&name)).find(|old| !old.exists()) {
                fs::copy(&self.path, &old).map_err(failed(&old))?;
                kept = Some(old);
            }
        }
        fs::rename(&new, &self.path).map_err(failed(&self.path))?;
        Ok(kept)
    }
}

/// A number, with or without a point.
fn number(item: &Value) -> Option<f64> {
    item.as_float().or_else(|| item.as_integer().map(|i| i as f64))
}

fn numbers(values: &[f64]) -> Item {
    Item::Value(Value::Array(values.iter().copied().collect::<Array>()))
}

fn note_item(note: &CalibrationNote) -> Item {
    let mut table = InlineTable::new();
    table.insert("date", note.date.as_str().into());
    table.insert("board", note.board.as_str().into());
    table.insert("frames", i64::try_from(note.frames).unwrap_or(i64::MAX).into());
    table.insert("rms_px", note.rms_px.into());
    Item::Value(Value::InlineTable(table))
}

fn pose_table(
    rotation: &Matrix3<f64>,
    translation_m: &Vector3<f64>,
    sigma: Option<&[f64; 6]>,
    note: Option<&CalibrationNote>,
) -> Table {
    let mut table = Table::new();
    table["rotation"] = numbers(rotation.transpose().as_slice());
    table["translation_m"] = numbers(translation_m.as_slice());
    if let Some(sigma) = sigma {
        table["sigma"] = numbers(sigma);
    }
    if let Some(note) = note {
        table["calibrated"] = note_item(note);
    }
    table
}

/// Where a span of the file begins. What has none is of the file as a whole, for which its first line stands.
fn start_of(span: Option<Range<usize>>) -> usize {
    span.map_or(0, |span| span.start)
}

#[cfg(test)]
mod tests {
    use super::super::ColourTest;
    use super::*;

    #[test]
    fn results_are_written_beside_comments_and_the_old_file_is_kept() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("rig.toml");
        let before = "name = \"lab\" # our lab\n\n[[camera]]\nname = \"left\"\nwidth = 1\nheight = 1\n\
                      pixel_format = \"BayerRG8\"\nexposure_us = 2000.0\n";
        fs::write(&path, before).expect("written");
        let mut edit = RigEdit::open(&path).expect("TOML");
        assert!(edit.resolve().is_err(), "not calibrated yet");
        let nominal = edit.clone().with_nominal_calibration().resolve().expect("good enough for pictures");
        assert_eq!((nominal.cameras[0].model.width, nominal.cameras[0].model.fx), (1, 1.0));
        let name = CameraName::new("left").expect("valid");
        let lens = Distortion::from_array([-0.1, 0.07, 1e-4, -2e-4, 0.003]);
        let model = CameraModel::new((1920, 1200), (672.25, 673.5), (984.0, 602.125), lens).expect("valid");
        let note =
            CalibrationNote { date: "2026-11-22".into(), board: "9×6".into(), frames: 30, rms_px: 0.12 };
        assert_eq!(edit.intrinsics("left"), None);
        edit.set_intrinsics(&name, &model, Some(&[0.5; 9]), Some(&note));
        assert_eq!(edit.intrinsics("left"), Some(model));
        let turn = nalgebra::Rotation3::new(Vector3::new(2.0, 0.1, -0.3));
        edit.set_table(turn.matrix(), &Vector3::new(0.1, 0.2, 2.0), None, Some(&note));
        edit.set_flight("friction", 0.5, "a first guess");
        edit.set_flight("friction", 0.21, "± 0.01");
        edit.set_flight("drag", 0.44, "");
        assert!(edit.text().contains("friction = 0.21 # ± 0.01\n"), "{}", edit.text());
        let clock = ClockDelay { delay_s: -0.117, sigma_s: 0.0125 };
        edit.set_clock_delay(&name, Some(&clock));
        assert!((edit.clock_delay_s("left") + 0.117).abs() < 1e-9 && edit.clock_delay_s("right") == 0.0);
        let tests = [([1.0, -0.5, 0.25], 3.5), ([0.1, 0.2, 0.7], -20.0)]
            .map(|(weights, bound)| ColourTest { weights, bound });
        let statistics = ([0.1, -0.4, 5.0], [0.04, 0.01, 0.0, 0.05, 0.0, 0.2]);
        let ball = LearntColour::new(ColourKind::Mosaic, &tests, statistics, [12.5, 31.0]);
        let learning =
            LearningNote { date: "2026-11-22".into(), frames: 9, kept: Some(0.97), ..Default::default() };
        edit.set_ball(&name, &ball, &learning);
        edit.save().expect("written");

        let rig = Rig::load(&path).expect("complete now");
        assert_eq!(rig.cameras[0].ball, Some(ball));
        let grey = fs::read_to_string(&path).expect("there").replace("BayerRG8", "Mono8");
        let refused = Rig::parse(&grey, &path).expect_err("learnt from colours").to_string();
        assert!(refused.contains("learnt from colour frames") && refused.contains("Mono8"), "{refused}");
        assert_eq!(rig.cameras[0].model, model);
        let read = rig.cameras[0].clock_delay.expect("noted");
        assert!((read.delay_s + 0.117).abs() < 1e-9 && (read.sigma_s - 0.0125).abs() < 1e-9, "{read:?}");
        let mut without = edit.clone();
        without.set_clock_delay(&name, None);
        assert_eq!(without.resolve().expect("complete").cameras[0].clock_delay, None);
        let mut lonely = without;
        lonely.camera(&name)["clock_delay_sigma_ms"] = value(1.0);
        let said = lonely.resolve().expect_err("a sigma of nothing").to_string();
        assert!(said.contains("clock_delay_ms"), "{said}");
        assert_eq!((rig.flight.friction, rig.flight.drag), (0.21, 0.44));
        assert_eq!(RigEdit::open(&path).expect("TOML").intrinsics("left"), Some(model));
        assert_eq!(edit.intrinsics("right"), None);
        assert_eq!(
            edit.poses().into_iter().collect::<Vec<_>>(),
            [("left".to_owned(), Transform::identity())]
        );
        assert_eq!(rig.cameras[0].intrinsics_sigma, Some([0.5; 9]));
        let read = rig.cameras[0].camera_from_world.rotation.matrix() - turn.matrix();
        assert!(read.amax() < 1e-14);
        let text = fs::read_to_string(&path).expect("there");
        assert!(text.starts_with("name = \"lab\" # our lab"), "{text}");
        let first = folder.path().join("rig.toml.bak");
        assert_eq!(fs::read_to_string(&first).expect("kept"), before);
        assert_eq!(edit.save().expect("written"), Some(folder.path().join("rig.toml.bak2")));
        assert_eq!(fs::read_to_string(first).expect("kept"), before);
    }

    #[test]
    fn a_file_in_which_results_have_no_place_is_refused_with_its_line() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let refused = |text: &str| {
            fs::write(file.path(), text).expect("written");
            RigEdit::open(file.path()).expect_err("refused").to_string()
        };
        let e = refused("name = \"lab\"\ncamera = [{ name = \"left\" }]\n");
        assert!(e.contains(":2:") && e.contains("[[camera]]"), "{e}");
        assert!(refused("flight = 3").contains("`flight` must be a table"));
        assert!(refused("name = ").contains(":1:"));
    }
}
