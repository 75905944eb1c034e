use std::{
    error::Error,
    path::{Path, PathBuf},
    sync::Arc,
};

use netcord_capture::recording::{Footage, FrameReader, RecordedTruth};
use netcord_common::{
    CameraName, PixelFormat,
    picture::{Channels, Picture},
    rig::{Rig, RigEdit},
};
use toml_edit::value;

use crate::commands::import::{mosaic, pictures_by_camera};

/// The exposure that a rig file begun for frames of unknown origin gets, µs: long enough for any blur.
const UNKNOWN_EXPOSURE_US: f64 = 10_000.0;

/// Frames to learn from, not read yet.
#[derive(Debug)]
pub(super) enum Frames {
    Pictures(Vec<(CameraName, Vec<PathBuf>)>),
    Recording { path: PathBuf, footage: Arc<Footage>, cameras: Vec<(CameraName, usize)> },
}

/// One frame.
#[derive(Debug)]
pub(super) struct Frame {
    /// For messages.
    pub(super) name: String,
    pub(super) format: PixelFormat,
    /// Columns and rows.
    pub(super) size: (usize, usize),
    pub(super) pixels: Vec<u8>,
}

impl Frames {
    /// A recording or pictures; of `only` one camera.
    pub(super) fn open(input: &Path, only: Option<&CameraName>) -> Result<Self, Box<dyn Error>> {
        if input.is_dir() {
            let single = match only {
                Some(name) => name.clone(),
                None => CameraName::new("camera")?,
            };
            let mut cameras = pictures_by_camera(input, &single)?;
            cameras.retain(|(name, _)| only.is_none_or(|only| only == name));
            if cameras.is_empty() {
                return Err(
                    format!("{} has no folder of pictures of camera {single}", input.display()).into()
                );
            }
            return Ok(Self::Pictures(cameras));
        }
        if !input.exists() {
            return Err(format!(
                "{} does not exist; give a recording or a folder of pictures",
                input.display()
            )
            .into());
        }
        let footage = Arc::new(Footage::open(input)?);
        let named = footage.cameras.iter().enumerate().map(|(i, camera)| (camera.name.clone(), i));
        let cameras = named.filter(|(name, _)| only.is_none_or(|only| only == name)).collect::<Vec<_>>();
        if cameras.is_empty() {
            let names = footage.cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ");
            let wanted = only.map_or_else(|| "any camera".to_owned(), ToString::to_string);
            return Err(
                format!("{} has no images of {wanted}; it has those of: {names}", input.display()).into()
            );
        }
        Ok(Self::Recording { path: input.to_owned(), footage, cameras })
    }

    pub(super) fn cameras(&self) -> usize {
        match self {
            Self::Pictures(cameras) => cameras.len(),
            Self::Recording { cameras, .. } => cameras.len(),
        }
    }

    pub(super) fn camera(&self, camera: usize) -> &CameraName {
        match self {
            Self::Pictures(cameras) => &cameras[camera].0,
            Self::Recording { cameras, .. } => &cameras[camera].0,
        }
    }

    /// Frames of a camera.
    pub(super) fn count(&self, camera: usize) -> usize {
        match self {
            Self::Pictures(cameras) => cameras[camera].1.len(),
            Self::Recording { footage, cameras, .. } => footage.cameras[cameras[camera].1].frames.len(),
        }
    }

    /// The picture of a place; none in a recording.
    pub(super) fn picture(&self, camera: usize, place: usize) -> Option<&Path> {
        match self {
            Self::Pictures(cameras) => cameras[camera].1.get(place).map(PathBuf::as_path),
            Self::Recording { .. } => None,
        }
    }

    /// All pictures; none of a recording.
    pub(super) fn pictures(&self) -> impl Iterator<Item = &Path> {
        let cameras = match self {
            Self::Pictures(cameras) => cameras.as_slice(),
            Self::Recording { .. } => &[],
        };
        cameras.iter().flat_map(|(_, pictures)| pictures).map(PathBuf::as_path)
    }

    /// The stamp of a place, ns; none of a picture.
    pub(super) fn stamp_ns(&self, camera: usize, place: usize) -> Option<u64> {
        match self {
            Self::Pictures(_) => None,
            Self::Recording { footage, cameras, .. } => {
                footage.cameras[cameras[camera].1].frames.get(place).map(|frame| frame.stamp_ns)
            }
        }
    }

    /// Length of a frame's exposure, s, where the recording tells it.
    pub(super) fn exposure_s(&self, camera: usize, place: usize) -> Option<f64> {
        match self {
            Self::Pictures(_) => None,
            Self::Recording { footage, cameras, .. } => {
                let header = footage.cameras[cameras[camera].1].frames.get(place)?.header?;
                (header.exposure_ns > 0).then_some(header.exposure_ns as f64 * 1e-9)
            }
        }
    }

    /// What a recording says of the true ball.
    pub(super) fn truth(&self) -> &[RecordedTruth] {
        match self {
            Self::Pictures(_) => &[],
            Self::Recording { footage, .. } => &footage.truth,
        }
    }

    /// The rig that filmed, where a recording tells it.
    pub(super) fn own_rig(&self) -> Option<Rig> {
        match self {
            Self::Pictures(_) => None,
            Self::Recording { footage, .. } => footage.rig().ok(),
        }
    }

    /// The cameras for a rig file that is begun.
    pub(super) fn begin(&self, edit: &mut RigEdit) -> Result<(), Box<dyn Error>> {
        for camera in 0..self.cameras() {
            let (size, format) = match self {
                Self::Pictures(cameras) => {
                    let picture = Picture::read(&cameras[camera].1[0], Channels::Rgb)?;
                    ((picture.width(), picture.height()), PixelFormat::BayerRG8)
                }
                Self::Recording { footage, cameras, .. } => {
                    let first = &footage.cameras[cameras[camera].1].frames[0];
                    ((first.width as usize, first.height as usize), first.format)
                }
            };
            let table = edit.camera(self.camera(camera));
            table["width"] = value(i64::try_from(size.0)?);
            table["height"] = value(i64::try_from(size.1)?);
            table["pixel_format"] = value(format.to_string());
            table["exposure_us"] = value(UNKNOWN_EXPOSURE_US);
        }
        Ok(())
    }

    /// Whether the rig has the cameras.
    pub(super) fn check_against(&self, rig: &Rig, path: &Path) -> Result<(), String> {
        let names = || rig.cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ");
        for camera in 0..self.cameras() {
            let name = self.camera(camera);
            if rig.camera(name).is_none() {
                return Err(format!(
                    "the rig file {} has no camera {name}, of which there are frames; it has: {} (--camera NAME says \
                     whose the pictures of a folder are)",
                    path.display(),
                    names()
                ));
            }
        }
        Ok(())
    }

    /// Reads a frame as its camera of `rig` would have given it.
    pub(super) fn read(&self, camera: usize, place: usize, rig: &Rig) -> Result<Frame, Box<dyn Error>> {
        let name = self.camera(camera);
        let known = rig.camera(name).ok_or_else(|| format!("the rig has no camera {name}"))?;
        let expected = (known.model.width as usize, known.model.height as usize);
        let frame = match self {
            Self::Pictures(cameras) => {
                let path = &cameras[camera].1[place];
                let picture = Picture::read(path, Channels::Rgb)?;
                let size = (picture.width(), picture.height());
                let format = known.pixel_format;
                Frame { name: path.display().to_string(), format, size, pixels: mosaic(&picture, format) }
            }
            Self::Recording { path, footage, cameras } => {
                let filmed = &footage.cameras[cameras[camera].1].frames[place];
                let pixels = FrameReader::new(Arc::clone(footage), std::iter::once(filmed.pixels.clone()));
                let pixels = pixels.last().ok_or_else(|| {
                    format!("{}: frame {place} of camera {name} cannot be read", path.display())
                })??;
                let (width, step) = (filmed.width as usize, filmed.step as usize);
                let rows = pixels.as_ref().chunks(step.max(1)).take(filmed.height as usize);
                Frame {
                    name: format!("{}: frame {place} of camera {name}", path.display()),
                    format: filmed.format,
                    size: (width, filmed.height as usize),
                    pixels: rows.flat_map(|row| &row[..width.min(row.len())]).copied().collect(),
                }
            }
        };
        if frame.size != expected {
            return Err(format!(
                "{} has {} × {} px, but the rig file says {} × {} of camera {name}",
                frame.name, frame.size.0, frame.size.1, expected.0, expected.1
            )
            .into());
        }
        if (frame.format == PixelFormat::Mono8) != (known.pixel_format == PixelFormat::Mono8) {
            return Err(format!(
                "{} is {}, but the rig file says {} of camera {name}",
                frame.name, frame.format, known.pixel_format
            )
            .into());
        }
        Ok(frame)
    }
}
