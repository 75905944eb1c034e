use netcord_common::rig::BallColour;
use thiserror::Error;

/// What the segmenter looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum InputMode {
    /// The mosaic as it left the sensor.
    #[default]
    Raw,
    /// All three colours at every pixel, interpolated linearly.
    Bilinear,
    /// All three colours at every pixel, interpolated along edges and not across them.
    EdgeAware,
    /// One pixel with all three colours for each 2 × 2 cell.
    Half,
}

impl InputMode {
    /// All, in the order in which `netcord compare --input` lists them.
    pub const ALL: [Self; 4] = [Self::Raw, Self::Bilinear, Self::EdgeAware, Self::Half];

    /// The name that options and reports use.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Raw => "raw",
            Self::Bilinear => "bilinear",
            Self::EdgeAware => "edge-aware",
            Self::Half => "half",
        }
    }
}

impl std::str::FromStr for InputMode {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|mode| mode.name() == name).ok_or_else(|| {
            format!("input {name:?} is not known; valid are raw, bilinear, edge-aware and half")
        })
    }
}

/// How a [`super::Segmenter`] works.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SegmentOptions {
    /// The ball's colour; `None`: the rig file's.
    pub colour: Option<BallColour>,
    /// What is looked at.
    pub input: InputMode,
    /// Whether each frame stands for itself: nothing is learnt from one for the next, and colour and shape
    /// alone decide. For pictures in no order.
    pub single_frames: bool,
}

/// Why a frame cannot be searched, or a segmenter not be made.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SegmentError {
    /// The rig has no such camera.
    #[error("the rig has no camera of index {index}; it has {cameras}, counted from 0")]
    NoSuchCamera {
        /// What was asked for.
        index: usize,
        /// How many there are.
        cameras: usize,
    },
    /// The frame is not what the rig file says of its camera.
    #[error(
        "camera {camera}: the frame is {found_width} × {found_height} {found_format}, but the rig file says \
         {width} × {height} {format}"
    )]
    WrongFrame {
        /// The camera.
        camera: String,
        /// Columns found.
        found_width: usize,
        /// Rows found.
        found_height: usize,
        /// Format found.
        found_format: netcord_common::PixelFormat,
        /// Columns by the rig file.
        width: usize,
        /// Rows by the rig file.
        height: usize,
        /// Format by the rig file.
        format: netcord_common::PixelFormat,
    },
    /// The image is too small for a ball.
    #[error("camera {camera}: images of {width} × {height} px are too small to search; 16 × 16 are needed")]
    TooSmall {
        /// The camera.
        camera: String,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
}
