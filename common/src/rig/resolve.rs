use std::{fs, ops::Range, path::Path};

use nalgebra::{Matrix3, Vector3};
use toml::Spanned;

use super::{
    Ball, CameraIndex, ClockDelay, ColourKind, ColourTest, FlightConstants, HittingPlane, LearntColour,
    MAX_COLOUR_TESTS, ProcessSpec, RigCamera, RigError, Wiring,
    file::{CameraTable, FlightTable, LearntTable, PoseTable, ProcessTable, RigFile},
};
use crate::{
    camera::{CameraModel, Distortion},
    geometry::{Camera, ReferenceFrame, Transform, World},
    name::{CameraName, DomainName},
    pixel::PixelFormat,
    wire::{MAX_CAMERAS, WorldFrame},
};

/// A complete and consistent system.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// The rig's name, and the default domain of its processes.
    pub name: DomainName,
    /// Exposures a second.
    pub rate_hz: f64,
    /// Largest difference between the exposures of one trigger, ns.
    pub tolerance_ns: u64,
    /// The ball.
    pub ball: Ball,
    /// What the world frame is: the table's where a table pose is known.
    pub world: WorldFrame,
    /// The cameras, in the file's order.
    pub cameras: Vec<RigCamera>,
    /// Constants of the flight.
    pub flight: FlightConstants,
    /// Where the ball can be hit.
    pub hitting_plane: HittingPlane,
    /// What `netcord up` starts.
    pub processes: Vec<ProcessSpec>,
}

/// Exposures a second where the file does not say.
const DEFAULT_RATE_HZ: f64 = 100.0;

/// The frame of the rig's first camera, in which the poses of cameras stand in the file.
enum First {}
impl ReferenceFrame for First {}

impl Rig {
    /// Reads and checks a rig file.
    ///
    /// # Errors
    /// [`RigError`] names file, line and key.
    pub fn load(path: &Path) -> Result<Self, RigError> {
        let text = fs::read_to_string(path).map_err(|cause| RigError::File {
            doing: "read",
            path: path.to_owned(),
            cause,
        })?;
        Self::parse(&text, path)
    }

    /// Checks the text of a rig file; `path` is what errors call it.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, RigError> {
        let source = Source { text, path };
        let file: RigFile = toml::from_str(text)
            .map_err(|e| source.error(e.span().unwrap_or_default(), e.message().trim()))?;
        source.resolve(&file)
    }

    /// The camera called `name`.
    pub fn camera(&self, name: &CameraName) -> Option<&RigCamera> {
        self.cameras.iter().find(|c| c.name == *name)
    }

    /// Bits of all cameras, as in messages.
    pub fn camera_mask(&self) -> u32 {
        self.cameras.iter().fold(0, |mask, c| mask | c.index.bit())
    }

    /// Time from one trigger to the next, ns.
    pub fn interval_ns(&self) -> u64 {
        interval_ns(self.rate_hz)
    }
}

fn interval_ns(rate_hz: f64) -> u64 {
    (1e9 / rate_hz).round() as u64
}

/// The file being resolved, for errors.
struct Source<'a> {
    text: &'a str,
    path: &'a Path,
}

impl Source<'_> {
    fn error(&self, span: Range<usize>, message: impl Into<String>) -> RigError {
        RigError::at(self.path, self.text, span.start, message)
    }

    fn resolve(&self, file: &RigFile) -> Result<Rig, RigError> {
        let name = DomainName::new(file.name.get_ref())
            .map_err(|e| self.error(file.name.span(), format!("name: {e}")))?;
        let rate_hz =
            self.within("rate_hz", file.rate_hz.as_ref(), 0.1..=10_000.0)?.unwrap_or(DEFAULT_RATE_HZ);
        let half_interval_us = interval_ns(rate_hz) as f64 * 0.5e-3;
        let tolerance_us = self
            .within("tolerance_us", file.tolerance_us.as_ref(), 0.0..=half_interval_us)?
            .unwrap_or(half_interval_us);
        let diameter = self.within("ball.diameter_m", file.ball.diameter_m.as_ref(), 0.005..=0.5)?;
        let table = file.table.as_ref().map(|t| self.pose::<First, World>("table", t)).transpose()?;
        Ok(Rig {
            name,
            rate_hz,
            tolerance_ns: (tolerance_us * 1e3).round() as u64,
            ball: Ball {
                diameter_m: diameter.unwrap_or(Ball::default().diameter_m),
                colour: file.ball.colour,
            },
            world: if table.is_some() { WorldFrame::Table } else { WorldFrame::FirstCamera },
            cameras: self.cameras(&file.camera, table.unwrap_or_else(Transform::identity))?,
            flight: self.flight(&file.flight)?,
            hitting_plane: self
                .within("flight.hitting_plane_y_m", file.flight.hitting_plane_y_m.as_ref(), -10.0..=10.0)?
                .map_or_else(HittingPlane::default, |y_m| HittingPlane { y_m }),
            processes: self.processes(&file.process)?,
        })
    }

    fn within(
        &self,
        key: &str,
        value: Option<&Spanned<f64>>,
        range: std::ops::RangeInclusive<f64>,
    ) -> Result<Option<f64>, RigError> {
        let Some(value) = value else { return Ok(None) };
        if range.contains(value.get_ref()) {
            return Ok(Some(*value.get_ref()));
        }
        let (low, high) = (range.start(), range.end());
        Err(self
            .error(value.span(), format!("{key} is {}; it must be from {low} to {high}", value.get_ref())))
    }

    fn cameras(
        &self,
        tables: &[Spanned<CameraTable>],
        first_from_world: Transform<First, World>,
    ) -> Result<Vec<RigCamera>, RigError> {
        if tables.is_empty() {
            return Err(self.error(0..0, "the rig has no [[camera]]; at least one is needed"));
        }
        let mut cameras: Vec<RigCamera> = Vec::new();
        for (place, table) in tables.iter().enumerate() {
            let index = CameraIndex::new(place).ok_or_else(|| {
                self.error(table.span(), format!("the rig has more than {MAX_CAMERAS} cameras"))
            })?;
            let camera = self.camera(index, table, &first_from_world)?;
            if let Some(other) = cameras.iter().find(|c| c.name == camera.name) {
                return Err(self.error(
                    table.get_ref().name.span(),
                    format!("two cameras are called {:?}; names must differ", other.name.as_str()),
                ));
            }
            if let Some(other) = cameras.iter().find(|c| !c.serial.is_empty() && c.serial == camera.serial) {
                return Err(self.error(
                    table.span(),
                    format!(
                        "cameras {} and {} have the same serial number {:?}",
                        other.name, camera.name, other.serial
                    ),
                ));
            }
            cameras.push(camera);
        }
        Ok(cameras)
    }

    fn camera(
        &self,
        index: CameraIndex,
        spanned: &Spanned<CameraTable>,
        first_from_world: &Transform<First, World>,
    ) -> Result<RigCamera, RigError> {
        let table = spanned.get_ref();
        let name = CameraName::new(table.name.get_ref())
            .map_err(|e| self.error(table.name.span(), format!("camera.name: {e}")))?;
        let missing = |what: &str, cure: &str| {
            self.error(spanned.span(), format!("camera {name} has no [camera.{what}]: {cure}"))
        };
        let intrinsics = table.intrinsics.as_ref().ok_or_else(|| {
            missing("intrinsics", "run `netcord calib mono`, or import them with `netcord rig import`")
        })?;
        let (at, k) = (intrinsics.span(), intrinsics.get_ref());
        let lens = Distortion::from_array(k.distortion);
        let model = CameraModel::new((table.width, table.height), (k.fx, k.fy), (k.cx, k.cy), lens)
            .map_err(|e| self.error(at, format!("camera {name}: {e}")))?;
        let camera_from_first = match &table.pose {
            Some(pose) => self.pose::<Camera, First>(&format!("camera {name}: pose"), pose)?,
            None if index.get() == 0 => Transform::identity(),
            None => {
                return Err(missing(
                    "pose",
                    "run `netcord calib rig`, or import it with `netcord rig import`",
                ));
            }
        };
        let format = |text: &Spanned<String>| {
            text.get_ref()
                .parse::<PixelFormat>()
                .map_err(|e| self.error(text.span(), format!("camera {name}: {e}")))
        };
        let pixel_format = format(&table.pixel_format)?;
        let device_format = table.device_format.as_ref().map(format).transpose()?;
        let given = |key: &str, value: Option<&Spanned<f64>>, range| {
            self.within(&format!("camera {name}: {key}"), value, range)
        };
        let gain_db = given("gain_db", table.gain_db.as_ref(), -100.0..=100.0)?.unwrap_or(0.0);
        let line_delay_us = given("line_delay_us", table.line_delay_us.as_ref(), 0.0..=1e6)?.unwrap_or(0.0);
        let delay_us = given("trigger_delay_us", table.trigger_delay_us.as_ref(), 0.0..=1e6)?.unwrap_or(0.0);
        let delay_ms = given("clock_delay_ms", table.clock_delay_ms.as_ref(), -1e3..=1e3)?;
        let sigma_ms = given("clock_delay_sigma_ms", table.clock_delay_sigma_ms.as_ref(), 0.0..=1e3)?;
        if let (None, Some(sigma)) = (delay_ms, &table.clock_delay_sigma_ms) {
            return Err(self.error(
                sigma.span(),
                format!(
                    "camera {name}: clock_delay_sigma_ms says how sure clock_delay_ms is, which is missing"
                ),
            ));
        }
        let clock_delay = delay_ms
            .map(|delay_ms| ClockDelay { delay_s: delay_ms * 1e-3, sigma_s: sigma_ms.unwrap_or(0.0) * 1e-3 });
        let exposure_us =
            given("exposure_us", Some(&table.exposure_us), 1.0..=1e6)?.expect("a value comes back");
        Ok(RigCamera {
            index,
            serial: table.serial.clone(),
            pixel_format,
            device_format,
            exposure_ns: (exposure_us * 1e3).round() as u64,
            gain_db,
            trigger: table.trigger,
            master: table.master,
            line: table.line.clone(),
            line_delay_ns: (line_delay_us * 1e3).round() as u64,
            wiring: Wiring {
                edge: table.trigger_edge,
                delay_ns: (delay_us * 1e3).round() as u64,
                stamp: table.stamp,
            },
            clock_delay,
            model,
            intrinsics_sigma: k.sigma,
            ball: table.ball.as_ref().map(|ball| self.learnt(&name, pixel_format, ball)).transpose()?,
            camera_from_world: &camera_from_first * first_from_world,
            name,
        })
    }

    /// The colour that a camera was taught; the mosaic must be of the kind that it was learnt from.
    fn learnt(
        &self,
        name: &CameraName,
        pixel_format: PixelFormat,
        spanned: &Spanned<LearntTable>,
    ) -> Result<LearntColour, RigError> {
        let table = spanned.get_ref();
        let wrong = |span, what: String| Err(self.error(span, format!("camera {name}: ball: {what}")));
        let kind = if pixel_format == PixelFormat::Mono8 { ColourKind::Grey } else { ColourKind::Mosaic };
        if table.from != kind {
            return wrong(
                spanned.span(),
                format!(
                    "the colour was learnt from {} frames, but the camera's are {pixel_format}; run `netcord \
                     segment --learn` again, or remove [camera.ball]",
                    if kind == ColourKind::Grey { "colour" } else { "grey" }
                ),
            );
        }
        let tests = table.tests.get_ref();
        if tests.is_empty()
            || tests.len() > MAX_COLOUR_TESTS
            || tests.iter().flatten().any(|x| !x.is_finite())
        {
            return wrong(
                table.tests.span(),
                format!("tests must be 1 to {MAX_COLOUR_TESTS} lists of four numbers: r, g, b, bound"),
            );
        }
        let [a, b, c, d, e, f] = *table.covariance.get_ref();
        let covariance = Matrix3::new(a, b, c, b, d, e, c, e, f);
        if covariance.cholesky().is_none() || table.mean.iter().any(|x| !x.is_finite()) {
            let what =
                "covariance (11, 12, 13, 22, 23, 33) must be positive definite, and mean finite".to_owned();
            return wrong(table.covariance.span(), what);
        }
        let [least, most] = *table.diameter_px.get_ref();
        if !(least > 0.0 && least <= most && most.is_finite()) {
            let what =
                format!("diameter_px is [{least}, {most}]; it must be [smallest, largest], above zero");
            return wrong(table.diameter_px.span(), what);
        }
        let tests = tests
            .iter()
            .map(|[r, g, b, bound]| ColourTest { weights: [*r, *g, *b], bound: *bound })
            .collect::<Vec<_>>();
        Ok(LearntColour::new(kind, &tests, (table.mean, *table.covariance.get_ref()), [least, most]))
    }

    fn pose<To: ReferenceFrame, From: ReferenceFrame>(
        &self,
        what: &str,
        pose: &PoseTable,
    ) -> Result<Transform<To, From>, RigError> {
        let rotation = Matrix3::from_row_slice(pose.rotation.get_ref());
        Transform::from_matrix(&rotation, Vector3::from(pose.translation_m))
            .map_err(|e| self.error(pose.rotation.span(), format!("{what}: {e}")))
    }

    fn flight(&self, table: &FlightTable) -> Result<FlightConstants, RigError> {
        let d = FlightConstants::default();
        let get = |key: &str, value: &Option<Spanned<f64>>, default: f64, range| {
            Ok::<_, RigError>(
                self.within(&format!("flight.{key}"), value.as_ref(), range)?.unwrap_or(default),
            )
        };
        Ok(FlightConstants {
            mass_kg: get("mass_kg", &table.mass_kg, d.mass_kg, 1e-4..=1.0)?,
            gravity_m_s2: get("gravity_m_s2", &table.gravity_m_s2, d.gravity_m_s2, 0.0..=20.0)?,
            drag: get("drag", &table.drag, d.drag, 0.0..=2.0)?,
            drag_induced: get("drag_induced", &table.drag_induced, d.drag_induced, 0.0..=10.0)?,
            magnus: get("magnus", &table.magnus, d.magnus, -1.0..=2.0)?,
            magnus_saturation: get(
                "magnus_saturation",
                &table.magnus_saturation,
                d.magnus_saturation,
                0.0..=20.0,
            )?,
            air_density_kg_m3: get(
                "air_density_kg_m3",
                &table.air_density_kg_m3,
                d.air_density_kg_m3,
                0.0..=2.0,
            )?,
            restitution: get("restitution", &table.restitution, d.restitution, 0.0..=1.0)?,
            restitution_slope_s_m: get(
                "restitution_slope_s_m",
                &table.restitution_slope_s_m,
                d.restitution_slope_s_m,
                0.0..=0.1,
            )?,
            friction: get("friction", &table.friction, d.friction, 0.0..=2.0)?,
        })
    }

    fn processes(&self, tables: &[Spanned<ProcessTable>]) -> Result<Vec<ProcessSpec>, RigError> {
        const COMMANDS: [&str; 7] =
            ["capture", "segment", "triangulate", "predict", "record", "view", "listen"];
        if tables.is_empty() {
            return Ok(ProcessSpec::stages());
        }
        tables
            .iter()
            .map(|spanned| {
                let t = spanned.get_ref();
                if !COMMANDS.contains(&t.command.as_str()) {
                    let valid = COMMANDS.join(", ");
                    let message = format!("process command {:?} is not known; valid are {valid}", t.command);
                    return Err(self.error(spanned.span(), message));
                }
                if t.priority.is_some_and(|p| !(1..=99).contains(&p)) {
                    return Err(self.error(spanned.span(), "process priority must be from 1 to 99"));
                }
                Ok(ProcessSpec {
                    command: t.command.clone(),
                    args: t.args.clone(),
                    affinity: t.affinity.clone(),
                    priority: t.priority,
                    restart: t.restart,
                })
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::{StampMeaning, TriggerEdge};
    use crate::{geometry::Point, rig::BallColour};

    const RIG: &str = r#"
name = "lab"
rate_hz = 200.0

[ball]
colour = "white"

[table] # first_from_table: the camera hangs 2 m above the table's centre and looks straight down
rotation = [1, 0, 0, 0, -1, 0, 0, 0, -1]
translation_m = [0, 0, 2]

[[camera]]
name = "left"
width = 1920
height = 1200
pixel_format = "BayerRG8"
exposure_us = 1000
intrinsics = { fx = 700, fy = 700, cx = 960, cy = 600, distortion = [0, 0, 0, 0, 0] }

[[camera]]
name = "right"
width = 1920
height = 1200
pixel_format = "BayerRG8"
exposure_us = 1000
intrinsics = { fx = 700, fy = 700, cx = 960, cy = 600, distortion = [0, 0, 0, 0, 0] }
pose = { rotation = [1, 0, 0, 0, 1, 0, 0, 0, 1], translation_m = [-1, 0, 0] }
"#;

    fn error_of(text: &str) -> String {
        Rig::parse(text, Path::new("lab.toml")).expect_err("must be refused").to_string()
    }

    #[test]
    fn poses_chain_from_the_table_over_the_first_camera() {
        let rig = Rig::parse(RIG, Path::new("lab.toml")).expect("valid");
        assert_eq!(
            (rig.world, rig.ball.colour, rig.interval_ns()),
            (WorldFrame::Table, BallColour::White, 5_000_000)
        );
        assert_eq!(rig.tolerance_ns, 2_500_000, "half an interval");
        let on_table = Point::<World>::new(0.5, 0.25, 0.0);
        let in_left = &rig.cameras[0].camera_from_world * on_table;
        assert!(in_left.distance(&Point::new(0.5, -0.25, 2.0)) < 1e-12);
        let in_right = &rig.cameras[1].camera_from_world * on_table;
        assert!(in_right.distance(&Point::new(-0.5, -0.25, 2.0)) < 1e-12);
        assert_eq!(rig.processes.len(), 4);
    }

    #[test]
    fn wiring_and_the_devices_name_of_a_mosaic_are_read_and_checked() {
        let usual = Rig::parse(RIG, Path::new("lab.toml")).expect("valid");
        assert_eq!((usual.cameras[0].wiring, usual.cameras[0].device_format), (Wiring::default(), None));
        let keys = "exposure_us = 1000\ntrigger_edge = \"falling\"\ntrigger_delay_us = 12.5\n\
                    stamp = \"exposure-end\"\ndevice_format = \"BayerGB8\"\n";
        let wired = RIG.replacen("exposure_us = 1000\n", keys, 1);
        let camera = Rig::parse(&wired, Path::new("lab.toml")).expect("valid").cameras[0].clone();
        let wiring =
            Wiring { edge: TriggerEdge::Falling, delay_ns: 12_500, stamp: StampMeaning::ExposureEnd };
        assert_eq!((camera.wiring, camera.device_format), (wiring, Some(PixelFormat::BayerGB8)));
        let e = error_of(&wired.replace("\"falling\"", "\"sideways\""));
        assert!(e.contains("sideways") && e.contains("falling"), "{e}");
        let e = error_of(&wired.replace("12.5", "-1"));
        assert!(e.contains("trigger_delay_us is -1"), "{e}");
        let e = error_of(&wired.replace("BayerGB8", "BayerGB12p"));
        assert!(e.contains("BayerGB12p") && e.contains("BayerGB8"), "{e}");
    }

    #[test]
    fn each_mistake_is_named_with_its_line_and_the_cure() {
        let unknown = RIG.replace("rate_hz", "rate");
        let e = error_of(&unknown);
        assert!(e.starts_with("lab.toml:3:") && e.contains("`rate`") && e.contains("`rate_hz`"), "{e}");

        let e = error_of(&RIG.replace("\"right\"", "\"left\""));
        assert!(e.starts_with("lab.toml:21:") && e.contains("two cameras are called \"left\""), "{e}");

        let e = error_of(&RIG.replacen("intrinsics", "#intrinsics", 1));
        assert!(
            e.contains("camera left has no [camera.intrinsics]") && e.contains("netcord calib mono"),
            "{e}"
        );

        let e = error_of(&RIG.replace("pose =", "#pose ="));
        assert!(e.contains("camera right has no [camera.pose]"), "{e}");

        let e = error_of(&RIG.replace("[1, 0, 0, 0, 1, 0, 0, 0, 1]", "[1, 0, 0, 0, 1, 0, 0, 0.1, 1]"));
        assert!(e.starts_with("lab.toml:27:") && e.contains("no rotation"), "{e}");

        let e = error_of(&RIG.replacen("BayerRG8", "RGB8", 1));
        assert!(e.starts_with("lab.toml:16:") && e.contains("RGB8") && e.contains("BayerGB8"), "{e}");

        let e = error_of(&RIG.replacen("exposure_us = 1000", "exposure_us = 0", 1));
        assert!(e.contains("exposure_us is 0"), "{e}");

        for (key, value) in [("gain_db", "nan"), ("line_delay_us", "-3")] {
            let with = format!("exposure_us = 1000\n{key} = {value}");
            let e = error_of(&RIG.replacen("exposure_us = 1000", &with, 1));
            assert!(e.to_lowercase().contains(&format!("camera left: {key} is {value}")), "{e}");
        }
        let e = error_of(&RIG.replace("[ball]", "[flight]\nhitting_plane_y_m = inf\n\n[ball]"));
        assert!(e.contains("hitting_plane_y_m is inf"), "{e}");

        let e = error_of(&RIG.replacen("fx = 700", "fx = -700", 1));
        assert!(e.contains("camera left: fx is -700"), "{e}");

        assert!(error_of("name = \"x\"").contains("no [[camera]]"));
        let e = error_of(&format!("{RIG}\n[[process]]\ncommand = \"sgment\""));
        assert!(e.contains("sgment") && e.contains("segment"), "{e}");
    }

    #[test]
    fn the_example_rigs_are_valid_and_look_at_the_table() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("rigs");
        for (file, cameras) in [("example-2cam", 2), ("example-4cam", 4), ("example-8cam", 8)] {
            let rig = Rig::load(&folder.join(format!("{file}.toml"))).expect("valid");
            assert_eq!((rig.name.as_str(), rig.cameras.len()), (file, cameras));
            assert_eq!(rig.world, WorldFrame::Table);
            for camera in &rig.cameras {
                for end_y in [-1.37, 0.0, 1.37] {
                    let in_camera = &camera.camera_from_world * Point::new(0.0, end_y, 0.2);
                    let pixel = camera.model.project(&in_camera).expect("in front");
                    assert!(
                        camera.model.contains(&pixel),
                        "{file}: {} does not see y = {end_y}",
                        camera.name
                    );
                }
            }
        }
    }
}
