//! What the ball does when it touches table, net or floor.

use nalgebra::{Matrix2, Vector2};
use netcord_common::rig::FlightConstants;

use super::physics::{FRICTION, RESTITUTION, State, StateMatrix};

/// Half the width of the table, m (ITTF 2.1: 1.525 m).
pub const TABLE_HALF_WIDTH_M: f64 = 0.7625;
/// Half the length of the table, m (ITTF 2.1: 2.74 m).
pub const TABLE_HALF_LENGTH_M: f64 = 1.37;
/// Height of the table above the floor, m.
pub const TABLE_HEIGHT_M: f64 = 0.76;
/// Height of the net above the table, m.
pub const NET_HEIGHT_M: f64 = 0.1525;
/// Half the width of the net, m: it reaches 0.1525 m past each side line.
pub const NET_HALF_WIDTH_M: f64 = TABLE_HALF_WIDTH_M + 0.1525;

/// Share of the contact point's slip that rolling takes from the velocity of a thin shell (inertia
/// ⅔ m r²): 1 / (1 + m r² / I) = 2/5.
const ROLLING_SHARE: f64 = 0.4;
/// What is left of the speed along the net's normal after a net contact: it stops most balls.
const NET_RESTITUTION: f64 = 0.1;
/// What is left of the other components after a net contact.
const NET_GRAZE: f64 = 0.5;

/// A surface that balls bounce on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Normal restitution at zero speed.
    pub restitution: f64,
    /// Its loss per m/s of normal speed.
    pub restitution_slope_s_m: f64,
    /// Coefficient of sliding friction.
    pub friction: f64,
    /// Radius of the ball, m.
    pub radius_m: f64,
}

/// How far a bounce differs from what the model says, as standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BounceScatter {
    /// Of the normal speed after it, per m/s before it.
    pub normal: f64,
    /// Of each tangential speed after it, per m/s of change.
    pub tangential: f64,
    /// Of each tangential speed after it, beside that, m/s.
    pub tangential_floor_m_s: f64,
}

impl Surface {
    /// The table of a rig file.
    pub fn table(constants: &FlightConstants, radius_m: f64) -> Self {
        Self {
            restitution: constants.restitution,
            restitution_slope_s_m: constants.restitution_slope_s_m,
            friction: constants.friction,
            radius_m,
        }
    }

    /// A floor of unknown make.
    pub fn floor(radius_m: f64) -> Self {
        Self { restitution: 0.8, restitution_slope_s_m: 0.02, friction: 0.3, radius_m }
    }

    /// Restitution at the normal speed `n` and its derivative by it; from a third to 1: the straight
    /// line is measured up to about 8 m/s only.
    fn restitution_at(&self, n: f64, offset: f64) -> (f64, f64) {
        let e = self.restitution + offset - self.restitution_slope_s_m * n;
        if (0.33..1.0).contains(&e) { (e, -self.restitution_slope_s_m) } else { (e.clamp(0.33, 1.0), 0.0) }
    }

    /// The state just after a bounce on this horizontal surface, and its derivative by the state just
    /// before, at a fixed instant. The impulse along the normal is (1 + e) m v_n; friction turns
    /// the slip of the contact point u = v + ω × (−r ẑ) by Coulomb's law until the ball rolls, whichever
    /// is less (Garwin 1969; Nakashima et al. 2010, "Modeling of rebound phenomenon of a rigid ball
    /// with friction and elastic effects").
    pub fn bounce(&self, state: &State) -> (State, StateMatrix) {
        let r = self.radius_m;
        let n = (-state[5]).max(0.0);
        let (e, e_by_n) = self.restitution_at(n, state[RESTITUTION]);
        let slip = Vector2::new(state[3] - r * state[7], state[4] + r * state[6]);
        let slip_speed = slip.norm();
        let friction = self.friction * state[FRICTION].exp();
        let limit = friction * (1.0 + e) * n;

        // Change of the tangential velocity is −turned.
        let (turned, by_slip, by_n) = if ROLLING_SHARE * slip_speed <= limit {
            (ROLLING_SHARE * slip, Matrix2::identity() * ROLLING_SHARE, Vector2::zeros())
        } else {
            let along = slip / slip_speed;
            let limit_by_n = friction * (1.0 + e + n * e_by_n);
            (
                limit * along,
                (Matrix2::identity() - along * along.transpose()) * (limit / slip_speed),
                along * limit_by_n,
            )
        };

        // Angular momentum about the contact point: Δω = 3/(2r) (−turned_y, turned_x) for the shell.
        let lever = 1.5 / r;
        let mut after = *state;
        after[3] -= turned.x;
        after[4] -= turned.y;
        after[5] = e * n;
        after[6] -= lever * turned.y;
        after[7] += lever * turned.x;

        // Rows of ∂turned/∂(v_x v_y v_z ω_x ω_y); n = −v_z.
        let column = |c: usize| -> Vector2<f64> {
            match c {
                3 => by_slip.column(0).into_owned(),
                4 => by_slip.column(1).into_owned(),
                5 => -by_n,
                6 => by_slip.column(1) * r,
                7 => by_slip.column(0) * -r,
                _ => Vector2::zeros(),
            }
        };
        let mut d = StateMatrix::identity();
        d[(5, 5)] = -(e + n * e_by_n);
        d[(5, RESTITUTION)] = n;
        // The friction's limit grows with the impulse.
        let slides = ROLLING_SHARE * slip_speed > limit;
        let along = if slides { slip / slip_speed } else { Vector2::zeros() };
        for (place, turned_by) in [(RESTITUTION, along * (friction * n)), (FRICTION, along * limit)] {
            d[(3, place)] = -turned_by.x;
            d[(4, place)] = -turned_by.y;
            d[(6, place)] = -lever * turned_by.y;
            d[(7, place)] = lever * turned_by.x;
        }
        for c in 3..8 {
            let t = column(c);
            d[(3, c)] -= t.x;
            d[(4, c)] -= t.y;
            d[(6, c)] -= lever * t.y;
            d[(7, c)] += lever * t.x;
        }
        (after, d)
    }

    /// By how much friction is stronger than what rolling takes, m/s, and its derivative by the state: above
    /// zero the ball rolls when it leaves, below it still slides.
    pub fn grip(&self, state: &State) -> (f64, State) {
        let r = self.radius_m;
        let n = (-state[5]).max(0.0);
        let (e, e_by_n) = self.restitution_at(n, state[RESTITUTION]);
        let slip = Vector2::new(state[3] - r * state[7], state[4] + r * state[6]);
        let along = slip / slip.norm().max(1e-9);
        let friction = self.friction * state[FRICTION].exp();
        let limit = friction * (1.0 + e) * n;
        let mut by = State::zeros();
        by[3] = -ROLLING_SHARE * along.x;
        by[4] = -ROLLING_SHARE * along.y;
        by[5] = -friction * (1.0 + e + n * e_by_n);
        by[6] = -ROLLING_SHARE * r * along.y;
        by[7] = ROLLING_SHARE * r * along.x;
        by[RESTITUTION] = friction * n;
        by[FRICTION] = limit;
        (limit - ROLLING_SHARE * slip.norm(), by)
    }

    /// Covariance that a bounce adds, from its states before and after.
    pub fn scatter(&self, scatter: &BounceScatter, before: &State, after: &State) -> StateMatrix {
        let sigma_n = scatter.normal * before[5].abs();
        let change = Vector2::new(after[3] - before[3], after[4] - before[4]);
        let sigma_t = (scatter.tangential * change.norm()).hypot(scatter.tangential_floor_m_s);
        let lever = 1.5 / self.radius_m;
        let mut q = StateMatrix::zeros();
        q[(5, 5)] = sigma_n * sigma_n;
        // What friction takes from the velocity it gives to the spin: fully correlated.
        let var = sigma_t * sigma_t;
        for (v, w, sign) in [(3, 7, -1.0), (4, 6, 1.0)] {
            q[(v, v)] += var;
            q[(w, w)] += var * lever * lever;
            q[(v, w)] += sign * var * lever;
            q[(w, v)] += sign * var * lever;
        }
        q
    }
}

/// The state just after touching the net (the plane y = 0), and the covariance that it adds: where the
/// ball goes from there is hardly known.
pub fn net_contact(state: &State) -> (State, StateMatrix, StateMatrix) {
    let mut d = StateMatrix::identity();
    d[(3, 3)] = NET_GRAZE;
    d[(4, 4)] = -NET_RESTITUTION;
    d[(5, 5)] = NET_GRAZE;
    let after = d * state;
    let mut q = StateMatrix::zeros();
    let scale = 0.2 * state[4].abs() + 0.3;
    for axis in 3..6 {
        q[(axis, axis)] = scale * scale;
    }
    for axis in 6..9 {
        q[(axis, axis)] = 50.0 * 50.0;
    }
    (after, d, q)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::flight::physics::{STATE, join};

    fn table() -> Surface {
        Surface { restitution: 0.98, restitution_slope_s_m: 0.02, friction: 0.25, radius_m: 0.02 }
    }

    fn state(v: [f64; 3], w: [f64; 3]) -> State {
        join(&Vector3::new(0.1, 0.2, 0.02), &v.into(), &w.into())
    }

    #[test]
    fn a_ball_without_slip_only_loses_normal_speed() {
        // ω_x = −v_y / r: rolls.
        let before = state([0.0, 4.0, -3.0], [-200.0, 0.0, 30.0]);
        let (after, _) = table().bounce(&before);
        assert!((after[5] - 3.0 * (0.98 - 0.06)).abs() < 1e-12);
        assert!((after[4] - 4.0).abs() < 1e-12 && (after[6] + 200.0).abs() < 1e-9);
    }

    #[test]
    fn friction_leaves_rolling_or_takes_its_limit() {
        let r = 0.02;
        let soft = state([0.5, 1.0, -4.0], [0.0; 3]);
        let (after, _) = table().bounce(&soft);
        // Rolling: the contact point rests.
        assert!((after[3] - r * after[7]).abs() < 1e-12 && (after[4] + r * after[6]).abs() < 1e-12);
        let hard = state([0.0, 15.0, -1.0], [300.0, 0.0, 0.0]);
        let (after, _) = table().bounce(&hard);
        assert!((after[4] - (15.0 - 0.25 * 1.96)).abs() < 1e-9, "{}", after[4]);
        // Angular momentum about the contact point is kept: ⅔ r ω_x − v_y.
        for (b, a) in [(soft, table().bounce(&soft).0), (hard, after)] {
            let about = |s: &State| [2.0 / 3.0 * r * s[6] - s[4], 2.0 / 3.0 * r * s[7] + s[3]];
            assert!(
                (about(&b)[0] - about(&a)[0]).abs() < 1e-12 && (about(&b)[1] - about(&a)[1]).abs() < 1e-12
            );
        }
    }

    #[test]
    fn derivatives_match_central_differences_while_it_slips_and_while_it_rolls() {
        for before in
            [state([0.5, 1.0, -4.0], [20.0, -10.0, 5.0]), state([2.0, 15.0, -2.0], [300.0, 40.0, 9.0])]
        {
            let (_, analytic) = table().bounce(&before);
            for column in 0..STATE {
                let mut e = State::zeros();
                e[column] = 1e-5;
                let numeric = (table().bounce(&(before + e)).0 - table().bounce(&(before - e)).0) / 2e-5;
                assert!((numeric - analytic.column(column)).norm() < 1e-5, "column {column}");
            }
        }
    }
}
