//! One ball followed through its flights: where they begin, bounce and end.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};

use super::{
    bank::{Bank, Hypothesis},
    belief::Belief,
    flow::{Exempt, Flow},
    physics::{DRAG, FRICTION, RESTITUTION, SLANT, STATE, StateMatrix, join},
    prior,
};

/// A measured position of the ball.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Observation {
    /// Middle of the exposure, ns.
    pub t_ns: u64,
    /// Where, m.
    pub position: Vector3<f64>,
    /// Covariance, m².
    pub covariance: Matrix3<f64>,
}

/// What an observation turned out to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Of the flight that is being followed.
    InFlight,
    /// The first of a flight was found with it.
    Began,
    /// It fits no flight: an outlier, or the first after a hit.
    Unexplained,
    /// It came too late, or twice.
    TooLate,
}

/// Positions further than this from every hypothesis (squared Mahalanobis distance, 3 degrees of
/// freedom) are unexplained.
const GATE_CHI2: f64 = 30.0;
/// Measured positions have heavy tails: in the gate, and only there, their covariance counts this many
/// times. A hit is metres per second away from every hypothesis, and leaves this gate all the same.
const TAIL_VARIANCE: f64 = 4.2;
/// A ball's first positions are still of the hit: a racket holds it for a few milliseconds, cameras smear the
/// turn, and what finds positions may have joined those before it. Taken as free flight they tell of a spin that
/// is not there, and the filter, sure of it, does not forgive them. Spectral density of the acceleration that a
/// flight begins with beside what the model leaves out, m²/s³, and how soon it is over, s.
const HIT_ACCELERATION: f64 = 0.85;
const HIT_LASTS_S: f64 = 0.016;
/// From here on a position's covariance is widened, so that it pulls no more than one at this distance
/// (Huber's weights): chance 9 %.
const HUBER_CHI2: f64 = 6.4;
/// Positions of the present flight that are kept to put late ones in their place: 0.5 s at 100 Hz.
const HISTORY: usize = 48;
/// Unexplained positions that are kept; a flight begins with at most as many.
const PENDING: usize = 6;
/// Unexplained positions that show a new flight on their own.
const PROOF: usize = 3;
/// A flight that has not been seen for so long has ended, ns. Gaps of 100 ms are survived with room.
const LONGEST_GAP_NS: u64 = 250_000_000;
/// Positions of one beginning lie within this time, ns.
const LONGEST_BEGINNING_NS: u64 = 120_000_000;
/// Slower than this nothing flies, m/s.
const SLOWEST_M_S: f64 = 0.3;
/// Faster than this no ball is hit, m/s: the record is about 36.
const FASTEST_M_S: f64 = 40.0;
/// Most drag and Magnus force together while a beginning is sought, m/s².
const UNMODELLED_M_S2: f64 = 40.0;
/// How near a flight's beginning must come to the end of the last one for two positions to prove a hit, m.
const HIT_PLACE_M: f64 = 0.08;
/// A hit changes the velocity by at least this, m/s.
const LEAST_TURN_M_S: f64 = 1.0;
/// By how much a belief is widened that many positions contradict: m, m/s.
const RECONCILE_M: f64 = 0.03;
const RECONCILE_M_S: f64 = 0.5;
/// A position that no flight explains tells where the ball is for so long, s.
const NEWCOMER_S: f64 = 0.03;
/// Standard deviation of the velocity after one such position, and after two, in each direction: windows hold
/// five, and no ball is hit faster. Two may lie on both sides of a hit.
const ANYWHERE_M_S: f64 = 6.0;
const TURNING_M_S: f64 = 3.0;
/// A flight seen for less time teaches nothing of ball and table, ns.
const INSTRUCTIVE_NS: u64 = 150_000_000;

/// One flight changes what is believed of ball and table by this share of its latitude at most: a hit that was
/// taken for a bounce must not spoil the flights to come.
const MOST_LESSON: f64 = 0.5;

/// How many numbers of a state are peculiar to ball, table and frame: the last of it.
const PECULIAR: usize = STATE - DRAG;

/// What is peculiar to this ball, table and frame ([`DRAG`], [`RESTITUTION`], [`SLANT`], [`FRICTION`]), learned
/// flight by flight: mean and variance of each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Habits([(f64, f64); PECULIAR]);

impl Habits {
    /// Nothing learned yet.
    pub fn new(latitude: &Latitude) -> Self {
        Self(latitude.sigmas().map(|sigma| (0.0, sigma * sigma)))
    }
}

/// How far ball, table and frame may differ from the rig file, as standard deviations, and how much of what
/// was learned is forgotten with each flight, as a share of that.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Latitude {
    /// Of the logarithm of the drag.
    pub drag: f64,
    /// Of the restitution.
    pub restitution: f64,
    /// Of each horizontal acceleration, m/s².
    pub slant_m_s2: f64,
    /// Of the logarithm of the table's friction.
    pub friction: f64,
    /// Share of the above by which it may change from flight to flight.
    pub forgetting: f64,
}

impl Latitude {
    /// In the order of a state.
    fn sigmas(&self) -> [f64; PECULIAR] {
        const { assert!(RESTITUTION == DRAG + 1 && SLANT == DRAG + 2) };
        const { assert!(FRICTION == SLANT + 2 && STATE == FRICTION + 1) };
        [self.drag, self.restitution, self.slant_m_s2, self.slant_m_s2, self.friction]
    }
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    observation: Observation,
    /// The bank after it.
    bank: Bank,
}

/// Follows the ball. Allocates only when it is made.
#[derive(Debug, Clone)]
pub struct Tracker {
    flow: Flow,
    latitude: Latitude,
    habits: Habits,
    bank: Bank,
    /// Instant of the bank.
    t_ns: u64,
    began_ns: u64,
    flight_id: u64,
    history: VecDeque<Entry>,
    pending: [Observation; PENDING],
    pending_len: usize,
}

impl Tracker {
    /// Follows no ball yet, and knows of ball and table what `habits` say.
    pub fn new(flow: Flow, latitude: Latitude, habits: Habits) -> Self {
        Self {
            flow,
            latitude,
            habits,
            bank: Bank::default(),
            t_ns: 0,
            began_ns: 0,
            flight_id: 0,
            history: VecDeque::with_capacity(HISTORY + 1),
            pending: [Observation::default(); PENDING],
            pending_len: 0,
        }
    }

    /// How beliefs move.
    pub fn flow(&self) -> &Flow {
        &self.flow
    }

    /// Counts the flights from 1.
    pub fn flight_id(&self) -> u64 {
        self.flight_id
    }

    /// Whether a flight is being followed.
    pub fn is_in_flight(&self) -> bool {
        self.bank.best().is_some()
    }

    /// Whether positions have been seen that no flight explains: a hit may have happened.
    pub fn is_unsettled(&self) -> bool {
        self.pending_len > 0
    }

    /// Instant of the last position of the flight, ns.
    pub fn last_seen_ns(&self) -> u64 {
        self.t_ns
    }

    /// The hypotheses moved on to `t_ns`.
    pub fn bank_at(&self, t_ns: u64) -> Bank {
        let mut bank = self.bank;
        bank.advance(&self.flow, seconds(self.t_ns, t_ns).max(0.0));
        bank
    }

    /// Where a ball will be at `t_ns` whose last positions no flight explains: it has been hit, or comes into view.
    pub fn newcomer_at(&self, t_ns: u64) -> Option<Hypothesis> {
        let (last, earlier) = self.pending[..self.pending_len].split_last()?;
        let ahead_s = seconds(last.t_ns, t_ns);
        if !(0.0..=NEWCOMER_S).contains(&ahead_s) {
            return None;
        }
        let between =
            earlier.last().map(|o| (o, seconds(o.t_ns, last.t_ns))).filter(|(_, s)| *s <= NEWCOMER_S);
        let (velocity, sigma) = match between {
            Some((o, s)) => ((last.position - o.position) / s, TURNING_M_S),
            None => (Vector3::zeros(), ANYWHERE_M_S),
        };
        let mut belief = Belief::default();
        let moved = last.position + velocity * ahead_s;
        belief.mean.fixed_rows_mut::<3>(0).copy_from(&moved);
        belief.mean.fixed_rows_mut::<3>(3).copy_from(&velocity);
        let spread = last.covariance + Matrix3::identity() * (sigma * ahead_s).powi(2);
        belief.covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&spread);
        Some(Hypothesis { belief, weight: 1.0, ..Hypothesis::default() })
    }

    /// How beliefs move on to positions at `t_ns`: soon after a hit less surely than the forecast's flow has it.
    fn flow_at_age(&self, t_ns: u64) -> Flow {
        let age_s = seconds(self.began_ns, t_ns).max(0.0);
        let mut flow = self.flow;
        flow.noise.acceleration += HIT_ACCELERATION * (-age_s / HIT_LASTS_S).exp();
        flow
    }

    /// Notes that the time is `t_ns`: a flight that has not been seen for long ends.
    pub fn pass_time(&mut self, t_ns: u64) {
        if self.is_in_flight() && t_ns.saturating_sub(self.t_ns) > LONGEST_GAP_NS {
            self.end();
        }
        self.forget_pending(t_ns);
    }

    /// Takes a position in, wherever in time it belongs.
    pub fn observe(&mut self, observation: &Observation) -> Verdict {
        let t_ns = observation.t_ns;
        if !observation.position.iter().chain(observation.covariance.iter()).all(|v| v.is_finite()) {
            return Verdict::Unexplained;
        }
        self.pass_time(t_ns);
        if self.is_in_flight() {
            if t_ns <= self.t_ns {
                return self.observe_late(observation);
            }
            let mut bank = self.bank;
            bank.advance(&self.flow_at_age(t_ns), seconds(self.t_ns, t_ns));
            if accept(&mut bank, observation) {
                self.bank = bank;
                self.t_ns = t_ns;
                self.remember(*observation);
                self.drop_pending_before(t_ns);
                return Verdict::InFlight;
            }
        }
        if !self.add_pending(observation) {
            return Verdict::TooLate;
        }
        if self.begin() { Verdict::Began } else { Verdict::Unexplained }
    }

    /// Puts a position between those that have been taken in, and takes these in again.
    fn observe_late(&mut self, observation: &Observation) -> Verdict {
        let later = self.history.partition_point(|e| e.observation.t_ns <= observation.t_ns);
        let Some(before) = later.checked_sub(1).map(|i| self.history[i]) else { return Verdict::TooLate };
        if before.observation.t_ns == observation.t_ns {
            return Verdict::TooLate;
        }
        let mut bank = before.bank;
        bank.advance(&self.flow_at_age(observation.t_ns), seconds(before.observation.t_ns, observation.t_ns));
        if !accept(&mut bank, observation) {
            return Verdict::Unexplained;
        }
        if self.history.len() == HISTORY {
            self.history.pop_front();
        }
        let place = self.history.partition_point(|e| e.observation.t_ns < observation.t_ns);
        self.history.insert(place, Entry { observation: *observation, bank });
        let mut t_ns = observation.t_ns;
        for i in place + 1..self.history.len() {
            let next = self.history[i].observation;
            bank.advance(&self.flow_at_age(next.t_ns), seconds(t_ns, next.t_ns));
            accept(&mut bank, &next);
            self.history[i].bank = bank;
            t_ns = next.t_ns;
        }
        self.bank = bank;
        Verdict::InFlight
    }

    fn remember(&mut self, observation: Observation) {
        if self.history.len() == HISTORY {
            self.history.pop_front();
        }
        self.history.push_back(Entry { observation, bank: self.bank });
    }

    /// Ends what is being followed, and tells what was learned of ball and table.
    pub fn finish(mut self) -> Habits {
        self.end();
        self.habits
    }

    /// The flight is over: what it taught of ball and table is kept.
    fn end(&mut self) {
        if let Some(best) = self.bank.consensus()
            && self.t_ns - self.began_ns >= INSTRUCTIVE_NS
        {
            let sigmas = self.latitude.sigmas();
            let known = self.habits.0;
            self.habits = Habits(std::array::from_fn(|i| {
                let (place, (before, _)) = (DRAG + i, known[i]);
                let most = MOST_LESSON * sigmas[i];
                let mean = before + (best.belief.mean[place] - before).clamp(-most, most);
                let forgotten = (self.latitude.forgetting * sigmas[i]).powi(2);
                let variance = best.belief.covariance[(place, place)] + forgotten;
                (mean, variance.min(sigmas[i] * sigmas[i]))
            }));
        }
        self.bank.clear();
        self.history.clear();
    }

    /// Looks whether the unexplained positions are the beginning of a flight, and begins it; or whether
    /// they are the old flight's after all, seen with a common error.
    fn begin(&mut self) -> bool {
        let n = self.pending_len;
        let found = (2..=n).rev().find_map(|k| {
            let beginning = Beginning::fit(&self.pending[n - k..n], &self.flow)?;
            let proven = match self.bank.best() {
                None => k >= PROOF,
                // Two are enough where they come from where the last flight was: an outlier has no past.
                Some(_) => {
                    self.is_turn(&beginning, self.pending[n - k].t_ns)
                        && (k >= PROOF || self.comes_from_flight(&beginning, self.pending[n - k].t_ns))
                }
            };
            proven.then_some((k, beginning))
        });
        let Some((k, beginning)) = found else {
            if n == PENDING && self.is_in_flight() {
                self.reconcile();
            }
            return false;
        };
        let first = n - k;
        self.end();
        self.flight_id += 1;
        self.began_ns = self.pending[first].t_ns;
        self.bank = beginning.bank(&self.habits);
        self.t_ns = self.began_ns;
        for i in first..n {
            let observation = self.pending[i];
            let flow = self.flow_at_age(observation.t_ns);
            self.bank.advance(&flow, seconds(self.t_ns, observation.t_ns));
            self.bank.take_in(&observation.position, &observation.covariance);
            self.t_ns = observation.t_ns;
            self.remember(observation);
        }
        self.pending_len = 0;
        true
    }

    /// Whether a beginning's velocity differs from the flight's by more than errors explain. Positions
    /// that are merely beside the flight have some error in common and are no hit.
    fn is_turn(&self, beginning: &Beginning, first_ns: u64) -> bool {
        self.bank_at(first_ns).all().iter().all(|h| {
            let doubt = h.belief.covariance.fixed_view::<3, 3>(3, 3).trace().sqrt();
            (beginning.velocity - h.belief.velocity()).norm()
                > LEAST_TURN_M_S + 2.0 * doubt + 4.0 * beginning.velocity_sigma
        })
    }

    /// Many positions in a row that no hypothesis explains, but that are no other flight either: the
    /// belief was too narrow. It is widened to take them in.
    fn reconcile(&mut self) {
        let (n, mut t_ns) = (self.pending_len, self.t_ns);
        let mut bank = self.bank;
        for i in 0..n {
            let observation = self.pending[i];
            if observation.t_ns <= t_ns {
                continue;
            }
            bank.advance(&self.flow, seconds(t_ns, observation.t_ns));
            if i == 0 {
                bank.widen(RECONCILE_M, RECONCILE_M_S);
            }
            t_ns = observation.t_ns;
            bank.take_in(&observation.position, &observation.covariance);
            self.bank = bank;
            self.t_ns = t_ns;
            self.remember(observation);
        }
        self.pending_len = 0;
    }

    /// Whether a beginning, followed back in time, meets the flight that was being followed.
    fn comes_from_flight(&self, beginning: &Beginning, first_ns: u64) -> bool {
        let Some(best) = self.bank.best() else { return false };
        let between = seconds(self.t_ns, first_ns);
        (0..=8).any(|step| {
            let after = between * f64::from(step) / 8.0;
            let mut old = best.belief;
            let mut exempt = best.exempt;
            self.flow.advance(&mut old, after, &mut exempt, |_| {});
            let new = beginning.position - beginning.velocity * (between - after);
            let slack = HIT_PLACE_M + old.position_covariance().trace().sqrt();
            (old.position() - new).norm() < slack
        })
    }

    fn forget_pending(&mut self, t_ns: u64) {
        self.drop_pending_before(t_ns.saturating_sub(LONGEST_BEGINNING_NS));
    }

    fn drop_pending_before(&mut self, t_ns: u64) {
        let old = self.pending[..self.pending_len].partition_point(|o| o.t_ns < t_ns);
        self.pending.copy_within(old..self.pending_len, 0);
        self.pending_len -= old;
    }

    /// Inserts by time; false for an instant that is there already.
    fn add_pending(&mut self, observation: &Observation) -> bool {
        if self.pending_len == PENDING {
            self.pending.copy_within(1.., 0);
            self.pending_len -= 1;
        }
        let place = self.pending[..self.pending_len].partition_point(|o| o.t_ns < observation.t_ns);
        if place < self.pending_len && self.pending[place].t_ns == observation.t_ns {
            return false;
        }
        self.pending.copy_within(place..self.pending_len, place + 1);
        self.pending[place] = *observation;
        self.pending_len += 1;
        true
    }
}

/// Takes an observation into the bank if it fits one of its hypotheses.
fn accept(bank: &mut Bank, observation: &Observation) -> bool {
    let Observation { position, covariance, .. } = observation;
    if bank.chi2(position, &(covariance * TAIL_VARIANCE)) > GATE_CHI2 {
        return false;
    }
    let chi2 = bank.chi2(position, covariance);
    bank.take_in(position, &(covariance * (chi2 / HUBER_CHI2).max(1.0)));
    true
}

fn seconds(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.wrapping_sub(from_ns).cast_signed() as f64 * 1e-9
}

/// A parabola through a few positions.
#[derive(Debug, Clone, Copy)]
struct Beginning {
    /// At the first position's instant, m.
    position: Vector3<f64>,
    /// At the first position's instant, m/s.
    velocity: Vector3<f64>,
    /// Standard deviation of the velocity, m/s.
    velocity_sigma: f64,
}

impl Beginning {
    /// Least squares of p + v t + g t²/2; `None` where the positions are not of one flight.
    fn fit(observations: &[Observation], flow: &Flow) -> Option<Self> {
        let (first, last) = (observations.first()?, observations.last()?);
        if last.t_ns - first.t_ns > LONGEST_BEGINNING_NS {
            return None;
        }
        let gravity = flow.forces.gravity_m_s2;
        let (mut n, mut st, mut stt) = (0.0, 0.0, 0.0);
        let (mut sx, mut stx) = (Vector3::zeros(), Vector3::zeros());
        for o in observations {
            let t = seconds(first.t_ns, o.t_ns);
            let weight = 1.0 / o.covariance.trace().max(1e-12);
            let x = o.position - 0.5 * t * t * gravity;
            n += weight;
            st += weight * t;
            stt += weight * t * t;
            sx += weight * x;
            stx += weight * t * x;
        }
        let determinant = n * stt - st * st;
        if determinant <= 0.0 {
            return None;
        }
        let velocity = (n * stx - st * sx) / determinant;
        let position = (stt * sx - st * stx) / determinant;
        if !(SLOWEST_M_S..FASTEST_M_S).contains(&velocity.norm()) {
            return None;
        }
        let fits = observations.iter().all(|o| {
            let t = seconds(first.t_ns, o.t_ns);
            let span = seconds(first.t_ns, last.t_ns);
            let off = o.position - (position + velocity * t + 0.5 * t * t * gravity);
            // Largest deviation of a parabola from its chord.
            let slack = UNMODELLED_M_S2 * span * span / 8.0;
            let tolerated = o.covariance + Matrix3::identity() * (slack * slack);
            tolerated.cholesky().is_some_and(|c| off.dot(&c.solve(&off)) < GATE_CHI2)
        });
        // The weights are inverse variances of all three coordinates together.
        let velocity_sigma = (n / determinant).sqrt();
        fits.then_some(Self { position, velocity, velocity_sigma })
    }

    /// Hypotheses at the first position's instant. Position and velocity are left open, since the
    /// positions that they were fitted to are taken in afterwards; the fit is where the flight is
    /// linearised.
    fn bank(&self, habits: &Habits) -> Bank {
        let mut bank = Bank::default();
        for (share, spin, spin_covariance) in prior::spin(&self.velocity) {
            let mut mean = join(&self.position, &self.velocity, &spin);
            let mut covariance = StateMatrix::zeros();
            for i in 0..3 {
                covariance[(i, i)] = 1.0;
                covariance[(i + 3, i + 3)] = 400.0;
            }
            for (i, (learned, variance)) in (DRAG..).zip(habits.0) {
                mean[i] = learned;
                covariance[(i, i)] = variance;
            }
            covariance.fixed_view_mut::<3, 3>(6, 6).copy_from(&spin_covariance);
            let belief = Belief::new(mean, covariance);
            bank.add(Hypothesis { belief, weight: share, bounces: 0, exempt: Exempt::default() });
        }
        bank
    }
}
