//! Several beliefs about one flight, while the evidence is open.

use nalgebra::{Matrix3, Vector3};

use super::{
    belief::Belief,
    contact::BounceScatter,
    flow::{Contact, Exempt, Flow, Touched},
};

/// Most hypotheses at a time.
pub const MAX_HYPOTHESES: usize = 8;
/// A hypothesis of less than this share of the weight is given up.
const NEGLIGIBLE: f64 = 1e-5;
/// A way that a ball may take at the table's edge with less than this chance is not followed.
const UNLIKELY_WAY: f64 = 5e-3;
/// Chance that a ball which reaches the table's plane has no table below it, where the edges are unknown.
const OFF_UNKNOWN_TABLE: f64 = 0.02;
/// Share of bounces that the model describes badly: an edge, dirt, a spin far from what was believed.
const ODD_BOUNCE: f64 = 0.03;
/// How such bounces scatter.
const ODD_SCATTER: BounceScatter = BounceScatter { normal: 0.1, tangential: 0.4, tangential_floor_m_s: 0.8 };
/// A bad position weighs this much against a hypothesis at most: a hypothesis is ruled out by several.
const WORST_CHI2: f64 = 60.0;

/// One belief, how likely it is, and what it has been through.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Hypothesis {
    /// The belief.
    pub belief: Belief,
    /// Its share, 0–1; those of a bank add up to 1.
    pub weight: f64,
    /// Table bounces since the flight began.
    pub bounces: u32,
    /// What it no longer touches.
    pub exempt: Exempt,
}

/// The hypotheses about one flight, at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bank {
    hypotheses: [Hypothesis; MAX_HYPOTHESES],
    len: usize,
}

impl Bank {
    /// Without hypotheses.
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// All hypotheses.
    pub fn all(&self) -> &[Hypothesis] {
        &self.hypotheses[..self.len]
    }

    /// The likeliest one.
    pub fn best(&self) -> Option<&Hypothesis> {
        self.all().iter().max_by(|a, b| a.weight.total_cmp(&b.weight))
    }

    /// The likeliest one, together with all that have been through the same: their common mean and
    /// covariance, which predicts better than any of them (its weight is the sum of theirs).
    pub fn consensus(&self) -> Option<Hypothesis> {
        let best = *self.best()?;
        let alike = |h: &&Hypothesis| h.bounces == best.bounces && h.exempt == best.exempt;
        let weight: f64 = self.all().iter().filter(alike).map(|h| h.weight).sum();
        let mut common = Belief::default();
        for h in self.all().iter().filter(alike) {
            let share = h.weight / weight;
            common.mean += share * h.belief.mean;
            common.struck_spin += share * h.belief.struck_spin;
        }
        for h in self.all().iter().filter(alike) {
            let share = h.weight / weight;
            let off = h.belief.mean - common.mean;
            common.covariance += share * (h.belief.covariance + off * off.transpose());
        }
        Some(Hypothesis { belief: common, weight, ..best })
    }

    /// Adds one, in the place of the least likely if there is no room.
    pub fn add(&mut self, hypothesis: Hypothesis) {
        if self.len < MAX_HYPOTHESES {
            self.hypotheses[self.len] = hypothesis;
            self.len += 1;
            return;
        }
        if let Some(least) = self.hypotheses.iter_mut().min_by(|a, b| a.weight.total_cmp(&b.weight))
            && least.weight < hypothesis.weight
        {
            *least = hypothesis;
        }
    }

    /// Moves all on by `dt` seconds. Where one reaches the plane of the table so near to its edge that it
    /// may as well pass beside it (or the other way round), both ways are followed.
    pub fn advance(&mut self, flow: &Flow, dt: f64) {
        let mut odd_bounces = *flow;
        odd_bounces.noise.bounce = ODD_SCATTER;
        for i in 0..self.len {
            let start = self.hypotheses[i];
            let h = &mut self.hypotheses[i];
            let mut off_table = 0.0;
            flow.advance(&mut h.belief, dt, &mut h.exempt, |contact| {
                if contact.touched == Touched::Table {
                    h.bounces += 1;
                    off_table = chance_beside(flow, contact);
                }
            });
            let bounced = h.bounces > start.bounces;
            if bounced {
                h.weight *= 1.0 - ODD_BOUNCE;
                let mut odd = start;
                odd.bounces = h.bounces;
                odd.weight = start.weight * ODD_BOUNCE;
                odd_bounces.advance(&mut odd.belief, dt, &mut odd.exempt, |_| {});
                self.add(odd);
            }
            let h = &mut self.hypotheses[i];
            if off_table > UNLIKELY_WAY && !start.exempt.table {
                h.weight *= 1.0 - off_table;
                let mut beside = start;
                beside.exempt.table = true;
                flow.advance(&mut beside.belief, dt, &mut beside.exempt, |_| {});
                beside.weight = start.weight * off_table;
                self.add(beside);
            }
        }
        self.normalise();
    }

    /// Adds uncertainty to position and velocity of all: standard deviations, m and m/s.
    pub fn widen(&mut self, position_m: f64, velocity_m_s: f64) {
        for h in &mut self.hypotheses[..self.len] {
            for axis in 0..3 {
                h.belief.covariance[(axis, axis)] += position_m * position_m;
                h.belief.covariance[(axis + 3, axis + 3)] += velocity_m_s * velocity_m_s;
            }
        }
    }

    /// Squared Mahalanobis distance of a position from the hypothesis that it fits best; infinite
    /// without hypotheses.
    pub fn chi2(&self, position: &Vector3<f64>, r: &Matrix3<f64>) -> f64 {
        self.all()
            .iter()
            .filter_map(|h| h.belief.agreement(position, r))
            .map(|a| a.chi2)
            .fold(f64::INFINITY, f64::min)
    }

    /// Logarithm of the probability density of a position, without the constant; `None` without
    /// hypotheses. Bounded below as in [`Self::take_in`].
    pub fn log_likelihood(&self, position: &Vector3<f64>, r: &Matrix3<f64>) -> Option<f64> {
        let mut density = 0.0;
        for h in self.all() {
            let a = h.belief.agreement(position, r)?;
            density += h.weight * (a.log_likelihood + 0.5 * (a.chi2 - a.chi2.min(WORST_CHI2))).exp();
        }
        (density > 0.0).then(|| density.ln())
    }

    /// Takes a position in: Bayes' rule on the weights, Kalman's on each belief.
    pub fn take_in(&mut self, position: &Vector3<f64>, r: &Matrix3<f64>) {
        let mut logs = [f64::NEG_INFINITY; MAX_HYPOTHESES];
        for (log, h) in logs.iter_mut().zip(&self.hypotheses[..self.len]) {
            if let Some(a) = h.belief.agreement(position, r) {
                *log = h.weight.ln() + a.log_likelihood + 0.5 * (a.chi2 - a.chi2.min(WORST_CHI2));
            }
        }
        let top = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if top == f64::NEG_INFINITY {
            return;
        }
        for (log, h) in logs.iter().zip(&mut self.hypotheses[..self.len]) {
            h.weight = (log - top).exp();
            h.belief.take_in(position, r);
        }
        self.normalise();
    }

    fn normalise(&mut self) {
        let sum: f64 = self.all().iter().map(|h| h.weight).sum();
        let mut kept = 0;
        for i in 0..self.len {
            let mut h = self.hypotheses[i];
            h.weight /= sum;
            if h.weight > NEGLIGIBLE {
                self.hypotheses[kept] = h;
                kept += 1;
            }
        }
        self.len = kept;
        let sum: f64 = self.all().iter().map(|h| h.weight).sum();
        for h in &mut self.hypotheses[..kept] {
            h.weight /= sum;
        }
    }
}

/// Chance that the ball has no table below it where it reaches the table's plane.
fn chance_beside(flow: &Flow, contact: &Contact) -> f64 {
    match flow.table {
        Some(table) if table.edges_known => {
            let p = contact.before.position();
            let cov = &contact.before.covariance;
            let sigma = cov[(0, 0)].max(cov[(1, 1)]).sqrt().max(1e-3);
            0.5 * (1.0 - erf(table.inside_by(p.x, p.y) / (sigma * std::f64::consts::SQRT_2)))
        }
        _ => OFF_UNKNOWN_TABLE,
    }
}

/// The error function, to 1.5e-7 (Abramowitz & Stegun 7.1.26).
pub(super) fn erf(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x.abs());
    let poly = t
        * (0.254_829_592
            + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    (1.0 - poly * (-x * x).exp()).copysign(x)
}
