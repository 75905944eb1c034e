use super::{Air, BallState, Contact, contact::Surface};

/// Step of the integration and spacing of the knots, s: the integrator's error is then a nanometre
/// over a flight, and that of interpolating between knots less.
const STEP_S: f64 = 1e-3;

/// Halvings of a step to find the instant of a contact: 1 ms / 2³⁰ is below a picosecond.
const HALVINGS: u32 = 30;

/// One flight from a racket on, contacts included, as knots between which it is interpolated.
#[derive(Debug, Clone, Default)]
pub struct FlightPath {
    knots: Vec<Knot>,
    contacts: Vec<(f64, Surface)>,
}

#[derive(Debug, Clone, Copy)]
struct Knot {
    t_s: f64,
    state: BallState,
}

impl FlightPath {
    /// Room for flights of up to four seconds, so that none allocates.
    pub fn with_room() -> Self {
        Self { knots: Vec::with_capacity(4200), contacts: Vec::with_capacity(64) }
    }

    /// Flies from `start` at `t_s` until `ends` says so, or for `longest_s`.
    pub fn fly(
        &mut self,
        air: &Air,
        contact: &Contact,
        (t_s, start): (f64, BallState),
        longest_s: f64,
        mut ends: impl FnMut(f64, &BallState, &[(f64, Surface)]) -> bool,
    ) {
        self.knots.clear();
        self.contacts.clear();
        let (mut t, mut state) = (t_s, start);
        self.knots.push(Knot { t_s: t, state });
        while t < t_s + longest_s && !ends(t, &state, &self.contacts) {
            let next = air.step(&state, STEP_S);
            let Some(surface) = contact.between(&state, &next) else {
                (t, state) = (t + STEP_S, next);
                self.knots.push(Knot { t_s: t, state });
                continue;
            };
            let (mut low, mut high) = (0.0, STEP_S);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (low + high);
                if contact.between(&state, &air.step(&state, middle)).is_some() {
                    high = middle;
                } else {
                    low = middle;
                }
            }
            // `low` is the last instant before the contact, so the bounce starts above the surface.
            let touching = air.step(&state, low);
            t += low.max(1e-9);
            self.knots.push(Knot { t_s: t, state: touching });
            state = contact.bounce(surface, &touching);
            self.contacts.push((t, surface));
            self.knots.push(Knot { t_s: t, state });
            if self.contacts.len() == self.contacts.capacity() {
                // A ball that rattles to rest: what follows is of no interest.
                break;
            }
        }
    }

    /// When it begins and ends, s.
    pub fn span(&self) -> (f64, f64) {
        let at = |knot: Option<&Knot>| knot.map_or(0.0, |k| k.t_s);
        (at(self.knots.first()), at(self.knots.last()))
    }

    /// The last state.
    pub fn end(&self) -> Option<(f64, BallState)> {
        self.knots.last().map(|k| (k.t_s, k.state))
    }

    /// Contacts, in order of time.
    #[cfg(test)]
    pub fn contacts(&self) -> &[(f64, Surface)] {
        &self.contacts
    }

    /// The state at `t_s`, within the span.
    pub fn at(&self, t_s: f64) -> Option<BallState> {
        let after = self.knots.partition_point(|k| k.t_s <= t_s);
        let (a, b) = (self.knots.get(after.checked_sub(1)?)?, self.knots.get(after)?);
        Some(between(a, b, t_s))
    }
}

/// Cubic Hermite interpolation: positions and velocities of both knots are met.
fn between(a: &Knot, b: &Knot, t_s: f64) -> BallState {
    let h = b.t_s - a.t_s;
    let s = (t_s - a.t_s) / h;
    let (s2, s3) = (s * s, s * s * s);
    let (p, q, v, w) = (a.state.position, b.state.position, a.state.velocity, b.state.velocity);
    BallState {
        position: p * (2.0 * s3 - 3.0 * s2 + 1.0)
            + v * (h * (s3 - 2.0 * s2 + s))
            + q * (3.0 * s2 - 2.0 * s3)
            + w * (h * (s3 - s2)),
        velocity: (q - p) * (6.0 * (s - s2) / h) + v * (3.0 * s2 - 4.0 * s + 1.0) + w * (3.0 * s2 - 2.0 * s),
        spin: a.state.spin.lerp(&b.state.spin, s),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn contact() -> Contact {
        Contact {
            radius_m: 0.02,
            restitution: 0.9,
            restitution_slope_s_m: 0.0,
            friction: 0.0,
            floor_restitution: 0.7,
        }
    }

    fn dropped(from_m: f64) -> BallState {
        BallState {
            position: Vector3::new(0.1, 0.5, from_m + 0.02),
            velocity: Vector3::zeros(),
            spin: Vector3::zeros(),
        }
    }

    #[test]
    fn a_dropped_ball_bounces_when_and_as_high_as_the_law_of_falling_says() {
        let mut arc = FlightPath::with_room();
        arc.fly(&Air::VACUUM, &contact(), (2.0, dropped(0.5)), 2.0, |_, _, c| c.len() == 3);
        let falling = (2.0 * 0.5 / 9.81_f64).sqrt();
        let expected = [falling, falling * 2.8, falling * (2.8 + 1.62)];
        for ((t, surface), expected) in arc.contacts().iter().zip(expected) {
            assert_eq!(*surface, Surface::Table);
            assert!((t - 2.0 - expected).abs() < 1e-8, "{t}");
        }
        let apex = arc.at(2.0 + falling * 1.9).expect("within");
        assert!((apex.position.z - 0.02 - 0.5 * 0.81).abs() < 1e-7, "{apex:?}");
    }

    #[test]
    fn between_knots_it_is_the_integrated_path() {
        let air = Air::new(0.02, 0.47, 0.12);
        let start = BallState {
            velocity: Vector3::new(3.0, 0.5, 2.0),
            spin: Vector3::new(0.0, 300.0, 500.0),
            ..dropped(0.4)
        };
        let mut arc = FlightPath::with_room();
        arc.fly(&air, &contact(), (0.0, start), 0.1, |_, _, _| false);
        let got = arc.at(0.05037).expect("within");
        let mut state = start;
        for _ in 0..50 {
            state = air.step(&state, 1e-3);
        }
        let exact = air.step(&state, 0.37e-3);
        assert!((got.position - exact.position).norm() < 1e-9);
        assert!((got.velocity - exact.velocity).norm() < 1e-5);
    }

    #[test]
    fn a_ball_into_the_net_drops_on_its_own_side() {
        let start = BallState {
            position: Vector3::new(0.0, -0.5, 0.1),
            velocity: Vector3::new(0.0, 8.0, 0.3),
            spin: Vector3::zeros(),
        };
        let mut arc = FlightPath::with_room();
        arc.fly(&Air::VACUUM, &contact(), (0.0, start), 1.0, |_, _, c| c.len() == 2);
        assert_eq!(arc.contacts()[0].1, Surface::Net);
        assert_eq!(arc.contacts()[1].1, Surface::Table);
        let end = arc.end().expect("flown").1;
        assert!(end.position.y < 0.0 && end.velocity.y < 0.0);
    }
}
