//! Whether of the predictions given p, a share of p holds.

use std::collections::BTreeMap;

use netcord_detect::flight::recorded::{Bet, CURVE, Curve};
use serde_json::{Value, json};

/// Bins of the confidence, of equal numbers of predictions.
const BINS: usize = 10;
/// The curve is fitted anew without a fifth of the recordings, in turn.
const FOLDS: u64 = 5;

/// A confidence that was given, and what came of it.
#[derive(Debug, Clone, Copy)]
struct Given {
    confidence: f64,
    held: bool,
    recording: u64,
}

/// Predictions of like confidence.
#[derive(Debug, Clone, Copy)]
pub struct Bin {
    /// Mean confidence.
    pub confidence: f64,
    /// Share that held.
    pub held: f64,
    /// Standard error of that share, the predictions of one recording taken as one.
    pub standard_error: f64,
    /// How many.
    pub n: usize,
}

impl Bin {
    fn of(given: &[Given]) -> Self {
        let n = given.len() as f64;
        let confidence = given.iter().map(|g| g.confidence).sum::<f64>() / n;
        let held = given.iter().filter(|g| g.held).count() as f64 / n;
        let mut by_recording: BTreeMap<u64, f64> = BTreeMap::new();
        for g in given {
            let off = f64::from(u8::from(g.held)) - g.confidence - (held - confidence);
            *by_recording.entry(g.recording).or_default() += off;
        }
        let standard_error = by_recording.values().map(|sum| sum * sum).sum::<f64>().sqrt() / n;
        Self { confidence, held, standard_error, n: given.len() }
    }

    fn report(&self) -> Value {
        json!({
            "confidence": self.confidence,
            "held": self.held,
            "standard_error": self.standard_error,
            "n": self.n,
        })
    }
}

/// Bins of like confidence, by rising confidence.
#[derive(Debug, Clone, Default)]
pub struct Reliability(pub Vec<Bin>);

impl Reliability {
    fn of(mut given: Vec<Given>) -> Self {
        given.sort_by(|a, b| a.confidence.total_cmp(&b.confidence));
        let size = given.len().div_ceil(BINS).max(1);
        Self(given.chunks(size).map(Bin::of).collect())
    }

    /// As the predictor gives it.
    pub fn as_given(bets: &[Bet]) -> Self {
        Self::of(bets.iter().map(|bet| given(bet, &CURVE)).collect())
    }

    /// With a curve that was fitted to other recordings: each group of predictions by one fitted to all other
    /// groups. `None` where these do not say how it runs.
    fn held_out(bets: &[Bet], group: impl Fn(usize, &Bet) -> u64) -> Option<Self> {
        let groups: Vec<u64> = bets.iter().enumerate().map(|(i, bet)| group(i, bet)).collect();
        let mut curves: BTreeMap<u64, Curve> = BTreeMap::new();
        for left_out in &groups {
            if !curves.contains_key(left_out) {
                let others = bets.iter().zip(&groups).filter(|(_, g)| *g != left_out);
                let curve = Curve::fit(others.map(|(bet, _)| (bet.sigma_m, bet.held)))?;
                curves.insert(*left_out, curve);
            }
        }
        Some(Self::of(bets.iter().zip(&groups).map(|(bet, g)| given(bet, &curves[g])).collect()))
    }

    /// With the curve fitted to four fifths of the recordings, chosen by a hash of their names.
    pub fn by_folds(bets: &[Bet]) -> Option<Self> {
        Self::held_out(bets, |_, bet| (bet.recording >> 32) % FOLDS)
    }

    /// With the curve fitted to the other sets; `ends` are where each set's predictions end.
    pub fn by_sets(bets: &[Bet], ends: &[usize]) -> Option<Self> {
        if ends.len() < 2 {
            return None;
        }
        Self::held_out(bets, |i, _| ends.partition_point(|end| *end <= i) as u64)
    }

    /// The largest difference between confidence and share.
    pub fn worst(&self) -> f64 {
        self.0.iter().map(|b| (b.held - b.confidence).abs()).fold(0.0, f64::max)
    }

    /// Its bins.
    pub fn report(&self) -> Value {
        self.0.iter().map(Bin::report).collect::<Vec<_>>().into()
    }

    /// As lines of a table.
    pub fn print(&self, title: &str) {
        println!("  {title}: at most {:.3} off", self.worst());
        println!("    confidence     held  ± error        n");
        for b in &self.0 {
            println!("    {:>10.3} {:>8.3} {:>8.3} {:>8}", b.confidence, b.held, b.standard_error, b.n);
        }
    }
}

fn given(bet: &Bet, curve: &Curve) -> Given {
    Given { confidence: bet.confidence(curve), held: bet.held, recording: bet.recording }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bets of `recordings` of which every `k`-th holds as often as `truth` says.
    fn bets(truth: &Curve, recordings: u64) -> Vec<Bet> {
        let mix = |x: u64| {
            let x = (x ^ (x >> 31)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let x = (x ^ (x >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            x ^ (x >> 32)
        };
        let uniform = |x: u64| (mix(x) >> 11) as f64 / (1_u64 << 53) as f64;
        (0..20_000)
            .map(|i| {
                let sigma_m = 0.004 * 50_f64.powf(uniform(2 * i));
                let held = uniform(2 * i + 1) < truth.chance(sigma_m);
                Bet { sigma_m, weight: 1.0, held, recording: mix(i % recordings + 77) }
            })
            .collect()
    }

    #[test]
    fn a_curve_of_its_own_is_reliable_where_it_was_not_fitted_and_a_wrong_one_is_seen() {
        let bets = bets(&Curve { even_m: 0.02, power: 2.5 }, 100);
        let folds = Reliability::by_folds(&bets).expect("both outcomes occur");
        assert!(folds.0.len() == BINS && folds.0.iter().all(|b| b.n == 2000));
        assert!(folds.worst() < 0.04, "{folds:?}");
        let sets = Reliability::by_sets(&bets, &[9000, 20_000]).expect("both outcomes occur");
        assert!(sets.worst() < 0.04, "{sets:?}");
        assert!(Reliability::as_given(&bets).worst() > 0.1, "the predictor's curve is another one");
        assert!(Reliability::by_sets(&bets, &[20_000]).is_none(), "one set has no others");
    }

    #[test]
    fn the_error_of_a_share_counts_recordings_not_predictions() {
        let all = |recording: u64| Given { confidence: 0.5, held: recording.is_multiple_of(2), recording };
        let few: Vec<_> = (0..1000).map(|i| all(i % 10)).collect();
        let many: Vec<_> = (0..1000).map(all).collect();
        let (few, many) = (Bin::of(&few), Bin::of(&many));
        assert!((few.standard_error - 0.5 / 10_f64.sqrt()).abs() < 1e-9, "{few:?}");
        assert!((many.standard_error - 0.5 / 1000_f64.sqrt()).abs() < 1e-9, "{many:?}");
    }
}
