//! One ball followed through its flights: where they begin, bounce and end.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};

use super::{
    bank::{Bank, Hypothesis},
    beginning::{Beginning, LONGEST_BEGINNING_NS},
    belief::Belief,
    flow::Flow,
    habits::{Habits, Latitude},
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
pub(super) const GATE_CHI2: f64 = 30.0;
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
    /// Velocity with which it began, m/s.
    struck_m_s: Vector3<f64>,
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
            struck_m_s: Vector3::zeros(),
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
            self.habits.learn(&self.latitude, &self.struck_m_s, &best.belief);
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
        self.struck_m_s = beginning.velocity;
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

pub(super) fn seconds(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.wrapping_sub(from_ns).cast_signed() as f64 * 1e-9
}
