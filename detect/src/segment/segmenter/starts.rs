//! What is worth measuring, and measuring it.

use netcord_common::{
    FrameView,
    wire::{Detection, DetectionFlags, SearchWindow},
};

use super::{
    super::{
        blobs::Blob,
        blur::BlurLimit,
        candidate::{Start, centre_px, is_of_size, start},
        colour::cell_colour,
        describe::describe,
        fit::Prior,
        measure::{Behind, Measured, Scene},
        outline::Outline,
        score::{LEAST_SCORE, SCORE_THRESHOLD, score, single_score},
        sphere,
        sweep::Sweep,
        verdict::Verdict,
    },
    Found, Segmenter,
    lessons::SURE,
};

/// Rank of a start up to which it is looked at only where nothing better is found, and how many such.
const UNLIKELY: f32 = 0.03;
const MAX_UNLIKELY: usize = 3;

/// Frames in one place after which a candidate no longer makes others unlikely.
const FEW_FRAMES: u32 = 3;

/// Score from which on a better measurement is worth its time.
const WORTH_REFINING: f64 = 0.3;

/// While a ball flies, what lies or rolls elsewhere is measured in one frame of so many.
const SLOW_EVERY: u64 = 4;

/// By how much the rim of a ball may be sharper or softer than it is taken for, px.
const RIM_PX: f32 = 0.7;

/// Share of a mosaic's pixels that have the colour of least pixels.
const SHARE_OF_COLOUR: f32 = 0.25;

/// What is left of the score of something that stays where it is.
const AT_REST_SHARE: f64 = 0.4;

/// What a candidate is held against.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Backdrop {
    /// The learnt background.
    Learnt,
    /// What is seen around it: the learnt background is hidden by what moves, or not known.
    Around,
}

impl Segmenter {
    /// Turns the finder's blobs into starts, the likeliest first.
    pub(super) fn collect_starts(&mut self, view: &FrameView<'_>) {
        for blob in self.finder.blobs() {
            if !is_of_size(blob) {
                continue;
            }
            let centre = centre_px(blob).map(|c| self.grid.frame_px(c));
            if self.found.iter().any(|f| f.covers(centre)) {
                continue;
            }
            if let Some(start) = self.start_of(view, blob, centre) {
                self.starts.push(start);
            }
        }
        self.starts.sort_unstable_by(|a, b| {
            b.rank()
                .total_cmp(&a.rank())
                .then(a.place.rectifier.anchor[0].total_cmp(&b.place.rectifier.anchor[0]))
        });
    }

    pub(super) fn start_of(&self, view: &FrameView<'_>, blob: &Blob, centre: [f64; 2]) -> Option<Start> {
        let start = start(blob, self.grid.scale, &sphere::place(&self.camera, centre), &self.ball)?;
        if !self.blur.allows(&start.sweep, BlurLimit::OF_A_START) {
            return None;
        }
        let colour = if self.background.is_known() { self.glimpse(view, &start) } else { 1.0 };
        let slow = self.is_slow(&start);
        Some(Start { colour, slow, ..start })
    }

    /// How well a few cells of a start agree with the ball's colour, 0–1.
    pub(super) fn glimpse(&self, view: &FrameView<'_>, start: &Start) -> f32 {
        // The share of the exposure for which the ball covers its path's middle.
        let cover = (2.0 * start.sweep.radius / start.sweep.length.max(0.1)).min(1.0);
        let (mut mean, mut count) = ([0.0; 3], 0.0);
        for place in start.inside() {
            let [x, y] = place.map(|p| self.grid.searched(p));
            let (Some(x), Some(y)) = (x, y) else { continue };
            if x + 1 >= view.width() || y + 1 >= view.height() {
                continue;
            }
            let seen = cell_colour(view, x, y);
            let behind = self.background.expected_colour(view.format(), x, y);
            for i in 0..3 {
                mean[i] += behind[i] + (seen[i] - behind[i]) / cover;
            }
            count += 1.0;
        }
        if count > 0.0 { self.colour.likeness(&self.light, mean.map(|m| m / count), [0.0; 3]) } else { 0.0 }
    }

    /// How well a measured candidate's colour agrees with the ball's, 0–1.
    fn likeness(&self, measured: &Measured) -> f32 {
        let Verdict { levels, behind, .. } = &measured.verdict;
        let unsure = self.level_spread(&measured.fit.sweep, levels, behind);
        self.colour.likeness(&self.light, *levels, unsure)
    }

    /// How far off the levels of a candidate may be, one standard deviation, DN: by noise, and by what its rim, of
    /// which nobody knows how sharp it is, changes in the levels of a ball that hardly has anything but a rim.
    fn level_spread(&self, sweep: &Sweep, levels: &[f32; 3], behind: &[f32; 3]) -> [f32; 3] {
        let pixels = (sweep.area() * SHARE_OF_COLOUR).max(1.0);
        let rim = (RIM_PX / sweep.radius).powi(2);
        std::array::from_fn(|i| {
            let noise = self.background.noise().sigma(behind[i].max(levels[i])) / pixels.sqrt();
            noise.hypot(rim * (levels[i] - behind[i]))
        })
    }

    /// Measures the likeliest starts, `most` at most.
    pub(super) fn measure_starts(
        &mut self,
        view: &FrameView<'_>,
        backdrop: Backdrop,
        prior: &Prior,
        most: usize,
        least_rank: f32,
    ) {
        let looks_at_slow = self.background.frames().is_multiple_of(SLOW_EVERY);
        let mut fits = 0;
        for i in 0..self.starts.len() {
            let start = self.starts[i];
            if start.rank() < least_rank {
                break;
            }
            if start.slow && !looks_at_slow && self.has_ball_in_flight() {
                self.rest.see(start.place.rectifier.anchor, 2.0 * f64::from(start.sweep.radius));
                continue;
            }
            let unlikely = start.rank() <= UNLIKELY;
            if unlikely && self.has_ball_in_play() {
                break;
            }
            let enough = if unlikely { MAX_UNLIKELY } else { most };
            if fits >= enough {
                break;
            }
            if self.found.iter().any(|f| f.covers(start.place.rectifier.anchor)) {
                continue;
            }
            fits += 1;
            if let Some(found) = self.measure(view, &start, backdrop, prior) {
                self.add(found);
            }
        }
    }

    /// Measures one start; none where it does not look at all like a ball.
    pub(super) fn measure(
        &mut self,
        view: &FrameView<'_>,
        start: &Start,
        backdrop: Backdrop,
        prior: &Prior,
    ) -> Option<Found> {
        let behind = match backdrop {
            Backdrop::Learnt => Behind::Learnt(&self.background),
            Backdrop::Around => Behind::Around(self.background.noise()),
        };
        let scene = Scene { view, grid: self.grid, behind, most_px: self.ball.most_px };
        let glanced = scene.glance(&mut self.patch, start, prior, &self.appearance)?;
        let likeness = self.likeness(&glanced);
        let glanced_score = score(&glanced, likeness, &self.ball);
        if glanced_score < LEAST_SCORE {
            return None;
        }
        let measured = if glanced_score > WORTH_REFINING {
            let allows = |sweep: &Sweep| self.blur.allows(sweep, BlurLimit::OF_A_START);
            let followed = scene.follow(&mut self.patch, glanced, prior, allows);
            scene.refine(&mut self.patch, followed, prior)
        } else {
            glanced
        };
        if !self.blur.allows(&measured.fit.sweep, BlurLimit::OF_A_FIT) {
            return None;
        }
        let likeness = self.likeness(&measured);
        let score = match self.frame_noise {
            Some(noise) => {
                let light = measured.place.light(&measured.light);
                let rectifier = &measured.place.rectifier;
                let outline = Outline::look(view, self.grid, rectifier, &measured.fit, &light, noise)?;
                single_score(&measured, &outline, likeness, self.colour.diameter_px())
            }
            None => score(&measured, likeness, &self.ball),
        };
        let mut item = describe(&self.camera, &measured, score);
        if self.rest.is_at_rest([item.u_px, item.v_px], item.diameter_px) {
            item.flags |= DetectionFlags::AT_REST;
            item.score *= AT_REST_SHARE;
        }
        Some(Found { item, measured, likeness })
    }

    /// Whether one of the candidates is likely the ball in play.
    pub(super) fn has_ball_in_play(&self) -> bool {
        self.found.iter().any(|f| self.is_in_play(&f.item))
    }

    /// Whether one of the candidates surely is the ball that a window expects, and nothing that rolls or lies there.
    pub(super) fn has_expected(&self, window: &SearchWindow) -> bool {
        self.found.iter().any(|f| {
            f.item.score >= SURE
                && self.is_in_play(&f.item)
                && !self.is_slow_item(&f.item)
                && f.is_expected(window)
        })
    }

    /// Whether one of the candidates surely is a ball and has come from elsewhere faster than things roll.
    pub(super) fn has_ball_in_flight(&self) -> bool {
        self.found.iter().any(|f| f.item.score >= SURE && !self.is_slow_item(&f.item))
    }

    /// Whether a candidate was here in the last frame, or so near that no ball in flight takes so long.
    pub(super) fn is_slow_item(&self, item: &Detection) -> bool {
        self.rest.is_slow([item.u_px, item.v_px], item.diameter_px)
    }

    /// Whether something was here in the last frame, or so near that no ball in flight takes so long.
    pub(super) fn is_slow(&self, start: &Start) -> bool {
        self.rest.is_slow(start.place.rectifier.anchor, 2.0 * f64::from(start.sweep.radius))
    }

    /// Whether a candidate is likely the ball, and has not stayed where it is.
    pub(super) fn is_in_play(&self, item: &Detection) -> bool {
        item.score >= SCORE_THRESHOLD
            && self.rest.frames_at([item.u_px, item.v_px], item.diameter_px) < FEW_FRAMES
    }

    /// Keeps a candidate unless a better one stands in its place.
    pub(super) fn add(&mut self, new: Found) {
        if let Some(same) = self.found.iter_mut().find(|f| f.is_same(&new)) {
            if new.item.score > same.item.score {
                *same = new;
            }
        } else if self.found.len() < self.found.capacity() {
            self.found.push(new);
        }
    }
}
