//! The forces on a flying ball.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use netcord_common::rig::{Ball, FlightConstants};

/// How many numbers make a [`State`].
pub const STATE: usize = 11;
/// Place of the logarithm of this ball's drag over the rig file's.
pub const DRAG: usize = 9;
/// Place of this table's normal restitution less the rig file's.
pub const RESTITUTION: usize = 10;

/// Position (m), velocity (m/s) and spin (rad/s) of the ball, and two properties of ball and table that
/// differ from the rig file's by a little and are learned from flight to flight: [`DRAG`] and
/// [`RESTITUTION`].
pub type State = SVector<f64, STATE>;
/// Covariance of a [`State`], and derivatives of one by another.
pub type StateMatrix = SMatrix<f64, STATE, STATE>;

/// Acceleration of free fall at middle latitudes, m/s². Sea level values range from 9.78 to 9.83: 0.3 %,
/// 6 mm after 0.5 s, which a fit of drag and Magnus partly absorbs.
pub const GRAVITY_M_S2: f64 = 9.81;

/// What bends and slows a flight, reduced to accelerations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Forces {
    /// Free fall, m/s².
    pub gravity_m_s2: Vector3<f64>,
    /// k_D in a = −k_D |v| v, 1/m: ρ C_d A / 2 m.
    pub drag_per_m: f64,
    /// k_M in a = k_M ω × v / (1 + c S), without unit: C_M ρ V / m.
    pub magnus: f64,
    /// c above, where S = r |ω × v| / v² is the spin parameter.
    pub magnus_saturation: f64,
    /// Radius of the ball r, m.
    pub radius_m: f64,
}

impl Forces {
    /// From the constants of a rig file, gravity along −z.
    pub fn new(constants: &FlightConstants, ball: &Ball) -> Self {
        let r = ball.radius_m();
        let area = std::f64::consts::PI * r * r;
        let volume = 4.0 / 3.0 * area * r;
        let density_over_mass = constants.air_density_kg_m3 / constants.mass_kg;
        Self {
            gravity_m_s2: Vector3::new(0.0, 0.0, -GRAVITY_M_S2),
            drag_per_m: 0.5 * density_over_mass * constants.drag * area,
            magnus: density_over_mass * constants.magnus * volume,
            magnus_saturation: constants.magnus_saturation,
            radius_m: r,
        }
    }

    /// Acceleration at velocity `v` and spin `w` with the drag `drag_per_m`, m/s². Lift grows less than in
    /// proportion to fast spins: C_L = 1 / (a + b / S) is how it is usually fitted to balls, which is this
    /// form with c = a / b.
    fn acceleration(&self, v: &Vector3<f64>, w: &Vector3<f64>, drag_per_m: f64) -> Vector3<f64> {
        let turned = w.cross(v);
        let v2 = v.norm_squared();
        let s = self.radius_m * turned.norm() / v2.max(1e-6);
        self.gravity_m_s2 - drag_per_m * v2.sqrt() * v
            + turned * (self.magnus / (1.0 + self.magnus_saturation * s))
    }

    /// ∂(Magnus acceleration)/∂v and /∂ω.
    fn magnus_derivatives(&self, v: &Vector3<f64>, w: &Vector3<f64>) -> (Matrix3<f64>, Matrix3<f64>) {
        let turned = w.cross(v);
        let (length, v2) = (turned.norm(), v.norm_squared().max(1e-6));
        let divisor = 1.0 + self.magnus_saturation * self.radius_m * length / v2;
        let (turned_by_v, turned_by_w) = (w.cross_matrix(), -v.cross_matrix());
        let along = if length > 1e-9 { turned / length } else { Vector3::zeros() };
        let scale = self.radius_m / v2;
        let s_by_v = scale * (turned_by_v.transpose() * along - v * (2.0 * length / v2));
        let s_by_w = scale * (turned_by_w.transpose() * along);
        let k = self.magnus / divisor;
        let loss = self.magnus_saturation / divisor;
        (
            k * (turned_by_v - loss * turned * s_by_v.transpose()),
            k * (turned_by_w - loss * turned * s_by_w.transpose()),
        )
    }

    /// This ball's drag, 1/m.
    fn drag_of(&self, state: &State) -> f64 {
        self.drag_per_m * state[DRAG].exp()
    }

    /// The state `h` seconds later in free flight, by one Runge–Kutta step of fourth order. At table
    /// tennis speeds a step of 20 ms errs by less than 1 µm.
    pub fn step(&self, state: &State, h: f64) -> State {
        let (p, v, w) = split(state);
        let k = self.drag_of(state);
        let a1 = self.acceleration(&v, &w, k);
        let v2 = v + 0.5 * h * a1;
        let a2 = self.acceleration(&v2, &w, k);
        let v3 = v + 0.5 * h * a2;
        let a3 = self.acceleration(&v3, &w, k);
        let v4 = v + h * a3;
        let a4 = self.acceleration(&v4, &w, k);
        let mut after = *state;
        after.fixed_rows_mut::<3>(0).copy_from(&(p + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)));
        after.fixed_rows_mut::<3>(3).copy_from(&(v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)));
        after
    }

    /// ∂(state after `h`)/∂(state before), from the accelerations' derivatives in the middle of the
    /// step, to third order in `h`.
    pub fn transition(&self, middle: &State, h: f64) -> StateMatrix {
        let (_, v, w) = split(middle);
        let speed = v.norm().max(1e-9);
        let drag = self.drag_of(middle);
        let (magnus_by_v, by_w) = self.magnus_derivatives(&v, &w);
        let by_v = magnus_by_v - drag * (Matrix3::identity() * speed + v * v.transpose() / speed);
        let i = Matrix3::identity();
        let by_v2 = by_v * by_v;
        let mut f = StateMatrix::identity();
        f.fixed_view_mut::<3, 3>(0, 3).copy_from(&(i * h + by_v * (h * h / 2.0) + by_v2 * (h * h * h / 6.0)));
        f.fixed_view_mut::<3, 3>(3, 3).copy_from(&(i + by_v * h + by_v2 * (h * h / 2.0)));
        // What a constant acceleration does to position and velocity.
        let to_p = i * (h * h / 2.0) + by_v * (h * h * h / 6.0);
        let to_v = i * h + by_v * (h * h / 2.0) + by_v2 * (h * h * h / 6.0);
        f.fixed_view_mut::<3, 3>(0, 6).copy_from(&(to_p * by_w));
        f.fixed_view_mut::<3, 3>(3, 6).copy_from(&(to_v * by_w));
        let by_drag = -drag * speed * v;
        f.fixed_view_mut::<3, 1>(0, DRAG).copy_from(&(to_p * by_drag));
        f.fixed_view_mut::<3, 1>(3, DRAG).copy_from(&(to_v * by_drag));
        f
    }
}

/// Position, velocity and spin of a state.
pub fn split(state: &State) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
    (
        state.fixed_rows::<3>(0).into_owned(),
        state.fixed_rows::<3>(3).into_owned(),
        state.fixed_rows::<3>(6).into_owned(),
    )
}

/// A state of position, velocity and spin, with drag and restitution as the rig file has them.
pub fn join(p: &Vector3<f64>, v: &Vector3<f64>, w: &Vector3<f64>) -> State {
    let mut state = State::zeros();
    state.fixed_rows_mut::<3>(0).copy_from(p);
    state.fixed_rows_mut::<3>(3).copy_from(v);
    state.fixed_rows_mut::<3>(6).copy_from(w);
    state
}

#[cfg(test)]
mod tests {
    use super::*;

    fn forces() -> Forces {
        let published = FlightConstants {
            drag: 0.47,
            magnus: 0.12,
            magnus_saturation: 0.0,
            ..FlightConstants::default()
        };
        Forces::new(&published, &Ball::default())
    }

    /// Hard strokes with heavy spin, and a ball let fall.
    fn strokes() -> [State; 3] {
        let state = |p: [f64; 3], v: [f64; 3], w: [f64; 3]| join(&p.into(), &v.into(), &w.into());
        [
            state([0.0, -1.5, 0.3], [2.0, 28.0, 1.0], [-800.0, 50.0, 200.0]),
            state([0.0, 1.5, 0.3], [-1.0, -6.0, 3.0], [300.0, 0.0, -400.0]),
            state([0.3, 0.0, 1.0], [0.0; 3], [0.0; 3]),
        ]
    }

    #[test]
    fn the_constants_are_those_of_the_formulas() {
        let f = forces();
        // ½ · 1.204 · 0.47 · π 0.02² / 0.0027 and 0.12 · 1.204 · 4/3 π 0.02³ / 0.0027, by hand.
        assert!((f.drag_per_m - 0.131_686).abs() < 1e-5, "{}", f.drag_per_m);
        assert!((f.magnus - 0.001_793_1).abs() < 1e-6, "{}", f.magnus);
    }

    #[test]
    fn topspin_pulls_the_ball_down_and_drag_slows_it() {
        // Flying along +y, the top of the ball moving forward: ω along −x.
        let state = join(&Vector3::zeros(), &Vector3::new(0.0, 10.0, 0.0), &Vector3::new(-100.0, 0.0, 0.0));
        let change = (forces().step(&state, 1e-4) - state) / 1e-4;
        assert!(change[5] < -GRAVITY_M_S2 - 1.0 && change[4] < -10.0, "{change}");
    }

    #[test]
    fn a_second_of_20_ms_steps_is_within_a_tenth_of_a_millimetre_of_10_us_steps() {
        let f = forces();
        for stroke in strokes() {
            let run = |h: f64| (0..(1.0 / h).round() as u32).fold(stroke, |s, _| f.step(&s, h));
            let error = (run(0.02) - run(1e-5)).fixed_rows::<3>(0).norm();
            assert!(error < 1e-4, "{error} m");
        }
    }

    #[test]
    fn the_transition_matches_central_differences() {
        let f = forces();
        for stroke in strokes().into_iter().take(2) {
            let h = 0.01;
            let analytic = f.transition(&f.step(&stroke, 0.5 * h), h);
            for column in 0..STATE {
                let d = if (6..9).contains(&column) { 1e-2 } else { 1e-4 };
                let mut e = State::zeros();
                e[column] = d;
                let numeric = (f.step(&(stroke + e), h) - f.step(&(stroke - e), h)) / (2.0 * d);
                let error = (numeric - analytic.column(column)).norm();
                assert!(error < 3e-4 * (1.0 + numeric.norm()), "column {column}: {error}");
            }
        }
    }
}
