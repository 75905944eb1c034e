use serde::Deserialize;

/// Most linear tests of a learnt colour.
pub const MAX_COLOUR_TESTS: usize = 6;

/// A linear test of the colour of a 2 × 2 cell: `r R + g G + b B > bound`, with R and B the levels of its red and its
/// blue pixel and G the mean of its green ones, DN. Of a grey cell all three are the mean level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColourTest {
    /// r, g and b.
    pub weights: [f64; 3],
    /// DN.
    pub bound: f64,
}

/// Whether colours were learnt from a mosaic of colours or from grey frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ColourKind {
    /// From a mosaic: hue and brightness tell the ball.
    Mosaic,
    /// From grey frames: brightness alone tells it.
    Grey,
}

/// What one camera sees of the ball's colour, as `netcord segment --learn` found it in marked frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LearntColour {
    /// What frames it was learnt from.
    pub kind: ColourKind,
    /// Cells of the ball pass the first `test_count` of these; the others are zero.
    tests: [ColourTest; MAX_COLOUR_TESTS],
    test_count: usize,
    /// Mean of ln ((R + 1) / (G + 1)), ln ((B + 1) / (G + 1)) and ln (G + 1) over the ball's cells.
    pub mean: [f64; 3],
    /// Covariance of these three: 11, 12, 13, 22, 23, 33.
    pub covariance: [f64; 6],
    /// Diameters of the smallest and the largest ball that was marked, px.
    pub diameter_px: [f64; 2],
}

impl LearntColour {
    /// A model with some tests, of which the first [`MAX_COLOUR_TESTS`] count.
    #[must_use]
    pub fn new(
        kind: ColourKind,
        tests: &[ColourTest],
        (mean, covariance): ([f64; 3], [f64; 6]),
        diameter_px: [f64; 2],
    ) -> Self {
        let none = ColourTest { weights: [0.0; 3], bound: -1.0 };
        let test_count = tests.len().min(MAX_COLOUR_TESTS);
        let mut all = [none; MAX_COLOUR_TESTS];
        all[..test_count].copy_from_slice(&tests[..test_count]);
        Self { kind, tests: all, test_count, mean, covariance, diameter_px }
    }

    /// The tests that a cell of the ball passes, all of them.
    #[must_use]
    pub fn tests(&self) -> &[ColourTest] {
        &self.tests[..self.test_count]
    }
}

/// How a colour was learnt, and how well it tells the ball: noted beside it, for people.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LearningNote {
    /// Day, ISO 8601.
    pub date: String,
    /// Marked frames.
    pub frames: u64,
    /// Marked balls.
    pub balls: u64,
    /// Share of the ball's cells that pass, 0–1, in frames that were not learnt from; none where there was one frame.
    pub kept: Option<f64>,
    /// Share of the other cells that pass, 0–1, in frames that were not learnt from.
    pub let_through: Option<f64>,
}
