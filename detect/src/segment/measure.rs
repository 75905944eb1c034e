//! Measures one candidate: gathers its pixels, fits the swept disc, and says how much it looks like a ball.

use nalgebra::Vector3;
use netcord_common::{Channel, FrameView, PixelFormat};

use super::{
    background::Background,
    candidate::{DIAMETER_PX, LONGEST_PATH_PX, Start},
    fit::{Fit, Prior, fit},
    grid::Grid,
    lanes::{LANES, Lanes},
    noise::Noise,
    patch::{CHANNELS, MAX_SAMPLES, Patch, Rectifier, Sample, margin, near},
    sphere::Place,
    sweep::{Coverer, Sweep},
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
    /// Mean level of the ball by colour (red, green, blue), DN.
    pub levels: [f32; CHANNELS],
    /// Mean level of what is behind it, DN.
    pub behind: [f32; CHANNELS],
    /// Mean level seen around it, DN.
    pub around: [f32; CHANNELS],
    /// Root mean square of what the fit leaves, as a share of what the ball changes.
    pub misfit: f32,
    /// The ball's change against the background, in standard deviations.
    pub signal: f32,
    /// Share of the pixels around the outline that differ from the background.
    pub clutter: f32,
    /// Share of the swept area in which the fit does not hold: something else is in front.
    pub hidden: f32,
    /// Whether pixels inside are saturated.
    pub saturated: bool,
}

/// Part of the contrast by which even a right model is off: texture of the ball, blur of the lens.
const MODEL_ERROR: f32 = 0.03;

/// Turns of the light smaller than this change nothing that matters, rad.
const LEAST_TURN: f32 = 0.1;
/// Most turns of the light for one candidate.
const MAX_TURNS: usize = 2;

impl Scene<'_> {
    /// Takes the pixels on and around a sweep into the patch.
    fn gather(&self, patch: &mut Patch, rectifier: &Rectifier, sweep: &Sweep) {
        let reach = margin(sweep.radius);
        let whole = Sweep { radius: sweep.radius + reach, ..*sweep };
        let per_pixel = (self.grid.scale * self.grid.scale) as f32;
        let decimation =
            (whole.area() * per_pixel / (0.8 * MAX_SAMPLES as f32)).sqrt().ceil().max(1.0) as usize;
        patch.clear(decimation);
        let [half_width, half_height] = rectifier.half_extent_px(f64::from(whole.radius));
        let path = rectifier.offset_px(sweep.path().map(f64::from));
        let centre = rectifier.pixel(sweep.centre.map(f64::from));
        let (half_width, half_height) = (half_width + 0.5 * path[0].abs(), half_height + 0.5 * path[1].abs());
        let columns = self.grid.range(centre[0] - half_width, centre[0] + half_width, self.view.width() & !1);
        let rows = self.grid.range(centre[1] - half_height, centre[1] + half_height, self.view.height() & !1);
        let (sin, cos) = sweep.angle.sin_cos();
        let noise = self.noise();
        'rows: for y in rows {
            if !(y / 2).is_multiple_of(decimation) {
                continue;
            }
            let row = self.view.row(y);
            let place_y = self.grid.place(y);
            for x in columns.clone() {
                if !(x / 2).is_multiple_of(decimation) {
                    continue;
                }
                let place = [self.grid.place(x), place_y];
                let [u, v] = rectifier.rectify(place);
                if !near(sweep, [cos, sin], reach, u as f32, v as f32) {
                    continue;
                }
                let seen = f32::from(row[x]);
                let background = match self.behind {
                    Behind::Learnt(background) => background.expected(x, y),
                    Behind::Around(_) => seen,
                };
                let sigma = noise.sigma(seen.max(background)) + MODEL_ERROR * (seen - background).abs();
                let channel = match self.view.format().channel_at(x, y) {
                    Channel::Red | Channel::Luma => 0,
                    Channel::Green => 1,
                    Channel::Blue => 2,
                };
                if !patch.push(rectifier, &Sample { place, channel, seen, background, sigma }) {
                    break 'rows;
                }
            }
        }
        patch.pad();
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

    /// Measures a candidate; `prior` is what the search window says of its size. None where nothing round
    /// can be fitted.
    pub fn measure(
        &self,
        patch: &mut Patch,
        start: &Start,
        prior: &Prior,
        light: &Vector3<f64>,
    ) -> Option<Measured> {
        let mut sweep = start.sweep;
        let mut light = *light;
        patch.light = start.place.light(&light);
        self.gather(patch, &start.place.rectifier, &sweep);
        let mut found = fit_either(patch, &sweep, prior)?;
        // Pixels around the outline decide: where it moved to the patch's edge, look again.
        let reach = margin(sweep.radius);
        for _ in 0..2 {
            let shift =
                (found.sweep.centre[0] - sweep.centre[0]).hypot(found.sweep.centre[1] - sweep.centre[1]);
            let growth =
                (found.sweep.radius - sweep.radius).max(0.0).max(0.5 * (found.sweep.length - sweep.length));
            let turn = (found.sweep.angle - sweep.angle).sin().abs() * 0.5 * found.sweep.length;
            let around = matches!(self.behind, Behind::Around(_));
            if shift + growth + turn < 0.5 * reach && !(around && found.sweep.radius < 0.8 * sweep.radius) {
                break;
            }
            sweep = found.sweep;
            if !in_bounds(&sweep) {
                return None;
            }
            self.gather(patch, &start.place.rectifier, &sweep);
            found = fit_either(patch, &sweep, prior)?;
        }
        // The light's direction to first order, then anew from there.
        for _ in 0..MAX_TURNS {
            let turn = found.light_turn();
            if turn[0].hypot(turn[1]) < LEAST_TURN || found.shading.iter().all(|s| s[3] < 10.0) {
                break;
            }
            let turned = start.place.turned(&light, turn);
            patch.light = start.place.light(&turned);
            let Some(better) = fit(patch, found.sweep, found.moving, prior, &contrasts(patch, &found.sweep))
            else {
                break;
            };
            if better.chi2 > found.chi2 {
                break;
            }
            (found, light) = (better, turned);
        }
        patch.light = start.place.light(&light);
        if !in_bounds(&found.sweep) {
            return None;
        }
        Some(self.judge(patch, start, found, &light))
    }

    fn judge(&self, patch: &Patch, start: &Start, found: Fit, light: &Vector3<f64>) -> Measured {
        let coverer = Coverer::new(&found.sweep, &patch.light);
        let peak = (2.0 * found.sweep.radius / found.sweep.length.max(1e-3)).min(1.0);
        let mut out = Measured {
            place: start.place,
            light: *light,
            fit: found,
            levels: [0.0; CHANNELS],
            behind: [0.0; CHANNELS],
            around: [0.0; CHANNELS],
            misfit: 1.0,
            signal: 0.0,
            clutter: 0.0,
            hidden: 0.0,
            saturated: false,
        };
        let (mut left, mut changed, mut signal) = (0.0_f32, 0.0_f32, 0.0_f32);
        let (mut inside, mut hidden, mut outside, mut clutter) = (0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32);
        for (channel, samples) in patch.channels.iter().enumerate() {
            let terms = found.shading[channel];
            let (mut behind, mut behind_weight, mut level) = (0.0, 0.0, 0.0);
            let (mut around, mut around_count) = (0.0, 0.0_f32);
            for at in (0..samples.len()).step_by(LANES) {
                let coverage = coverer.at(Lanes::load(&samples.x, at), Lanes::load(&samples.y, at));
                for lane in 0..LANES {
                    let inverse_sigma = samples.inverse_sigma[at + lane];
                    if inverse_sigma <= 0.0 {
                        continue;
                    }
                    let alpha = coverage.alpha.0[lane];
                    let (seen, background) = (samples.seen[at + lane], samples.background[at + lane]);
                    let difference = seen - background;
                    if alpha < 0.01 {
                        outside += 1.0;
                        around += seen;
                        around_count += 1.0;
                        clutter += f32::from(u8::from((difference * inverse_sigma).abs() > 4.0));
                        continue;
                    }
                    let ball: f32 =
                        terms.iter().zip(&coverage.place).map(|(term, place)| term * place.0[lane]).sum();
                    let model = (background + alpha * (ball - background)).min(255.0);
                    let residual = seen - model;
                    // What noise explains is not the shape's fault.
                    left += residual * residual - 1.0 / (inverse_sigma * inverse_sigma);
                    changed += difference * difference;
                    signal += ((model - background) * inverse_sigma).powi(2);
                    level += alpha * ball;
                    behind += alpha * background;
                    behind_weight += alpha;
                    if alpha > 0.5 * peak {
                        inside += 1.0;
                        hidden += f32::from(u8::from((residual * inverse_sigma).abs() > 4.0));
                        out.saturated |= seen > 253.5;
                    }
                }
            }
            out.levels[channel] = level / f32::max(behind_weight, 1e-3);
            out.behind[channel] = behind / f32::max(behind_weight, 1e-3);
            out.around[channel] = around / around_count.max(1.0);
        }
        out.misfit = (left.max(0.0) / changed.max(1.0)).sqrt();
        out.signal = (signal * (patch.decimation * patch.decimation) as f32).sqrt();
        out.clutter = clutter / outside.max(1.0);
        out.hidden = hidden / inside.max(1.0);
        if self.view.format() == PixelFormat::Mono8 {
            out.levels = [out.levels[0]; CHANNELS];
            out.behind = [out.behind[0]; CHANNELS];
            out.around = [out.around[0]; CHANNELS];
        }
        out
    }
}

fn in_bounds(sweep: &Sweep) -> bool {
    let diameter = 2.0 * sweep.radius;
    (DIAMETER_PX.0..=DIAMETER_PX.1).contains(&diameter)
        && sweep.length <= LONGEST_PATH_PX
        && sweep.centre.iter().all(|c| c.is_finite())
}

/// Robust mean square residual, in units of the variance, of a fit that leaves nothing to be explained.
const GOOD_CHI2: f32 = 1.0;

/// Fits with or without a path, as the pixels want it.
fn fit_either(patch: &Patch, start: &Sweep, prior: &Prior) -> Option<Fit> {
    let typical = contrasts(patch, start);
    let moving = start.length > 0.7 * start.radius;
    let first = fit(patch, *start, moving, prior, &typical);
    match first {
        Some(found) if found.moving && found.sweep.length > 1.0 => Some(found),
        // A path that has shrunk to nothing is none: with none there is less to be determined.
        Some(found) if found.moving => fit(patch, found.sweep, false, prior, &typical).or(Some(found)),
        // A short path that the pixels do not ask for would only widen the covariance.
        Some(still) if still.chi2 < GOOD_CHI2 && start.length < 0.45 * start.radius => Some(still),
        Some(still) => {
            let length = (0.6 * start.radius).max(start.length).max(1.5);
            let guess = Sweep { length, angle: start.angle, ..still.sweep };
            match fit(patch, guess, true, prior, &typical) {
                // Two parameters more must earn their place.
                Some(swept)
                    if swept.sweep.length > 0.8
                        && (swept.chi2 < 0.9 * still.chi2
                            || (swept.chi2 - still.chi2) * (patch.count as f32) < -12.0 * swept.chi2) =>
                {
                    Some(swept)
                }
                _ => Some(still),
            }
        }
        None => fit(patch, *start, !moving, prior, &typical),
    }
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
