//! The instants behind the stamps of a recording.
//!
//! Who stamps a picture when it arrives, or writes whole milliseconds, says that the ball was ½ ms away from where it
//! was: 4 mm, where cameras measure it to 1 mm. But cameras take pictures at even intervals: the same of the three
//! sets of recorded flights at hand. Followed from stamp to stamp, the interval gives each instant to a tenth of
//! that, from no stamp but those before it.

use super::parse::Recording;

/// Steps this much longer than the usual one say nothing of the interval.
const EVEN_STEPS: f64 = 3.0;
/// A stamp this far from a whole number of intervals is none of an even camera, as a share of one; where more than a
/// tenth are, the camera is not even.
const UNEVEN: f64 = 0.35;
const MOST_UNEVEN: f64 = 0.1;
/// Stamps that jitter by less than this share of the interval are taken as they are.
const LEAST_JITTER: f64 = 0.01;
/// Steps that tell the interval.
const LEAST_STEPS: usize = 50;
/// Standard deviation of one recording's interval from the set's, as a share of it.
const PERIOD_SIGMA: f64 = 1e-3;
/// How far intervals wander, as standard deviation of one, s.
const WANDER_S: f64 = 5e-6;
/// A stamp further off than this, in standard deviations, came late for a reason of its own and tells nothing.
const GATE_SIGMAS: f64 = 3.0;
/// So many of these in a row: the clock was wrong.
const MOST_REFUSED: u32 = 2;
/// After a longer silence the count is lost, in intervals.
const LONGEST_SILENCE: f64 = 12.0;

/// How the stamps of a set of recordings run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    /// Interval of the pictures, s.
    pub period_s: f64,
    /// Standard deviation of a stamp from its instant, s.
    pub jitter_s: f64,
}

impl Pace {
    /// The pace of recordings of one set; `None` where their stamps are exact, or their steps not even.
    pub fn find(recordings: &[Recording]) -> Option<Self> {
        let steps = || {
            let pairs = recordings.iter().flat_map(|r| r.samples.windows(2));
            pairs.map(|w| w[1].t_s - w[0].t_s).filter(|s| *s > 0.0)
        };
        let mut sorted: Vec<f64> = steps().collect();
        if sorted.len() < LEAST_STEPS {
            return None;
        }
        sorted.sort_by(f64::total_cmp);
        let mut period_s = sorted[sorted.len() / 2];
        // Means of steps are right to a fraction of what stamps are rounded to, medians are not.
        for _ in 0..3 {
            let counted = || {
                steps().map(|s| (s, (s / period_s).round())).filter(|(_, n)| (1.0..EVEN_STEPS).contains(n))
            };
            let (sum, count) = counted().fold((0.0, 0.0), |(s, c), (step, n)| (s + step, c + n));
            period_s = sum / count;
        }
        let off = |s: f64| s - (s / period_s).round().max(1.0) * period_s;
        let near = || steps().filter(|s| s / period_s < EVEN_STEPS);
        let uneven = near().filter(|s| off(*s).abs() > UNEVEN * period_s).count();
        let even = near().map(off).filter(|o| o.abs() <= UNEVEN * period_s);
        let (square, n) = even.fold((0.0, 0.0), |(s, n), o| (s + o * o, n + 1.0));
        // A step has the jitter of two stamps.
        let jitter_s = (square / n / 2.0).sqrt();
        let is_even = (uneven as f64) < MOST_UNEVEN * (n + uneven as f64);
        (is_even && jitter_s > LEAST_JITTER * period_s).then_some(Self { period_s, jitter_s })
    }
}

/// Follows the stamps of one recording: a Kalman filter of instant and interval.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    pace: Pace,
    /// Instant of the last picture and interval, s, and their covariance, if there was a picture.
    at: Option<Ticking>,
}

#[derive(Debug, Clone, Copy)]
struct Ticking {
    t_s: f64,
    period_s: f64,
    tt: f64,
    tp: f64,
    pp: f64,
    refused: u32,
}

impl Clock {
    /// A clock that has seen no stamp.
    pub fn new(pace: Pace) -> Self {
        Self { pace, at: None }
    }

    /// The instant behind the next stamp, and its standard deviation, s.
    pub fn instant(&mut self, stamp_s: f64) -> (f64, f64) {
        let noise = self.pace.jitter_s * self.pace.jitter_s;
        let begun = Ticking {
            t_s: stamp_s,
            period_s: self.pace.period_s,
            tt: noise,
            tp: 0.0,
            pp: (PERIOD_SIGMA * self.pace.period_s).powi(2),
            refused: 0,
        };
        let next = match self.at {
            None => begun,
            Some(last) => last.next(stamp_s, noise).unwrap_or(Ticking { period_s: last.period_s, ..begun }),
        };
        self.at = Some(next);
        (next.t_s, next.tt.sqrt())
    }
}

impl Ticking {
    /// After another stamp; `None` where that is none of this clock's.
    fn next(mut self, stamp_s: f64, noise: f64) -> Option<Self> {
        let n = ((stamp_s - self.t_s) / self.period_s).round();
        if !(1.0..=LONGEST_SILENCE).contains(&n) {
            return None;
        }
        self.t_s += n * self.period_s;
        self.tt += 2.0 * n * self.tp + n * n * self.pp + n * WANDER_S * WANDER_S;
        self.tp += n * self.pp;
        let (off, variance) = (stamp_s - self.t_s, self.tt + noise);
        if off * off > GATE_SIGMAS * GATE_SIGMAS * variance {
            self.refused += 1;
            return (self.refused <= MOST_REFUSED).then_some(self);
        }
        let (by_t, by_p) = (self.tt / variance, self.tp / variance);
        self.t_s += by_t * off;
        self.period_s += by_p * off;
        self.pp -= by_p * self.tp;
        self.tp -= by_t * self.tp;
        self.tt -= by_t * self.tt;
        self.refused = 0;
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::flight::recorded::{RecordedFrame, Sample};

    fn recording(stamps: impl Iterator<Item = f64>) -> Recording {
        let samples = stamps.map(|t_s| Sample { t_s, position: Vector3::zeros() }).collect();
        Recording { name: "made up".into(), samples, frame: RecordedFrame::Upright, spin_rad_s: None }
    }

    /// Instants every 6.93 ms, of which every ninth has no picture; stamps late by chance, in whole milliseconds.
    #[test]
    fn instants_are_found_behind_stamps_in_whole_milliseconds() {
        let mut rng = Pcg64::seed_from_u64(4);
        let instants: Vec<f64> =
            (0..120).filter(|k| k % 9 != 5).map(|k| 0.002 + f64::from(k) * 6.93e-3).collect();
        let mut stamp = |t: &f64| ((t + 0.001 * (rng.random::<f64>() - 0.5)) * 1e3).round() * 1e-3;
        let stamps: Vec<f64> = instants.iter().map(&mut stamp).collect();
        let pace = Pace::find(&[recording(stamps.iter().copied())]).expect("they jitter");
        assert!((pace.period_s / 6.93e-3 - 1.0).abs() < 2e-3, "{pace:?}");
        let rms = |errors: &[f64]| (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let raw: Vec<f64> = stamps.iter().zip(&instants).map(|(s, t)| s - t).collect();
        let mut clock = Clock::new(pace);
        let (found, sigmas): (Vec<f64>, Vec<f64>) = stamps.iter().map(|s| clock.instant(*s)).unzip();
        let error: Vec<f64> = found.iter().zip(&instants).map(|(s, t)| s - t).collect();
        assert!((pace.jitter_s / rms(&raw) - 1.0).abs() < 0.2, "{pace:?} {}", rms(&raw));
        assert!(rms(&error[40..]) < 0.4 * rms(&raw), "{} {}", rms(&error[40..]), rms(&raw));
        assert!(error.iter().zip(&sigmas).all(|(e, s)| e.abs() < 4.0 * s), "{error:?} {sigmas:?}");
    }

    #[test]
    fn a_stamp_that_is_late_moves_nothing_and_a_clock_that_jumps_is_followed() {
        let pace = Pace { period_s: 5e-3, jitter_s: 2e-4 };
        let mut clock = Clock::new(pace);
        for k in 0..20 {
            clock.instant(f64::from(k) * 5e-3);
        }
        let (late, _) = clock.instant(0.1 + 0.002);
        assert!((late - 0.1).abs() < 1e-4, "{late}");
        let jumped = [0.1071, 0.1121, 0.1171, 0.1221].map(|s| clock.instant(s).0);
        assert!((jumped[3] - 0.1221).abs() < 1e-4, "{jumped:?}");
    }

    #[test]
    fn exact_stamps_and_uneven_ones_have_no_pace() {
        let exact = recording((0..100).map(|k| f64::from(k) * 0.005));
        assert_eq!(Pace::find(&[exact]), None);
        let mut rng = Pcg64::seed_from_u64(1);
        let mut t = 0.0;
        let uneven = recording((0..200).map(|_| {
            t += 0.002 + 0.01 * rng.random::<f64>();
            t
        }));
        assert_eq!(Pace::find(&[uneven]), None);
    }
}
