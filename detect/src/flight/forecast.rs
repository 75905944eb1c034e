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
}

impl Crossing {
    /// Where `belief`, moving fast enough along `axis`, passes the plane that it is on now.
    fn at(belief: &Belief, after_s: f64, axis: usize) -> Self {
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

/// Follows `belief` for `horizon_s`; `at_point(k, belief)` is told every [`PATH_STEP_S`], from k = 1 on.
/// `plane_y_m`: the hitting plane.
pub fn look_ahead(
    flow: &Flow,
    belief: &Belief,
    exempt: Exempt,
    horizon_s: f64,
    plane_y_m: Option<f64>,
    mut at_point: impl FnMut(usize, &Belief),
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
                    Touched::Table => Some((Descent::Table, Crossing::at(&contact.before, after_s, 2))),
                    Touched::Net => Some((Descent::Net, Crossing::at(&contact.before, after_s, 1))),
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
            ahead.landing = Some((Descent::Beside, Crossing::at(&crossed, start_s + after_s, 2)));
        }
        if ahead.crossing.is_none()
            && let Some(y) = plane_y_m
            && (before.mean[1] - y) * (at.mean[1] - y) < 0.0
        {
            let (crossed, after_s) = pass(flow, &before, exempt_before, 1, y);
            ahead.crossing = Some(Crossing::at(&crossed, start_s + after_s, 1));
        }
        at_point(k, &at);
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
