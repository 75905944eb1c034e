//! Physical constants from recorded flights.

use nalgebra::{SMatrix, SVector};
use netcord_common::rig::FlightConstants;

use super::{
    evaluate::{EvaluateOptions, observation},
    parse::Recording,
};
use crate::flight::{
    flow::{Flow, Table},
    physics::Forces,
    tracker::{Habits, Latitude, Tracker},
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
/// Most Newton steps.
const ITERATIONS: usize = 6;
/// Constants are fitted, so the filter may not learn others.
const NO_LATITUDE: Latitude = Latitude { drag: 0.01, restitution: 0.003, slant_m_s2: 0.05, forgetting: 1.0 };

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

fn constants(v: &Vector, start: &FlightConstants) -> FlightConstants {
    FlightConstants {
        drag: v[0].clamp(0.05, 2.0),
        drag_induced: v[1].clamp(0.0, 10.0),
        magnus: v[2].clamp(0.0, 2.0),
        magnus_saturation: v[3].clamp(0.0, 20.0),
        restitution: v[4].clamp(0.3, 1.0),
        restitution_slope_s_m: v[5].clamp(0.0, 0.1),
        friction: v[6].clamp(0.01, 1.0),
        ..*start
    }
}

/// Whether a recording is held out of the fit: one in three, by a hash of its name (FNV-1a), so that the
/// choice depends on nothing else.
pub fn is_held_out(recording: &Recording) -> bool {
    let hash = recording
        .name
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    hash % 3 == 0
}

/// Negative log-likelihood of a recording's positions, each given those before it, and how many they are.
fn cost(set: &FitSet<'_>, recording: &Recording, c: &FlightConstants) -> (f64, usize) {
    let options = set.options;
    let mut flow = Flow::new(c, &options.ball, set.table, options.tuning.noise);
    flow.forces = Forces::new(c, &options.ball);
    let mut tracker = Tracker::new(flow, NO_LATITUDE, Habits::new(&NO_LATITUDE));
    let (mut sum, mut n) = (0.0, 0);
    for sample in &recording.samples {
        let o = observation(sample, &options);
        if let Some(log) = tracker.bank_at(o.t_ns).log_likelihood(&o.position, &o.covariance) {
            sum -= log;
            n += 1;
        }
        tracker.observe(&o);
    }
    (sum, n)
}

/// Costs of all recordings that are, or are not, held out.
fn costs(sets: &[FitSet<'_>], held_out: bool, c: &FlightConstants) -> Vec<(f64, usize)> {
    let work: Vec<_> = sets
        .iter()
        .flat_map(|s| s.recordings.iter().map(move |r| (s, r)))
        .filter(|(_, r)| is_held_out(r) == held_out)
        .collect();
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let share = work.len().div_ceil(threads).max(1);
    std::thread::scope(|scope| {
        let parts: Vec<_> = work
            .chunks(share)
            .map(|part| scope.spawn(move || part.iter().map(|(s, r)| cost(s, r, c)).collect::<Vec<_>>()))
            .collect();
        parts.into_iter().flat_map(|p| p.join().unwrap_or_default()).collect()
    })
}

fn sum(costs: &[(f64, usize)]) -> f64 {
    costs.iter().map(|c| c.0).sum()
}

/// Fits by maximum likelihood of each position given those before (the prediction-error decomposition,
/// Schweppe 1965), with Newton steps on numeric derivatives from `start` on. The uncertainty is the
/// sandwich estimator over recordings (Huber 1967): recordings are independent, positions are not quite.
/// `None` without recordings to fit to.
pub fn fit(sets: &[FitSet<'_>], start: &FlightConstants) -> Option<Fit> {
    let at = |v: &Vector| costs(sets, false, &constants(v, start));
    let mut best = vector(start);
    let mut best_costs = at(&best);
    if best_costs.is_empty() {
        return None;
    }
    let (mut hessian, mut outer) = derivatives(&at, &best, &best_costs).1;
    for _ in 0..ITERATIONS {
        let (gradient, (h, o)) = derivatives(&at, &best, &best_costs);
        (hessian, outer) = (h, o);
        // Newton's step; where the Hessian is not positive, or misleads, the step by the gradients' outer
        // product, which always is (Berndt, Hall, Hall & Hausman 1974).
        let steps = [hessian, outer].map(|matrix| {
            let damped = matrix + SMatrix::from_diagonal(&matrix.diagonal().map(|d| 0.02 * d.abs() + 1e-9));
            damped.cholesky().map(|c| c.solve(&gradient))
        });
        let better = steps.into_iter().flatten().find_map(|step| {
            let mut share = 1.0;
            while share > 0.02 {
                let trial = vector(&constants(&(best - step * share), start));
                let trial_costs = at(&trial);
                if sum(&trial_costs) < sum(&best_costs) {
                    return Some((trial, trial_costs));
                }
                share *= 0.4;
            }
            None
        });
        let Some((next, next_costs)) = better else { break };
        let gain = sum(&best_costs) - sum(&next_costs);
        (best, best_costs) = (next, next_costs);
        if gain < 0.5 {
            break;
        }
    }
    let inverse = hessian.try_inverse().unwrap_or_else(SMatrix::zeros);
    let covariance = inverse * outer * inverse.transpose();
    let found = constants(&best, start);
    let mean = |c: &FlightConstants| {
        let held = costs(sets, true, c);
        sum(&held) / held.iter().map(|c| c.1).sum::<usize>().max(1) as f64
    };
    Some(Fit {
        constants: found,
        sigma: std::array::from_fn(|i| covariance[(i, i)].max(0.0).sqrt()),
        recordings: (best_costs.len(), costs(sets, true, &found).len()),
        held_out: (mean(start), mean(&found)),
    })
}

type Matrices = (SMatrix<f64, FITTED, FITTED>, SMatrix<f64, FITTED, FITTED>);

/// Gradient, Hessian, and the sum over recordings of the gradient's outer product.
fn derivatives(
    at: &impl Fn(&Vector) -> Vec<(f64, usize)>,
    v: &Vector,
    here: &[(f64, usize)],
) -> (Vector, Matrices) {
    let shifted = |i: usize, sign: f64| {
        let mut moved = *v;
        moved[i] += sign * STEPS[i];
        moved
    };
    let plus: [Vec<(f64, usize)>; FITTED] = std::array::from_fn(|i| at(&shifted(i, 1.0)));
    let minus: [Vec<(f64, usize)>; FITTED] = std::array::from_fn(|i| at(&shifted(i, -1.0)));
    let slope = |i: usize, k: usize| (plus[i][k].0 - minus[i][k].0) / (2.0 * STEPS[i]);
    let each: Vec<Vector> = (0..here.len()).map(|k| Vector::from_fn(|i, _| slope(i, k))).collect();
    let gradient: Vector = each.iter().sum();
    let outer = each.iter().map(|g| g * g.transpose()).sum();
    let base = sum(here);
    let mut hessian = SMatrix::zeros();
    for i in 0..FITTED {
        hessian[(i, i)] = (sum(&plus[i]) - 2.0 * base + sum(&minus[i])) / (STEPS[i] * STEPS[i]);
        for j in 0..i {
            let mut both = shifted(i, 1.0);
            both[j] += STEPS[j];
            let mixed = sum(&at(&both)) - sum(&plus[i]) - sum(&plus[j]) + base;
            hessian[(i, j)] = mixed / (STEPS[i] * STEPS[j]);
            hessian[(j, i)] = hessian[(i, j)];
        }
    }
    (gradient, (hessian, outer))
}
