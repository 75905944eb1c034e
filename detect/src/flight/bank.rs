//! Several beliefs about one flight, while the evidence is open.

use nalgebra::{Matrix3, Vector3};

use super::{
    belief::Belief,
    contact::BounceScatter,
    flow::{Contact, Exempt, Flow, Leaving, ModelNoise, Touched},
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
const ODD_BOUNCE: f64 = 0.018;
/// How such bounces scatter.
const ODD_SCATTER: BounceScatter = BounceScatter { normal: 0.03, tangential: 0.4, tangential_floor_m_s: 0.8 };
/// A way in which a ball may leave the table with less than this chance is not followed.
const UNLIKELY_LEAVING: f64 = 0.05;
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
            let off = h.belief.struck_spin - common.struck_spin;
            common.struck_covariance += share * (h.belief.struck_covariance + off * off.transpose());
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

    /// Moves all on by `dt` seconds. Where the future forks, each way is followed: beside the table or onto it,
    /// where one reaches the table's plane near its edge; off the table rolling or still sliding, where friction
    /// hardly decides; and an odd bounce beside each bounce.
    pub fn advance(&mut self, flow: &Flow, dt: f64) {
        let mut next = Self::default();
        for start in self.all() {
            let (mut h, mut off_table, mut rolling) = (*start, 0.0, 1.0);
            flow.advance(&mut h.belief, dt, &mut h.exempt, |contact| {
                if contact.touched == Touched::Table {
                    h.bounces += 1;
                    off_table = chance_beside(flow, contact);
                    rolling = flow.chance_of_rolling(&contact.before);
                }
            });
            if h.bounces == start.bounces {
                next.add(h);
                continue;
            }
            let mut follow = |flow: &Flow, share: f64, bounces: u32, exempt: Exempt| {
                let mut way = Hypothesis { weight: start.weight * share, bounces, exempt, ..*start };
                flow.advance(&mut way.belief, dt, &mut way.exempt, |_| {});
                next.add(way);
            };
            if off_table > UNLIKELY_WAY && !start.exempt.table {
                follow(flow, off_table, start.bounces, Exempt { table: true, ..start.exempt });
            } else {
                off_table = 0.0;
            }
            let on_table = 1.0 - off_table;
            let odd = ModelNoise { bounce: ODD_SCATTER, ..flow.noise };
            follow(&Flow { noise: odd, ..*flow }, on_table * ODD_BOUNCE, h.bounces, start.exempt);
            let even = on_table * (1.0 - ODD_BOUNCE);
            if rolling.min(1.0 - rolling) > UNLIKELY_LEAVING {
                for (leaving, chance) in [(Leaving::Rolling, rolling), (Leaving::Sliding, 1.0 - rolling)] {
                    let given = Flow { leaving: Some(leaving), ..*flow };
                    follow(&given, even * chance, h.bounces, start.exempt);
                }
            } else {
                next.add(Hypothesis { weight: start.weight * even, ..h });
            }
        }
        next.normalise();
        *self = next;
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

#[cfg(test)]
mod tests {
    use nalgebra::SVector;
    use netcord_common::rig::{Ball, FlightConstants};
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::flight::{
        flow::Table,
        physics::{STATE, State, StateMatrix, join},
        settings::Tuning,
    };

    fn flow() -> Flow {
        let mut noise = Tuning::default().noise;
        noise.bounce = BounceScatter { normal: 0.0, tangential: 0.0, tangential_floor_m_s: 0.0 };
        let constants = FlightConstants { friction: 0.25, ..FlightConstants::default() };
        Flow::new(&constants, &Ball::default(), Some(Table::CENTRED), noise)
    }

    fn bank(p: [f64; 3], v: [f64; 3], w: [f64; 3], sigmas: [f64; 3]) -> Bank {
        let mut covariance = StateMatrix::zeros();
        for i in 0..9 {
            covariance[(i, i)] = sigmas[i / 3].powi(2);
        }
        let belief = Belief::new(join(&p.into(), &v.into(), &w.into()), covariance);
        let mut bank = Bank::default();
        bank.add(Hypothesis { belief, weight: 1.0, bounces: 0, exempt: Exempt::default() });
        bank
    }

    #[test]
    fn near_the_edge_both_ways_live_until_positions_tell_which() {
        let flow = flow();
        // 5 mm inside the end line, known to 20 mm.
        let mut bank = bank([0.0, 1.345, 0.06], [0.0, 2.0, -4.0], [0.0; 3], [0.02, 0.05, 20.0]);
        bank.advance(&flow, 0.02);
        let share = |bank: &Bank, bounces: u32| -> f64 {
            bank.all().iter().filter(|h| h.bounces == bounces).map(|h| h.weight).sum()
        };
        assert!(share(&bank, 0) > 0.2 && share(&bank, 1) > 0.2, "{}", share(&bank, 0));
        assert!((share(&bank, 0) + share(&bank, 1) - 1.0).abs() < 1e-12);
        let (mut beside, mut onto) = (bank, bank);
        let r = Matrix3::identity() * 1e-6;
        beside.take_in(&Vector3::new(0.0, 1.385, -0.02), &r);
        onto.take_in(&Vector3::new(0.0, 1.38, 0.06), &r);
        assert!(share(&beside, 0) > 0.999 && share(&onto, 1) > 0.999);
    }

    /// Against what 40,000 balls drawn from the belief do, each of which rolls or slides.
    #[test]
    fn a_bounce_between_rolling_and_sliding_has_the_moments_of_many_balls() {
        let flow = flow();
        // Slip 0.4 · 3.1 m/s takes as much as friction can: 0.25 · 1.95 · 2.55.
        let mut start = bank([0.0, 0.5, 0.0201], [0.0, 4.1, -2.55], [-50.0, 0.0, 0.0], [1e-6, 0.02, 40.0]);
        // Across, slip would be second order: the size of a vector.
        start.hypotheses[0].belief.covariance[(7, 7)] = 1.0;
        let mut belief_bank = start;
        belief_bank.advance(&flow, 1e-4);
        let forks = belief_bank.all().iter().filter(|h| h.weight > 0.1).count();
        assert_eq!(forks, 2, "one rolls, one slides");
        let common = belief_bank.consensus().expect("a hypothesis").belief;
        let mut rng = Pcg64::seed_from_u64(5);
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let h = &start.all()[0];
        let (mut mean, mut square) = (State::zeros(), State::zeros());
        let (mut rolling, n) = (0.0, 40_000.0);
        for _ in 0..n as u32 {
            let drawn = h.belief.mean
                + SVector::<f64, STATE>::from_fn(|i, _| h.belief.covariance[(i, i)].sqrt() * normal());
            rolling += f64::from(u8::from(flow.table_surface.grip(&drawn).0 > 0.0)) / n;
            let after = flow.table_surface.bounce(&drawn).0;
            mean += after / n;
            square += after.component_mul(&after) / n;
        }
        let variance = square - mean.component_mul(&mean);
        assert!((flow.chance_of_rolling(&h.belief) - rolling).abs() < 0.02, "{rolling}");
        // Along y, where it slips, and the spin that friction gives. Linearised at the mean alone, the speed after
        // is 0.1 m/s too low.
        assert!((common.mean[4] - mean[4]).abs() < 0.01, "{} {}", common.mean[4], mean[4]);
        assert!((common.mean[6] - mean[6]).abs() < 1.0, "{} {}", common.mean[6], mean[6]);
        for i in [4, 6] {
            let (found, truth) = (common.covariance[(i, i)].sqrt(), variance[i].sqrt());
            // Odd bounces are in the mixture, and not among the balls drawn: a little wider.
            assert!((0.9..1.35).contains(&(found / truth)), "{i}: {found} {truth}");
        }
    }
}
