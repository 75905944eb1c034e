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
                // Where the learnt background is all that is seen there is nothing in front of it.
                if backdrop == Backdrop::Around && !self.hides_background(view, &expected) {
                    break;
                }
                // Whatever happens to be there is near the prediction: only what surely is a ball counts, and, where
                // it is not its motion that sets it off, only one that moves as predicted.
                let Some(found) = self.measure(view, &expected, backdrop, &prior) else { continue };
                let moves =
                    backdrop == Backdrop::Learnt || moves_as(&expected.sweep, &found.measured.fit.sweep);
                if found.item.score >= SCORE_THRESHOLD && moves {
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

    /// Whether what is seen where a ball is expected differs from the learnt background.
    fn hides_background(&self, view: &FrameView<'_>, expected: &Start) -> bool {
        /// A difference of more standard deviations than this is none of noise.
        const STRAY_SIGMAS: f32 = 4.0;
        let noise = self.background.noise();
        expected.inside().into_iter().any(|place| {
            let [x, y] = place.map(|p| self.grid.searched(p));
            let (Some(x), Some(y)) = (x, y) else { return false };
            if x + 1 >= view.width() || y + 1 >= view.height() {
                return false;
            }
            let behind = self.background.expected_cell(x, y);
            [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().zip(behind).any(|((dx, dy), behind)| {
                let seen = f32::from(view.row(y + dy)[x + dx]);
                (seen - behind).abs() > STRAY_SIGMAS * noise.sigma(seen.max(behind))
            })
        })
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
        Some(Start { place, sweep, likeness: 1.0, colour: 1.0, slow: false, usual_px: self.ball.usual_px })
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

/// Whether a path is as long as the one that was expected, but for half the ball.
fn moves_as(expected: &Sweep, found: &Sweep) -> bool {
    let most = expected.radius + 0.5 * expected.length.max(found.length);
    let [a, b] = [expected.path(), found.path()];
    // A path does not tell its sense.
    let apart = |sign: f32| (a[0] - sign * b[0]).hypot(a[1] - sign * b[1]);
    apart(1.0).min(apart(-1.0)) <= most
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_alike_whatever_their_sense_and_no_longer_than_expected_but_for_the_ball() {
        let sweep = |length: f32, angle: f32| Sweep { centre: [0.0; 2], radius: 9.0, length, angle };
        let half_turn = std::f32::consts::PI;
        assert!(moves_as(&sweep(30.0, 0.3), &sweep(32.0, 0.4)));
        assert!(moves_as(&sweep(30.0, 0.3), &sweep(32.0, 0.4 + half_turn)));
        assert!(moves_as(&sweep(2.0, 0.0), &sweep(5.0, 1.5)));
        assert!(!moves_as(&sweep(1.0, 0.0), &sweep(45.0, 0.0)));
        assert!(!moves_as(&sweep(40.0, 0.0), &sweep(40.0, 1.5)));
    }
}
