//! What really happened in a recorded flight: found with all of it at hand, unlike the filter.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use super::parse::Sample;

/// Positions on each side of an instant that its velocities are taken from.
const SIDE: usize = 6;
/// A longer silence ends a flight, s.
const LONGEST_SILENCE_S: f64 = 0.2;
/// Between positions further apart than this the truth is not known, s.
const LONGEST_STEP_S: f64 = 0.035;
/// Above this height over the table's surface a kink is no bounce, m.
const BOUNCE_HEIGHT_M: f64 = 0.09;
/// A change of velocity that no bounce, net or noise explains, m/s.
const HIT_M_S: f64 = 2.5;

/// A parabola fitted to some positions: p + v τ + a τ²/2 with τ = t − t₀.
#[derive(Debug, Clone, Copy)]
pub struct Arc {
    t0_s: f64,
    coefficients: [Vector3<f64>; 3],
    /// Root mean square of what is left, m.
    pub rms_m: f64,
}

impl Arc {
    /// Least squares through `samples`; `None` with fewer than 4 or degenerate ones.
    pub fn fit(samples: &[Sample]) -> Option<Self> {
        if samples.len() < 4 {
            return None;
        }
        let t0_s = samples.iter().map(|s| s.t_s).sum::<f64>() / samples.len() as f64;
        let row = |s: &Sample| {
            let t = s.t_s - t0_s;
            Vector3::new(1.0, t, 0.5 * t * t)
        };
        let normal: Matrix3<f64> = samples.iter().map(|s| row(s) * row(s).transpose()).sum();
        let right: Matrix3<f64> = samples.iter().map(|s| row(s) * s.position.transpose()).sum();
        let c = normal.lu().solve(&right)?;
        let coefficients = [0, 1, 2].map(|i| c.row(i).transpose());
        let mut arc = Self { t0_s, coefficients, rms_m: 0.0 };
        let sum: f64 = samples.iter().map(|s| (arc.position(s.t_s) - s.position).norm_squared()).sum();
        arc.rms_m = (sum / samples.len() as f64).sqrt();
        Some(arc)
    }

    /// Position at an instant, m.
    pub fn position(&self, t_s: f64) -> Vector3<f64> {
        let [p, v, a] = &self.coefficients;
        let t = t_s - self.t0_s;
        p + v * t + a * (0.5 * t * t)
    }

    /// Velocity at an instant, m/s.
    pub fn velocity(&self, t_s: f64) -> Vector3<f64> {
        self.coefficients[1] + self.coefficients[2] * (t_s - self.t0_s)
    }

    /// When the height is `z`, the instant nearest to `near_s`.
    fn time_at_height(&self, z: f64, near_s: f64) -> Option<f64> {
        let mut t = near_s;
        for _ in 0..20 {
            let rate = self.velocity(t).z;
            if rate.abs() < 1e-3 {
                return None;
            }
            t -= (self.position(t).z - z) / rate;
        }
        ((t - near_s).abs() < 0.05).then_some(t)
    }
}

/// A bounce on the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounce {
    /// When, s.
    pub t_s: f64,
    /// Where the ball's centre was, m.
    pub position: Vector3<f64>,
    /// Velocity just before, m/s.
    pub before: Vector3<f64>,
    /// Velocity just after, m/s.
    pub after: Vector3<f64>,
}

/// Heights at which the ball turned upwards sharply: table bounces, and perhaps hits.
pub fn turning_heights(samples: &[Sample]) -> Vec<f64> {
    lowest_points(samples)
        .filter_map(|k| {
            let (before, after) = sides(samples, k)?;
            // Where the two parabolas meet.
            let at = samples[k].t_s;
            let (mut low, mut high) = (at - 0.02, at + 0.02);
            let gap = |t: f64| before.position(t).z - after.position(t).z;
            if gap(low) * gap(high) > 0.0 || after.velocity(at).z - before.velocity(at).z < 1.0 {
                return None;
            }
            for _ in 0..40 {
                let middle = 0.5 * (low + high);
                if gap(low) * gap(middle) <= 0.0 { high = middle } else { low = middle }
            }
            Some(before.position(0.5 * (low + high)).z)
        })
        .collect()
}

fn lowest_points(samples: &[Sample]) -> impl Iterator<Item = usize> + '_ {
    (SIDE..samples.len().saturating_sub(SIDE)).filter(move |&k| {
        let z = samples[k].position.z;
        let near = k - 3..k + 4;
        near.clone().all(|i| samples[i].position.z >= z)
            && near.clone().all(|i| i >= k || samples[i].position.z > z)
    })
}

/// Parabolas through the positions before and after the turn near `k`. The lowest position itself may
/// belong to either side and is left out, and so are its neighbours if they do not fit.
fn sides(samples: &[Sample], k: usize) -> Option<(Arc, Arc)> {
    let before = samples.get(k.checked_sub(SIDE + 1)?..k)?;
    let after = samples.get(k + 1..(k + 2 + SIDE).min(samples.len()))?;
    let silent = |part: &[Sample]| part.windows(2).any(|w| w[1].t_s - w[0].t_s > LONGEST_STEP_S);
    if silent(before) || silent(after) || samples[k + 1].t_s - samples[k - 1].t_s > 2.0 * LONGEST_STEP_S {
        return None;
    }
    Some((Arc::fit(before)?, Arc::fit(after)?))
}

/// Table bounces: separate fits before and after the lowest point, and where they pass `level_z`, the
/// height of the ball's centre when it touches; the mean of the two.
pub fn bounces(samples: &[Sample], level_z: f64) -> Vec<Bounce> {
    lowest_points(samples)
        .filter(|&k| (samples[k].position.z - level_z).abs() < BOUNCE_HEIGHT_M)
        .filter_map(|k| {
            let (before, after) = sides(samples, k)?;
            let at = samples[k].t_s;
            let t1 = before.time_at_height(level_z, at)?;
            let t2 = after.time_at_height(level_z, at)?;
            if (t1 - t2).abs() > 0.02 || before.velocity(t1).z > -0.3 || after.velocity(t2).z < 0.1 {
                return None;
            }
            Some(Bounce {
                t_s: 0.5 * (t1 + t2),
                position: 0.5 * (before.position(t1) + after.position(t2)),
                before: before.velocity(t1),
                after: after.velocity(t2),
            })
        })
        .collect()
}

/// Ranges of the samples that belong to one flight each: cut at silences and at hits.
pub fn flights(samples: &[Sample], level_z: f64) -> Vec<Range<usize>> {
    let mut cuts = vec![0];
    let mut k = 1;
    while k < samples.len() {
        if samples[k].t_s - samples[k - 1].t_s > LONGEST_SILENCE_S {
            cuts.push(k);
        } else if is_hit(samples, k, level_z) {
            // The sharpest kink of the neighbourhood is the hit.
            let sharpest = (k..(k + SIDE).min(samples.len()))
                .max_by(|a, b| kink(samples, *a).total_cmp(&kink(samples, *b)))
                .unwrap_or(k);
            cuts.push(sharpest);
            k = sharpest + SIDE;
            continue;
        }
        k += 1;
    }
    cuts.push(samples.len());
    cuts.windows(2).map(|w| w[0]..w[1]).filter(|r| !r.is_empty()).collect()
}

fn velocities(samples: &[Sample], k: usize) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let line = |part: &[Sample]| {
        let n = part.len() as f64;
        let t = part.iter().map(|s| s.t_s).sum::<f64>() / n;
        let p = part.iter().map(|s| s.position).sum::<Vector3<f64>>() / n;
        let stt: f64 = part.iter().map(|s| (s.t_s - t).powi(2)).sum();
        part.iter().map(|s| (s.position - p) * (s.t_s - t)).sum::<Vector3<f64>>() / stt
    };
    let before = samples.get(k.checked_sub(SIDE)?..k)?;
    let after = samples.get(k..k + SIDE)?;
    (after[SIDE - 1].t_s - before[0].t_s < 0.2).then(|| (line(before), line(after)))
}

/// Change of the horizontal velocity at sample `k`, m/s.
fn kink(samples: &[Sample], k: usize) -> f64 {
    velocities(samples, k).map_or(0.0, |(a, b)| (b - a).xy().norm())
}

fn is_hit(samples: &[Sample], k: usize, level_z: f64) -> bool {
    let Some((before, after)) = velocities(samples, k) else { return false };
    let change = (after - before).xy().norm();
    let turned = before.xy().dot(&after.xy()) < 0.0 && change > 1.0;
    let low = samples[k].position.z - level_z < BOUNCE_HEIGHT_M;
    turned || (change > HIT_M_S && !low)
}

/// The position at `t_s`, between recorded ones; `None` outside them and in silences.
pub fn position_at(samples: &[Sample], t_s: f64) -> Option<Vector3<f64>> {
    let next = samples.partition_point(|s| s.t_s < t_s);
    let (a, b) = (samples.get(next.checked_sub(1)?)?, samples.get(next)?);
    let span = b.t_s - a.t_s;
    (span < LONGEST_STEP_S).then(|| a.position + (b.position - a.position) * ((t_s - a.t_s) / span))
}
