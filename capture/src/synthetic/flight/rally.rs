use nalgebra::{Vector2, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, LogNormal};
use rand_pcg::Pcg64;

use super::{
    Air, BallState, BallTrack, Contact, NET_HEIGHT_M, TrackPoint,
    contact::Surface,
    path::FlightPath,
    shot::{self, Aim},
};

/// How a rally is played.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RallyStyle {
    /// Median speed of a stroke, m/s (the mean over the way to the bounce).
    pub speed_m_s: f64,
    /// Fastest stroke, m/s.
    pub fastest_m_s: f64,
    /// Median spin, rad/s.
    pub spin_rad_s: f64,
    /// Strongest spin, rad/s.
    pub strongest_rad_s: f64,
    /// Share of strokes that the receiver misses.
    pub misses: f64,
    /// Shortest and longest time without a ball between rallies, s.
    pub pause_s: (f64, f64),
}

/// A rally that never ends: strokes to and fro, a miss now and then, a pause, a new serve.
#[derive(Debug)]
pub struct Rally {
    air: Air,
    contact: Contact,
    style: RallyStyle,
    seed: u64,
    random: Pcg64,
    /// The newest stretch last; older ones are kept for exposures that began in them.
    stretches: [Stretch; KEPT],
    server: f64,
    flights: u64,
}

/// Stretches kept: an exposure, a desynchronised camera and a delayed question look back less than
/// one flight.
const KEPT: usize = 4;

/// The time until the first serve, s.
const FIRST_SERVE_S: f64 = 0.1;

/// A ball that is not returned is watched this long, s.
const WATCHED_S: f64 = 0.6;

/// Spread of the logarithm of speeds and spins: professional strokes have a median of 8.4 m/s and a
/// 99th percentile of 21 m/s, 265 and 811 rad/s.
const SPEED_SPREAD: f64 = 0.40;
const SPIN_SPREAD: f64 = 0.48;

/// Serves that are tried before there is a pause instead: of a ball that can be played the first nearly always is good.
const SERVES: u32 = 20;

/// Attempts at a stroke before the player gives up; each third of them is slower than the last.
const ATTEMPTS: u32 = 60;

#[derive(Debug, Clone, Default)]
struct Stretch {
    from_s: f64,
    to_s: f64,
    /// 0 where there is no ball.
    flight_id: u64,
    path: FlightPath,
}

impl Rally {
    /// A rally of a ball that flies and bounces so, in that style; the same for the same `seed`.
    pub fn new(air: Air, contact: Contact, style: RallyStyle, seed: u64) -> Self {
        let mut rally = Self {
            air,
            contact,
            style,
            seed,
            random: Pcg64::seed_from_u64(seed),
            stretches: std::array::from_fn(|_| Stretch {
                path: FlightPath::with_room(),
                ..Stretch::default()
            }),
            server: -1.0,
            flights: 0,
        };
        rally.restart();
        rally
    }

    /// Whether the ball can be played at all: one that is large and as light as the rules have it is stopped by the
    /// air before the net.
    pub fn begins(&mut self) -> bool {
        self.restart();
        self.at(FIRST_SERVE_S).is_some()
    }

    fn restart(&mut self) {
        self.random = Pcg64::seed_from_u64(self.seed);
        self.server = -1.0;
        self.flights = 0;
        for stretch in &mut self.stretches {
            (stretch.from_s, stretch.to_s, stretch.flight_id) = (0.0, 0.0, 0);
        }
        self.newest().to_s = FIRST_SERVE_S;
    }

    fn newest(&mut self) -> &mut Stretch {
        &mut self.stretches[KEPT - 1]
    }

    /// Adds the stretch that follows the newest.
    fn advance(&mut self) {
        let end = self.newest().path.end().filter(|_| self.newest().flight_id != 0);
        let from_s = self.newest().to_s;
        let returned =
            end.filter(|(_, ball)| playable(ball, self.contact.radius_m) && ball.velocity.y != 0.0);
        self.stretches.rotate_left(1);
        match (end, returned) {
            (Some(_), Some((_, ball))) if self.stroke(from_s, &ball) => {}
            (None, _) if self.serve(from_s) => {}
            (_, _) => {
                let (shortest, longest) = self.style.pause_s;
                let pause = self.random.random_range(shortest..=longest);
                let stretch = self.newest();
                (stretch.from_s, stretch.to_s, stretch.flight_id) = (from_s, from_s + pause, 0);
            }
        }
    }

    /// Feeds serves from behind the table until one is good; false where none was.
    fn serve(&mut self, from_s: f64) -> bool {
        self.server = -self.server;
        for _ in 0..SERVES {
            let position = Vector3::new(
                self.random.random_range(-0.5..0.5),
                self.server * self.random.random_range(1.4..1.8),
                self.random.random_range(0.15..0.5),
            );
            let ball = BallState { position, velocity: Vector3::y() * self.server, spin: Vector3::zeros() };
            if self.stroke(from_s, &ball) {
                return true;
            }
        }
        false
    }

    /// Plays `ball` back to the other side; false where no stroke could.
    fn stroke(&mut self, from_s: f64, ball: &BallState) -> bool {
        let side = ball.position.y.signum();
        let style = self.style;
        let median = LogNormal::new(style.speed_m_s.ln(), SPEED_SPREAD).expect("finite");
        let turning = LogNormal::new(style.spin_rad_s.ln(), SPIN_SPREAD).expect("finite");
        let mut speed = median.sample(&mut self.random).min(style.fastest_m_s);
        let mut spin = turning.sample(&mut self.random).min(style.strongest_rad_s);
        for attempt in 1..=ATTEMPTS {
            let to = Vector2::new(
                self.random.random_range(-0.6..0.6),
                -side * self.random.random_range(0.3..1.28),
            );
            // Topspin or backspin about x, with sidespin mixed in; two strokes of three are topspin.
            let top = if self.random.random_bool(0.66) { side } else { -0.6 * side };
            let axis =
                Vector3::new(top, self.random.random_range(-0.25..0.25), self.random.random_range(-0.6..0.6));
            let distance = (to - ball.position.xy()).norm();
            let aim =
                Aim { from: ball.position, to, spin: axis.normalize() * spin, flight_s: distance / speed };
            if let Some(start) = shot::solve(&self.air, self.contact.radius_m, &aim) {
                self.fly(from_s, start);
                return true;
            }
            if attempt % 3 == 0 {
                speed = (speed * 0.93).max(3.0);
                spin *= 0.97;
            }
        }
        false
    }

    fn fly(&mut self, from_s: f64, start: BallState) {
        let receiver = start.velocity.y.signum();
        let missed = self.random.random_bool(self.style.misses);
        let reach = self.random.random_range(1.38..1.95);
        let radius = self.contact.radius_m;
        self.flights += 1;
        let (air, contact, flight_id) = (self.air, self.contact, self.flights);
        let stretch = self.newest();
        stretch.path.fly(&air, &contact, (from_s, start), 4.0, |t, ball, contacts| {
            let good = contacts.len() == 1 && contacts[0].1 == Surface::Table;
            if good && !missed && ball.position.y * receiver > 0.0 && playable(ball, radius) {
                return ball.position.y * receiver >= reach
                    || ball.velocity.z < 0.0 && ball.position.z < 0.06 && ball.position.y * receiver > 1.37;
            }
            contacts.last().is_some_and(|(last, _)| t - last > WATCHED_S)
                || contacts.iter().filter(|(_, s)| *s == Surface::Floor).count() > 3
        });
        let (from_s, to_s) = stretch.path.span();
        (stretch.from_s, stretch.to_s, stretch.flight_id) = (from_s, to_s, flight_id);
    }
}

/// Whether a player can return a ball from here: near the table's end, not below its edge.
fn playable(ball: &BallState, radius_m: f64) -> bool {
    ball.position.y.abs() > 1.2
        && ball.position.y.abs() < 2.1
        && ball.position.x.abs() < 1.2
        && ball.position.z > radius_m
        && ball.position.z < NET_HEIGHT_M + 0.8
}

impl BallTrack for Rally {
    fn at(&mut self, t_s: f64) -> Option<TrackPoint> {
        if t_s < self.stretches[0].from_s {
            self.restart();
        }
        while t_s >= self.newest().to_s {
            self.advance();
        }
        let stretch = self.stretches.iter().find(|s| (s.from_s..s.to_s).contains(&t_s))?;
        if stretch.flight_id == 0 {
            return None;
        }
        stretch.path.at(t_s).map(|state| TrackPoint { state, flight_id: stretch.flight_id })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rally(seed: u64) -> Rally {
        rally_of(0.02, seed)
    }

    fn rally_of(radius_m: f64, seed: u64) -> Rally {
        let contact = Contact {
            radius_m,
            restitution: 0.98,
            restitution_slope_s_m: 0.02,
            friction: 0.27,
            floor_restitution: 0.75,
        };
        let style = RallyStyle {
            speed_m_s: 8.4,
            fastest_m_s: 30.0,
            spin_rad_s: 265.0,
            strongest_rad_s: 800.0,
            misses: 0.15,
            pause_s: (0.4, 1.0),
        };
        Rally::new(Air::new(radius_m, 0.47, 0.12), contact, style, seed)
    }

    #[test]
    fn a_ball_that_cannot_be_played_is_never_there_and_asking_for_it_ends() {
        assert!((0..5).all(|seed| rally(seed).begins()));
        let mut balloon = rally_of(0.075, 1);
        assert!(!balloon.begins());
        assert_eq!(balloon.at(3.0), None);
    }

    #[test]
    fn play_stays_over_the_table_with_the_speeds_and_spins_of_real_play() {
        let mut rally = rally(5);
        let (mut seen, mut near, mut speeds, mut spins) = (0, 0, Vec::new(), Vec::new());
        let mut last_flight = 0;
        for frame in 0..12_000 {
            let Some(point) = rally.at(f64::from(frame) * 0.01) else { continue };
            seen += 1;
            let p = point.state.position;
            near += u32::from(p.x.abs() < 1.3 && p.y.abs() < 2.2 && p.z > 0.0 && p.z < 1.0);
            if point.flight_id != last_flight {
                last_flight = point.flight_id;
                speeds.push(point.state.velocity.norm());
                spins.push(point.state.spin.norm());
            }
        }
        assert!(last_flight > 100, "{last_flight} flights in two minutes");
        assert!((0.5..0.97).contains(&(f64::from(seen) / 12_000.0)), "a ball in {seen} of 12000 frames");
        assert!(f64::from(near) > 0.75 * f64::from(seen), "{near} of {seen} over and about the table");
        speeds.sort_by(f64::total_cmp);
        spins.sort_by(f64::total_cmp);
        let median = speeds[speeds.len() / 2];
        assert!((6.0..11.0).contains(&median), "median speed {median}");
        assert!(*speeds.last().expect("some") > 15.0, "fastest {:?}", speeds.last());
        assert!((150.0..350.0).contains(&spins[spins.len() / 2]), "{}", spins[spins.len() / 2]);
        assert!(*spins.last().expect("some") <= 801.0);
    }

    #[test]
    fn the_ball_jumps_nowhere_but_between_rallies() {
        let mut rally = rally(6);
        let mut before: Option<TrackPoint> = None;
        for step in 0..60_000 {
            let now = rally.at(f64::from(step) * 1e-3);
            if let (Some(a), Some(b)) = (before, now) {
                let moved = (a.state.position - b.state.position).norm();
                assert!(moved < 0.045, "{moved} m in a millisecond at {step} ms");
                assert!(b.flight_id == a.flight_id || b.flight_id == a.flight_id + 1);
            }
            if let Some(point) = now {
                let p = point.state.position;
                let over = p.x.abs() < 0.76 && p.y.abs() < 1.36;
                assert!(!over || p.z > 0.019, "through the table at {step} ms: {p}");
            }
            before = now;
        }
    }

    #[test]
    fn the_order_of_asking_does_not_matter() {
        let mut forward = rally(7);
        let path: Vec<_> = (0..3000).map(|i| forward.at(f64::from(i) * 0.01)).collect();
        let mut random = rally(7);
        for i in [2999, 5, 1500, 1499, 0, 2500] {
            assert_eq!(random.at(i as f64 * 0.01), path[i], "frame {i}");
        }
        assert_ne!(rally(8).at(1.0), path[100]);
    }
}
