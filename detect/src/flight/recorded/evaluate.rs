//! How well recorded flights would have been predicted, had they been seen live.

use nalgebra::{Matrix3, Vector3};
use netcord_common::rig::{Ball, FlightConstants};

use super::{
    clock::{Clock, Pace},
    parse::{RecordedFrame, Recording, Sample},
    truth::{self, Arc},
};
use crate::flight::{
    confidence::{Curve, TOLERANCE_M, sigma_m},
    flow::{Flow, Table},
    forecast::{PATH_STEP_S, look_ahead},
    habits::Habits,
    physics::Forces,
    settings::Tuning,
    tracker::{Observation, Tracker},
};

/// Hash of a recording's name (FNV-1a): what is held out is chosen by it, and by nothing else.
pub fn name_hash(recording: &Recording) -> u64 {
    let mix = |h: u64, b: u8| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3);
    recording.name.bytes().fold(0xcbf2_9ce4_8422_2325, mix)
}

/// Horizons of the prediction error, ms.
pub const HORIZONS_MS: [u32; 5] = [100, 200, 300, 400, 500];
/// How long before the bounce its place is predicted, ms.
pub const LEADS_MS: [u32; 4] = [50, 100, 150, 200];
/// Predictions count from this long after a flight's first position, s.
const WARM_UP_S: f64 = 0.1;
/// The spin is judged this long after a flight's first position, s.
const SPIN_AFTER_S: f64 = 0.3;
/// Slower spins are hardly told from none, rad/s.
const LEAST_SPIN_RAD_S: f64 = 60.0;
/// The hitting plane of a recorded flight lies where it is after this share of its time.
const PLANE_AT: f64 = 0.85;
/// Positions on each side of the hitting plane that tell how the ball passes it.
const HITTING_SIDE: usize = 3;
/// What passes the hitting plane more slowly is not on its way to a racket, m/s.
const SLOWEST_HITTING_M_S: f64 = 1.0;
/// A table frame's origin whose height was measured on the ball rather than on the table is off by less, m.
const SAME_FRAME_M: f64 = 0.05;

/// What is known beside the positions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EvaluateOptions {
    /// Physical constants.
    pub constants: FlightConstants,
    /// The ball.
    pub ball: Ball,
    /// Height of the table's surface in recordings that are not in the table frame, m; otherwise it is
    /// found from the bounces.
    pub table_z_m: Option<f64>,
    /// Standard deviation of the positions along x, y and z, m.
    pub sigma_m: Vector3<f64>,
    /// How the stamps run, where they are not exact.
    pub pace: Option<Pace>,
    /// Noise of the model, and how far ball and table may differ from the constants.
    pub tuning: Tuning,
}

impl Default for EvaluateOptions {
    fn default() -> Self {
        Self {
            constants: FlightConstants::default(),
            ball: Ball::default(),
            table_z_m: None,
            sigma_m: Vector3::repeat(0.002),
            pace: None,
            tuning: Tuning::default(),
        }
    }
}

/// A prediction of the hitting point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bet {
    /// Standard deviation that the filter gave it, m; infinite where no crossing was predicted.
    pub sigma_m: f64,
    /// Weight of the hypotheses that predict it.
    pub weight: f64,
    /// Whether it held.
    pub held: bool,
    /// Hash of the recording's name: bets of one recording are not independent of each other.
    pub recording: u64,
}

impl Bet {
    /// The confidence that is given by `curve`.
    pub fn confidence(&self, curve: &Curve) -> f64 {
        self.weight * curve.chance(self.sigma_m)
    }
}

/// One prediction of where the ball would be, and how far it was off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictionError {
    /// How far ahead: one of [`HORIZONS_MS`].
    pub horizon_ms: u32,
    /// Prediction less truth, m.
    pub error_m: Vector3<f64>,
    /// How long the flight had been seen, s.
    pub seen_s: f64,
    /// Bounces seen before.
    pub bounces_before: usize,
    /// Bounces between the prediction and its instant.
    pub bounces_ahead: usize,
}

/// Errors of one recording, or of many together.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Evaluation {
    /// Every prediction of a place.
    pub predictions: Vec<PredictionError>,
    /// Distance between predicted and true landing point by lead, as [`LEADS_MS`], m.
    pub landing_m: [Vec<f64>; LEADS_MS.len()],
    /// Distance between predicted and true hitting point by horizon (to the nearest 0.1 s), m.
    pub hitting_m: [Vec<f64>; HORIZONS_MS.len()],
    /// Every prediction of a hitting point.
    pub bets: Vec<Bet>,
    /// Error of the spin over its size, of the parts perpendicular to the velocity.
    pub spin_perpendicular: Vec<f64>,
    /// The same of the whole vectors.
    pub spin_full: Vec<f64>,
    /// Angle between the spin found and the one measured, of the parts perpendicular to the velocity, rad; in the
    /// order of [`Self::spin_perpendicular`]. Half a turn or so: the measured one belongs to another flight.
    pub spin_off_rad: Vec<f64>,
    /// Flights seen.
    pub flights: usize,
    /// Predictions that had to be made while no flight was being followed; they count as well.
    pub blind: usize,
}

impl Evaluation {
    /// Distances between prediction and truth at one horizon, m.
    pub fn prediction_errors_m(&self, horizon_ms: u32) -> Vec<f64> {
        let at = self.predictions.iter().filter(|p| p.horizon_ms == horizon_ms);
        at.map(|p| p.error_m.norm()).collect()
    }

    /// Adds the errors of another recording.
    pub fn append(&mut self, other: &mut Self) {
        let pairs = |a: &mut [Vec<f64>], b: &mut [Vec<f64>]| {
            for (a, b) in a.iter_mut().zip(b) {
                a.append(b);
            }
        };
        self.predictions.append(&mut other.predictions);
        pairs(&mut self.landing_m, &mut other.landing_m);
        pairs(&mut self.hitting_m, &mut other.hitting_m);
        self.bets.append(&mut other.bets);
        self.spin_perpendicular.append(&mut other.spin_perpendicular);
        self.spin_full.append(&mut other.spin_full);
        self.spin_off_rad.append(&mut other.spin_off_rad);
        self.flights += other.flights;
        self.blind += other.blind;
    }
}

/// The table in a set of recordings that share a frame (one folder): the table frame's where the format
/// says so, else at `table_z_m`, else a radius below the height at which most sharp turns upwards
/// happen; `None` where there are none.
pub fn find_table(recordings: &[Recording], options: &EvaluateOptions) -> Option<Table> {
    if recordings.iter().all(|r| r.frame == RecordedFrame::Table) {
        return Some(Table::CENTRED);
    }
    let surface_z_m = options.table_z_m.or_else(|| {
        let mut heights: Vec<f64> =
            recordings.iter().flat_map(|r| truth::turning_heights(&r.samples)).collect();
        heights.sort_by(f64::total_cmp);
        // The densest 2 cm.
        let best =
            (0..heights.len()).max_by_key(|&i| heights[i..].partition_point(|z| z - heights[i] < 0.02))?;
        let dense = &heights[best..];
        let dense = &dense[..dense.partition_point(|z| z - dense[0] < 0.02)];
        Some(dense[dense.len() / 2] - options.ball.radius_m())
    })?;
    // Whether a net is up is not known: ball guns are tried without.
    Some(Table { surface_z_m, edges_known: surface_z_m.abs() < SAME_FRAME_M, net: false })
}

/// How much larger the errors of positions are than their scatter from one to the next shows: slow
/// errors (of calibration, of a camera that takes over) are common to neighbours. Found with the tuning.
const SLOW_ERRORS: f64 = 2.7;

/// Standard deviation of the positions of a set of recordings along x, y and z, m, as their own scatter
/// shows it: from third differences, which no flight has, by their median size.
pub fn find_noise(recordings: &[Recording], pace: Option<Pace>) -> Option<Vector3<f64>> {
    /// A clock needs some stamps before its instants are better than these.
    const SETTLED: usize = 12;
    /// Nearly equal steps only: the weights 1, −3, 3, −1 are for such.
    const EVEN: f64 = 0.25;
    let mut sizes: [Vec<f64>; 3] = Default::default();
    let timed: Vec<Vec<Sample>> = recordings.iter().map(|r| settled(r, pace, SETTLED)).collect();
    for w in timed.iter().flat_map(|samples| samples.windows(4)) {
        let step = (w[3].t_s - w[0].t_s) / 3.0;
        if step > 0.02 || w.windows(2).any(|p| (p[1].t_s - p[0].t_s - step).abs() > EVEN * step) {
            continue;
        }
        // Lagrange's weights for the times as they are.
        let weight =
            |i: usize| -> f64 { (0..4).filter(|j| *j != i).map(|j| 1.0 / (w[i].t_s - w[j].t_s)).product() };
        let weights = [0, 1, 2, 3].map(weight);
        let norm = weights.iter().map(|c| c * c).sum::<f64>().sqrt();
        let difference = (0..4).map(|i| w[i].position * (weights[i] / norm)).sum::<Vector3<f64>>();
        for (sizes, d) in sizes.iter_mut().zip(difference.iter()) {
            sizes.push(d.abs());
        }
    }
    let median = |sizes: &mut Vec<f64>| {
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len() / 2).copied()
    };
    let [x, y, z] = &mut sizes;
    // 1.4826: the median size of a normal variable is its standard deviation over this.
    Some(Vector3::new(median(x)?, median(y)?, median(z)?) * (1.4826 * SLOW_ERRORS))
}

/// The positions of a recording at the instants that a clock finds, without the first `skipped` if there is one.
fn settled(recording: &Recording, pace: Option<Pace>, skipped: usize) -> Vec<Sample> {
    let Some(pace) = pace else { return recording.samples.clone() };
    let mut clock = Clock::new(pace);
    let timed = recording.samples.iter().map(|s| Sample { t_s: clock.instant(s.t_s).0, ..*s });
    timed.skip(skipped).collect()
}

/// Runs over recordings of one set, one after the other as if live: what a flight teaches of ball and
/// table is known in the next.
pub fn evaluate_set(recordings: &[Recording], table: Option<Table>, options: &EvaluateOptions) -> Evaluation {
    let mut habits = Habits::new(&options.tuning.latitude);
    let mut all = Evaluation::default();
    for recording in recordings {
        let (mut one, learned) = evaluate(recording, table, options, habits);
        all.append(&mut one);
        habits = learned;
    }
    all
}

/// Runs over one recording as if live, knowing `habits`; returns what is known then as well.
pub fn evaluate(
    recording: &Recording,
    table: Option<Table>,
    options: &EvaluateOptions,
    habits: Habits,
) -> (Evaluation, Habits) {
    let mut flow = Flow::new(&options.constants, &options.ball, table, options.tuning.noise);
    // Recordings are upright even where no table was found.
    flow.forces = Forces::new(&options.constants, &options.ball);
    let mut tracker = Tracker::new(flow, options.tuning.latitude, habits);
    let level_z = table.map_or(f64::NEG_INFINITY, |t| t.surface_z_m + options.ball.radius_m());
    let mut result = Evaluation::default();
    let seen = observations(recording, options);
    let mut start = 0;
    for range in truth::flights(&recording.samples, level_z) {
        // A flight's remains that were cut off (a hit's own samples) teach the filter, but are no flight.
        for o in &seen[start..range.start] {
            tracker.observe(o);
        }
        let flight = Flight {
            samples: &recording.samples[range.clone()],
            seen: &seen[range.clone()],
            spin_rad_s: recording.spin_rad_s,
            name_hash: name_hash(recording),
        };
        flight.evaluate(&mut tracker, level_z, &mut result);
        start = range.end;
    }
    (result, tracker.finish())
}

/// A recording as the tracker sees it: each position at the instant that is known of it when it comes.
pub(super) fn observations(recording: &Recording, options: &EvaluateOptions) -> Vec<Observation> {
    /// Two positions further apart do not tell how fast the ball is, s.
    const LONGEST_STEP_S: f64 = 0.05;
    let mut clock = options.pace.map(Clock::new);
    let own = Matrix3::from_diagonal(&options.sigma_m.map(|s| s * s));
    let mut last: Option<(f64, Vector3<f64>)> = None;
    let observe = |sample: &Sample| {
        let (t_s, sigma_s) = clock.as_mut().map_or((sample.t_s, 0.0), |c| c.instant(sample.t_s));
        // A ball moves along its path while the instant is in doubt.
        let velocity = last.filter(|(before_s, _)| (1e-3..LONGEST_STEP_S).contains(&(t_s - before_s)));
        let along = velocity.map_or_else(Vector3::zeros, |(before_s, p)| {
            (sample.position - p) * (sigma_s / (t_s - before_s))
        });
        last = Some((t_s, sample.position));
        Observation { t_ns: ns(t_s), position: sample.position, covariance: own + along * along.transpose() }
    };
    recording.samples.iter().map(observe).collect()
}
/// Recorded seconds as the tracker's instants, with a second of room before the first.
fn ns(t_s: f64) -> u64 {
    ((t_s + 1.0) * 1e9).round() as u64
}

/// Where the filter says that the ball is at each horizon, and where it lands and is hit.
struct Said {
    path: [Vector3<f64>; HORIZONS_MS.len()],
    landing: Option<Vector3<f64>>,
    /// Where, the standard deviation, and the weight of those who say so.
    hitting: Option<(Vector3<f64>, f64, f64)>,
}

/// What is said of times after the stamp `t_s`, of a position that was taken at `seen_ns`.
fn ask(tracker: &Tracker, seen_ns: u64, t_s: f64, plane_y_m: f64) -> Option<Said> {
    let mut best = tracker.bank_at(seen_ns).consensus()?;
    let stamp_late_s = (ns(t_s) as f64 - seen_ns as f64) * 1e-9;
    tracker.flow().fly(&mut best.belief, stamp_late_s);
    let mut path = [Vector3::zeros(); HORIZONS_MS.len()];
    let ahead = look_ahead(tracker.flow(), &best.belief, best.exempt, 1.2, Some(plane_y_m), |k, belief| {
        let ms = (k as f64 * PATH_STEP_S * 1e3).round() as u32;
        if let Some(i) = HORIZONS_MS.iter().position(|h| *h == ms) {
            path[i] = belief.position();
        }
    });
    Some(Said {
        path,
        landing: ahead.landing.map(|(_, c)| c.belief.position()),
        hitting: ahead.crossing.map(|c| (c.belief.position(), sigma_m(&c.covariance), best.weight)),
    })
}

/// What is said while no flight is followed: the ball goes on as between its last two positions.
fn guess(samples: &[Sample]) -> Option<Said> {
    let [.., a, b] = samples else { return None };
    let velocity = (b.position - a.position) / (b.t_s - a.t_s);
    let path = HORIZONS_MS.map(|ms| b.position + velocity * (f64::from(ms) * 1e-3));
    Some(Said { path, landing: Some(b.position), hitting: None })
}

/// One flight of a recording.
struct Flight<'a> {
    samples: &'a [Sample],
    /// What the tracker is told.
    seen: &'a [Observation],
    spin_rad_s: Option<Vector3<f64>>,
    name_hash: u64,
}

impl Flight<'_> {
    fn evaluate(&self, tracker: &mut Tracker, level_z: f64, result: &mut Evaluation) {
        let flight = self.samples;
        result.flights += 1;
        let begin_s = flight[0].t_s;
        let end_s = flight[flight.len() - 1].t_s;
        let bounces = truth::bounces(flight, level_z);
        let plane = truth::position_at(flight, begin_s + PLANE_AT * (end_s - begin_s)).map(|p| p.y);
        let mut spin_judged = false;
        for (k, (sample, seen)) in flight.iter().zip(self.seen).enumerate() {
            tracker.observe(seen);
            let seen_s = sample.t_s - begin_s;
            if seen_s < WARM_UP_S {
                continue;
            }
            let said = ask(tracker, seen.t_ns, sample.t_s, plane.unwrap_or(f64::NAN));
            result.blind += usize::from(said.is_none());
            let Some(said) = said.or_else(|| guess(&flight[..=k])) else { continue };
            for (i, ms) in HORIZONS_MS.iter().enumerate() {
                if let Some(p) = truth::position_at(flight, sample.t_s + f64::from(*ms) * 1e-3) {
                    let until_s = sample.t_s + f64::from(*ms) * 1e-3;
                    result.predictions.push(PredictionError {
                        horizon_ms: *ms,
                        error_m: said.path[i] - p,
                        seen_s,
                        bounces_before: bounces.iter().filter(|b| b.t_s <= sample.t_s).count(),
                        bounces_ahead: bounces
                            .iter()
                            .filter(|b| b.t_s > sample.t_s && b.t_s <= until_s)
                            .count(),
                    });
                }
            }
            let next_s = flight.get(k + 1).map_or(f64::INFINITY, |s| s.t_s);
            if let Some(bounce) = bounces.iter().find(|b| b.t_s > sample.t_s) {
                for (i, ms) in LEADS_MS.iter().enumerate() {
                    let at = bounce.t_s - f64::from(*ms) * 1e-3;
                    if sample.t_s <= at && at < next_s {
                        let error = said.landing.map_or(f64::INFINITY, |p| (p - bounce.position).xy().norm());
                        result.landing_m[i].push(error);
                    }
                }
            }
            if let Some(y) = plane {
                judge_hitting(flight, k, y, &said, self.name_hash, result);
            }
            if let Some(truth) = self.spin_rad_s
                && !spin_judged
                && seen_s >= SPIN_AFTER_S
                && truth.norm() > LEAST_SPIN_RAD_S
                && let Some(best) = tracker.bank_at(seen.t_ns).consensus()
                && let Some(arc) =
                    Arc::fit(&flight[..flight.partition_point(|s| s.t_s < begin_s + WARM_UP_S)])
            {
                spin_judged = true;
                let along = arc.velocity(begin_s).normalize();
                let across = |w: &Vector3<f64>| w - along * along.dot(w);
                let found = best.belief.struck_spin;
                let error = found - truth;
                result.spin_off_rad.push(across(&found).angle(&across(&truth)));
                result.spin_perpendicular.push(across(&error).norm() / across(&truth).norm().max(1e-9));
                result.spin_full.push(error.norm() / truth.norm());
            }
        }
    }
}

/// Whether a ball with these positions flies at the plane y = …, rather than along it: what has been caught, or
/// creeps along a wall, passes nowhere that anybody would hit it.
fn is_hitting(samples: &[Sample]) -> bool {
    let [first, .., last] = samples else { return false };
    let moved = last.position - first.position;
    moved.y.abs() > moved.x.abs() && moved.y.abs() > SLOWEST_HITTING_M_S * (last.t_s - first.t_s)
}

/// Compares the predicted crossing of the plane y = `y` with the true one, if that is still to come.
fn judge_hitting(flight: &[Sample], k: usize, y: f64, said: &Said, recording: u64, result: &mut Evaluation) {
    let crosses = |w: &[Sample]| (w[0].position.y - y) * (w[1].position.y - y) <= 0.0;
    let Some(w) = flight[k..].windows(2).find(|w| crosses(w)) else { return };
    let share = (y - w[0].position.y) / (w[1].position.y - w[0].position.y);
    if !share.is_finite() || w[1].t_s - w[0].t_s > 0.035 {
        return;
    }
    let truth = w[0].position + (w[1].position - w[0].position) * share;
    let place = flight.partition_point(|s| s.t_s < w[0].t_s);
    if !is_hitting(&flight[place.saturating_sub(HITTING_SIDE)..flight.len().min(place + HITTING_SIDE + 1)]) {
        return;
    }
    let ahead_s = w[0].t_s + share * (w[1].t_s - w[0].t_s) - flight[k].t_s;
    let (error, sigma_m, weight) =
        said.hitting.map_or((f64::INFINITY, f64::INFINITY, 1.0), |(p, sigma_m, weight)| {
            ((p - truth).norm(), sigma_m, weight)
        });
    result.bets.push(Bet { sigma_m, weight, held: error <= TOLERANCE_M, recording });
    let nearest = (ahead_s * 10.0).round() as usize;
    if (1..=HORIZONS_MS.len()).contains(&nearest) {
        result.hitting_m[nearest - 1].push(error);
    }
}
