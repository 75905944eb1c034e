//! Where a streak goes on beyond what has been measured of it.

use netcord_common::Channel;

use super::{
    candidate::LONGEST_PATH_PX,
    measure::{Behind, Measured, Scene},
    patch::CHANNELS,
    sweep::Sweep,
};

/// Between two pieces of a streak, px: so long it may happen to look like what is behind it.
const GAP_PX: f32 = 24.0;

/// Share of the width of a streak in which it is surely seen.
const CORE: f32 = 0.7;

/// Evidence for a change, as the sum over colours of squared means in units of their variance: three are 3 by chance,
/// and more than this once in 50,000 places.
const CHANGED: f32 = 25.0;

/// Error of the light that is expected of a place, as a share.
const LIGHT_ERROR: f32 = 0.015;

impl Scene<'_> {
    /// A sweep that reaches as far as the background is seen to be changed along its path as the measured part
    /// changes it; none where that is no farther than it reaches itself, and where its direction or what is behind
    /// it is not known.
    pub fn beyond(&self, measured: &Measured) -> Option<Sweep> {
        let sweep = &measured.fit.sweep;
        if sweep.length < sweep.radius || matches!(self.behind, Behind::Around(_)) {
            return None;
        }
        let (sin, cos) = sweep.angle.sin_cos();
        let step = sweep.radius.max(3.0);
        let reaches = [-1.0, 1.0].map(|side: f32| {
            let (mut reach, mut at) = (0.0, 0.5 * step);
            while at < reach + GAP_PX.max(2.0 * sweep.radius) && sweep.length + at < LONGEST_PATH_PX {
                let along = side * (0.5 * sweep.length + sweep.radius + at);
                let centre = [sweep.centre[0] + along * cos, sweep.centre[1] + along * sin];
                if self.is_changed(measured, centre, [cos, sin], [0.5 * step, CORE * sweep.radius]) {
                    reach = at;
                }
                at += step;
            }
            reach
        });
        let [before, after] = reaches;
        let shift = 0.5 * (after - before);
        (before + after > 0.0).then(|| Sweep {
            centre: [sweep.centre[0] + shift * cos, sweep.centre[1] + shift * sin],
            length: sweep.length + before + after,
            ..*sweep
        })
    }

    /// Whether the background is changed in a rectangle of the patch, of half sides along a direction and across it,
    /// towards the levels of what has been measured.
    fn is_changed(
        &self,
        measured: &Measured,
        centre: [f32; 2],
        [cos, sin]: [f32; 2],
        [half_along, half_across]: [f32; 2],
    ) -> bool {
        let Behind::Learnt(background) = self.behind else { return false };
        let (width, height) = (self.view.width(), self.view.height());
        let (mut change, mut level, mut count) =
            ([0.0_f32; CHANNELS], [0.0_f32; CHANNELS], [0.0_f32; CHANNELS]);
        // Cells are 2 px wide; of large rectangles some are enough.
        let steps = |half: f32| ((half).ceil() as i32).clamp(1, 4);
        let (n, m) = (steps(half_along), steps(half_across));
        for i in 0..n {
            for j in 0..m {
                let of = |k: i32, n: i32, half: f32| ((2 * k + 1) as f32 / n as f32 - 1.0) * half;
                let (along, across) = (of(i, n, half_along), of(j, m, half_across));
                let place = [centre[0] + along * cos - across * sin, centre[1] + along * sin + across * cos];
                let [x, y] =
                    measured.place.rectifier.pixel(place.map(f64::from)).map(|p| self.grid.searched(p));
                let (Some(x), Some(y)) = (x, y) else { continue };
                if x + 1 >= width || y + 1 >= height {
                    continue;
                }
                let expected = background.expected_cell(x, y);
                for (k, expected) in expected.into_iter().enumerate() {
                    let (dx, dy) = (k % 2, k / 2);
                    let channel = match self.view.format().channel_at(dx, dy) {
                        Channel::Red | Channel::Luma => 0,
                        Channel::Green => 1,
                        Channel::Blue => 2,
                    };
                    let seen = f32::from(self.view.row(y + dy)[x + dx]);
                    change[channel] += seen - expected;
                    level[channel] += expected;
                    count[channel] += 1.0;
                }
            }
        }
        let noise = background.noise();
        let (mut evidence, mut agreement) = (0.0, 0.0);
        for c in (0..CHANNELS).filter(|c| count[*c] > 0.0) {
            let (mean, level) = (change[c] / count[c], level[c] / count[c]);
            let weight = 1.0 / (noise.sigma(level).powi(2) / count[c] + (LIGHT_ERROR * level).powi(2));
            let by_ball = measured.verdict.levels[c] - level;
            evidence += weight * mean * mean;
            agreement += weight * mean * by_ball;
        }
        evidence > CHANGED && agreement > 0.0
    }
}
