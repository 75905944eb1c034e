use std::fmt;

use nalgebra::Vector3;
use serde::Serialize;

/// A ninth of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Place {
    /// 0 left, 1 middle, 2 right.
    pub column: usize,
    /// 0 top, 1 middle, 2 bottom.
    pub row: usize,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match (self.row, self.column) {
            (0, 0) => "top left corner",
            (0, 1) => "top edge",
            (0, _) => "top right corner",
            (1, 0) => "left edge",
            (1, 1) => "middle",
            (1, _) => "right edge",
            (_, 0) => "bottom left corner",
            (_, 1) => "bottom edge",
            _ => "bottom right corner",
        })
    }
}

/// Which edge of the board, as the camera sees it, is farther away than the opposite one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Tilt {
    /// The left edge.
    Left,
    /// The right edge.
    Right,
    /// The top edge.
    Top,
    /// The bottom edge.
    Bottom,
}

impl Tilt {
    /// All four.
    pub const ALL: [Self; 4] = [Self::Left, Self::Right, Self::Top, Self::Bottom];

    /// Where a board tilted so faces, beside towards the camera: if depth grows along x, its normal towards the
    /// camera leans along x.
    pub(super) fn direction(self) -> Vector3<f64> {
        match self {
            Self::Left => -Vector3::x(),
            Self::Right => Vector3::x(),
            Self::Top => -Vector3::y(),
            Self::Bottom => Vector3::y(),
        }
    }
}

impl fmt::Display for Tilt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Left => "left edge",
            Self::Right => "right edge",
            Self::Top => "top edge",
            Self::Bottom => "bottom edge",
        })
    }
}

/// What the person with the board should do next.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "do", rename_all = "kebab-case")]
pub enum Advice {
    /// Begin to gather.
    Start,
    /// Show the board to a camera.
    ShowBoard {
        /// The camera.
        camera: String,
    },
    /// Show the board to two cameras at once.
    ShowToBoth {
        /// One.
        camera: String,
        /// The other.
        other: String,
        /// Views that both have had.
        common: usize,
    },
    /// Lay the board on the table.
    LayOnTable,
    /// Do not move the board.
    HoldStill {
        /// The camera that sees it move.
        camera: String,
    },
    /// More of the board must be seen.
    ShowMore {
        /// The camera.
        camera: String,
    },
    /// The picture is blurred.
    Focus {
        /// The camera.
        camera: String,
    },
    /// Move the board to a part of the picture.
    MoveTo {
        /// The camera.
        camera: String,
        /// Where to.
        place: Place,
    },
    /// Turn the board.
    Tilt {
        /// The camera.
        camera: String,
        /// The edge that should go away from the camera.
        edge: Tilt,
    },
    /// Bring the board closer.
    Closer {
        /// The camera.
        camera: String,
    },
    /// Take the board farther away.
    Farther {
        /// The camera.
        camera: String,
    },
    /// Anything that is unlike the views kept.
    Different {
        /// The camera.
        camera: String,
    },
    /// There are no more pictures: compute.
    AllLookedAt,
    /// There are no more pictures, and none was of use.
    NothingFound,
    /// Wait.
    Wait,
    /// There is enough: compute.
    Process,
    /// Look at the result; save it, or go on gathering.
    Review,
    /// It is saved.
    Done,
}

impl fmt::Display for Advice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Start => write!(f, "Start gathering when every camera shows a sharp picture."),
            Self::ShowBoard { camera } => write!(f, "Show the board to camera {camera}."),
            Self::ShowToBoth { camera, other, common } => {
                write!(
                    f,
                    "Show the board to cameras {camera} and {other} at once ({common} common views so far)."
                )
            }
            Self::LayOnTable => {
                write!(f, "Lay the board on the table where all cameras see it, and step back.")
            }
            Self::HoldStill { .. } => write!(f, "Hold still."),
            Self::ShowMore { camera } => write!(f, "Show more of the board to camera {camera}."),
            Self::Focus { camera } => {
                write!(f, "Camera {camera} is blurred: focus it, or give it more light.")
            }
            Self::MoveTo { camera, place } => write!(f, "Move the board to the {place} in camera {camera}."),
            Self::Tilt { camera, edge } => {
                write!(f, "Tilt the board by about 30°: {edge} away from camera {camera}.")
            }
            Self::Closer { camera } => write!(f, "Bring the board closer to camera {camera}."),
            Self::Farther { camera } => write!(f, "Take the board farther away from camera {camera}."),
            Self::Different { camera } => {
                write!(f, "Show the board to camera {camera} in a few more places, each unlike the last.")
            }
            Self::AllLookedAt => write!(f, "All pictures have been looked at: process."),
            Self::NothingFound => {
                write!(f, "All pictures have been looked at, and none is of use; the counters say why.")
            }
            Self::Wait => write!(f, "Computing…"),
            Self::Process => write!(f, "That is enough: process."),
            Self::Review => write!(f, "Look at the result; then save it, or gather more."),
            Self::Done => write!(f, "Saved."),
        }
    }
}
