use nalgebra::Vector3;

use super::BallState;

/// Half the width of the playing surface (along x), m.
pub const TABLE_HALF_WIDTH_M: f64 = 0.7625;
/// Half its length (along y), m.
pub const TABLE_HALF_LENGTH_M: f64 = 1.37;
/// Height of the net above the surface, m.
pub const NET_HEIGHT_M: f64 = 0.1525;
/// The net reaches 15.25 cm beyond each side line.
pub const NET_HALF_WIDTH_M: f64 = TABLE_HALF_WIDTH_M + 0.1525;
/// The floor: the surface is 76 cm above it.
pub const FLOOR_Z_M: f64 = -0.76;

/// What the ball meets, and how it comes off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Radius of the ball, m.
    pub radius_m: f64,
    /// Normal restitution of the table at zero speed.
    pub restitution: f64,
    /// Loss of it per m/s of normal speed, s/m.
    pub restitution_slope_s_m: f64,
    /// Coefficient of sliding friction of the table.
    pub friction: f64,
    /// Normal restitution of the floor.
    pub floor_restitution: f64,
}

/// A surface that the ball has met.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surface {
    /// The playing surface.
    Table,
    /// The net.
    Net,
    /// The floor.
    Floor,
}

/// Share of the speed across the net that a ball keeps, backwards: the net gives way and swings back.
const NET_RESTITUTION: f64 = 0.15;
/// Share of the speed along the net that a ball keeps.
const NET_SLIP: f64 = 0.4;

impl Contact {
    /// The surface that the ball has come to touch between `before` and `after`, a short step apart.
    pub fn between(&self, before: &BallState, after: &BallState) -> Option<Surface> {
        let (p, q) = (&before.position, &after.position);
        let fell_to = |z: f64| p.z > z && q.z <= z;
        let over_table = q.x.abs() <= TABLE_HALF_WIDTH_M && q.y.abs() <= TABLE_HALF_LENGTH_M;
        if over_table && fell_to(self.radius_m) {
            return Some(Surface::Table);
        }
        // The ball's surface meets the net's plane one radius before its centre does.
        let side = if before.velocity.y > 0.0 { -self.radius_m } else { self.radius_m };
        let reaches_net = (p.y - side) * (q.y - side) <= 0.0 && p.y != side;
        let below_top = q.z > 0.0 && q.z < NET_HEIGHT_M + 0.5 * self.radius_m;
        if reaches_net && below_top && q.x.abs() <= NET_HALF_WIDTH_M {
            return Some(Surface::Net);
        }
        fell_to(FLOOR_Z_M + self.radius_m).then_some(Surface::Floor)
    }

    /// The state just after touching `surface`.
    pub fn bounce(&self, surface: Surface, state: &BallState) -> BallState {
        match surface {
            Surface::Table => {
                let speed = state.velocity.z.abs();
                let restitution = (self.restitution - self.restitution_slope_s_m * speed).max(0.5);
                self.impulse(state, restitution, self.friction)
            }
            Surface::Floor => self.impulse(state, self.floor_restitution, 0.4),
            Surface::Net => {
                let v = &state.velocity;
                let velocity = Vector3::new(v.x * NET_SLIP, -v.y * NET_RESTITUTION, v.z * NET_SLIP);
                BallState { velocity, spin: state.spin * NET_SLIP, ..*state }
            }
        }
    }

    /// A thin shell meets a level plane: the normal speed is reversed and shrinks; friction acts on
    /// the touching point until it sticks, or as long as the normal impulse lasts (Garwin 1969;
    /// inertia ⅔ m r², so that sticking takes the impulse ⅖ m v_t).
    fn impulse(&self, state: &BallState, restitution: f64, friction: f64) -> BallState {
        let arm = Vector3::new(0.0, 0.0, -self.radius_m);
        let normal = (1.0 + restitution) * state.velocity.z.abs();
        let touching = state.velocity + state.spin.cross(&arm);
        let sliding = Vector3::new(touching.x, touching.y, 0.0);
        let tangential = (0.4 * sliding.norm()).min(friction * normal);
        // Both impulses per unit of mass.
        let along = sliding.try_normalize(1e-12).map_or_else(Vector3::zeros, |d| -d * tangential);
        BallState {
            velocity: state.velocity + along + Vector3::z() * normal,
            spin: state.spin + arm.cross(&along) / (2.0 / 3.0 * self.radius_m * self.radius_m),
            ..*state
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONTACT: Contact = Contact {
        radius_m: 0.02,
        restitution: 0.98,
        restitution_slope_s_m: 0.02,
        friction: 0.25,
        floor_restitution: 0.75,
    };

    fn state(velocity: [f64; 3], spin: [f64; 3]) -> BallState {
        BallState {
            position: Vector3::new(0.0, 0.7, 0.02),
            velocity: Vector3::from(velocity),
            spin: Vector3::from(spin),
        }
    }

    /// Energy per unit of mass, without height.
    fn energy(s: &BallState) -> f64 {
        0.5 * s.velocity.norm_squared() + 0.5 * (2.0 / 3.0) * 0.02 * 0.02 * s.spin.norm_squared()
    }

    #[test]
    fn a_bounce_takes_energy_and_keeps_angular_momentum_about_the_touching_point() {
        for (v, w) in [
            ([1.0, 12.0, -5.0], [-600.0, 30.0, 100.0]),
            ([0.0, 5.0, -2.0], [400.0, 0.0, 0.0]),
            ([0.3, 0.2, -3.0], [0.0; 3]),
        ] {
            let before = state(v, w);
            let after = CONTACT.bounce(Surface::Table, &before);
            assert!(energy(&after) < energy(&before));
            // About the touching point friction has no arm: I ω + m r × v changes only along z × v_z.
            let momentum = |s: &BallState| {
                s.spin * (2.0 / 3.0 * 0.02 * 0.02) + Vector3::new(0.0, 0.0, 0.02).cross(&s.velocity)
            };
            assert!((momentum(&after) - momentum(&before)).norm() < 1e-12);
            let restitution = -after.velocity.z / before.velocity.z;
            assert!((restitution - (0.98 + 0.02 * v[2])).abs() < 1e-12);
        }
    }

    #[test]
    fn a_slow_slide_ends_in_rolling_and_a_fast_one_goes_on() {
        let rolling = CONTACT.bounce(Surface::Table, &state([0.0, 1.0, -4.0], [0.0; 3]));
        let touching = rolling.velocity + rolling.spin.cross(&Vector3::new(0.0, 0.0, -0.02));
        assert!(touching.xy().norm() < 1e-12, "sticks: {touching}");
        let sliding = CONTACT.bounce(Surface::Table, &state([0.0, 20.0, -2.0], [0.0; 3]));
        let lost = 20.0 - sliding.velocity.y;
        assert!((lost - 0.25 * (1.0 + 0.94) * 2.0).abs() < 1e-12, "friction's whole impulse: {lost}");
    }

    #[test]
    fn topspin_shoots_forward_and_backspin_holds_back() {
        // Flying along +y, topspin turns about −x.
        let plain = CONTACT.bounce(Surface::Table, &state([0.0, 2.0, -3.0], [0.0; 3]));
        let top = CONTACT.bounce(Surface::Table, &state([0.0, 2.0, -3.0], [-600.0, 0.0, 0.0]));
        let back = CONTACT.bounce(Surface::Table, &state([0.0, 2.0, -3.0], [400.0, 0.0, 0.0]));
        assert!(top.velocity.y > 2.0 && back.velocity.y < plain.velocity.y);
    }
}
