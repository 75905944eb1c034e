//! The `[[camera]]` tables.

use nalgebra::Matrix3;
use toml::Spanned;

use super::{First, Source};
use crate::{
    camera::{CameraModel, Distortion},
    geometry::{Camera, Transform, World},
    name::CameraName,
    pixel::PixelFormat,
    rig::{
        CameraIndex, ClockDelay, ColourKind, ColourTest, LearntColour, MAX_COLOUR_TESTS, RigCamera, RigError,
        Wiring,
        file::{CameraTable, LearntTable},
    },
    wire::MAX_CAMERAS,
};

impl Source<'_> {
    pub(super) fn cameras(
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
}
