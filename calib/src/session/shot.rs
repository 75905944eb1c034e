use super::blur::blur_px;
use crate::{
    detect::{Absence, BoardView, Depth, Detector, Luma},
    gather::Rejection,
};

/// What one camera saw.
#[derive(Debug, Clone, PartialEq)]
pub struct Sight {
    /// Width and height of the picture, px.
    pub size: (u32, u32),
    /// Middle of the exposure, ns, where it is known.
    pub stamp_ns: Option<u64>,
    /// The board, or why there is none.
    pub board: Result<BoardView, Absence>,
    /// How blurred the board's edges are ([`blur_px`]); `None` without a board.
    pub blur_px: Option<f64>,
}

impl Sight {
    /// Searches a picture. Where there is no board, the final search also says what is there instead.
    pub fn of(picture: &Luma, detector: &Detector, depth: Depth, stamp_ns: Option<u64>) -> Self {
        let size = (picture.width() as u32, picture.height() as u32);
        match detector.find(picture, depth) {
            Some(board) => {
                let blur = blur_px(picture, &board);
                Self { size, stamp_ns, board: Ok(board), blur_px: blur }
            }
            None => {
                let absence = match depth {
                    Depth::Guiding => Absence::Nothing { wanted: detector.board().to_string() },
                    Depth::Final => detector.diagnose(picture),
                };
                Self { size, stamp_ns, board: Err(absence), blur_px: None }
            }
        }
    }
}

/// What all cameras saw at once.
#[derive(Debug, Clone)]
pub struct Shot {
    /// Its name, unlike that of any other shot.
    pub name: String,
    /// Per camera: nothing where it gave no picture, and why a picture could not be read.
    pub sights: Vec<Option<Result<Sight, Rejection>>>,
}
