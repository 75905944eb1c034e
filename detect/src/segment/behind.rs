//! What is behind a candidate, where the learnt background does not tell it alone.

use super::{
    measure::MODEL_ERROR,
    noise::Noise,
    patch::{CHANNELS, Patch, margin, near},
    sweep::Sweep,
};

/// Gives the patch a background where none is known: by colour, the plane through what is seen around the
/// sweep; what strays from it counts as noise.
pub fn continue_around(patch: &mut Patch, sweep: &Sweep, noise: &Noise) {
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

/// Light around a candidate, as a share of what is expected, below which it may lie in a shadow.
const DARKENED: f64 = 0.98;
/// Colours are darkened alike by a shadow: the brightest of them against the darkest, at most.
const ALIKE: f64 = 1.15;
/// Squares left of the differences around a candidate, at most, where they are those of a shadow.
const LEFT_BY_SHADOW: f64 = 0.4;
/// Darkest and brightest that a shadow leaves a surface, as shares.
const SHADOW: (f32, f32) = (0.3, 1.0);

/// Darkens the background where a shadow lies on all of what is around a candidate: a ball that is about to touch the
/// table throws one on it. A shadow darkens all colours alike, by a share that changes evenly from place to place.
pub fn darken_by_shadow(patch: &mut Patch, sweep: &Sweep) {
    // What is beside a piece of a streak may be the rest of the streak.
    if sweep.length > sweep.radius {
        return;
    }
    let (sin, cos) = sweep.angle.sin_cos();
    let gap = 0.4 * margin(sweep.radius);
    let beside = |x: f32, y: f32| !near(sweep, [cos, sin], gap, x, y);
    let mut ratios = [1.0; CHANNELS];
    let (mut seen_sum, mut behind_sum) = (0.0_f64, 0.0_f64);
    for (ratio, samples) in ratios.iter_mut().zip(&patch.channels) {
        let (mut seen, mut behind) = (0.0_f64, 0.0_f64);
        for i in 0..samples.seen.len() {
            let share = f64::from(u8::from(beside(samples.x[i], samples.y[i])));
            seen += share * f64::from(samples.seen[i]);
            behind += share * f64::from(samples.background[i]);
        }
        // Black tells nothing.
        *ratio = (seen + samples.seen.len() as f64) / (behind + samples.seen.len() as f64);
        seen_sum += seen;
        behind_sum += behind;
    }
    let (least, most) = ratios.iter().fold((f64::MAX, 0.0_f64), |(l, m), r| (l.min(*r), m.max(*r)));
    if seen_sum > DARKENED * behind_sum || most > ALIKE * least {
        return;
    }
    // Minimises the squares of seen − (a + b x + c y) background.
    let scale = 1.0 / (sweep.radius + 0.5 * sweep.length);
    let (mut normal, mut right) = (nalgebra::Matrix3::<f64>::zeros(), nalgebra::Vector3::<f64>::zeros());
    let (mut before, mut square) = (0.0, 0.0);
    for samples in &patch.channels {
        for i in 0..samples.seen.len() {
            let (x, y) = (samples.x[i], samples.y[i]);
            if !beside(x, y) {
                continue;
            }
            let (seen, behind) = (f64::from(samples.seen[i]), f64::from(samples.background[i]));
            let row = nalgebra::Vector3::new(1.0, f64::from(x * scale), f64::from(y * scale)) * behind;
            normal += row * row.transpose();
            right += row * seen;
            square += seen * seen;
            before += (seen - behind).powi(2);
        }
    }
    let Some(solved) = normal.cholesky().map(|a| a.solve(&right)) else { return };
    if square - solved.dot(&right) > LEFT_BY_SHADOW * before {
        return;
    }
    let [a, b, c] = [0, 1, 2].map(|i| solved[i] as f32);
    for samples in &mut patch.channels {
        for i in 0..samples.seen.len() {
            let share = a + scale * (b * samples.x[i] + c * samples.y[i]);
            samples.background[i] *= share.clamp(SHADOW.0, SHADOW.1);
        }
    }
}
