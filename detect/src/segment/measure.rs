//! Measures one candidate: gathers its pixels, fits the swept disc, and says how much it looks like a ball.

use nalgebra::Vector3;
use netcord_common::{Channel, FrameView, PixelFormat};

use super::{
    background::Background,
    candidate::{LONGEST_PATH_PX, Start},
    fit::{Fit, Prior, fit, fit_again},
    grid::Grid,
    noise::Noise,
    patch::{CHANNELS, MAX_SAMPLES, Patch, Rectifier, Sample, margin, near},
    size::LEAST_DIAMETER_PX,
    sphere::Place,
    sweep::Sweep,
    verdict::Verdict,
};

/// What lies behind the ball.
#[derive(Debug, Clone, Copy)]
pub enum Behind<'a> {
    /// The learnt background.
    Learnt(&'a Background),
    /// Nothing is known: what is seen around the candidate is taken to go on behind it.
    Around(&'a Noise),
}

/// A frame to measure in.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// The pixels.
    pub view: &'a FrameView<'a>,
    /// How they lie in the frame.
    pub grid: Grid,
    /// What is behind.
    pub behind: Behind<'a>,
    /// Largest diameter of a ball, px.
    pub most_px: f32,
}

/// A measured candidate.
#[derive(Debug, Clone, Copy)]
pub struct Measured {
    /// Where it is, and the map in which the outline was fitted.
    pub place: Place,
    /// The direction of the main light, in the camera's frame.
    pub light: Vector3<f64>,
    /// The outline.
    pub fit: Fit,
    /// How well the pixels agree with it.
    pub verdict: Verdict,
}

/// Part of the contrast by which even a right model is off: texture of the ball, blur of the lens.
const MODEL_ERROR: f32 = 0.03;

/// Turns of the light smaller than this change nothing that matters, rad.
const LEAST_TURN: f32 = 0.1;
/// Mean robust square residual, in units of the variance, of a fit that leaves nothing to be explained.
const GOOD_CHI2: f32 = 1.0;
/// Light weaker than this has no direction, DN.
const LEAST_LIGHT: f32 = 10.0;
/// Pixels that are enough to tell a ball from other things.
const GLANCE_SAMPLES: usize = 400;
/// Standard deviation of the centre from which on more pixels are worth their time, px.
const WORTH_MORE_PX: f64 = 0.03;
/// Looks again at most.
const MAX_LOOKS: usize = 1;
/// How often a streak is followed beyond its ends, and what may be left of it unexplained then.
const MAX_EXTENSIONS: usize = 2;
const WHOLE_MISFIT: f32 = 0.2;
/// Mean robust square residual of a fit that is not worth a second look.
const POOR_CHI2: f32 = 3.0;

/// The pixels of a cell.
const CELL: [(usize, usize); 4] = [(0, 0), (1, 0), (0, 1), (1, 1)];

/// A step along a row of cells per row, coprime with `n`, that spreads every `n`th cell evenly: about the
/// golden section of `n`.
fn lattice_step(n: usize) -> usize {
    let coprime = |step: usize| {
        let (mut a, mut b) = (step, n);
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a == 1
    };
    let golden = (n as f64 * 0.381_966).round().max(1.0) as usize;
    (golden..=n).find(|step| coprime(*step)).unwrap_or(1)
}

impl Scene<'_> {
    /// Takes about `wanted` of the pixels on and around a sweep into the patch, spread evenly.
    fn gather(&self, patch: &mut Patch, rectifier: &Rectifier, sweep: &Sweep, wanted: usize) {
        let reach = margin(sweep.radius);
        let whole = Sweep { radius: sweep.radius + reach, ..*sweep };
        let per_pixel = (self.grid.scale * self.grid.scale) as f32;
        let decimation = (whole.area() * per_pixel / wanted as f32).ceil().max(1.0) as usize;
        patch.clear(decimation);
        let [half_width, half_height] = rectifier.half_extent_px(f64::from(whole.radius));
        let path = rectifier.offset_px(sweep.path().map(f64::from));
        let centre = rectifier.pixel(sweep.centre.map(f64::from));
        let (half_width, half_height) = (half_width + 0.5 * path[0].abs(), half_height + 0.5 * path[1].abs());
        let columns = self.grid.range(centre[0] - half_width, centre[0] + half_width, self.view.width() & !1);
        let rows = self.grid.range(centre[1] - half_height, centre[1] + half_height, self.view.height() & !1);
        let (sin, cos) = sweep.angle.sin_cos();
        let lattice = lattice_step(decimation);
        let channels = CELL.map(|(x, y)| match self.view.format().channel_at(x, y) {
            Channel::Red | Channel::Luma => 0,
            Channel::Green => 1,
            Channel::Blue => 2,
        });
        // From one pixel of a cell to the next.
        let step = (self.grid.place(1) - self.grid.place(0)) as f32;
        let [[a, b], [c, d]] = rectifier.forward.map(|row| row.map(|m| m as f32));
        'rows: for cell_y in rows.step_by(2) {
            // A lattice of rank one: every `decimation`th cell of a row, shifted from row to row.
            let first = columns.start / 2;
            let shift = (cell_y / 2 * lattice + first) % decimation;
            let skipped = (decimation - shift) % decimation;
            let seen = [self.view.row(cell_y), self.view.row(cell_y + 1)];
            let down = (self.grid.place(cell_y) - rectifier.anchor[1]) as f32;
            for cell_x in (columns.start + 2 * skipped..columns.end).step_by(2 * decimation) {
                let along = (self.grid.place(cell_x) - rectifier.anchor[0]) as f32;
                // Its pixels belong together: where its middle is near enough, all four are taken.
                let (x, y) = (along + 0.5 * step, down + 0.5 * step);
                if !near(sweep, [cos, sin], reach, a * x + b * y, c * x + d * y) {
                    continue;
                }
                let levels = CELL.map(|(dx, dy)| f32::from(seen[dy][cell_x + dx]));
                let behind = match self.behind {
                    Behind::Learnt(background) => background.expected_cell(cell_x, cell_y),
                    Behind::Around(_) => levels,
                };
                for (i, (dx, dy)) in CELL.into_iter().enumerate() {
                    let (x, y) = (along + dx as f32 * step, down + dy as f32 * step);
                    let rectified = [a * x + b * y, c * x + d * y];
                    let sample =
                        Sample { rectified, channel: channels[i], seen: levels[i], background: behind[i] };
                    if !patch.push(&sample) {
                        break 'rows;
                    }
                }
            }
        }
        let noise = *self.noise();
        patch.finish(|seen, background| {
            noise.sigma(seen.max(background)) + MODEL_ERROR * (seen - background).abs()
        });
        if let Behind::Around(noise) = self.behind {
            continue_around(patch, sweep, noise);
        }
    }

    fn noise(&self) -> &Noise {
        match self.behind {
            Behind::Learnt(background) => background.noise(),
            Behind::Around(noise) => noise,
        }
    }

    /// Measures a candidate from some of its pixels; `prior` is what the search window says of its size. None
    /// where nothing round can be fitted.
    pub fn glance(
        &self,
        patch: &mut Patch,
        start: &Start,
        prior: &Prior,
        light: &Vector3<f64>,
    ) -> Option<Measured> {
        patch.light = start.place.light(light);
        let found = self.settle(patch, &start.place.rectifier, start.sweep, None, prior, GLANCE_SAMPLES)?;
        Some(self.judge(patch, start.place, found, light))
    }

    /// Measures along all of a streak of which only a part has been measured: where its contrast is low, the marks
    /// of one streak are several. The same where it does not go on, goes on as no ball does, or farther than
    /// `allows` says; `patch` holds the pixels of what is given back.
    pub fn follow(
        &self,
        patch: &mut Patch,
        glanced: Measured,
        prior: &Prior,
        allows: impl Fn(&Sweep) -> bool,
    ) -> Measured {
        let mut best = glanced;
        for _ in 0..MAX_EXTENSIONS {
            let Some(longer) = self.beyond(&best).filter(&allows) else { break };
            let found = self.settle(patch, &best.place.rectifier, longer, None, prior, GLANCE_SAMPLES);
            let whole = found
                .filter(|found| found.sweep.length > best.fit.sweep.length)
                .map(|found| self.judge(patch, best.place, found, &best.light))
                .filter(|whole| {
                    whole.verdict.signal > best.verdict.signal
                        && whole.verdict.misfit < best.verdict.misfit.max(WHOLE_MISFIT)
                });
            let Some(whole) = whole else {
                // The pixels of the last one that held.
                self.gather(patch, &best.place.rectifier, &best.fit.sweep, GLANCE_SAMPLES);
                break;
            };
            best = whole;
        }
        best
    }

    /// Measures again, as well as the pixels allow: all of them where some leave the centre uncertain, and with
    /// the light turned to where they show it. The same where nothing better can be had.
    pub fn refine(&self, patch: &mut Patch, glanced: Measured, prior: &Prior) -> Measured {
        let (place, mut light, mut found) = (glanced.place, glanced.light, glanced.fit);
        let spread =
            found.covariance[0][0].max(found.covariance[1][1]).sqrt() * f64::from(found.chi2.max(1.0));
        if patch.decimation > 1 && spread > WORTH_MORE_PX {
            let wanted = MAX_SAMPLES * 4 / 5;
            match self.settle(patch, &place.rectifier, found.sweep, Some(found), prior, wanted) {
                Some(better) => found = better,
                None => return glanced,
            }
        }
        // The light's direction to first order, then anew from there.
        let turn = found.light_turn();
        if turn[0].hypot(turn[1]) > LEAST_TURN
            && found.chi2 > GOOD_CHI2
            && found.shading.iter().any(|s| s[3] > LEAST_LIGHT)
        {
            let turned = place.turned(&light, turn);
            patch.light = place.light(&turned);
            match fit_again(patch, &found, prior, &contrasts(patch, &found.sweep)) {
                Some(better) if better.chi2 <= found.chi2 && in_bounds(&better.sweep, self.most_px) => {
                    (found, light) = (better, turned);
                }
                _ => patch.light = place.light(&light),
            }
        }
        self.judge(patch, place, found, &light)
    }

    /// Fits, and looks again where the outline has moved to the edge of what was looked at: pixels around the
    /// outline decide.
    fn settle(
        &self,
        patch: &mut Patch,
        rectifier: &Rectifier,
        mut sweep: Sweep,
        mut before: Option<Fit>,
        prior: &Prior,
        wanted: usize,
    ) -> Option<Fit> {
        let mut rounds = 0;
        loop {
            self.gather(patch, rectifier, &sweep, wanted);
            let typical = contrasts(patch, &sweep);
            let found = match &before {
                Some(before) => fit_again(patch, before, prior, &typical),
                None => fit(patch, sweep, prior, &typical),
            }?;
            if !in_bounds(&found.sweep, self.most_px) {
                return None;
            }
            let shift =
                (found.sweep.centre[0] - sweep.centre[0]).hypot(found.sweep.centre[1] - sweep.centre[1]);
            let growth =
                (found.sweep.radius - sweep.radius).max(0.0).max(0.5 * (found.sweep.length - sweep.length));
            let turn = (found.sweep.angle - sweep.angle).sin().abs() * 0.5 * found.sweep.length;
            let around = matches!(self.behind, Behind::Around(_));
            let near = shift + growth + turn < 0.5 * margin(sweep.radius)
                && !(around && found.sweep.radius < 0.8 * sweep.radius);
            rounds += 1;
            if near || rounds > MAX_LOOKS || found.chi2 > POOR_CHI2 {
                return Some(found);
            }
            (sweep, before) = (found.sweep, Some(found));
        }
    }

    /// What a fit says of the candidate.
    fn judge(&self, patch: &Patch, place: Place, found: Fit, light: &Vector3<f64>) -> Measured {
        let mut verdict = Verdict::of(patch, &found);
        if self.view.format() == PixelFormat::Mono8 {
            for levels in [&mut verdict.levels, &mut verdict.behind, &mut verdict.around] {
                *levels = [levels[0]; CHANNELS];
            }
        }
        Measured { place, light: *light, fit: found, verdict }
    }
}

fn in_bounds(sweep: &Sweep, most_px: f32) -> bool {
    let diameter = 2.0 * sweep.radius;
    (LEAST_DIAMETER_PX..=most_px).contains(&diameter)
        && sweep.length <= LONGEST_PATH_PX
        && sweep.centre.iter().all(|c| c.is_finite())
}

/// The size of the ball's contrast by colour: the root mean square change over the patch's busier half, DN,
/// and where the ball covers a pixel only part of the time, so much more.
fn contrasts(patch: &Patch, sweep: &Sweep) -> [f64; CHANNELS] {
    let covered = f64::from(2.0 * sweep.radius / (2.0 * sweep.radius + sweep.length));
    patch.channels.each_ref().map(|samples| {
        let square =
            samples.seen.iter().zip(&samples.background).map(|(s, b)| f64::from(s - b).powi(2)).sum::<f64>();
        ((2.0 * square / (samples.len().max(1) as f64)).sqrt() + 5.0) / covered
    })
}

/// Gives the patch a background where none is known: by colour, the plane through what is seen around the
/// sweep; what strays from it counts as noise.
fn continue_around(patch: &mut Patch, sweep: &Sweep, noise: &Noise) {
    let (sin, cos) = sweep.angle.sin_cos();
    let gap = 0.3 * margin(sweep.radius);
    for samples in &mut patch.channels {
        let n = samples.len();
        let mut plane = [0.0_f32; 3];
        let mut spread = 0.0_f32;
        for round in 0..3 {
            let (mut a, mut b) = ([[0.0_f64; 3]; 3], [0.0_f64; 3]);
            let (mut left, mut weights) = (0.0_f64, 0.0_f64);
            for i in 0..n {
                let (x, y) = (samples.x[i], samples.y[i]);
                if samples.inverse_sigma[i] <= 0.0 || near(sweep, [cos, sin], gap, x, y) {
                    continue;
                }
                let seen = samples.seen[i];
                let residual = seen - (plane[0] + plane[1] * x + plane[2] * y);
                let weight = if round == 0 {
                    1.0
                } else {
                    1.0 / (1.0 + f64::from(residual / (1.5 * spread.max(1.0))).powi(2))
                };
                left += weight * f64::from(residual).powi(2);
                weights += weight;
                let row = [1.0, f64::from(x), f64::from(y)];
                for j in 0..3 {
                    for k in 0..3 {
                        a[j][k] += weight * row[j] * row[k];
                    }
                    b[j] += weight * row[j] * f64::from(seen);
                }
            }
            if round > 0 {
                spread = (left / weights.max(1.0)).sqrt() as f32;
            }
            // The slopes are tied to zero as strongly as three pixels at the patch's edge would.
            let tie = 3.0 * f64::from(sweep.radius + gap).powi(2);
            a[1][1] += tie;
            a[2][2] += tie;
            let mut inverse_times = nalgebra::Vector3::from(b);
            let matrix = nalgebra::Matrix3::from_fn(|j, k| a[j][k]);
            if let Some(solved) = matrix.cholesky() {
                solved.solve_mut(&mut inverse_times);
                plane = std::array::from_fn(|j| inverse_times[j] as f32);
            }
            if round == 0 {
                spread = 20.0;
            }
        }
        for i in 0..n {
            if samples.inverse_sigma[i] <= 0.0 {
                continue;
            }
            let seen = samples.seen[i];
            let background = (plane[0] + plane[1] * samples.x[i] + plane[2] * samples.y[i]).clamp(0.0, 255.0);
            samples.background[i] = background;
            let sigma =
                noise.sigma(seen.max(background)).hypot(spread) + MODEL_ERROR * (seen - background).abs();
            samples.inverse_sigma[i] = 1.0 / sigma;
        }
    }
}
