//! Measures one candidate: gathers its pixels, fits the swept disc, and says how much it looks like a ball.

use nalgebra::Vector3;
use netcord_common::{Channel, FrameView, PixelFormat};

use super::{
    appearance::Appearance,
    background::Background,
    behind::{continue_around, darken_by_shadow},
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
pub const MODEL_ERROR: f32 = 0.03;

/// Turns of the light smaller than this change nothing that matters, rad.
const LEAST_TURN: f32 = 0.1;
/// Mean robust square residual, in units of the variance, of a fit that leaves nothing to be explained.
const GOOD_CHI2: f32 = 1.0;
/// Light weaker than this has no direction, DN.
const LEAST_LIGHT: f32 = 10.0;
/// Pixels that are enough to tell a ball from other things.
const GLANCE_SAMPLES: usize = 400;
/// Pixels that all are looked at where the ball is expected.
const FEW_SAMPLES: usize = 1000;
/// Standard deviation of the centre from which on more pixels are worth their time, px.
const WORTH_MORE_PX: f64 = 0.015;
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
        let [bend_x, bend_y] = rectifier.bend.map(|terms| terms.map(|m| m as f32));
        let bent = |[xx, xy, yy]: [f32; 3], x: f32, y: f32| x * (xx * x + xy * y) + yy * y * y;
        let rectify =
            |x: f32, y: f32| [a * x + b * y + bent(bend_x, x, y), c * x + d * y + bent(bend_y, x, y)];
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
                let [x, y] = rectify(along + 0.5 * step, down + 0.5 * step);
                if !near(sweep, [cos, sin], reach, x, y) {
                    continue;
                }
                let levels = CELL.map(|(dx, dy)| f32::from(seen[dy][cell_x + dx]));
                let behind = match self.behind {
                    Behind::Learnt(background) => background.expected_cell(cell_x, cell_y),
                    Behind::Around(_) => levels,
                };
                for (i, (dx, dy)) in CELL.into_iter().enumerate() {
                    let rectified = rectify(along + dx as f32 * step, down + dy as f32 * step);
                    let sample =
                        Sample { rectified, channel: channels[i], seen: levels[i], background: behind[i] };
                    if !patch.push(&sample) {
                        break 'rows;
                    }
                }
            }
        }
        if let Behind::Learnt(_) = self.behind {
            darken_by_shadow(patch, sweep);
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
        appearance: &Appearance,
    ) -> Option<Measured> {
        let light = &appearance.towards_light;
        patch.look = appearance.look(&start.place, light);
        let reach = start.sweep.radius + margin(start.sweep.radius);
        let few = Sweep { radius: reach, ..start.sweep }.area() < FEW_SAMPLES as f32;
        // Where the ball is expected, it most likely is: its pixels will be looked at anyway.
        let wanted = if prior.radius.is_some() && few { FEW_SAMPLES } else { GLANCE_SAMPLES };
        let found = self.settle(patch, &start.place.rectifier, start.sweep, None, prior, wanted)?;
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
            patch.look.light = place.light(&turned);
            match fit_again(patch, &found, prior, &contrasts(patch, &found.sweep)) {
                Some(better) if better.chi2 <= found.chi2 && in_bounds(&better.sweep, self.most_px) => {
                    (found, light) = (better, turned);
                }
                _ => patch.look.light = place.light(&light),
            }
        }
        self.judge(patch, place, found, &light)
    }

    /// Lets the appearance of balls be learnt from one that was measured.
    pub fn teach(&self, patch: &mut Patch, ball: &Measured, appearance: &mut Appearance) {
        let (place, fit) = (&ball.place, &ball.fit);
        patch.look = appearance.look(place, &ball.light);
        self.gather(patch, &place.rectifier, &fit.sweep, FEW_SAMPLES);
        let typical = contrasts(patch, &fit.sweep);
        appearance.learn(patch, place, fit, &typical);
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
