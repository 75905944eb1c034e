use thiserror::Error;

/// A mark that does not fit its frame.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum MarkError {
    /// Its middle is outside.
    #[error(
        "the mark at ({u:.1}, {v:.1}) px lies outside the image of {width} × {height} px; marks are in pixels of \
         the frame, with (0, 0) the centre of the first"
    )]
    Outside {
        /// Where, px.
        u: f64,
        /// Where, px.
        v: f64,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// It has no size, or a very large one.
    #[error(
        "the mark at ({u:.1}, {v:.1}) px is {across:.1} px across; a ball is {least} to {most} px across"
    )]
    Size {
        /// Where, px.
        u: f64,
        /// Where, px.
        v: f64,
        /// Its diameter, or the box's smaller side.
        across: f64,
        /// Smallest valid.
        least: f64,
        /// Largest valid.
        most: f64,
    },
    /// Nothing in the box stands out.
    #[error(
        "in the box around ({u:.1}, {v:.1}) px nothing of a ball's shape differs from what is around the box; mark \
         it by its centre and diameter instead"
    )]
    NothingInBox {
        /// Where, px.
        u: f64,
        /// Where, px.
        v: f64,
    },
}

/// Why no colour could be learnt.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum LearnError {
    /// No mark could be used.
    #[error("no ball is marked in the frames that were read; at least one must be")]
    NoMark,
    /// Too little of the ball was marked.
    #[error(
        "only {found} cells of 2 × 2 px lie inside the marked balls, and {needed} are needed: mark more frames, or \
         larger balls"
    )]
    TooFewCells {
        /// How many there are.
        found: usize,
        /// How many there must be.
        needed: usize,
    },
    /// The ball's colour is everywhere.
    #[error(
        "the ball's colour does not separate it from the rest of these frames: with {:.0} % of the ball's cells \
         kept, {:.0} % of all others pass, too (area under the curve {area:.2}; {:.0} % and less pass where learning \
         helps). Check the marks; if they are right, the ball must be told by its motion and shape alone, or \
         another ball or light be used",
        100.0 * kept, 100.0 * let_through, 100.0 * MOST_LET_THROUGH
    )]
    NotSeparable {
        /// Share of the ball's cells that pass.
        kept: f64,
        /// Share of the other cells that pass.
        let_through: f64,
        /// Area under the ROC curve.
        area: f64,
    },
}

/// Share of cells that are not the ball, 0–1, above which a gate is of no use.
pub const MOST_LET_THROUGH: f64 = 0.35;
