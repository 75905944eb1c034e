use super::{
    blobs::Blob,
    size::BallSize,
    sphere::Place,
    sweep::{MIN_LENGTH_PX, Sweep},
};

/// Longest path during one exposure that is looked for, px.
pub const LONGEST_PATH_PX: f32 = 150.0;

/// The widest and highest blob of a ball, in cells of 2 px: wide lenses stretch, and marks are broader than the ball
/// by what touches a cell.
pub fn most_cells(ball: &BallSize) -> u16 {
    (1.3 * (ball.most_px + LONGEST_PATH_PX) / 2.0) as u16
}

/// Fewest cells of a candidate: a ball of 4 px covers three.
const LEAST_CELLS: u32 = 3;

/// By how much the longer second moment of a round blob's cells exceeds the shorter one, as a rule.
const RAGGED: f64 = 0.12;

/// What is left of the rank of something slow: more balls lie about than fly, but those that fly count.
const SLOW_SHARE: f32 = 0.5;

/// Usual diameter of the ball from which on whatever is small or thin is none, px.
const ENOUGH_PX: f32 = 12.0;

/// A blob seen as a swept disc.
#[derive(Debug, Clone, Copy)]
pub struct Start {
    /// Where it is.
    pub place: Place,
    /// First guess.
    pub sweep: Sweep,
    /// How well the blob's area and moments agree with a swept disc, 0–1.
    pub likeness: f32,
    /// How well a few of its cells agree with the ball's colour, 0–1.
    pub colour: f32,
    /// Whether something was here in the last frame already, or rolls past.
    pub slow: bool,
    /// Diameter of the ball over the table's middle, px.
    pub usual_px: f32,
}

impl Start {
    /// Places along and across it, px in the frame, that the ball covers longer than any others.
    pub fn inside(&self) -> [[f64; 2]; 5] {
        let Sweep { radius, length, angle, .. } = self.sweep;
        let (sin, cos) = angle.sin_cos();
        let (along, across) = (0.25 * length + 0.3 * radius, 0.4 * radius);
        [(0.0, 0.0), (along, 0.0), (-along, 0.0), (0.0, across), (0.0, -across)].map(|(s, w)| {
            self.place.rectifier.pixel([f64::from(s * cos - w * sin), f64::from(s * sin + w * cos)])
        })
    }

    /// How much it deserves to be looked at, 0–1: noise makes small blobs, and edges of what moves make thin
    /// ones. Where the ball itself is small, so are those.
    pub fn rank(&self) -> f32 {
        let share = (self.usual_px / ENOUGH_PX).clamp(0.25, 1.0);
        let size = (self.sweep.area() / (40.0 * share * share)).min(1.0);
        let width = ((self.sweep.radius - 0.9) / (1.2 * share)).clamp(0.1, 1.0);
        self.likeness * size * width * self.colour * if self.slow { SLOW_SHARE } else { 1.0 }
    }
}

/// Whether a blob has as many cells as the smallest ball.
pub const fn is_of_size(blob: &Blob) -> bool {
    blob.cells >= LEAST_CELLS
}

/// The centre of a blob in pixels.
pub fn centre_px(blob: &Blob) -> [f64; 2] {
    // The centre of cell 0 lies between pixels 0 and 1.
    blob.centre().map(|c| 2.0 * c + 0.5)
}

/// The swept disc with the blob's moments; `scale` is the grid's; none where no ball has such.
pub fn start(blob: &Blob, scale: usize, place: &Place, ball: &BallSize) -> Option<Start> {
    let rectifier = place.rectifier;
    // Pixels of the frame to a cell's side.
    let cell_px = 2.0 / scale as f64;
    let [[a, b], [c, d]] = rectifier.forward;
    let [xx, xy, yy] = blob.moments().map(|m| cell_px * cell_px * m);
    // Moments in the rectified plane: F M Fᵀ.
    let (p, q) = (a * xx + b * xy, a * xy + b * yy);
    let (r, s) = (c * xx + d * xy, c * xy + d * yy);
    let (mxx, mxy, myy) = (p * a + q * b, p * c + q * d, r * c + s * d);
    let half = 0.5 * (mxx + myy);
    let root = (0.25 * (mxx - myy).powi(2) + mxy * mxy).sqrt();
    let (large, small) = (half + root, (half - root).max(0.25));
    let angle = 0.5 * (2.0 * mxy).atan2(mxx - myy);
    // A swept disc has the variance r²/4 across its path, and L²/12 more along it. Marked are cells that the
    // disc only touches, too: about half a pixel on each side. Ragged edges alone make one axis longer.
    let radius = (2.0 * small.sqrt() - 0.7).max(1.2);
    let length = (12.0 * (large - (1.0 + RAGGED) * small).max(0.0)).sqrt();
    let sweep = Sweep {
        centre: [0.0; 2],
        radius: radius as f32,
        length: (length as f32).max(MIN_LENGTH_PX),
        angle: angle as f32,
    };
    if sweep.radius > 0.6 * ball.most_px || sweep.length > 1.3 * LONGEST_PATH_PX {
        return None;
    }
    let marked = (cell_px * cell_px) as f32 * blob.cells as f32;
    let grown = Sweep { radius: sweep.radius + 0.5, ..sweep };
    let ratio = marked / grown.area();
    let likeness = (-((ratio.ln() / 0.5).powi(2))).exp();
    Some(Start { place: *place, sweep, likeness, colour: 1.0, slow: false, usual_px: ball.usual_px })
}
