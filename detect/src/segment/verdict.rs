#[cfg(target_arch = "x86_64")]
use super::lanes::{Avx2, Avx2Lanes};
#[cfg(target_arch = "aarch64")]
use super::lanes::{Neon, NeonLanes};
use super::{
    fit::Fit,
    lanes::{LANES, Lanes, Plain, PlainLanes},
    patch::{CHANNELS, Patch},
    sweep::Coverer,
};

/// How well the pixels of a patch agree with what was fitted to them.
#[derive(Debug, Clone, Copy, Default)]
pub struct Verdict {
    /// Mean level of the ball by colour, DN.
    pub levels: [f32; CHANNELS],
    /// Mean level of what is behind it, DN.
    pub behind: [f32; CHANNELS],
    /// Mean level seen around it, DN.
    pub around: [f32; CHANNELS],
    /// Root mean square of what the fit leaves beyond noise, as a share of what the ball changes.
    pub misfit: f32,
    /// The ball's change against the background, in standard deviations.
    pub signal: f32,
    /// Share of the pixels around the outline that differ from the background.
    pub clutter: f32,
    /// Share of the swept area in which the fit does not hold.
    pub hidden: f32,
    /// Whether pixels inside are saturated.
    pub saturated: bool,
}

/// Below this share of cover a pixel is beside the ball.
const BESIDE: f32 = 0.01;
/// A difference of more standard deviations than this is none of noise.
const STRAY_SIGMAS: f32 = 4.0;
/// The level from which on a pixel is saturated, DN.
const SATURATED: f32 = 253.5;

impl Verdict {
    /// Of a fit to the pixels of `patch`.
    pub fn of(patch: &Patch, fit: &Fit) -> Self {
        #[cfg(target_arch = "x86_64")]
        if let Some(level) = Avx2::detect() {
            // SAFETY: just asked.
            return unsafe { verdict_avx2(level, patch, fit) };
        }
        #[cfg(target_arch = "aarch64")]
        if let Some(level) = Neon::detect() {
            return verdict_body::<NeonLanes>(level, patch, fit);
        }
        verdict_body::<PlainLanes>(Plain, patch, fit)
    }
}

/// # Safety
/// The processor has AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn verdict_avx2(level: Avx2, patch: &Patch, fit: &Fit) -> Verdict {
    verdict_body::<Avx2Lanes>(level, patch, fit)
}

#[inline(always)]
fn verdict_body<L: Lanes>(level: L::Level, patch: &Patch, fit: &Fit) -> Verdict {
    let all = |value| L::all(level, value);
    // The share of the exposure for which the ball covers its path's middle.
    let peak = (2.0 * fit.sweep.radius / fit.sweep.length.max(1e-3)).min(1.0);
    let zero = all(0.0);
    let one = all(1.0);
    let strays = |z: L| one.where_positive(z * z - all(STRAY_SIGMAS * STRAY_SIGMAS));
    let mut out = Verdict::default();
    let [mut left, mut changed, mut signal] = [zero; 3];
    let [mut inside, mut hidden, mut outside, mut clutter, mut saturated] = [zero; 5];
    for (channel, samples) in patch.channels.iter().enumerate() {
        let coverer = Coverer::new(level, &fit.sweep, &patch.look, channel);
        let terms = fit.shading[channel].map(all);
        let [mut own, mut behind, mut covered, mut around, mut beside] = [zero; 5];
        for at in (0..samples.len()).step_by(LANES) {
            let coverage = coverer.at(L::load(level, &samples.x, at), L::load(level, &samples.y, at));
            let inverse_sigma = L::load(level, &samples.inverse_sigma, at);
            let seen = L::load(level, &samples.seen, at);
            let background = L::load(level, &samples.background, at);
            // Ones and zeros: padding is neither on the ball nor beside it.
            let known = one.where_positive(inverse_sigma);
            let on = known.where_positive(coverage.alpha - all(BESIDE));
            let off = known - on;
            let core = on.where_positive(coverage.alpha - all(0.5 * peak));

            let difference = seen - background;
            around = off.times_plus(seen, around);
            beside = beside + off;
            clutter = off.times_plus(strays(difference * inverse_sigma), clutter);

            let mut ball = zero;
            for (term, place) in terms.iter().zip(&coverage.place) {
                ball = term.times_plus(*place, ball);
            }
            let model = coverage.alpha.times_plus(ball - background, background).min(all(255.0));
            let residual = seen - model;
            // What noise explains is not the shape's fault.
            let variance = (inverse_sigma * inverse_sigma).max(all(1e-9)).recip();
            left = on.times_plus(residual * residual - variance, left);
            changed = on.times_plus(difference * difference, changed);
            let change = (model - background) * inverse_sigma;
            signal = on.times_plus(change * change, signal);
            let share = on * coverage.alpha;
            own = share.times_plus(ball, own);
            behind = share.times_plus(background, behind);
            covered = covered + share;
            inside = inside + core;
            hidden = core.times_plus(strays(residual * inverse_sigma), hidden);
            saturated = saturated + core.where_positive(seen - all(SATURATED));
        }
        let covered = covered.sum().max(1e-3);
        out.levels[channel] = own.sum() / covered;
        out.behind[channel] = behind.sum() / covered;
        out.around[channel] = around.sum() / beside.sum().max(1.0);
        outside = outside + beside;
    }
    out.misfit = (left.sum().max(0.0) / changed.sum().max(1.0)).sqrt();
    out.signal = (signal.sum() * patch.decimation as f32).sqrt();
    out.clutter = clutter.sum() / outside.sum().max(1.0);
    out.hidden = hidden.sum() / inside.sum().max(1.0);
    out.saturated = saturated.sum() > 0.0;
    out
}

#[cfg(test)]
mod tests {
    use super::{
        super::{fit::OUTLINE, sweep::Sweep},
        *,
    };

    #[test]
    fn vectors_give_the_verdict_of_plain_rust() {
        for seed in 0..20 {
            let patch = Patch::of_noise(seed);
            let fit = Fit {
                sweep: Sweep { centre: [0.3, -1.2], radius: 7.0, length: seed as f32, angle: 0.4 },
                shading: [[90.0, 4.0, -3.0, 60.0, 5.0, -8.0]; CHANNELS],
                covariance: [[0.0; OUTLINE]; OUTLINE],
                chi2: 1.0,
            };
            let plain = verdict_body::<PlainLanes>(Plain, &patch, &fit);
            // Printed, numbers are apart where their bits are.
            assert_eq!(format!("{:?}", Verdict::of(&patch, &fit)), format!("{plain:?}"));
        }
    }
}
