use thiserror::Error;

use crate::gather::Rejection;

/// Why a camera's sight was not kept.
#[derive(Debug, Clone, Error)]
pub enum Reason {
    /// What holds for single pictures too.
    #[error(transparent)]
    View(#[from] Rejection),
    /// The board's edges are blurred.
    #[error("the board is blurred by {blur_px:.1} px (at most {most_px} px): focus, or give it more light")]
    Blurred {
        /// Measured.
        blur_px: f64,
        /// Allowed.
        most_px: f64,
    },
    /// The board moves.
    #[error("the board has moved by {moved_px:.1} px since the look before: hold it still")]
    Moving {
        /// Measured; from one look to the next.
        moved_px: f64,
    },
    /// The board has just come into sight.
    #[error("the board has just come into sight: hold it still")]
    JustSeen,
    /// The frames of the shot were not exposed together.
    #[error("the cameras' frames lie {apart_ms:.1} ms apart (at most {most_ms:.1} ms): not simultaneous")]
    NotSimultaneous {
        /// Largest difference of stamps, ms.
        apart_ms: f64,
        /// Allowed, ms.
        most_ms: f64,
    },
    /// No other camera saw the board then, and this one needs no views of its own.
    #[error("only {camera} sees the board: a pose needs two cameras that see it at once")]
    Alone {
        /// The camera.
        camera: String,
    },
}

impl Reason {
    /// A short name under which reasons of one kind are counted.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::View(Rejection::Unreadable(_)) => "unreadable picture",
            Self::View(Rejection::Size { .. }) => "other picture size",
            Self::View(Rejection::NoBoard(_)) => "no board",
            Self::View(Rejection::FewCorners { .. }) => "too few corners",
            Self::View(Rejection::Unanchored) => "corners not numbered",
            Self::View(Rejection::NeverWhole { .. }) => "never seen whole",
            Self::View(Rejection::Alike { .. }) => "like a kept view (IoU)",
            Self::View(Rejection::Enough(_)) => "enough views",
            Self::Blurred { .. } => "blurred",
            Self::Moving { .. } | Self::JustSeen => "moving",
            Self::NotSimultaneous { .. } => "not simultaneous",
            Self::Alone { .. } => "one camera only",
        }
    }
}

/// What becomes of a shot: per camera, nothing where it gave no picture.
#[derive(Debug, Clone)]
pub struct Verdict {
    /// By camera.
    pub cameras: Vec<Option<Result<(), Reason>>>,
}

impl Verdict {
    /// Whether anything of the shot is to be kept.
    pub fn keeps_any(&self) -> bool {
        self.cameras.iter().flatten().any(Result::is_ok)
    }
}
