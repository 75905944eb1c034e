use std::collections::BTreeSet;

use netcord_common::{FrameView, PixelFormat};

use super::{
    Mark, MarkError,
    density::{Normal, Surroundings},
};
use crate::segment::colour::colour_of;

/// What a 2 × 2 cell of a marked frame shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellLabel {
    /// The ball alone.
    Ball,
    /// No ball.
    Other,
    /// An edge, or not known.
    Unknown,
}

/// A frame with what its cells show.
#[derive(Debug, Clone)]
pub struct LabelledFrame {
    /// The mosaic.
    pub format: PixelFormat,
    /// Cells in a row, and rows of cells.
    pub size: (usize, usize),
    /// By cell, row by row.
    pub labels: Vec<CellLabel>,
    /// The four levels of each cell: top left, top right, bottom left, bottom right, DN.
    pub cells: Vec<[u8; 4]>,
    /// Diameter of each marked ball, px, with the indices of its cells.
    pub balls: Vec<(f64, Vec<usize>)>,
}

/// Share of an outline's radius up to which a cell shows the ball alone, and from which on it shows none of it.
const SURELY_BALL: f64 = 0.75;
const SURELY_OTHER: f64 = 1.5;
/// Fewest cells of a ball that is told from what is around it.
const LEAST_CELLS: usize = 5;

impl LabelledFrame {
    /// Labels a frame by its marks.
    ///
    /// # Errors
    /// [`MarkError`]: a mark outside the image or of no ball's size, or a box in which nothing stands out.
    pub fn new(view: &FrameView<'_>, marks: &[Mark]) -> Result<Self, MarkError> {
        let size = (view.width() / 2, view.height() / 2);
        let cells = (0..size.1)
            .flat_map(|y| {
                let (top, bottom) = (view.row(2 * y), view.row(2 * y + 1));
                (0..size.0).map(move |x| [top[2 * x], top[2 * x + 1], bottom[2 * x], bottom[2 * x + 1]])
            })
            .collect::<Vec<_>>();
        let mut frame = Self {
            format: view.format(),
            size,
            labels: vec![CellLabel::Other; cells.len()],
            cells,
            balls: Vec::with_capacity(marks.len()),
        };
        for mark in marks {
            mark.check((view.width(), view.height()))?;
            // What is in one ball's box is no surroundings of another's.
            let (low, high) = mark.extent();
            frame.each_within(low, high, |frame, i, _| frame.labels[i] = CellLabel::Unknown);
        }
        for mark in marks {
            let (diameter, inside) = match mark {
                Mark::Outline { centre, diameter, path } => {
                    (*diameter, frame.outline(*centre, *diameter, *path))
                }
                Mark::Box { low, high } => frame.ball_in_box(*low, *high).ok_or_else(|| {
                    let [u, v] = mark.centre();
                    MarkError::NothingInBox { u, v }
                })?,
            };
            for i in &inside {
                frame.labels[*i] = CellLabel::Ball;
            }
            frame.balls.push((diameter, inside));
        }
        Ok(frame)
    }

    /// Levels of red, green and blue of a cell, DN; of a grey one its mean, three times.
    #[must_use]
    pub fn rgb(&self, cell: usize) -> [f64; 3] {
        colour_of(self.format, |dx, dy| f32::from(self.cells[cell][2 * dy + dx])).map(f64::from)
    }

    /// The middle of a cell, px.
    #[must_use]
    pub fn place(&self, cell: usize) -> [f64; 2] {
        [(2 * (cell % self.size.0)) as f64 + 0.5, (2 * (cell / self.size.0)) as f64 + 0.5]
    }

    /// Calls `see` with each cell whose middle is inside a box, and that middle.
    fn each_within(
        &mut self,
        low: [f64; 2],
        high: [f64; 2],
        mut see: impl FnMut(&mut Self, usize, [f64; 2]),
    ) {
        let range = |i: usize, n: usize| {
            let first = ((low[i] - 0.5) / 2.0).ceil().max(0.0) as usize;
            let last = ((high[i] - 0.5) / 2.0).floor().max(-1.0) as isize + 1;
            first..usize::try_from(last).unwrap_or(0).clamp(first.min(n), n)
        };
        for y in range(1, self.size.1) {
            for x in range(0, self.size.0) {
                let i = y * self.size.0 + x;
                let place = self.place(i);
                see(self, i, place);
            }
        }
    }

    /// Cells well inside an outline; those of its edge become unknown.
    fn outline(&mut self, centre: [f64; 2], diameter: f64, path: [f64; 2]) -> Vec<usize> {
        let radius = 0.5 * diameter;
        let length = path[0].hypot(path[1]);
        let along = if length > 1e-9 { path.map(|p| p / length) } else { [1.0, 0.0] };
        // Cells that the ball covers for the whole exposure; where there are none, those it covers longest.
        let is_inside = |s: f64, w: f64| {
            if length < 0.8 * diameter {
                (s.abs() + 0.5 * length).hypot(w)
                    <= (SURELY_BALL * radius).max(0.55 * (radius + 0.5 * length))
                    && s.hypot(w) <= SURELY_BALL * radius
            } else {
                s.abs() <= 0.25 * length && w.abs() <= 0.5 * radius
            }
        };
        let mut inside = Vec::new();
        let most = SURELY_OTHER * radius + 3.0;
        let reach = [0, 1].map(|i| most + 0.5 * path[i].abs());
        let (low, high) = ([0, 1].map(|i| centre[i] - reach[i]), [0, 1].map(|i| centre[i] + reach[i]));
        self.each_within(low, high, |frame, i, place| {
            let [dx, dy] = [place[0] - centre[0], place[1] - centre[1]];
            let (s, w) = (dx * along[0] + dy * along[1], dy * along[0] - dx * along[1]);
            let from = |half: f64| (s.abs() - half).max(0.0).hypot(w);
            if is_inside(s, w) {
                inside.push(i);
            } else if from(0.5 * length) <= most && frame.labels[i] == CellLabel::Other {
                frame.labels[i] = CellLabel::Unknown;
            }
        });
        inside
    }

    /// The ball in a box: cells whose colour is likelier that of the box's middle than that of its surroundings, as
    /// far as they hang together. Its diameter, and its cells without those of its edge.
    fn ball_in_box(&mut self, low: [f64; 2], high: [f64; 2]) -> Option<(f64, Vec<usize>)> {
        let centre = [0, 1].map(|i| 0.5 * (low[i] + high[i]));
        let half = [0, 1].map(|i| 0.5 * (high[i] - low[i]));
        let mut around = Surroundings::default();
        let reach = half.map(|h| 1.4 * h + 6.0);
        let (outer_low, outer_high) =
            ([0, 1].map(|i| centre[i] - reach[i]), [0, 1].map(|i| centre[i] + reach[i]));
        let mut box_cells = Vec::new();
        self.each_within(outer_low, outer_high, |frame, i, place| {
            if (0..2).all(|a| (low[a]..=high[a]).contains(&place[a])) {
                box_cells.push((i, place, frame.rgb(i)));
            } else if frame.labels[i] == CellLabel::Other {
                around.add(frame.rgb(i));
            }
        });
        let away =
            |place: &[f64; 2]| ((place[0] - centre[0]) / half[0]).hypot((place[1] - centre[1]) / half[1]);
        // First the cells of the box's middle that its surroundings know least.
        let mut first = box_cells.iter().filter(|(_, place, _)| away(place) < 0.6).collect::<Vec<_>>();
        first.sort_by(|a, b| around.density(a.2).total_cmp(&around.density(b.2)));
        first.truncate((first.len() / 4).max(4));
        let mut ball = Normal::of(first.iter().map(|(_, _, rgb)| *rgb))?;
        let mut members = Vec::new();
        for _ in 0..6 {
            let inside = box_cells.iter().filter(|(_, _, rgb)| ball.density(*rgb) > around.density(*rgb));
            let marked = inside.map(|(i, _, _)| *i).collect::<Vec<_>>();
            let found = self.nearest_piece(&marked, centre);
            if found.len() < LEAST_CELLS {
                return None;
            }
            let same = found == members;
            members = found;
            if same {
                break;
            }
            ball = Normal::of(self.core(&members).iter().map(|i| self.rgb(*i)))?;
        }
        // As large as the box and more: it is the surroundings that were found.
        if members.len() * 10 > box_cells.len() * 9 {
            return None;
        }
        let diameter = self.across(&members);
        Some((diameter, self.core(&members)))
    }

    /// Of some cells the piece that hangs together and is nearest to a place, in order.
    fn nearest_piece(&self, marked: &[usize], centre: [f64; 2]) -> Vec<usize> {
        let mut left = marked.iter().copied().collect::<BTreeSet<_>>();
        let mut best: (f64, Vec<usize>) = (f64::INFINITY, Vec::new());
        while let Some(seed) = left.pop_first() {
            let (mut piece, mut at) = (vec![seed], 0);
            while at < piece.len() {
                let i = piece[at];
                at += 1;
                piece.extend(self.neighbours(i).into_iter().flatten().filter(|n| left.remove(n)));
            }
            // Large and near the middle.
            let away = piece
                .iter()
                .map(|i| self.place(*i))
                .map(|p| (p[0] - centre[0]).hypot(p[1] - centre[1]))
                .fold(f64::INFINITY, f64::min);
            let cost = (away + 4.0) / (piece.len() as f64).sqrt();
            if cost < best.0 {
                best = (cost, piece);
            }
        }
        best.1.sort_unstable();
        best.1
    }

    /// The cells left and right, above and below; none beyond the image's edges.
    fn neighbours(&self, cell: usize) -> [Option<usize>; 4] {
        let (columns, rows) = self.size;
        let (x, y) = (cell % columns, cell / columns);
        [
            (x > 0).then(|| cell - 1),
            (x + 1 < columns).then(|| cell + 1),
            (y > 0).then(|| cell - columns),
            (y + 1 < rows).then(|| cell + columns),
        ]
    }

    /// Of a piece, the cells all of whose neighbours belong to it; of a small one, all.
    fn core(&self, piece: &[usize]) -> Vec<usize> {
        let belongs = |cell: Option<usize>| cell.is_some_and(|cell| piece.binary_search(&cell).is_ok());
        let inner = piece
            .iter()
            .copied()
            .filter(|i| self.neighbours(*i).into_iter().all(belongs))
            .collect::<Vec<_>>();
        if inner.len() >= LEAST_CELLS { inner } else { piece.to_vec() }
    }

    /// The diameter of the disc that, swept, has a piece's moments, px.
    fn across(&self, piece: &[usize]) -> f64 {
        let n = piece.len() as f64;
        let places = || piece.iter().map(|i| self.place(*i));
        let mean = [0, 1].map(|a| places().map(|p| p[a]).sum::<f64>() / n);
        let moment =
            |a: usize, b: usize| places().map(|p| (p[a] - mean[a]) * (p[b] - mean[b])).sum::<f64>() / n;
        // Each cell is a square of 2 px.
        let (xx, xy, yy) = (moment(0, 0) + 1.0 / 3.0, moment(0, 1), moment(1, 1) + 1.0 / 3.0);
        let small = 0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        4.0 * small.max(0.25).sqrt()
    }
}
