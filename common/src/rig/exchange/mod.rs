//! Calibrations in the formats of other programs.
//!
//! | format | cameras | poses |
//! | --- | --- | --- |
//! | [`Format::OpenCv`] | one, or a stereo pair `M1 D1 M2 D2 R T` | of the pair |
//! | [`Format::Ros`] | one (`camera_info`) | none |
//! | [`Format::Kalibr`] | a chain `cam0`, `cam1`, … | each from the one before |
//! | [`Format::Parameters`] | `parameters:` of the original rig, by id | from the first camera, Rodrigues vector |
//! | [`Format::Json`] | a list `cameras` | from the table |
//!
//! [`read`] tells the format from the text. All lens models are `k1 k2 p1 p2 k3`; what a format says beyond
//! that is an error, never dropped.

mod error;
mod json;
mod kalibr;
mod opencv;
mod parameters;
mod parts;
mod ros;
mod set;

pub use error::ExchangeError;
pub use set::{CameraSet, ExchangedCamera, ImportDefaults};

use std::{fmt, path::Path, str::FromStr};

use super::Rig;
use crate::name::CameraName;

/// A format of another program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// OpenCV's FileStorage YAML: `camera_matrix: !!opencv-matrix`, …
    OpenCv,
    /// ROS's `camera_info` YAML.
    Ros,
    /// Kalibr's camera chain YAML.
    Kalibr,
    /// The original rig's YAML.
    Parameters,
    /// `{"cameras": [{"name", "width", "height", "K", "D", "R", "t"}]}`.
    Json,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 5] = [Self::OpenCv, Self::Ros, Self::Kalibr, Self::Parameters, Self::Json];

    /// The name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::OpenCv => "opencv",
            Self::Ros => "ros",
            Self::Kalibr => "kalibr",
            Self::Parameters => "parameters",
            Self::Json => "json",
        }
    }

    /// The format of a text by its marks; `None` when it has those of none.
    pub fn of(text: &str) -> Option<Self> {
        let has_key = |key: &str| text.lines().any(|l| l.trim_start().starts_with(key));
        if text.trim_start().starts_with('{') {
            Some(Self::Json)
        } else if text.contains("opencv-matrix") {
            Some(Self::OpenCv)
        } else if has_key("parameters:") {
            Some(Self::Parameters)
        } else if has_key("cam0:") {
            Some(Self::Kalibr)
        } else if has_key("camera_matrix:") {
            Some(Self::Ros)
        } else {
            None
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Format {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|f| f.name() == name).ok_or_else(|| {
            let valid: Vec<_> = Self::ALL.iter().map(|f| f.name()).collect();
            format!("format {name:?} is not known; valid are {}", valid.join(", "))
        })
    }
}

/// Reads the cameras in `text`; `path` is what errors and unnamed cameras are called after. `size` is the
/// image size where the format does not say it (OpenCV's stereo pairs).
///
/// # Errors
/// [`ExchangeError`] names the file, and what in it is wrong.
pub fn read(
    text: &str,
    path: &Path,
    format: Option<Format>,
    size: Option<(u32, u32)>,
) -> Result<CameraSet, ExchangeError> {
    let format = match format.or_else(|| Format::of(text)) {
        Some(format) => format,
        None => return Err(ExchangeError::UnknownFormat { path: path.to_owned() }),
    };
    let stem = parts::name_from(path);
    let cameras = match format {
        Format::OpenCv => opencv::read(text, &stem, size),
        Format::Ros => ros::read(text, &stem),
        Format::Kalibr => kalibr::read(text),
        Format::Parameters => parameters::read(text),
        Format::Json => json::read(text),
    };
    let cameras =
        cameras.map_err(|message| ExchangeError::Content { path: path.to_owned(), format, message })?;
    CameraSet::checked(cameras).map_err(|message| ExchangeError::Content {
        path: path.to_owned(),
        format,
        message,
    })
}

/// The rig's cameras as a text of `format`; `camera` chooses one where the format holds only one.
///
/// # Errors
/// [`ExchangeError::CannotExpress`] when the format cannot hold what the rig says.
pub fn write(rig: &Rig, format: Format, camera: Option<&CameraName>) -> Result<String, ExchangeError> {
    let cannot = |message: String| ExchangeError::CannotExpress { format, message };
    let one = || match camera {
        Some(name) => rig.camera(name).ok_or_else(|| cannot(format!("the rig has no camera {name}"))),
        None if rig.cameras.len() == 1 => Ok(&rig.cameras[0]),
        None => Err(cannot(format!(
            "it holds one camera and the rig has {}; choose one with --camera",
            rig.cameras.len()
        ))),
    };
    match format {
        Format::OpenCv => Ok(opencv::write(one()?)),
        Format::Ros => Ok(ros::write(one()?)),
        Format::Kalibr => kalibr::write(rig).map_err(cannot),
        Format::Parameters => Ok(parameters::write(rig)),
        Format::Json => Ok(json::write(rig)),
    }
}

#[cfg(test)]
mod tests;
