use nalgebra::Vector3;

/// Position, velocity and spin of a ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallState {
    /// Centre, m.
    pub position: Vector3<f64>,
    /// m/s.
    pub velocity: Vector3<f64>,
    /// rad/s.
    pub spin: Vector3<f64>,
}

/// Forces on a ball between contacts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Air {
    /// Acceleration of gravity, m/s², downwards.
    pub gravity_m_s2: f64,
    /// ½ ρ C_d A / m: deceleration per v², 1/m.
    pub drag_per_m: f64,
    /// C_M ρ V / m: acceleration per ω × v, dimensionless.
    pub magnus: f64,
    /// Rate at which spin decays, 1/s.
    pub spin_decay_per_s: f64,
}

/// 2.7 g by the ITTF's rules.
const MASS_KG: f64 = 0.0027;
/// Air at 20 °C and 101 kPa.
const AIR_DENSITY_KG_M3: f64 = 1.204;

impl Air {
    /// A ball of radius `radius_m` with drag coefficient `c_d` (published: 0.44–0.50) and Magnus
    /// coefficient `c_m` in F = C_M ρ V ω × v (published: about 0.12).
    pub fn new(radius_m: f64, c_d: f64, c_m: f64) -> Self {
        let area = std::f64::consts::PI * radius_m * radius_m;
        let volume = 4.0 / 3.0 * area * radius_m;
        Self {
            gravity_m_s2: 9.81,
            drag_per_m: 0.5 * AIR_DENSITY_KG_M3 * c_d * area / MASS_KG,
            magnus: c_m * AIR_DENSITY_KG_M3 * volume / MASS_KG,
            // Measured spins lose a few percent a second.
            spin_decay_per_s: 0.04,
        }
    }

    /// No air at all.
    pub const VACUUM: Self = Self { gravity_m_s2: 9.81, drag_per_m: 0.0, magnus: 0.0, spin_decay_per_s: 0.0 };

    fn acceleration(&self, velocity: &Vector3<f64>, spin: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(0.0, 0.0, -self.gravity_m_s2) - velocity * (self.drag_per_m * velocity.norm())
            + spin.cross(velocity) * self.magnus
    }

    /// The state `dt` seconds later, by one step of the classical fourth-order Runge–Kutta method.
    pub fn step(&self, state: &BallState, dt: f64) -> BallState {
        let BallState { position, velocity, spin } = *state;
        let spin_at = |t: f64| spin * (-self.spin_decay_per_s * t).exp();
        let (middle, end) = (spin_at(0.5 * dt), spin_at(dt));
        let a1 = self.acceleration(&velocity, &spin);
        let v2 = velocity + a1 * (0.5 * dt);
        let a2 = self.acceleration(&v2, &middle);
        let v3 = velocity + a2 * (0.5 * dt);
        let a3 = self.acceleration(&v3, &middle);
        let v4 = velocity + a3 * dt;
        let a4 = self.acceleration(&v4, &end);
        BallState {
            position: position + (velocity + 2.0 * v2 + 2.0 * v3 + v4) * (dt / 6.0),
            velocity: velocity + (a1 + 2.0 * a2 + 2.0 * a3 + a4) * (dt / 6.0),
            spin: end,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fly(air: &Air, mut state: BallState, seconds: f64, dt: f64) -> BallState {
        let steps = (seconds / dt).round() as usize;
        for _ in 0..steps {
            state = air.step(&state, dt);
        }
        state
    }

    fn smash() -> BallState {
        BallState {
            position: Vector3::new(0.1, -1.5, 0.4),
            velocity: Vector3::new(1.0, 25.0, 2.0),
            spin: Vector3::new(-700.0, 50.0, 300.0),
        }
    }

    #[test]
    fn without_air_the_path_is_the_parabola() {
        let end = fly(&Air::VACUUM, smash(), 0.5, 1e-3);
        let expected = smash().position + smash().velocity * 0.5 - Vector3::z() * (0.5 * 9.81 * 0.25);
        assert!((end.position - expected).norm() < 1e-12, "{end:?}");
    }

    #[test]
    fn drag_alone_follows_the_closed_form() {
        // dv/dt = −k v²: v = v0 / (1 + k v0 t), x = ln(1 + k v0 t) / k.
        let air = Air { gravity_m_s2: 0.0, drag_per_m: 0.13, magnus: 0.0, spin_decay_per_s: 0.0 };
        let start = BallState { velocity: Vector3::new(0.0, 30.0, 0.0), spin: Vector3::zeros(), ..smash() };
        let end = fly(&air, start, 0.4, 1e-3);
        let grown: f64 = 1.0 + 0.13 * 30.0 * 0.4;
        assert!((end.velocity.y - 30.0 / grown).abs() < 1e-9);
        assert!((end.position.y - start.position.y - grown.ln() / 0.13).abs() < 1e-9);
    }

    #[test]
    fn spin_alone_turns_the_velocity_in_a_circle() {
        // dv/dt = m ω × v keeps the speed and turns it by m |ω| t.
        let air = Air { gravity_m_s2: 0.0, drag_per_m: 0.0, magnus: 0.0018, spin_decay_per_s: 0.0 };
        let start = BallState {
            velocity: Vector3::new(10.0, 0.0, 0.0),
            spin: Vector3::new(0.0, 0.0, 500.0),
            ..smash()
        };
        let end = fly(&air, start, 0.5, 1e-3);
        let angle: f64 = 0.0018 * 500.0 * 0.5;
        let expected = Vector3::new(10.0 * angle.cos(), 10.0 * angle.sin(), 0.0);
        assert!((end.velocity - expected).norm() < 1e-9, "{}", end.velocity);
    }

    #[test]
    fn the_error_falls_with_the_fourth_power_of_the_step() {
        let air = Air::new(0.020, 0.47, 0.12);
        let exact = fly(&air, smash(), 0.4, 1e-4).position;
        let coarse = (fly(&air, smash(), 0.4, 0.02).position - exact).norm();
        let fine = (fly(&air, smash(), 0.4, 0.01).position - exact).norm();
        assert!((12.0..20.0).contains(&(coarse / fine)), "ratio {}", coarse / fine);
        assert!((fly(&air, smash(), 0.4, 1e-3).position - exact).norm() < 1e-9, "a nanometre at 1 ms");
    }
}
