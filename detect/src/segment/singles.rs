//! Where to look in a frame that stands for itself: no background is known, so whatever has the ball's colour and is
//! set off from what is around it may be the ball.
//!
//! A fixed threshold of brightness does not do: a white ball before a white wall is a shade brighter than the wall
//! only. So all thresholds are tried, and a piece counts that has the outline of a swept disc at one of them, the
//! more the longer it keeps that outline (after the stable regions of Matas et al. 2002).

use netcord_common::{FrameView, PixelFormat};

use super::{
    blobs::{BlobFinder, MAX_BLOBS},
    candidate::{Start, is_of_size},
    kernel::{ColourGate, Kernel, WORD_PX},
};

/// From one threshold to the next: a factor of the level.
const STEP: f32 = 1.045;
/// The lowest and the highest threshold, DN.
const THRESHOLDS: (f32, f32) = (18.0, 250.0);
/// What thresholds are applied to: brightness, and red alone, in which a ball in warm light stands out before white
/// lines and walls. Weights of red, of each green, of blue.
const CHANNELS: [[f32; 3]; 2] = [[0.25, 0.25, 0.25], [1.0, 0.0, 0.0]];
/// Agreement with a swept disc, 0–1, below which a piece is none.
const LEAST_LIKENESS: f32 = 0.35;
/// Thresholds over which a ball that is well set off keeps its outline.
const ENOUGH: f32 = 4.0;

/// A place that may hold the ball.
#[derive(Debug, Clone, Copy)]
pub struct Single {
    /// The best outline that it had.
    pub start: Start,
    /// Thresholds at which it had such an outline.
    support: u32,
}

impl Single {
    /// How much it deserves to be looked at, 0–1.
    pub fn rank(&self) -> f32 {
        self.start.rank() * (self.support as f32 / ENOUGH).min(1.0)
    }
}

/// Finds such places.
#[derive(Debug)]
pub struct SingleFinder {
    format: PixelFormat,
    kernel: Kernel,
    words_per_row: usize,
    inside: Vec<u16>,
    found: Vec<Single>,
}

impl SingleFinder {
    /// For frames of `format` with `words` words, so many in each row of cells.
    pub fn new(kernel: Kernel, format: PixelFormat, (words, words_per_row): (usize, usize)) -> Self {
        Self { format, kernel, words_per_row, inside: vec![0; words], found: Vec::with_capacity(MAX_BLOBS) }
    }

    /// Forgets the places of the last frame.
    pub fn clear(&mut self) {
        self.found.clear();
    }

    /// The places, the likeliest first.
    pub fn sorted(&mut self) -> &[Single] {
        let anchor = |single: &Single| single.start.place.rectifier.anchor;
        self.found.sort_unstable_by(|a, b| {
            b.rank()
                .total_cmp(&a.rank())
                .then(anchor(a)[0].total_cmp(&anchor(b)[0]))
                .then(anchor(a)[1].total_cmp(&anchor(b)[1]))
        });
        &self.found
    }

    /// The variance of a pixel's noise at some level, DN² and DN² per DN, from differences between neighbours of one
    /// colour: half of them see the same surface.
    pub fn noise(view: &FrameView<'_>) -> [f32; 2] {
        const BINS: usize = 8;
        let mut columns: [Vec<f32>; BINS] = std::array::from_fn(|_| Vec::with_capacity(4096));
        let step = (view.width() * view.height() / 40_000).max(1) | 1;
        let inner = view.width().saturating_sub(4);
        for n in (0..inner * view.height()).step_by(step) {
            let (x, row) = (n % inner.max(1), view.row(n / inner.max(1)));
            let [a, b, c] = [row[x], row[x + 2], row[x + 4]].map(f32::from);
            // Of a saturated pixel nothing is known.
            if a.max(b).max(c) < 250.0 {
                columns[(b / 32.0) as usize].push((b - 0.5 * (a + c)).abs());
            }
        }
        let (mut weights, mut sum, mut slope) = (0.0_f32, 0.0_f32, 0.0_f32);
        for (bin, column) in columns.iter_mut().enumerate().filter(|(_, column)| column.len() > 50) {
            // A lower quantile: texture makes differences, too. That of a normal distribution is 0.3186 σ, and the
            // difference has 1.5 times the variance of a pixel.
            let place = column.len() / 4;
            let sigma = *column.select_nth_unstable_by(place, f32::total_cmp).1 / 0.3186;
            let weight = column.len() as f32;
            weights += weight;
            sum += weight * sigma * sigma / 1.5;
            slope += weight * (32.0 * bin as f32 + 16.0);
        }
        // Half of it grows with the level (shot noise): few frames tell the share.
        let variance = (sum / weights.max(1.0)).max(0.3);
        [0.5 * variance, 0.5 * variance * weights / slope.max(1.0)]
    }

    /// Adds the places at which `gate` passes; `words` and `finder` are for its use, and `start_of` turns a blob
    /// into an outline.
    pub fn search(
        &mut self,
        view: &FrameView<'_>,
        gate: &ColourGate,
        (words, finder): (&mut Vec<u16>, &mut BlobFinder),
        start_of: impl Fn(&super::blobs::Blob) -> Option<Start>,
    ) {
        let height = view.height() & !1;
        let (kernel, words_per_row) = (self.kernel, self.words_per_row);
        self.inside.fill(0xffff);
        let pass = |words: &mut [u16], gate: &ColourGate| {
            for y in (0..height).step_by(2) {
                let row = &mut words[y / 2 * words_per_row..(y / 2 + 1) * words_per_row];
                // Words beyond the frame's right edge belong to no pixel.
                let covered = view.width().div_ceil(WORD_PX).min(row.len());
                row[covered..].fill(0);
                kernel.colour([view.row(y), view.row(y + 1)], gate, row);
            }
        };
        pass(&mut self.inside, gate);
        let channels = if self.format.red_at().is_some() { &CHANNELS[..] } else { &CHANNELS[..1] };
        for weights in channels {
            words.copy_from_slice(&self.inside);
            let mut level = THRESHOLDS.0;
            while level < THRESHOLDS.1 {
                // Each threshold leaves a part of what the last one left.
                pass(words, &ColourGate::new(self.format, &[(*weights, level)]));
                finder.find(words, words_per_row, 0..height / 2);
                for blob in finder.blobs() {
                    if !is_of_size(blob) {
                        continue;
                    }
                    if let Some(start) = start_of(blob).filter(|s| s.likeness >= LEAST_LIKENESS) {
                        self.add(start);
                    }
                }
                level *= STEP;
            }
        }
    }

    fn add(&mut self, start: Start) {
        let same = |single: &Single| {
            let (a, b) = (&single.start, &start);
            let [dx, dy] = [0, 1].map(|i| a.place.rectifier.anchor[i] - b.place.rectifier.anchor[i]);
            let (small, large) = (a.sweep.area().min(b.sweep.area()), a.sweep.area().max(b.sweep.area()));
            dx.hypot(dy) < 0.5 * f64::from(a.sweep.radius.min(b.sweep.radius)) && large < 1.7 * small
        };
        match self.found.iter().position(same) {
            Some(place) => {
                let single = &mut self.found[place];
                single.support += 1;
                if start.likeness > single.start.likeness {
                    single.start = start;
                }
            }
            None if self.found.len() < MAX_BLOBS => self.found.push(Single { start, support: 1 }),
            None => {}
        }
    }
}
