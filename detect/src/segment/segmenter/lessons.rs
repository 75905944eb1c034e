//! What a frame teaches for the next one.

use netcord_common::{
    FrameView,
    wire::{Detection, SearchWindow},
};

use super::{
    super::{
        appearance::Appearance,
        background::PixelBox,
        measure::{Behind, Scene},
        score::is_gone,
    },
    Found, Segmenter,
};

/// Score of what surely is a ball; it may teach what balls look like here.
pub(super) const SURE: f64 = 0.6;

impl Segmenter {
    /// What the frame teaches for the next one.
    pub(super) fn after(&mut self, view: &FrameView<'_>, window: Option<&SearchWindow>) {
        if self.options.single_frames {
            return;
        }
        self.kept.clear();
        for found in &self.found {
            let item = &found.item;
            let place = [item.u_px, item.v_px];
            let frames = self.rest.frames_at(place, item.diameter_px);
            self.rest.see(place, item.diameter_px);
            let area = self.pixel_box(item, view);
            if is_gone(&found.measured) {
                if frames >= 4 {
                    self.background.replace(view, &area);
                }
                continue;
            }
            if self.kept.len() < self.kept.capacity() && item.score > 0.15 {
                self.kept.push(area);
            }
        }
        if let Some(ball) = self.example(window) {
            self.colour.learn(ball.measured.verdict.levels);
            // Lamps hang here and there: a running mean over about ten balls.
            let light = &mut self.appearance.towards_light;
            *light = (*light * 0.9 + ball.measured.light * 0.1).normalize();
            if self.appearance.is_due(self.background.frames()) {
                let scene = Scene {
                    view,
                    grid: self.grid,
                    behind: Behind::Learnt(&self.background),
                    most_px: self.ball.most_px,
                };
                scene.teach(&mut self.patch, &ball.measured, &mut self.appearance);
            }
        }
        self.background.learn(view, &self.kept);
    }

    /// The ball that shows what balls look like here. One camera alone takes a sleeve for a ball now and then, and
    /// would look for sleeves ever after: what it has learnt counts until a ball is found where its flight, which
    /// other cameras have seen, too, was expected; from then on only such balls teach.
    fn example(&mut self, window: Option<&SearchWindow>) -> Option<Found> {
        let best = *self.found.iter().max_by(|a, b| a.item.score.total_cmp(&b.item.score))?;
        let verdict = &best.measured.verdict;
        let clear = best.item.score > SURE
            && best.likeness > 0.25
            && verdict.misfit < 0.15
            && verdict.clutter < 0.2
            && self.background.is_known()
            && self.rest.frames_at(best.place(), best.item.diameter_px) <= 1;
        let followed = window.is_some_and(|window| best.is_expected(window));
        if !clear || self.has_followed && !followed {
            return None;
        }
        if followed && !self.has_followed {
            self.has_followed = true;
            self.colour.unlearn();
            self.appearance = Appearance::new(self.up);
        }
        Some(best)
    }

    pub(super) fn pixel_box(&self, item: &Detection, view: &FrameView<'_>) -> PixelBox {
        let x = self.grid.range(item.x0_px - 1.0, item.x1_px + 1.0, view.width());
        let y = self.grid.range(item.y0_px - 1.0, item.y1_px + 1.0, view.height());
        PixelBox { x0: x.start, y0: y.start, x1: x.end, y1: y.end }
    }
}
