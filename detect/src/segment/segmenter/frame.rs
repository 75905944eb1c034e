//! The search of a whole frame.

use std::ops::Range;

use netcord_common::FrameView;

use super::{
    super::{
        blobs::BlobFinder,
        candidate::centre_px,
        colour::{MAX_MODELS, SceneLight},
        fit::Prior,
        kernel::ColourGate,
        score::{LEAST_SCORE, SCORE_THRESHOLD},
        singles::SingleFinder,
    },
    Found, Segmenter,
    starts::Backdrop,
};

/// Fits per frame, at most: the likeliest blobs come first.
pub(super) const MAX_FITS: usize = 5;

/// Fits per frame where nothing is known of the background.
pub(super) const MAX_FITS_ALONE: usize = 16;

/// Fits in a frame that stands for itself: pictures in no order leave time.
const MAX_FITS_SINGLE: usize = 100;

/// Fits of each colour among what moves, and the least rank that is worth one there.
const MAX_FITS_IN_CROWD: usize = 3;
const LIKELY_IN_CROWD: f32 = 0.15;

/// Fits beside a ball that is where it was expected, of what ranks so high.
const MAX_FITS_BESIDE: usize = 2;
const LIKELY_BESIDE: f32 = 0.3;

/// Share of marked cells from which on a frame shows another scene.
const OTHER_SCENE: f64 = 0.35;

/// A blob of more cells than this that is no ball may have a ball in front of it.
const CROWD_CELLS: u32 = 60;

impl Segmenter {
    /// Looks for what moves, in the whole frame; `expected`: the ball has been found where it was expected; `sought`: it
    /// was expected somewhere.
    pub(super) fn search_frame(&mut self, view: &FrameView<'_>, expected: bool, sought: bool) {
        if let Some(mut singles) = self.singles.take() {
            self.search_single(view, &mut singles);
            self.singles = Some(singles);
            return;
        }
        let height = view.height() & !1;
        let known = self.background.is_known();
        self.foreground.mark(view, &self.background);
        self.finder.find(self.foreground.words(), self.foreground.words_per_row(), 0..height / 2);
        let cells = (view.width() / 2 * (height / 2)) as f64;
        if known && (self.finder.overflowed() || self.finder.cells() as f64 > OTHER_SCENE * cells) {
            self.background.start_over(view);
            self.light = SceneLight::of(view);
            self.rest.clear();
            self.search_by_colour(view, None, &Prior::default());
            return;
        }
        self.starts.clear();
        self.collect_starts(view);
        if expected {
            let prior = Prior::default();
            self.measure_starts(view, Backdrop::Learnt, &prior, MAX_FITS_BESIDE, LIKELY_BESIDE);
            return;
        }
        self.measure_starts(view, Backdrop::Learnt, &Prior::default(), MAX_FITS, 0.0);
        if !known {
            self.search_by_colour(view, None, &Prior::default());
        } else if (sought || !self.has_ball_in_flight()) && self.crowded() {
            // What flies elsewhere than the ball should may be a hand.
            self.search_by_colour(view, Some((0..view.width(), 0..height)), &Prior::default());
        }
    }

    /// Looks for the ball in a frame that stands for itself.
    pub(super) fn search_single(&mut self, view: &FrameView<'_>, singles: &mut SingleFinder) {
        singles.clear();
        self.frame_noise = Some(SingleFinder::noise(view));
        let (gates, count) = self.gates(false);
        for gate in &gates[..count] {
            let mut finder = std::mem::replace(&mut self.finder, BlobFinder::empty());
            let mut words = std::mem::take(&mut self.coloured);
            singles.search(view, gate, (&mut words, &mut finder), |blob| {
                self.start_of(view, blob, centre_px(blob).map(|c| self.grid.frame_px(c)))
            });
            (self.finder, self.coloured) = (finder, words);
        }
        self.starts.clear();
        self.starts.extend(singles.sorted().iter().map(|single| single.start).take(MAX_FITS_SINGLE));
        for i in 0..self.starts.len() {
            let start = self.starts[i];
            let certain = |f: &Found| f.item.score > SCORE_THRESHOLD;
            if self.found.iter().any(|f| certain(f) && f.covers(start.place.rectifier.anchor)) {
                continue;
            }
            let found = self.measure(view, &start, Backdrop::Around, &Prior::default());
            if let Some(found) = found.filter(|f| f.item.score >= LEAST_SCORE) {
                self.add(found);
            }
        }
    }

    /// Gates for the ball's colours, and how many of them count.
    pub(super) fn gates(&self, in_a_crowd: bool) -> ([ColourGate; MAX_MODELS], usize) {
        let mut gates = [ColourGate::OPEN; MAX_MODELS];
        let mut count = 0;
        for gate in self.colour.gates(&self.light, in_a_crowd).take(MAX_MODELS) {
            gates[count] = gate;
            count += 1;
        }
        (gates, count)
    }

    /// Whether something large, or something that was no ball, moves.
    pub(super) fn crowded(&self) -> bool {
        self.finder.saw_larger()
            || self.finder.blobs().iter().any(|blob| {
                blob.cells > CROWD_CELLS
                    && !self.found.iter().any(|f| f.item.score > 0.3 && f.covers(centre_px(blob)))
            })
    }

    /// Looks for the ball's colours: among the marked cells of some columns and rows, or everywhere where no
    /// background is known.
    pub(super) fn search_by_colour(
        &mut self,
        view: &FrameView<'_>,
        among: Option<(Range<usize>, Range<usize>)>,
        prior: &Prior,
    ) {
        let everywhere = among.is_none();
        let (columns, rows) = among.unwrap_or((0..view.width(), 0..view.height() & !1));
        let (gates, count) = self.gates(!everywhere);
        for gate in &gates[..count] {
            self.foreground.pass(view, gate, (&columns, &rows), everywhere, &mut self.coloured);
            self.finder.find(&self.coloured, self.foreground.words_per_row(), rows.start / 2..rows.end / 2);
            self.starts.clear();
            self.collect_starts(view);
            let (most, least) = if everywhere {
                (MAX_FITS_ALONE / count.max(1), 0.0)
            } else {
                (MAX_FITS_IN_CROWD, LIKELY_IN_CROWD)
            };
            self.measure_starts(view, Backdrop::Around, prior, most, least);
        }
    }
}
