//! A marker's corners from its whole picture: the known pattern, blurred, laid over the pixels.

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2};

use super::{luma::Luma, markers::Marker, normal::normal_distribution};
use crate::{
    board::Dictionary,
    solve::{apply_homography, homography},
};

/// Unknowns: four corners, two bends, the blur; then levels of black and white, each with its slopes.
const UNKNOWNS: usize = 19;
type Row = SVector<f64, UNKNOWNS>;
/// Index of the blur among the unknowns, and of the levels.
const BLUR: usize = 12;
const LEVELS: usize = 13;
/// Steps of the iteration.
const STEPS: usize = 15;
/// A step of the corners below this, in px, ends it.
const STILL_PX: f64 = 2e-3;
/// Narrowest and widest blur, as a standard deviation in px.
const BLUR_PX: std::ops::RangeInclusive<f64> = 0.2..=6.0;
/// Furthest that a corner may move, in px or cells, whichever is more.
const REACH_PX: f64 = 2.0;
const REACH_CELLS: f64 = 0.35;
/// Most pixels of a marker that are looked at: larger markers are sampled by rows and columns.
const MOST_PIXELS: f64 = 12_000.0;
/// Cauchy's scale in standard deviations of the residuals (95 % efficient for normal noise).
const CAUCHY: f64 = 2.385;
/// Largest scatter of the residuals, as a share of the contrast, of a picture that shows this marker.
const MISFIT: f64 = 0.2;
/// Least contrast, in grey levels.
const MIN_STEP: f64 = 8.0;

/// Where the marker's corners are, by least squares over all pixels of the marker and of the white around it:
/// I = black + (white − black) · S, where S is the pattern under a Gaussian blur, laid into the picture by a
/// homography, a correction of each corner, and one bend along either axis (what a lens does to a marker, up to
/// second order). Each edge of the pattern counts, the inner ones too, with the weight that its contrast and the
/// noise give it; a hand over a part of the marker is an outlier of Cauchy's loss.
///
/// `marker` comes from a first fit, whose corners are off by less than a pixel or two. `None` where the pixels do
/// not show this marker: then the first fit stands.
pub(super) fn fit_pattern(
    image: &Luma,
    marker: &Marker,
    dictionary: &Dictionary,
    gap_cells: f64,
) -> Option<Marker> {
    let pattern = Pattern::new(dictionary, marker.id)?;
    let sheet = Sheet::new(&marker.corners)?;
    let mut pixels = sheet.pixels(image, (0.45 * gap_cells / pattern.cells).min(0.15))?;
    let mut state = State::new(marker);
    state.start_levels(&sheet, &pattern, &mut pixels)?;
    let mut scale = f64::INFINITY;
    for _ in 0..STEPS {
        let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
        let mut rhs = Row::zeros();
        let mut misfits = Vec::with_capacity(pixels.len());
        for pixel in &mut pixels {
            let (model, row) = state.predict(&sheet, &pattern, pixel)?;
            let off = pixel.value - model;
            misfits.push(off.abs());
            let weight = 1.0 / (1.0 + (off / (CAUCHY * scale)).powi(2));
            let weighted = row * weight;
            normal.ger(1.0, &weighted, &row, 1.0);
            rhs.axpy(off, &weighted, 1.0);
        }
        let middle = misfits.len() / 2;
        scale = (1.4826 * *misfits.select_nth_unstable_by(middle, f64::total_cmp).1).max(0.3);
        for i in 0..UNKNOWNS {
            // A bend that the picture does not show stays nought.
            normal[(i, i)] += 1e-6 * normal[(i, i)] + if (8..BLUR).contains(&i) { 1e-3 } else { 0.0 };
        }
        let step = normal.cholesky()?.solve(&rhs);
        state.advance(&step);
        let cell = state.shortest_side() / pattern.cells;
        let moved = (0..4).map(|k| (state.corners[k] - marker.corners[k]).norm()).fold(0.0, f64::max);
        if moved > REACH_PX.max(REACH_CELLS * cell) || !BLUR_PX.contains(&state.blur) {
            return None;
        }
        let contrast = state.contrast();
        if step.fixed_rows::<8>(0).amax() < STILL_PX {
            let clear = contrast > MIN_STEP && scale < MISFIT * contrast;
            return clear.then_some(Marker { corners: state.corners, ..*marker });
        }
    }
    None
}

/// What is printed: the marker's cells, with a border of black, on white.
struct Pattern {
    /// Cells along one side.
    cells: f64,
    size: isize,
    white: Vec<bool>,
}

impl Pattern {
    fn new(dictionary: &Dictionary, id: usize) -> Option<Self> {
        let inner = dictionary.size();
        let size = inner + 2;
        let mut white = vec![false; size * size];
        for row in 0..inner {
            for column in 0..inner {
                white[(row + 1) * size + column + 1] = dictionary.is_white(id, row, column)?;
            }
        }
        Some(Self { cells: size as f64, size: size as isize, white })
    }

    fn level(&self, column: isize, row: isize) -> f64 {
        let inside = (0..self.size).contains(&column) && (0..self.size).contains(&row);
        let white = !inside || self.white[(row * self.size + column) as usize];
        f64::from(u8::from(white))
    }

    /// Share of white at (u, v), in sides of the marker, under a blur of (σᵤ, σᵥ) sides; its derivatives by u
    /// and v, and by the logarithm of the blur.
    fn blurred(&self, u: f64, v: f64, sigma_u: f64, sigma_v: f64) -> [f64; 4] {
        let (across, down) = (self.shares(u, sigma_u), self.shares(v, sigma_v));
        let mut out = [0.0; 4];
        for (j, d) in down.shares() {
            for (i, a) in across.shares() {
                if self.level(i, j) > 0.0 {
                    out[0] += a[0] * d[0];
                    out[1] += a[1] * d[0];
                    out[2] += a[0] * d[1];
                    out[3] += a[2] * d[0] + a[0] * d[2];
                }
            }
        }
        out
    }

    /// How much of each column of cells the blur sees at `u`.
    fn shares(&self, u: f64, sigma: f64) -> Shares {
        let (x, s) = (u * self.cells, (sigma * self.cells).max(1e-6));
        let first = ((x - 3.5 * s).floor() as isize).clamp(-1, self.size);
        let last = ((x + 3.5 * s).floor() as isize).clamp(first, self.size);
        let count = ((last - first + 1) as usize).min(Shares::MOST);
        let mut out = Shares { first, count, share: [[0.0; 3]; Shares::MOST] };
        // At each line between two columns: Φ(z), dΦ/du and dΦ/d ln σ. What lies beyond the first and the last
        // column is as they are.
        let mut before = [1.0, 0.0, 0.0];
        for k in 0..count {
            let after = if k + 1 == count {
                [0.0; 3]
            } else {
                let z = (x - (first + k as isize + 1) as f64) / s;
                let (cumulative, density) = normal_distribution(z);
                [cumulative, density / s * self.cells, -density * z]
            };
            out.share[k] = std::array::from_fn(|i| before[i] - after[i]);
            before = after;
        }
        out
    }
}

/// Shares of neighbouring columns of cells: value, derivative by u, derivative by ln σ.
struct Shares {
    first: isize,
    count: usize,
    share: [[f64; 3]; Self::MOST],
}

impl Shares {
    /// Cells that a blur of any width allowed here reaches: more would mean that nothing can be read.
    const MOST: usize = 10;

    fn shares(&self) -> impl Iterator<Item = (isize, &[f64; 3])> {
        self.share[..self.count].iter().enumerate().map(|(k, s)| (self.first + k as isize, s))
    }
}

/// The plane of the marker as the first fit lays it into the picture; (u, v) run from 0 to 1 along its sides.
struct Sheet {
    image_from_unit: Matrix3<f64>,
    unit_from_image: Matrix3<f64>,
    box_px: [Vector2<f64>; 2],
}

/// A pixel, and where on the marker it lies at the present state.
struct Pixel {
    at: Vector2<f64>,
    value: f64,
    unit: Vector2<f64>,
}

impl Sheet {
    fn new(corners: &[Vector2<f64>; 4]) -> Option<Self> {
        let unit = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(x, y)| Vector2::new(x, y));
        let image_from_unit = homography(&unit, corners)?;
        let (low, high) = corners.iter().fold((corners[0], corners[0]), |(l, h), c| (l.inf(c), h.sup(c)));
        Some(Self { unit_from_image: image_from_unit.try_inverse()?, image_from_unit, box_px: [low, high] })
    }

    /// The pixels of the marker and of `margin` sides around it that lie in the picture.
    fn pixels(&self, image: &Luma, margin: f64) -> Option<Vec<Pixel>> {
        let [low, high] = self.box_px;
        let wider = (high - low) * margin;
        let (low, high) = (low - wider, high + wider);
        let stride = ((high.x - low.x) * (high.y - low.y) / MOST_PIXELS).sqrt().floor().max(1.0) as usize;
        let range = |low: f64, high: f64, size: usize| {
            (low.ceil().max(0.0) as usize..=(high.floor().max(0.0) as usize).min(size - 1)).step_by(stride)
        };
        let mut pixels = Vec::new();
        for y in range(low.y, high.y, image.height()) {
            for x in range(low.x, high.x, image.width()) {
                let at = Vector2::new(x as f64, y as f64);
                let Some(unit) = apply_homography(&self.unit_from_image, &at) else { continue };
                if unit.iter().all(|c| (-margin..=1.0 + margin).contains(c)) {
                    pixels.push(Pixel { at, value: f64::from(image.at(x, y)), unit });
                }
            }
        }
        (pixels.len() > 4 * UNKNOWNS).then_some(pixels)
    }

    /// Where (u, v) lies in the picture, and the Jacobian.
    fn place(&self, unit: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let h = &self.image_from_unit;
        let p = h * unit.push(1.0);
        let at = Vector2::new(p.x, p.y) / p.z;
        let jacobian = Matrix2::new(
            h[(0, 0)] - at.x * h[(2, 0)],
            h[(0, 1)] - at.x * h[(2, 1)],
            h[(1, 0)] - at.y * h[(2, 0)],
            h[(1, 1)] - at.y * h[(2, 1)],
        ) / p.z;
        (at, jacobian)
    }
}

/// The unknowns.
struct State {
    start: [Vector2<f64>; 4],
    corners: [Vector2<f64>; 4],
    bends: [Vector2<f64>; 2],
    blur: f64,
    /// Level, slope along u, slope along v: of black, and of white over black.
    levels: [f64; 6],
}

impl State {
    fn new(marker: &Marker) -> Self {
        Self {
            start: marker.corners,
            corners: marker.corners,
            bends: [Vector2::zeros(); 2],
            blur: 1.0,
            levels: [0.0; 6],
        }
    }

    fn shortest_side(&self) -> f64 {
        (0..4).map(|k| (self.corners[(k + 1) % 4] - self.corners[k]).norm()).fold(f64::INFINITY, f64::min)
    }

    /// White over black in the marker's middle.
    fn contrast(&self) -> f64 {
        self.levels[3] + 0.5 * (self.levels[4] + self.levels[5])
    }

    /// How much (u, v) follows each corner, and each bend.
    fn shapes(unit: &Vector2<f64>) -> [f64; 6] {
        let (u, v) = (unit.x, unit.y);
        let (a, b) = (1.0 - u, 1.0 - v);
        [a * b, u * b, u * v, a * v, u * a, v * b]
    }

    /// Where (u, v) lies now, and the Jacobian.
    fn place(&self, sheet: &Sheet, unit: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let (mut at, mut jacobian) = sheet.place(unit);
        let (u, v) = (unit.x, unit.y);
        let shapes = Self::shapes(unit);
        let slopes = [
            (v - 1.0, u - 1.0),
            (1.0 - v, -u),
            (v, u),
            (-v, 1.0 - u),
            (1.0 - 2.0 * u, 0.0),
            (0.0, 1.0 - 2.0 * v),
        ];
        let moves = (0..4).map(|k| self.corners[k] - self.start[k]).chain(self.bends);
        for ((shape, (by_u, by_v)), moved) in shapes.iter().zip(slopes).zip(moves) {
            at += moved * *shape;
            jacobian += Matrix2::from_columns(&[moved * by_u, moved * by_v]);
        }
        (at, jacobian)
    }

    /// The levels for the pattern as the first fit places it: the mean of what is mostly black and white.
    fn start_levels(&mut self, sheet: &Sheet, pattern: &Pattern, pixels: &mut [Pixel]) -> Option<()> {
        let (mut sums, mut counts) = ([0.0; 2], [0.0; 2]);
        for pixel in pixels {
            let (share, _) = self.share(sheet, pattern, pixel)?;
            if !(0.1..0.9).contains(&share[0]) {
                let kind = usize::from(share[0] > 0.5);
                sums[kind] += pixel.value;
                counts[kind] += 1.0;
            }
        }
        (counts[0] > 0.0 && counts[1] > 0.0).then(|| {
            self.levels[0] = sums[0] / counts[0];
            self.levels[3] = sums[1] / counts[1] - self.levels[0];
        })
    }

    /// The share of white that the pixel sees, its derivatives, and ∂(u, v)/∂pixel.
    fn share(&self, sheet: &Sheet, pattern: &Pattern, pixel: &mut Pixel) -> Option<([f64; 4], Matrix2<f64>)> {
        // One step of Newton's: the state moves by little from step to step.
        let (at, jacobian) = self.place(sheet, &pixel.unit);
        pixel.unit += jacobian.try_inverse()? * (pixel.at - at);
        let inverse = self.place(sheet, &pixel.unit).1.try_inverse()?;
        let (across, down) = (inverse.row(0).norm(), inverse.row(1).norm());
        let share = pattern.blurred(pixel.unit.x, pixel.unit.y, self.blur * across, self.blur * down);
        Some((share, inverse))
    }

    /// The pixel's value, and its derivatives by the unknowns.
    fn predict(&self, sheet: &Sheet, pattern: &Pattern, pixel: &mut Pixel) -> Option<(f64, Row)> {
        let ([share, by_u, by_v, by_blur], inverse) = self.share(sheet, pattern, pixel)?;
        let (u, v) = (pixel.unit.x, pixel.unit.y);
        let l = &self.levels;
        let contrast = l[3] + l[4] * u + l[5] * v;
        let value = l[0] + l[1] * u + l[2] * v + contrast * share;
        // What moves the pattern by d moves what the pixel sees by −d.
        let gradient = inverse.transpose() * Vector2::new(by_u, by_v) * -contrast;
        let mut row = Row::zeros();
        for (k, shape) in Self::shapes(&pixel.unit).into_iter().enumerate() {
            row[2 * k] = gradient.x * shape;
            row[2 * k + 1] = gradient.y * shape;
        }
        row[BLUR] = contrast * by_blur;
        for (k, slope) in [1.0, u, v].into_iter().enumerate() {
            row[LEVELS + k] = slope;
            row[LEVELS + 3 + k] = slope * share;
        }
        Some((value, row))
    }

    fn advance(&mut self, step: &Row) {
        for k in 0..4 {
            self.corners[k] += step.fixed_rows::<2>(2 * k);
        }
        for k in 0..2 {
            self.bends[k] += step.fixed_rows::<2>(8 + 2 * k);
        }
        // The blur's unknown is its logarithm; it changes by no more than a half at once.
        self.blur *= step[BLUR].clamp(-0.4, 0.4).exp();
        for (level, change) in self.levels.iter_mut().zip(&step.as_slice()[LEVELS..]) {
            *level += change;
        }
    }
}
