//! The future of a belief: its path, where it lands, and where it crosses the hitting plane.

use nalgebra::Matrix3;

use super::{
    belief::Belief,
    flow::{Exempt, Flow, Touched},
};

/// Spacing of the predicted path, s.
pub const PATH_STEP_S: f64 = 0.02;

/// Where and when the ball passes a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// Seconds ahead.
    pub after_s: f64,
    /// The belief there.
    pub belief: Belief,
    /// Covariance of the place within the plane, m²: what lies along the path is in `sigma_t_s`.
    pub covariance: Matrix3<f64>,
    /// Standard deviation of the instant, s.
    pub sigma_t_s: f64,
    /// The coordinate that the plane is across.
    pub axis: usize,
    /// Whether the ball bounces before.
    pub after_bounce: bool,
}

impl Crossing {
    /// Where `belief`, moving fast enough along `axis`, passes the plane that it is on now.
    fn at(belief: &Belief, after_s: f64, axis: usize, after_bounce: bool) -> Self {
        let v = belief.velocity();
        let rate = v[axis].signum() * v[axis].abs().max(0.1);
        let mut onto = Matrix3::<f64>::identity();
        for row in 0..3 {
            onto[(row, axis)] -= v[row] / rate;
        }
        let p = belief.position_covariance();
        Self {
            after_s,
            belief: *belief,
            covariance: onto * p * onto.transpose(),
            sigma_t_s: p[(axis, axis)].max(0.0).sqrt() / rate.abs(),
            axis,
            after_bounce,
        }
    }
}

/// How the ball comes down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Descent {
    /// On the table.
    Table,
    /// Into the net first.
    Net,
    /// Past the table, through the height of its surface.
    Beside,
}

/// What lies ahead.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ahead {
    /// Where the hitting plane is crossed.
    pub crossing: Option<Crossing>,
    /// Where it comes down next.
    pub landing: Option<(Descent, Crossing)>,
}

/// Follows `belief` for `horizon_s`; `at_point(k, belief, bounced)` is told every [`PATH_STEP_S`], from k = 1 on;
/// `bounced`: whether the ball has come down by then.
/// `plane_y_m`: the hitting plane.
pub fn look_ahead(
    flow: &Flow,
    belief: &Belief,
    exempt: Exempt,
    horizon_s: f64,
    plane_y_m: Option<f64>,
    mut at_point: impl FnMut(usize, &Belief, bool),
) -> Ahead {
    let (mut at, mut exempt, mut ahead) = (*belief, exempt, Ahead::default());
    let steps = (horizon_s / PATH_STEP_S).round() as usize;
    let level = flow.table.map(|t| t.surface_z_m + flow.radius_m);
    for k in 1..=steps {
        let start_s = (k - 1) as f64 * PATH_STEP_S;
        let (before, exempt_before) = (at, exempt);
        flow.advance(&mut at, PATH_STEP_S, &mut exempt, |contact| {
            if ahead.landing.is_none() {
                let after_s = start_s + contact.after_s;
                ahead.landing = match contact.touched {
                    Touched::Table => {
                        Some((Descent::Table, Crossing::at(&contact.before, after_s, 2, false)))
                    }
                    Touched::Net => Some((Descent::Net, Crossing::at(&contact.before, after_s, 1, false))),
                    Touched::Floor => None,
                };
            }
        });
        if ahead.landing.is_none()
            && let Some(level) = level
            && before.mean[2] > level
            && at.mean[2] <= level
        {
            let (crossed, after_s) = pass(flow, &before, exempt_before, 2, level);
            ahead.landing = Some((Descent::Beside, Crossing::at(&crossed, start_s + after_s, 2, false)));
        }
        if ahead.crossing.is_none()
            && let Some(y) = plane_y_m
            && (before.mean[1] - y) * (at.mean[1] - y) < 0.0
        {
            let (crossed, after_s) = pass(flow, &before, exempt_before, 1, y);
            let after_bounce = ahead.landing.is_some_and(|(_, l)| l.after_s < start_s + after_s);
            ahead.crossing = Some(Crossing::at(&crossed, start_s + after_s, 1, after_bounce));
        }
        at_point(k, &at, ahead.landing.is_some());
    }
    ahead
}

/// The belief where coordinate `axis`, on different sides of `level` before and after one path step,
/// passes it; by bisection, since a contact may lie between.
fn pass(flow: &Flow, before: &Belief, exempt: Exempt, axis: usize, level: f64) -> (Belief, f64) {
    let side = before.mean[axis] > level;
    let (mut low, mut high) = (0.0, PATH_STEP_S);
    let mut at = *before;
    for _ in 0..12 {
        let middle = 0.5 * (low + high);
        at = *before;
        flow.advance(&mut at, middle, &mut exempt.clone(), |_| {});
        if (at.mean[axis] > level) == side { low = middle } else { high = middle }
    }
    // The rest, at most 5 µs, in a straight line.
    let rate = at.mean[axis + 3];
    let rest = if rate.abs() > 0.1 { ((level - at.mean[axis]) / rate).clamp(-1e-5, 1e-5) } else { 0.0 };
    flow.fly(&mut at, rest);
    (at, 0.5 * (low + high))
}

/// Chance that an error with covariance `covariance` is shorter than `radius`: of the sum of weighted
/// squares of normal variables, by the gamma distribution of the same mean and variance
/// (Satterthwaite 1946, Welch 1947).
pub fn chance_within(radius: f64, covariance: &Matrix3<f64>) -> f64 {
    let (mean, half_variance) = (covariance.trace(), (covariance * covariance).trace());
    if mean <= 0.0 || half_variance <= 0.0 {
        return 1.0;
    }
    let shape = 0.5 * mean * mean / half_variance;
    let scale = 2.0 * half_variance / mean;
    lower_gamma(shape, radius * radius / scale)
}

/// The regularised lower incomplete gamma function P(a, x) for a from ½ to 3/2, by its power series or
/// continued fraction (Press et al., Numerical Recipes §6.2).
fn lower_gamma(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    let front = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        for _ in 0..60 {
            n += 1.0;
            term *= x / n;
            sum += term;
            if term < sum * 1e-12 {
                break;
            }
        }
        return (front * sum).min(1.0);
    }
    let mut b = x + 1.0 - a;
    let (mut c, mut d) = (1e300, 1.0 / b);
    let mut h = d;
    for i in 1..60 {
        let i = f64::from(i);
        let an = -i * (i - a);
        b += 2.0;
        d = 1.0 / (an * d + b);
        c = b + an / c;
        h *= d * c;
        if (d * c - 1.0).abs() < 1e-12 {
            break;
        }
    }
    (1.0 - front * h).clamp(0.0, 1.0)
}

/// ln Γ(a) (Lanczos 1964, six terms: 2e-10).
fn ln_gamma(a: f64) -> f64 {
    const TERMS: [f64; 6] = [
        76.180_091_729_471_46,
        -86.505_320_329_416_77,
        24.014_098_240_830_91,
        -1.231_739_572_450_155,
        0.120_865_097_386_617_9e-2,
        -0.539_523_938_495_3e-5,
    ];
    let base = a + 5.5;
    let sum = TERMS.iter().zip(1..).fold(1.000_000_000_190_015, |s, (t, i)| s + t / (a + f64::from(i)));
    (a + 0.5) * base.ln() - base + (2.506_628_274_631_000_5 * sum / a).ln()
}
