//! The search of the window in which the ball is expected.

use nalgebra::Vector2;
use netcord_common::{FrameView, wire::SearchWindow};

use super::{
    super::{
        candidate::Start,
        fit::Prior,
        score::SCORE_THRESHOLD,
        sphere,
        sweep::{MIN_LENGTH_PX, Sweep},
    },
    Segmenter,
    starts::Backdrop,
};

impl Segmenter {
    /// Measures inside a window: first where the ball should be, then what moves.
    pub(super) fn search_window(&mut self, view: &FrameView<'_>, window: &SearchWindow) {
        let prior = self.prior(window);
        let columns = self.grid.range(window.x0_px, window.x1_px, view.width());
        let rows = self.grid.range(window.y0_px, window.y1_px, view.height() & !1);
        self.background.look_at_light_within(view, &columns, &rows);
        if let Some(expected) = self.expected(window) {
            for backdrop in [Backdrop::Learnt, Backdrop::Around] {
                // Whatever happens to be there is near the prediction: only what surely is a ball counts.
                let Some(found) = self.measure(view, &expected, backdrop, &prior) else { continue };
                if found.item.score >= SCORE_THRESHOLD {
                    self.blur.learn(&found.item, window);
                    self.add(found);
                    return;
                }
            }
        }
        if columns.is_empty() || rows.is_empty() {
            return;
        }
        self.foreground.mark_within(view, &self.background, &columns, &rows);
        self.finder.find(
            self.foreground.words(),
            self.foreground.words_per_row(),
            rows.start / 2..rows.end / 2,
        );
        self.starts.clear();
        self.collect_starts(view);
        self.measure_starts(view, Backdrop::Learnt, &prior, 3, 0.0);
        if !self.has_ball_in_play() && self.crowded() {
            let place = Some((columns, rows));
            self.search_by_colour(view, place, &prior);
        }
    }

    /// The ball as it was predicted; none where its place is known to no more than its size.
    pub(super) fn expected(&self, window: &SearchWindow) -> Option<Start> {
        let radius = 0.5 * window.diameter_px as f32;
        let [uu, _, vv] = window.covariance_px2;
        let known = uu.max(vv).sqrt() < 0.5 * window.diameter_px;
        if radius < 1.0 || !known || !self.camera.contains(&Vector2::new(window.u_px, window.v_px)) {
            return None;
        }
        let place = sphere::place(&self.camera, [window.u_px, window.v_px]);
        let path = place.rectifier.rectify_offset(window.velocity_px_s.map(|v| v * self.blur.exposure_s()));
        let sweep = Sweep {
            centre: [0.0; 2],
            radius,
            length: (path[0].hypot(path[1]) as f32).max(MIN_LENGTH_PX),
            angle: path[1].atan2(path[0]) as f32,
        };
        Some(Start { place, sweep, likeness: 1.0, colour: 1.0, slow: false })
    }

    /// What a window says of the ball's size.
    pub(super) fn prior(&self, window: &SearchWindow) -> Prior {
        let diameter = window.diameter_px as f32;
        if diameter > 1.0 {
            // Prediction knows the depth to a few per cent.
            Prior { radius: Some((0.5 * diameter, 0.015 * diameter + 0.08)) }
        } else {
            Prior::default()
        }
    }
}
