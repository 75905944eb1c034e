//! Physical constants from recorded flights.

use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use netcord_common::rig::FlightConstants;

use super::{
    evaluate::{EvaluateOptions, HORIZONS_MS, evaluate_set, name_hash, observations},
    parse::Recording,
};
use crate::flight::{
    flow::{Flow, Table},
    habits::{Habits, Latitude},
    physics::Forces,
    tracker::Tracker,
};

/// How many constants are fitted.
pub const FITTED: usize = 7;
/// Their names, as in the rig file.
pub const FITTED_NAMES: [&str; FITTED] = [
    "drag",
    "drag_induced",
    "magnus",
    "magnus_saturation",
    "restitution",
    "restitution_slope_s_m",
    "friction",
];
/// Steps of the numeric derivatives.
const STEPS: [f64; FITTED] = [0.01, 0.2, 0.02, 0.2, 0.005, 0.002, 0.01];
/// Most Gauss–Newton steps.
const ITERATIONS: usize = 6;
/// Gauss–Newton steps without one group of recordings.
const ITERATIONS_WITHOUT: usize = 2;
/// Groups of recordings that are left out in turn, to see how far the constants move.
const GROUPS: u64 = 5;
/// A gain in log-likelihood below this ends the search: far less than what a standard deviation of a constant
/// is worth.
const LEAST_GAIN: f64 = 0.05;
/// An innovation that a small step of a constant moves by more than this many standard deviations was taken for
/// something else (a hit, an outlier): no derivative.
const LEAP_SIGMAS: f64 = 3.0;
/// Constants are fitted, so the filter may not learn others.
const NO_LATITUDE: Latitude =
    Latitude { drag: 0.01, restitution: 0.003, slant_m_s2: 0.05, friction: 0.03, forgetting: 1.0 };

/// Recordings that share a frame, and what is known of it.
#[derive(Debug, Clone, Copy)]
pub struct FitSet<'a> {
    /// The recordings.
    pub recordings: &'a [Recording],
    /// The table in their frame.
    pub table: Option<Table>,
    /// Options, with the noise of this set's positions.
    pub options: EvaluateOptions,
}

/// The outcome.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The constants found.
    pub constants: FlightConstants,
    /// Standard deviation of each fitted constant, as [`FITTED_NAMES`].
    pub sigma: [f64; FITTED],
    /// Recordings fitted to, and held out.
    pub recordings: (usize, usize),
    /// Mean negative log-likelihood per position of the held-out recordings, before and after.
    pub held_out: (f64, f64),
    /// Median prediction error of the held-out recordings at [`HORIZONS_MS`], before and after, m; `None` where
    /// none reaches that far.
    pub held_out_errors_m: [[Option<f64>; HORIZONS_MS.len()]; 2],
}

impl Fit {
    /// By which factor the held-out prediction errors grew, as the geometric mean over the horizons: below 1 the
    /// constants found are the better ones. `None` where nothing that was held out tells.
    pub fn held_out_growth(&self) -> Option<f64> {
        let [before, after] = &self.held_out_errors_m;
        let pairs = before.iter().zip(after).filter_map(|(b, a)| Some((*b)?.max(1e-9) / (*a)?.max(1e-9)));
        let logs: Vec<f64> = pairs.map(|shrunk| -shrunk.ln()).collect();
        (!logs.is_empty()).then(|| (logs.iter().sum::<f64>() / logs.len() as f64).exp())
    }
}

type Vector = SVector<f64, FITTED>;

/// The fitted ones of all constants, as [`FITTED_NAMES`].
pub fn fitted_values(c: &FlightConstants) -> [f64; FITTED] {
    [
        c.drag,
        c.drag_induced,
        c.magnus,
        c.magnus_saturation,
        c.restitution,
        c.restitution_slope_s_m,
        c.friction,
    ]
}

fn vector(c: &FlightConstants) -> Vector {
    Vector::from(fitted_values(c))
}

/// What each may be, as [`FITTED_NAMES`].
const BOUNDS: [(f64, f64); FITTED] =
    [(0.05, 2.0), (0.0, 10.0), (0.0, 2.0), (0.0, 20.0), (0.3, 1.0), (0.0, 0.1), (0.01, 1.0)];

fn within_bounds(v: &Vector) -> Vector {
    Vector::from_fn(|i, _| v[i].clamp(BOUNDS[i].0, BOUNDS[i].1))
}

fn constants(v: &Vector, start: &FlightConstants) -> FlightConstants {
    let v = within_bounds(v);
    FlightConstants {
        drag: v[0],
        drag_induced: v[1],
        magnus: v[2],
        magnus_saturation: v[3],
        restitution: v[4],
        restitution_slope_s_m: v[5],
        friction: v[6],
        ..*start
    }
}

/// Whether a recording is held out of the fit: one in three, by a hash of its name.
pub fn is_held_out(recording: &Recording) -> bool {
    name_hash(recording).is_multiple_of(3)
}

/// What the filter had not foreseen of one position.
#[derive(Debug, Clone, Copy)]
struct Innovation {
    /// Position less what the flight's best hypotheses expected, m.
    off: Vector3<f64>,
    /// Inverse of its covariance, 1/m².
    information: Matrix3<f64>,
}

/// One recording seen with some constants.
#[derive(Debug, Clone, Default)]
struct Pass {
    /// Negative log-likelihood of the positions, each given those before it.
    cost: f64,
    /// Of each sample; `None` where no flight was followed.
    innovations: Vec<Option<Innovation>>,
}

impl Pass {
    fn run(set: &FitSet<'_>, recording: &Recording, c: &FlightConstants) -> Self {
        let options = set.options;
        let mut flow = Flow::new(c, &options.ball, set.table, options.tuning.noise);
        flow.forces = Forces::new(c, &options.ball);
        let mut tracker = Tracker::new(flow, NO_LATITUDE, Habits::new(&NO_LATITUDE));
        let mut pass = Self::default();
        for o in observations(recording, &options) {
            let bank = tracker.bank_at(o.t_ns);
            let log = bank.log_likelihood(&o.position, &o.covariance);
            pass.cost -= log.unwrap_or(0.0);
            pass.innovations.push(log.and_then(|_| bank.consensus()).and_then(|h| {
                let information = (h.belief.position_covariance() + o.covariance).try_inverse()?;
                Some(Innovation { off: o.position - h.belief.position(), information })
            }));
            tracker.observe(&o);
        }
        pass
    }

    fn positions(&self) -> usize {
        self.innovations.iter().flatten().count()
    }
}

/// All recordings that are to be `kept`, on all cores.
fn passes(sets: &[FitSet<'_>], kept: impl Fn(&Recording) -> bool, c: &FlightConstants) -> Vec<Pass> {
    let work: Vec<_> =
        sets.iter().flat_map(|s| s.recordings.iter().map(move |r| (s, r))).filter(|(_, r)| kept(r)).collect();
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let next = AtomicUsize::new(0);
    let mut all: Vec<(usize, Pass)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads)
            .map(|_| {
                scope.spawn(|| {
                    let mut done = Vec::new();
                    loop {
                        // Relaxed: each number is handed out once, and nothing else is shared.
                        let i = next.fetch_add(1, Ordering::Relaxed);
                        let Some((set, recording)) = work.get(i) else { return done };
                        done.push((i, Pass::run(set, recording, c)));
                    }
                })
            })
            .collect();
        // A panic goes on: constants fitted to a part of the recordings would look like those of all.
        workers
            .into_iter()
            .flat_map(|w| w.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect()
    });
    all.sort_by_key(|(i, _)| *i);
    all.into_iter().map(|(_, pass)| pass).collect()
}

/// With a thousandth more on the diagonal: what the flights do not show stays where it is.
fn damped(information: &SMatrix<f64, FITTED, FITTED>) -> SMatrix<f64, FITTED, FITTED> {
    information + SMatrix::from_diagonal(&information.diagonal().map(|d| 1e-3 * d + 1e-9))
}

fn total(passes: &[Pass]) -> f64 {
    passes.iter().map(|p| p.cost).sum()
}

/// Where a search ended.
struct Summit {
    constants: Vector,
    /// Variance of each constant: the sandwich estimate (Huber 1967), since recordings are independent and positions
    /// are not, or the inverse information, if that is more: few recordings scatter too little.
    variance: Vector,
    recordings: usize,
}

/// At most `iterations` Gauss–Newton steps up from `start`; `None` without recordings.
fn climb(
    at: &impl Fn(&Vector) -> Vec<Pass>,
    start: Vector,
    iterations: usize,
    progress: &mut dyn FnMut(f64),
) -> Option<Summit> {
    let mut best = within_bounds(&start);
    let mut here = at(&best);
    if here.is_empty() {
        return None;
    }
    let mut variance = Vector::zeros();
    for iteration in 0..iterations {
        let share = |part: f64| (iteration as f64 + part) / iterations as f64;
        let mut slopes = slopes(at, &best, &here, &mut |part| progress(share(0.9 * part)));
        let Some(inverse) = damped(&slopes.information).cholesky().map(|c| c.inverse()) else { break };
        let sandwich = inverse * slopes.outer * inverse.transpose();
        variance = sandwich.diagonal().sup(&inverse.diagonal()).map(|v| v.max(0.0));
        slopes.hold_at_bounds(&best);
        let Some(step) = damped(&slopes.information).cholesky().map(|c| c.solve(&slopes.gradient)) else {
            break;
        };
        let better = [1.0, 0.4, 0.16, 0.06].into_iter().find_map(|length| {
            let trial = within_bounds(&(best - step * length));
            let there = at(&trial);
            (total(&there) < total(&here)).then_some((trial, there))
        });
        let Some((next, there)) = better else { break };
        let gain = total(&here) - total(&there);
        (best, here) = (next, there);
        if gain < LEAST_GAIN {
            break;
        }
    }
    Some(Summit { constants: best, variance, recordings: here.len() })
}

/// Fits by maximum likelihood of each position given those before (the prediction-error decomposition,
/// Schweppe 1965), by Gauss–Newton steps on the innovations from `start` on: all flights share the constants,
/// and each flight's own state is left to the filter. The variance of each constant is the sandwich estimator's over
/// recordings (Huber 1967), or, if that is more, the jackknife's over groups of them (Efron 1982), each fitted
/// again: a likelihood with bounces in it is no parabola, as the former takes it to be. `progress` is told the share
/// that is done. `None` without recordings to fit to.
pub fn fit(sets: &[FitSet<'_>], start: &FlightConstants, progress: &mut dyn FnMut(f64)) -> Option<Fit> {
    let at = |v: &Vector| passes(sets, |r| !is_held_out(r), &constants(v, start));
    let summit = climb(&at, vector(start), ITERATIONS, &mut |share| progress(0.5 * share))?;
    let moved =
        moved_without_groups(sets, start, &summit.constants, &mut |share| progress(0.5 + 0.45 * share));
    let variance = summit.variance.sup(&moved);
    let found = constants(&summit.constants, start);
    let held = [start, &found].map(|c| passes(sets, is_held_out, c));
    let mean = |held: &[Pass]| total(held) / held.iter().map(Pass::positions).sum::<usize>().max(1) as f64;
    let held_out_errors_m = [start, &found].map(|c| held_out_errors(sets, c));
    progress(1.0);
    Some(Fit {
        constants: found,
        sigma: variance.map(f64::sqrt).into(),
        recordings: (summit.recordings, held[0].len()),
        held_out: (mean(&held[0]), mean(&held[1])),
        held_out_errors_m,
    })
}

/// The jackknife's variance of each constant: (G − 1) / G times the sum of squares by which it moves when one of G
/// groups of recordings is left out.
fn moved_without_groups(
    sets: &[FitSet<'_>],
    start: &FlightConstants,
    best: &Vector,
    progress: &mut dyn FnMut(f64),
) -> Vector {
    // Other bits than those that hold recordings out.
    let group = |r: &Recording| (name_hash(r) >> 24) % GROUPS;
    let found: Vec<Vector> = (0..GROUPS)
        .filter_map(|left_out| {
            let kept = |r: &Recording| !is_held_out(r) && group(r) != left_out;
            let at = |v: &Vector| passes(sets, kept, &constants(v, start));
            let summit = climb(&at, *best, ITERATIONS_WITHOUT, &mut |share| {
                progress((left_out as f64 + share) / GROUPS as f64);
            });
            summit.map(|s| s.constants)
        })
        .collect();
    let n = found.len() as f64;
    let mean = found.iter().sum::<Vector>() / n.max(1.0);
    let squares: Vector = found.iter().map(|v| (v - mean).component_mul(&(v - mean))).sum();
    squares * ((n - 1.0) / n.max(1.0))
}

/// Median prediction errors over the recordings that are held out.
fn held_out_errors(sets: &[FitSet<'_>], c: &FlightConstants) -> [Option<f64>; HORIZONS_MS.len()] {
    let mut errors: [Vec<f64>; HORIZONS_MS.len()] = Default::default();
    for set in sets {
        let held: Vec<Recording> = set.recordings.iter().filter(|r| is_held_out(r)).cloned().collect();
        let evaluation = evaluate_set(&held, set.table, &EvaluateOptions { constants: *c, ..set.options });
        for (errors, ms) in errors.iter_mut().zip(HORIZONS_MS) {
            errors.append(&mut evaluation.prediction_errors_m(ms));
        }
    }
    errors.map(|mut e| {
        e.sort_by(f64::total_cmp);
        e.get(e.len() / 2).copied()
    })
}

/// What the cost does around some constants.
struct Slopes {
    gradient: Vector,
    /// Gauss–Newton's matrix: the information that the innovations hold.
    information: SMatrix<f64, FITTED, FITTED>,
    /// Sum over recordings of the gradient's outer product.
    outer: SMatrix<f64, FITTED, FITTED>,
}

impl Slopes {
    /// Leaves constants out that stand at a bound and would go beyond it: the others' step is one without them.
    fn hold_at_bounds(&mut self, v: &Vector) {
        for (i, (low, high)) in BOUNDS.into_iter().enumerate() {
            let outwards = if self.gradient[i] > 0.0 { v[i] <= low } else { v[i] >= high };
            if outwards {
                self.gradient[i] = 0.0;
                self.information.row_mut(i).fill(0.0);
                self.information.column_mut(i).fill(0.0);
                self.information[(i, i)] = 1.0;
            }
        }
    }
}

/// By differences of whole passes, central ones where the bounds allow it.
fn slopes(
    at: &impl Fn(&Vector) -> Vec<Pass>,
    v: &Vector,
    here: &[Pass],
    progress: &mut dyn FnMut(f64),
) -> Slopes {
    let shifted = |i: usize, sign: f64| {
        let mut moved = *v;
        moved[i] += sign * STEPS[i];
        within_bounds(&moved)
    };
    let widths: [f64; FITTED] = std::array::from_fn(|i| (shifted(i, 1.0) - shifted(i, -1.0))[i]);
    let sides: Vec<[Vec<Pass>; 2]> = (0..FITTED)
        .map(|i| {
            let both = [at(&shifted(i, 1.0)), at(&shifted(i, -1.0))];
            progress((i + 1) as f64 / FITTED as f64);
            both
        })
        .collect();
    let mut slopes =
        Slopes { gradient: Vector::zeros(), information: SMatrix::zeros(), outer: SMatrix::zeros() };
    for (k, pass) in here.iter().enumerate() {
        let slope = |i: usize| (sides[i][0][k].cost - sides[i][1][k].cost) / widths[i];
        let gradient = Vector::from_fn(|i, _| slope(i));
        slopes.gradient += gradient;
        slopes.outer += gradient * gradient.transpose();
        for (n, innovation) in pass.innovations.iter().enumerate() {
            let Some(innovation) = innovation else { continue };
            let jacobian =
                SMatrix::<f64, 3, FITTED>::from_columns(&std::array::from_fn::<_, FITTED, _>(|i| {
                    let [plus, minus] =
                        [0, 1].map(|side| sides[i][side][k].innovations.get(n).copied().flatten());
                    let (Some(plus), Some(minus)) = (plus, minus) else { return Vector3::zeros() };
                    let moved = plus.off - minus.off;
                    let leap = moved.dot(&(innovation.information * moved)).sqrt();
                    if leap > LEAP_SIGMAS { Vector3::zeros() } else { moved / widths[i] }
                }));
            slopes.information += jacobian.transpose() * innovation.information * jacobian;
        }
    }
    slopes
}
