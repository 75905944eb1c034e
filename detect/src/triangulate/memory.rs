//! What the triangulator remembers of past triggers: where the ball was, and which things do not move.

use nalgebra::Vector3;

/// Gravity, m/s², along −z of the table frame.
const GRAVITY_M_S2: f64 = 9.81;

/// Faster than any ball in play, m/s.
const TOP_SPEED_M_S: f64 = 45.0;

/// A track that was not seen for this long says nothing any more.
const TRACK_MEMORY_NS: u64 = 200_000_000;

/// Positions that the velocity is taken from.
const RECENT: usize = 6;

/// Positions older than this are from before a hit or bounce too often.
const RECENT_NS: u64 = 80_000_000;

/// What the prediction is off by after 10 ms: drag, spin and noise.
const PREDICTION_SIGMA_M: f64 = 0.015;

/// Most things at rest that are remembered.
const SPOTS: usize = 48;

/// Two sightings nearer than this are of the same thing at rest, m.
pub(super) const SPOT_RADIUS_M: f64 = 0.015;

/// A ball in flight leaves such a circle within 0.12 s, even at the top of a vertical toss.
const REST_NS: u64 = 300_000_000;

/// Sightings that prove rest.
const REST_SIGHTINGS: u32 = 8;

/// A spot that was not seen for this long is forgotten.
const SPOT_MEMORY_NS: u64 = 3_000_000_000;

/// The path that proves that a track moves, m.
const MOVING_M: f64 = 0.15;

/// What triangulation and the table's pose may be off by at the table, m.
const LEVEL_M: f64 = 0.015;

/// Half the table with a margin: width and length, m.
const TABLE_HALF_M: [f64; 2] = [0.80, 1.40];

/// Nearer to the floor than any stroke is played; the playing surface lies 0.76 m above it, m.
const NEAR_FLOOR_M: f64 = -0.60;

/// A track whose heights span more than this flies; what rolls or rests does not, m.
const FLYING_SPAN_M: f64 = 0.025;

/// A flying ball comes to the table within this distance of where it was predicted, m.
const ARRIVES_M: f64 = 0.12;

/// Most things that lie or roll that are followed.
const ROLLERS: usize = 8;

/// Faster than balls roll about on a table, m/s.
const ROLLING_M_S: f64 = 0.8;

/// Sightings after which something that lies or rolls is known.
const KNOWN_ROLLER: u32 = 3;

/// Something that rolls and was not seen for this long may be anywhere: it goes behind the net, or the ball.
const ROLLER_MEMORY_NS: u64 = 250_000_000;

#[derive(Debug, Clone, Copy, Default)]
struct Spot {
    anchor: Vector3<f64>,
    first_ns: u64,
    last_ns: u64,
    sightings: u32,
    /// It was seen while a ball was in flight elsewhere: it is not the ball.
    beside_ball: bool,
}

/// Something at the height of a ball that lies or rolls.
#[derive(Debug, Clone, Copy, Default)]
struct Roller {
    place: Vector3<f64>,
    last_ns: u64,
    sightings: u32,
}

impl Roller {
    /// Whether it may have come to `point` by `t_ns`.
    fn reaches(&self, t_ns: u64, point: &Vector3<f64>) -> bool {
        let Some(age) = age_ns(t_ns, self.last_ns).filter(|age| *age <= ROLLER_MEMORY_NS) else {
            return false;
        };
        self.sightings > 0 && (self.place - point).norm() <= SPOT_RADIUS_M + ROLLING_M_S * age as f64 * 1e-9
    }
}

impl Spot {
    fn rests(&self) -> bool {
        self.sightings >= REST_SIGHTINGS && self.last_ns.saturating_sub(self.first_ns) >= REST_NS
    }
}

/// The memory.
#[derive(Debug, Clone)]
pub(super) struct Memory {
    recent: [(u64, Vector3<f64>); RECENT],
    count: usize,
    spots: [Spot; SPOTS],
    rollers: [Roller; ROLLERS],
    gravity: Vector3<f64>,
    /// The ball's radius, m: so far above the table its centre lies when it touches it.
    radius_m: f64,
}

/// Where the track goes on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Predicted {
    /// Where, m.
    pub place: Vector3<f64>,
    /// How fast, m/s.
    pub velocity: Vector3<f64>,
}

/// What is known of a point that does not move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rest {
    /// Nothing: it moves, or has not been seen for long enough.
    Unknown,
    /// It has not moved.
    Still,
    /// It has not moved while the ball was in flight elsewhere.
    LookAlike,
}

impl Memory {
    /// For a ball of so large a radius; `upright`: whether z of the world points up (the table frame), so that gravity
    /// is known.
    pub fn new(upright: bool, radius_m: f64) -> Self {
        let g = if upright { -GRAVITY_M_S2 } else { 0.0 };
        Self {
            recent: [(0, Vector3::zeros()); RECENT],
            count: 0,
            spots: [Spot::default(); SPOTS],
            rollers: [Roller::default(); ROLLERS],
            gravity: Vector3::new(0.0, 0.0, g),
            radius_m,
        }
    }

    fn recent(&self) -> &[(u64, Vector3<f64>)] {
        &self.recent[..self.count]
    }

    /// Logarithm of how much likelier the ball is at `point` at `t_ns` than anywhere in a hall; 0 where
    /// nothing is known. `predicted`: what [`Self::predict`] says; `off_track`: squared distance of the paths that the
    /// ball left during the exposure from those of the predicted velocity, in standard deviations: what flies on has
    /// both place and velocity.
    pub fn log_prior(
        &self,
        t_ns: u64,
        point: &Vector3<f64>,
        predicted: Option<&Predicted>,
        off_track: f64,
    ) -> f64 {
        /// Volume in which a ball could be, m³.
        const HALL_M3: f64 = 100.0;
        /// Chance that the ball has been hit since, and flies on in any direction.
        const HIT: f64 = 0.1;
        /// Chance that the track was not the ball, or that another ball is served.
        const WRONG: f64 = 0.1;
        let Some((last_ns, last)) = self.recent().last() else { return 0.0 };
        let Some(age_ns) = age_ns(t_ns, *last_ns).filter(|age| *age <= TRACK_MEMORY_NS) else {
            return 0.0;
        };
        let dt = age_ns as f64 * 1e-9;
        let mut density = WRONG / HALL_M3;
        density += HIT * gaussian((point - last).norm_squared(), 0.05 + 0.4 * TOP_SPEED_M_S * dt);
        if let Some(predicted) = predicted {
            // Grows with the square of time: what is not modelled is an acceleration.
            let sigma = PREDICTION_SIGMA_M * (1.0 + (dt / 0.02).powi(2));
            let flies_on = gaussian((point - predicted.place).norm_squared(), sigma);
            density += (1.0 - HIT - WRONG) * flies_on * (-0.5 * off_track).exp();
        }
        (density * HALL_M3).ln()
    }

    /// Where the ball should be at `t_ns`, at constant velocity under gravity.
    pub fn predict(&self, t_ns: u64) -> Option<Predicted> {
        let (last_ns, last) = self.recent().last()?;
        let age_ns = age_ns(t_ns, *last_ns).filter(|age| *age <= TRACK_MEMORY_NS)?;
        // Least squares for p and v at the last instant, of p + v t + g t²/2.
        let (mut n, mut st, mut stt) = (0.0, 0.0, 0.0);
        let (mut sp, mut stp) = (Vector3::zeros(), Vector3::zeros());
        for (at_ns, p) in self.recent().iter().filter(|(at, _)| last_ns - at <= RECENT_NS) {
            let t = -((last_ns - at_ns) as f64 * 1e-9);
            let level = p - self.gravity * (0.5 * t * t) - last;
            n += 1.0;
            st += t;
            stt += t * t;
            sp += level;
            stp += level * t;
        }
        let determinant = n * stt - st * st;
        if n < 2.0 || determinant <= 1e-12 {
            return None;
        }
        let velocity = (stp * n - sp * st) / determinant;
        let start = (sp - velocity * st) / n + last;
        let t = age_ns as f64 * 1e-9;
        Some(Predicted {
            place: start + velocity * t + self.gravity * (0.5 * t * t),
            velocity: velocity + self.gravity * t,
        })
    }

    /// Whether the track has moved far enough to be a ball in play.
    pub fn is_moving(&self) -> bool {
        let recent = self.recent();
        recent.len() >= 4 && (recent[0].1 - recent[recent.len() - 1].1).norm() > MOVING_M
    }

    /// Adds the position of a trigger.
    pub fn follow(&mut self, t_ns: u64, point: Vector3<f64>) {
        if let Some((last_ns, last)) = self.recent().last().copied() {
            let dt = t_ns.saturating_sub(last_ns) as f64 * 1e-9;
            let gone = t_ns < last_ns || t_ns - last_ns > TRACK_MEMORY_NS;
            if gone || (point - last).norm() > TOP_SPEED_M_S * dt + 0.05 {
                self.count = 0;
            }
        }
        if self.count == RECENT {
            self.recent.copy_within(1.., 0);
            self.count -= 1;
        }
        self.recent[self.count] = (t_ns, point);
        self.count += 1;
    }

    /// What is known of a point as a thing at rest.
    pub fn rest(&self, t_ns: u64, point: &Vector3<f64>) -> Rest {
        if self.lies_or_rolls(t_ns, point) {
            return Rest::LookAlike;
        }
        match self.spot(t_ns, point).map(|i| &self.spots[i]) {
            Some(spot) if spot.rests() && spot.beside_ball => Rest::LookAlike,
            Some(spot) if spot.rests() => Rest::Still,
            _ => Rest::Unknown,
        }
    }

    /// Whether a point is at the height of a ball that lies or rolls on the table or the floor, and no flight
    /// has brought it there: a ball in play touches the table only where its path comes down, and not where something
    /// is known to lie or roll.
    fn lies_or_rolls(&self, t_ns: u64, point: &Vector3<f64>) -> bool {
        if !self.is_low(point) {
            return false;
        }
        let known = |roller: &Roller| roller.sightings >= KNOWN_ROLLER && roller.reaches(t_ns, point);
        !self.arrives(t_ns, point) || self.rollers.iter().any(known)
    }

    /// Whether a point is at the height of a ball that lies on the table or the floor.
    fn is_low(&self, point: &Vector3<f64>) -> bool {
        let on_table = (point.z - self.radius_m).abs() < LEVEL_M
            && point.x.abs() < TABLE_HALF_M[0]
            && point.y.abs() < TABLE_HALF_M[1];
        self.gravity.z != 0.0 && (on_table || point.z < NEAR_FLOOR_M)
    }

    /// Whether a flight comes to a point.
    fn arrives(&self, t_ns: u64, point: &Vector3<f64>) -> bool {
        let heights = self.recent().iter().map(|(_, p)| p.z);
        let span = heights.clone().fold(f64::MIN, f64::max) - heights.fold(f64::MAX, f64::min);
        let near = self.predict(t_ns).is_some_and(|p| (p.place - point).norm() < ARRIVES_M);
        span > FLYING_SPAN_M && near
    }

    /// Follows what lies or rolls.
    fn sight_roller(&mut self, t_ns: u64, point: &Vector3<f64>) {
        if !self.lies_or_rolls(t_ns, point) {
            return;
        }
        if let Some(i) = self.rollers.iter().position(|roller| roller.reaches(t_ns, point)) {
            let roller = &mut self.rollers[i];
            roller.sightings += u32::from(roller.last_ns != t_ns);
            (roller.place, roller.last_ns) = (*point, t_ns);
            return;
        }
        let age = |roller: &Roller| age_ns(t_ns, roller.last_ns).unwrap_or(u64::MAX);
        if let Some(oldest) = self.rollers.iter_mut().max_by_key(|roller| age(roller)) {
            *oldest = Roller { place: *point, last_ns: t_ns, sightings: 1 };
        }
    }

    fn spot(&self, t_ns: u64, point: &Vector3<f64>) -> Option<usize> {
        self.spots.iter().position(|s| {
            s.sightings > 0
                && age_ns(t_ns, s.last_ns).is_some_and(|age| age <= SPOT_MEMORY_NS)
                && (s.anchor - point).norm_squared() <= SPOT_RADIUS_M * SPOT_RADIUS_M
        })
    }

    /// How long ago something was seen at `point`, s, if within the last few frames and not for the first time: it has
    /// hardly moved since. A ball that is hit back comes through a place twice.
    pub fn stayed_s(&self, t_ns: u64, point: &Vector3<f64>) -> Option<f64> {
        /// Older sightings tell of another thing; those of the same trigger of none.
        const AGE_NS: std::ops::RangeInclusive<u64> = 500_000..=50_000_000;
        let here = |spot: &&Spot| (spot.anchor - point).norm_squared() <= SPOT_RADIUS_M * SPOT_RADIUS_M;
        let seen = self.spots.iter().filter(|spot| spot.sightings > 1).filter(here);
        seen.filter_map(|spot| age_ns(t_ns, spot.last_ns))
            .filter(|age| AGE_NS.contains(age))
            .min()
            .map(|age| age as f64 * 1e-9)
    }

    /// Takes note of any point that cameras agree on; `chosen`: it was reported as the ball.
    pub fn sight(&mut self, t_ns: u64, point: &Vector3<f64>, chosen: bool) {
        self.sight_roller(t_ns, point);
        let beside = !chosen && self.is_moving();
        if let Some(i) = self.spot(t_ns, point) {
            let spot = &mut self.spots[i];
            if spot.last_ns != t_ns {
                spot.sightings += 1;
                spot.last_ns = t_ns;
            }
            spot.beside_ball |= beside && spot.rests();
            return;
        }
        // What flies leaves a new spot in each frame: the one that was not seen for longest goes.
        // One from the future is of an earlier round of a loop.
        let age = |s: &Spot| age_ns(t_ns, s.last_ns).unwrap_or(u64::MAX);
        let oldest = self.spots.iter().enumerate().max_by_key(|(_, s)| age(s)).map_or(0, |(i, _)| i);
        self.spots[oldest] =
            Spot { anchor: *point, first_ns: t_ns, last_ns: t_ns, sightings: 1, beside_ball: false };
    }
}

/// Time from `then` to `now`, zero where `now` is another camera's exposure of the same trigger; `None`
/// where time has gone back, as in a recording that is played in a loop: then nothing is known.
fn age_ns(now: u64, then: u64) -> Option<u64> {
    /// More than the exposures of one trigger lie apart, less than a loop of any recording.
    const SKEW_NS: u64 = 50_000_000;
    now.checked_sub(then).or_else(|| (then - now <= SKEW_NS).then_some(0))
}

/// Density of an isotropic normal distribution in space at a squared distance.
fn gaussian(distance2: f64, sigma: f64) -> f64 {
    let norm = (std::f64::consts::TAU * sigma * sigma).powf(1.5);
    (-0.5 * distance2 / (sigma * sigma)).exp() / norm
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME_NS: u64 = 10_000_000;

    fn thrown(t_ns: u64) -> Vector3<f64> {
        let t = t_ns as f64 * 1e-9;
        Vector3::new(0.1 + 2.0 * t, -1.0 + 6.0 * t, 0.3 + 2.0 * t - 0.5 * GRAVITY_M_S2 * t * t)
    }

    fn log_prior(memory: &Memory, t_ns: u64, point: &Vector3<f64>) -> f64 {
        memory.log_prior(t_ns, point, memory.predict(t_ns).as_ref(), 0.0)
    }

    #[test]
    fn a_thrown_ball_is_predicted_and_favoured() {
        let mut memory = Memory::new(true, 0.020);
        for i in 0..6 {
            memory.follow(i * FRAME_NS, thrown(i * FRAME_NS));
        }
        let next = 6 * FRAME_NS;
        assert!((memory.predict(next).expect("six positions").place - thrown(next)).norm() < 1e-9);
        assert!(memory.is_moving());
        let near = log_prior(&memory, next, &thrown(next));
        let hit = log_prior(&memory, next, &(thrown(next) + Vector3::new(0.1, 0.1, 0.1)));
        let far = log_prior(&memory, next, &(thrown(next) + Vector3::new(2.0, 0.0, 0.0)));
        assert!(near > 8.0 && near > hit && hit > 0.0 && far < -2.0, "{near} {hit} {far}");
        assert_eq!(log_prior(&memory, next + 300_000_000, &thrown(0)), 0.0);
        memory.follow(next, thrown(next));
        assert!(memory.predict(next - 1_000_000).is_some(), "another camera's exposure of the same trigger");
        assert_eq!((log_prior(&memory, 0, &thrown(0)), memory.predict(0)), (0.0, None), "back in time");
        memory.follow(0, thrown(0));
        assert!(log_prior(&memory, FRAME_NS, &thrown(FRAME_NS)) > 0.0, "a new track from there");
    }

    #[test]
    fn what_rolls_on_the_table_is_a_look_alike_however_large_balls_are() {
        for radius_m in [0.005, 0.020, 0.050] {
            let mut memory = Memory::new(true, radius_m);
            for i in 0..40 {
                let t = f64::from(i) * 0.01;
                // Half a metre a second, measured to 5 mm.
                let rolling =
                    Vector3::new(-0.05, -1.1 + 0.5 * t, radius_m + 0.005 * (1.7 * f64::from(i)).sin());
                let t_ns = i as u64 * FRAME_NS;
                assert_eq!(memory.rest(t_ns, &rolling), Rest::LookAlike, "radius {radius_m}, frame {i}");
                memory.sight(t_ns, &rolling, false);
            }
        }
    }

    #[test]
    fn rest_takes_time_and_a_look_alike_is_one_that_was_there_beside_the_ball() {
        let mut memory = Memory::new(true, 0.020);
        let lamp = Vector3::new(1.0, 1.0, 1.0);
        for i in 0..100 {
            let t = i * FRAME_NS;
            let noise = Vector3::new(0.002 * (i as f64).sin(), 0.0, 0.002 * (i as f64).cos());
            if i < 25 {
                assert_eq!(memory.rest(t, &(lamp + noise)), Rest::Unknown, "frame {i}");
            } else if (35..50).contains(&i) {
                assert_eq!(memory.rest(t, &(lamp + noise)), Rest::Still, "frame {i}");
            } else if i > 60 {
                assert_eq!(memory.rest(t, &(lamp + noise)), Rest::LookAlike, "frame {i}");
            }
            if i >= 50 {
                assert_eq!(memory.rest(t, &thrown(t)), Rest::Unknown, "the ball itself never rests");
                memory.follow(t, thrown(t));
                memory.sight(t, &thrown(t), true);
            }
            memory.sight(t, &(lamp + noise), false);
        }
    }
}
