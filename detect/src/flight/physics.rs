//! The forces on a flying ball.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use netcord_common::rig::{Ball, FlightConstants};

/// How many numbers make a [`State`].
pub const STATE: usize = 14;
/// Place of the logarithm of this ball's drag over the rig file's.
pub const DRAG: usize = 9;
/// Place of this table's normal restitution less the rig file's.
pub const RESTITUTION: usize = 10;
/// Place of the two horizontal accelerations of the frame, m/s²: a table's normal is not quite plumb, and
/// air moves.
pub const SLANT: usize = 11;
/// Place of the logarithm of this table's friction over the rig file's.
pub const FRICTION: usize = 13;

/// Position (m), velocity (m/s) and spin (rad/s) of the ball, and properties of ball and table that differ
/// from the rig file's by a little and are learned from flight to flight: [`DRAG`], [`RESTITUTION`],
/// [`SLANT`] and [`FRICTION`].
pub type State = SVector<f64, STATE>;
/// Covariance of a [`State`], and derivatives of one by another.
pub type StateMatrix = SMatrix<f64, STATE, STATE>;

/// What bends and slows a flight, reduced to accelerations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Forces {
    /// Free fall, m/s².
    pub gravity_m_s2: Vector3<f64>,
    /// k_D in a = −k_D |v| v, 1/m: ρ C_d A / 2 m.
    pub drag_per_m: f64,
    /// k_M in a = k_M ω × v / √(1 + c² S²), without unit: C_M ρ V / m.
    pub magnus: f64,
    /// c above, where S = r |ω × v| / v² is the spin parameter.
    pub magnus_saturation: f64,
    /// k_I in a = −k_I |a_M|² v / |v|³, s²/m: the drag that comes with the lift a_M.
    pub induced_s2_per_m: f64,
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
        // a = κ C v² turns coefficients into accelerations; C_L² of the induced drag is (|a_M| / κ v²)².
        let per_coefficient = 0.5 * density_over_mass * area;
        let induced = if per_coefficient > 0.0 { constants.drag_induced / per_coefficient } else { 0.0 };
        Self {
            gravity_m_s2: Vector3::new(0.0, 0.0, -constants.gravity_m_s2),
            drag_per_m: per_coefficient * constants.drag,
            magnus: density_over_mass * constants.magnus * volume,
            magnus_saturation: constants.magnus_saturation,
            induced_s2_per_m: induced,
            radius_m: r,
        }
    }

    /// Acceleration at velocity `v` and spin `w`, m/s².
    ///
    /// Lift grows in proportion to slow spins only. Of the balls of a launcher whose spins were measured, C_L
    /// is 0.10, 0.18, 0.24 at S = 0.12, 0.3, 0.5 and stays there up to 1: hence the root. Their drag grows
    /// with the square of the lift, as that of wings does.
    fn acceleration(&self, v: &Vector3<f64>, w: &Vector3<f64>, own: &Own) -> Vector3<f64> {
        let turned = w.cross(v);
        let v2 = v.norm_squared().max(1e-6);
        let speed = v2.sqrt();
        let cs = self.magnus_saturation * self.radius_m * turned.norm() / v2;
        let lift = turned * (self.magnus / (1.0 + cs * cs).sqrt());
        let induced = self.induced_s2_per_m * lift.norm_squared() / (v2 * speed);
        own.gravity_m_s2 - v * (own.resistance * (self.drag_per_m * speed + induced)) + lift
    }

    /// ∂(acceleration without gravity)/∂v and /∂ω, and the drag's part of the acceleration.
    fn derivatives(
        &self,
        v: &Vector3<f64>,
        w: &Vector3<f64>,
        resistance: f64,
    ) -> (Matrix3<f64>, Matrix3<f64>, Vector3<f64>) {
        let turned = w.cross(v);
        let (length, v2) = (turned.norm(), v.norm_squared().max(1e-6));
        let speed = v2.sqrt();
        let cs = self.magnus_saturation * self.radius_m * length / v2;
        let divisor2 = 1.0 + cs * cs;
        let k = self.magnus / divisor2.sqrt();
        let (turned_by_v, turned_by_w) = (w.cross_matrix(), -v.cross_matrix());
        let along = if length > 1e-9 { turned / length } else { Vector3::zeros() };
        let scale = self.magnus_saturation * self.radius_m / v2;
        let cs_by_v = scale * (turned_by_v.transpose() * along - v * (2.0 * length / v2));
        let cs_by_w = scale * (turned_by_w.transpose() * along);
        let loss = cs / divisor2;
        let lift = k * turned;
        let lift_by_v = k * (turned_by_v - loss * turned * cs_by_v.transpose());
        let lift_by_w = k * (turned_by_w - loss * turned * cs_by_w.transpose());

        let heading = v / speed;
        let projector = heading * heading.transpose();
        let drag_by_v = self.drag_per_m * speed * (Matrix3::identity() + projector);
        // Of |a_M|² v / |v|³.
        let (induced, cubed) = (self.induced_s2_per_m, v2 * speed);
        let lift2 = lift.norm_squared();
        let by_lift = v * lift.transpose() * (2.0 * induced / cubed);
        let induced_by_v =
            by_lift * lift_by_v + (Matrix3::identity() - 3.0 * projector) * (induced * lift2 / cubed);
        let drag = -v * (resistance * (self.drag_per_m * speed + induced * lift2 / cubed));
        (
            lift_by_v - resistance * (drag_by_v + induced_by_v),
            lift_by_w - resistance * by_lift * lift_by_w,
            drag,
        )
    }

    /// The state `h` seconds later in free flight, by one Runge–Kutta step of fourth order. At table
    /// tennis speeds a step of 20 ms errs by less than 1 µm.
    pub fn step(&self, state: &State, h: f64) -> State {
        let (p, v, w) = split(state);
        let own = &Own::of(self, state);
        let a1 = self.acceleration(&v, &w, own);
        let v2 = v + 0.5 * h * a1;
        let a2 = self.acceleration(&v2, &w, own);
        let v3 = v + 0.5 * h * a2;
        let a3 = self.acceleration(&v3, &w, own);
        let v4 = v + h * a3;
        let a4 = self.acceleration(&v4, &w, own);
        let mut after = *state;
        after.fixed_rows_mut::<3>(0).copy_from(&(p + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)));
        after.fixed_rows_mut::<3>(3).copy_from(&(v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)));
        after
    }

    /// ∂(state after `h`)/∂(state before), from the accelerations' derivatives in the middle of the
    /// step, to third order in `h`.
    pub fn transition(&self, middle: &State, h: f64) -> StateMatrix {
        let (_, v, w) = split(middle);
        let (by_v, by_w, by_drag) = self.derivatives(&v, &w, middle[DRAG].exp());
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
        f.fixed_view_mut::<3, 1>(0, DRAG).copy_from(&(to_p * by_drag));
        f.fixed_view_mut::<3, 1>(3, DRAG).copy_from(&(to_v * by_drag));
        f.fixed_view_mut::<3, 2>(0, SLANT).copy_from(&to_p.fixed_columns::<2>(0));
        f.fixed_view_mut::<3, 2>(3, SLANT).copy_from(&to_v.fixed_columns::<2>(0));
        f
    }
}

/// What is peculiar to one ball and frame.
struct Own {
    /// Drag over the rig file's.
    resistance: f64,
    /// Free fall in the frame of the positions, m/s².
    gravity_m_s2: Vector3<f64>,
}

impl Own {
    fn of(forces: &Forces, state: &State) -> Self {
        Self {
            resistance: state[DRAG].exp(),
            gravity_m_s2: forces.gravity_m_s2 + Vector3::new(state[SLANT], state[SLANT + 1], 0.0),
        }
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
            gravity_m_s2: 9.81,
            drag: 0.47,
            magnus: 0.12,
            magnus_saturation: 0.0,
            drag_induced: 0.0,
            ..FlightConstants::default()
        };
        Forces::new(&published, &Ball::default())
    }

    fn fitted() -> Forces {
        Forces::new(&FlightConstants::default(), &Ball::default())
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
        assert!(change[5] < -9.81 - 1.0 && change[4] < -10.0, "{change}");
    }

    #[test]
    fn a_second_of_20_ms_steps_is_within_a_tenth_of_a_millimetre_of_10_us_steps() {
        let f = fitted();
        for stroke in strokes() {
            let run = |h: f64| (0..(1.0 / h).round() as u32).fold(stroke, |s, _| f.step(&s, h));
            let error = (run(0.02) - run(1e-5)).fixed_rows::<3>(0).norm();
            assert!(error < 1e-4, "{error} m");
        }
    }

    #[test]
    fn the_transition_matches_central_differences() {
        for (f, stroke) in [forces(), fitted()].into_iter().flat_map(|f| strokes().map(|s| (f, s))).take(5) {
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
